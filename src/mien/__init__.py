"""mien: the 3D pose and the expression of a face in a video, with its uncertainty."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from mien._version import __version__

# Loaded on first use, so that `import mien` and `mien --help` stay quick.
_HOME = {
    "Camera": "mien.geometry.camera",
    "Candide": "mien.candide.model",
    "Estimate": "mien.tracking.state",
    "Landmarks": "mien.initialization.landmarks",
    "MienError": "mien.errors",
    "Track": "mien.output.track",
    "Tracker": "mien.tracking.state",
    "stream": "mien.live",
    "track": "mien.pipeline",
    "track_faces": "mien.faces",
}
__all__ = [
    "Camera",
    "Candide",
    "Estimate",
    "Landmarks",
    "MienError",
    "Track",
    "Tracker",
    "__version__",
    "stream",
    "track",
    "track_faces",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'mien' has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return __all__
