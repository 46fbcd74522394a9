"""The command line, and the jobs of an evaluation, in processes that are forked from one which has imported this: what
tracking a video needs, of code and compiled kernels, is there already.

Nothing here starts a thread, which a forked process would be without, but for one of Arrow's allocator, which knows of
forks.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from importlib import import_module

from mien.cli import main
from mien.initialization.mediapipe_mesh import import_solution
from mien.output.columns import import_pandas
from mien.tracking import first_run

for _module in ("mien.evaluation.job", "mien.faces", "mien.tracking.realtime", "pyarrow.csv", "pyarrow.parquet"):
    import_module(_module)
import_pandas()
for _solution in (("face_mesh", "FaceMesh"), ("face_detection", "FaceDetection")):
    with suppress(ImportError):
        import_solution(*_solution)
first_run.load_cached()


def run(*arguments: str) -> None:
    """What `mien` does with these arguments."""
    sys.argv = ["mien", *arguments]
    main()
