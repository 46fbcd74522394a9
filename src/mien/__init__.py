"""mien: 3D head pose and facial expression from video, with calibrated uncertainty."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from mien._version import __version__

if TYPE_CHECKING:  # for editors and type checkers only; at run time `__getattr__` loads each name
    from mien.candide.model import Candide
    from mien.errors import MienError, MienWarning
    from mien.faces import track_faces
    from mien.frame import Frame
    from mien.geometry.camera import Camera
    from mien.initialization.landmarks import Landmarks
    from mien.live import stream
    from mien.output.track import Track
    from mien.pipeline.track import track
    from mien.tracking.state import EXPRESSION_NAMES, Closing, Estimate, Status, TrackedLandmarks, Tracker

# Loaded on first use, so that `import mien` and `mien --help` stay fast.
_HOME = {
    "EXPRESSION_NAMES": "mien.tracking.state",
    "Camera": "mien.geometry.camera",
    "Candide": "mien.candide.model",
    "Closing": "mien.tracking.state",
    "Estimate": "mien.tracking.state",
    "Frame": "mien.frame",
    "Landmarks": "mien.initialization.landmarks",
    "MienError": "mien.errors",
    "MienWarning": "mien.errors",
    "Status": "mien.tracking.state",
    "Track": "mien.output.track",
    "TrackedLandmarks": "mien.tracking.state",
    "Tracker": "mien.tracking.state",
    "stream": "mien.live",
    "track": "mien.pipeline.track",
    "track_faces": "mien.faces",
}
__all__ = [
    "EXPRESSION_NAMES",
    "Camera",
    "Candide",
    "Closing",
    "Estimate",
    "Frame",
    "Landmarks",
    "MienError",
    "MienWarning",
    "Status",
    "Track",
    "TrackedLandmarks",
    "Tracker",
    "__version__",
    "stream",
    "track",
    "track_faces",
]


if not TYPE_CHECKING:  # a type checker would take any name for one of the package's

    def __getattr__(name: str) -> Any:
        if name not in _HOME:
            raise AttributeError(f"module 'mien' has no attribute {name!r}")
        return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return __all__
