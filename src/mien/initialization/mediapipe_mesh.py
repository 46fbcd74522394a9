"""MediaPipe's Face Mesh and its detector for distant faces, when the extra `auto` is installed."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections.abc import Iterator
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np

from mien.frame import Pixels
from mien.geometry.rotation import Array
from mien.initialization.landmarks import Place


class MediaPipeMesh:
    """Face Mesh with refined lids and lips, and the detector for distant faces, which is made when it is first
    asked."""

    def __init__(self, faces: int) -> None:
        """faces: the largest number that is looked for. Raises ImportError where MediaPipe is not installed."""
        self.mesh = import_solution("face_mesh", "FaceMesh")(
            static_image_mode=True, max_num_faces=faces, refine_landmarks=True, min_detection_confidence=0.5
        )
        self.detection: Any = None

    def faces(self, pixels: Pixels) -> list[Array]:
        """Points (478, 3) of every face of an image (H, W, 3) that is large enough in it to be seen; see
        `read_faces`."""
        return read_faces(self.mesh, pixels)

    def places(self, pixels: Pixels) -> list[Place]:
        """Where there may be a face, near or distant."""
        if self.detection is None:
            self.detection = import_solution("face_detection", "FaceDetection")(model_selection=1)
        places = []
        for found in self.detection.process(np.ascontiguousarray(pixels)).detections or []:
            box, extent = found.location_data.relative_bounding_box, pixels.shape[1::-1]
            size = np.array([box.width, box.height]) * extent
            places.append((np.array([box.xmin, box.ymin]) * extent + 0.5 * size, float(size.max())))
        return places


def read_faces(mesh: Any, pixels: Any) -> list[Array]:
    """Points (478, 3) in pixels of every face; the third is depth relative to the head's centre."""
    height, width = pixels.shape[:2]
    answer = mesh.process(np.ascontiguousarray(pixels)).multi_face_landmarks or []
    # Its pixels are counted from the centre of the first: with half a pixel taken off, as from its edge, what is found
    # in a mirrored picture lies half a pixel beside what is found in the picture, however large both are drawn.
    return [np.array([[p.x * width, p.y * height, p.z * width] for p in f.landmark]) for f in answer]


def import_solution(module: str, name: str) -> Any:
    """One of MediaPipe's solutions. What draws their results comes with them and imports Matplotlib, which takes half a
    second: that is put off until somebody draws.

    Raises ImportError where MediaPipe is not installed.
    """
    names = ("matplotlib", "matplotlib.pyplot")
    later = {} if names[0] in sys.modules else {name: _Later(name) for name in names}
    if later:
        vars(later[names[0]])["pyplot"] = later[names[1]]
    sys.modules.update(later)
    try:
        return getattr(import_module(f"mediapipe.python.solutions.{module}"), name)
    finally:
        for name in later:
            del sys.modules[name]


class _Later(ModuleType):
    """Stands for a module until something of it is asked for."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(import_module(self.__name__), name)


class _Silence:
    """MediaPipe logs to the process's standard error from C++; keep that off the user's screen, and on it what Python
    writes there: from the first to the last of those who want it so, in whatever threads, as there is one for all."""

    def __init__(self) -> None:
        self.lock, self.wanted, self.kept = threading.Lock(), 0, contextlib.ExitStack()

    def __enter__(self) -> None:
        with self.lock:
            if self.wanted == 0:
                self.kept.enter_context(_off_screen())
            self.wanted += 1

    def __exit__(self, *raised: object) -> None:
        with self.lock:
            self.wanted -= 1
            if self.wanted == 0:
                self.kept.close()


_silence = _Silence()


def silenced() -> _Silence:
    """The one silence of this process, for a `with`."""
    return _silence


@contextlib.contextmanager
def _off_screen() -> Iterator[None]:
    """Standard error goes nowhere, but for what Python writes to it."""
    own, saved, null = sys.stderr, os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)
    with os.fdopen(saved, "w", buffering=1, closefd=False) as screen:
        if own is sys.__stderr__:
            sys.stderr = screen
        try:
            yield
        finally:
            sys.stderr = own
            screen.flush()
            os.dup2(saved, 2)
            os.close(saved)
            os.close(null)
