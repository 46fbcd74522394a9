"""Preloaded by the process from which the command line and evaluation jobs are forked, so that a fork starts with all
the code and compiled kernels that tracking needs.

Nothing here may start a thread, as threads do not survive a fork; the one of Arrow's allocator handles forks itself.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from importlib import import_module

from mien.cli import main
from mien.initialization.mediapipe_mesh import import_solution
from mien.output.columns import import_pandas
from mien.tracking.realtime import first_run

for _module in ("mien.evaluation.job", "mien.faces", "mien.tracking.realtime", "pyarrow.csv", "pyarrow.parquet"):
    import_module(_module)
import_pandas()
for _solution in (("face_mesh", "FaceMesh"), ("face_detection", "FaceDetection")):
    with suppress(ImportError):
        import_solution(*_solution)
first_run.load_cached()


def run(*arguments: str) -> None:
    """Run `mien` with these arguments."""
    sys.argv = ["mien", *arguments]
    main()
