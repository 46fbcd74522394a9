"""Preloaded by the process from which the command line and evaluation jobs are forked, so that a fork starts with all
the code and compiled kernels that tracking needs.

Nothing here may start a thread, as threads do not survive a fork; the one of Arrow's allocator handles forks itself.
"""

from __future__ import annotations

import sys
import warnings
from contextlib import suppress
from importlib import import_module

from mien.cli import main
from mien.terminal import show_warning


def _preload() -> None:
    """Import what tracking needs, and load its kernels."""
    from mien.initialization.mediapipe_mesh import import_solution
    from mien.output.columns import import_pandas
    from mien.tracking.realtime import first_run

    for module in ("mien.evaluation.job", "mien.faces", "mien.tracking.realtime", "pyarrow.csv", "pyarrow.parquet"):
        import_module(module)
    import_pandas()
    for solution in (("face_mesh", "FaceMesh"), ("face_detection", "FaceDetection")):
        with suppress(ImportError):
            import_solution(*solution)
    first_run.load_cached()


warnings.showwarning = show_warning  # of kernels that cannot be kept is warned where they are imported
_preload()


def run(*arguments: str) -> None:
    """Run `mien` with these arguments."""
    sys.argv = ["mien", *arguments]
    main()
