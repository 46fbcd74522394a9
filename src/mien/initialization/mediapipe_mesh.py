"""MediaPipe's Face Mesh and its detector for distant faces; needs the extra `auto`."""

from __future__ import annotations

import atexit
import contextlib
import os
import re
import sys
import tempfile
import threading
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any, TextIO

import numpy as np

from mien.arrays import Array, Pixels
from mien.errors import require
from mien.initialization.landmarks import Place


class MediaPipeMesh:
    """Face Mesh with refined lids and lips, and the detector for distant faces, which is created on first use."""

    def __init__(self, faces: int) -> None:
        """faces: maximum number of faces. Raises ImportError if MediaPipe is not installed."""
        self.mesh = face_mesh(faces, static=True)
        self.detection: Any = None

    def faces(self, pixels: Pixels) -> list[Array]:
        """Points (478, 3) of every detected face of an image (H, W, 3), RGB; see `read_faces`."""
        with silenced():
            return read_faces(self.mesh, pixels)

    def places(self, pixels: Pixels) -> list[Place]:
        """Candidate places of near and distant faces."""
        with silenced():
            if self.detection is None:
                self.detection = import_solution("face_detection", "FaceDetection")(model_selection=1)
            answer = self.detection.process(np.ascontiguousarray(pixels)).detections or []
        places = []
        for found in answer:
            box, extent = found.location_data.relative_bounding_box, pixels.shape[1::-1]
            size = np.array([box.width, box.height]) * extent
            places.append((np.array([box.xmin, box.ymin]) * extent + 0.5 * size, float(size.max())))
        return places


_process: int | None = None
"""The process that has made a mesh."""


def face_mesh(faces: int, static: bool) -> Any:
    """MediaPipe's Face Mesh with refined lids and lips, for at most so many faces. static: whether it detects them in
    each image, instead of following them. Raises ImportError if MediaPipe is not installed, and MienError in a process
    that was forked from one that has such a mesh: there it would wait for threads that it does not have."""
    global _process
    require(
        _process in (None, os.getpid()),
        "this process was forked from one that had looked for a face, which MediaPipe does not survive; start "
        'processes by multiprocessing.get_context("spawn"), or before a face is looked for',
    )
    with silenced():
        create = import_solution("face_mesh", "FaceMesh")
        _process = os.getpid()
        mesh = create(static_image_mode=static, max_num_faces=faces, refine_landmarks=True)
        read_faces(mesh, np.zeros((8, 8, 3), np.uint8))  # its threads log until they are ready
    return mesh


def read_faces(mesh: Any, pixels: Pixels) -> list[Array]:
    """Points (478, 3) in pixels of every face of an image (H, W, 3), RGB; the third is depth relative to the head's
    centre."""
    height, width = pixels.shape[:2]
    answer = mesh.process(np.ascontiguousarray(pixels)).multi_face_landmarks or []
    # Its pixel coordinates have their origin at the centre of the first pixel: if half a pixel is subtracted, as for an
    # origin at its edge, results in an image and in its mirror image differ by half a pixel, at any scale.
    return [np.array([[p.x * width, p.y * height, p.z * width] for p in f.landmark]) for f in answer]


_NOT_NEEDED = ("matplotlib", "matplotlib.pyplot", "sounddevice")


def import_solution(module: str, name: str) -> Any:
    """Import one of MediaPipe's solutions without Matplotlib, which their drawing code imports and which takes half a
    second, and without sounddevice, which opens the audio of the machine: these are imported on first use.

    Raises ImportError if MediaPipe is not installed.
    """
    lazy = {name: _LazyModule(name) for name in _NOT_NEEDED if name not in sys.modules}
    if "matplotlib" in lazy:
        vars(lazy["matplotlib"])["pyplot"] = lazy["matplotlib.pyplot"]
    sys.modules.update(lazy)
    try:
        return getattr(import_module(f"mediapipe.python.solutions.{module}"), name)
    finally:
        for placeholder in lazy:
            sys.modules.pop(placeholder, None)  # another thread may have removed it


class _LazyModule(ModuleType):
    """Placeholder for a module that is imported when an attribute is first accessed."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(import_module(self.__name__), name)


_NATIVE_LOG = re.compile(
    rb"^(?:[IWEF]\d{4,8} [\d:.]+ +\d+ \S+:\d+\] |INFO: .*TensorFlow Lite|WARNING: All log messages before absl).*\n?",
    re.MULTILINE,
)
"""A line of MediaPipe's log."""


class _NativeLogFilter:
    """Context manager that discards what MediaPipe logs to standard error from C++, and keeps what others write there.

    The process has one standard error, so all threads share the filter: it is active while any of them needs it.
    """

    def __init__(self) -> None:
        self.lock, self.users, self.active = threading.Lock(), 0, contextlib.ExitStack()

    def __enter__(self) -> None:
        with self.lock:
            if self.users == 0:
                self.active.enter_context(_native_log_discarded())
            self.users += 1

    def __exit__(self, *raised: object) -> None:
        with self.lock:
            self.users -= 1
            if self.users == 0:
                self.active.close()


_filter = _NativeLogFilter()


def silenced() -> _NativeLogFilter:
    """The log filter of this process, for a `with` block."""
    return _filter


@contextlib.contextmanager
def _native_log_discarded() -> Iterator[None]:
    """Hold back what is written to standard error, and discard the native log in it. What Python writes to `sys.stderr`
    is not held back, but others may have kept that as it was before, as a handler of `logging` does."""
    try:
        os.fstat(2)
        held = tempfile.TemporaryFile()  # noqa: SIM115 - closed below
    except OSError:  # there is no standard error, or no place for the file
        yield
        return
    screen = _screen()
    os.dup2(2, screen.fileno(), inheritable=False)
    own = sys.stderr
    os.dup2(held.fileno(), 2)
    if own is sys.__stderr__:
        sys.stderr = screen
    try:
        yield
    finally:
        sys.stderr = own
        screen.flush()
        os.dup2(screen.fileno(), 2)
        with held, contextlib.suppress(OSError):  # nobody may read it any more
            held.seek(0)
            screen.buffer.write(_NATIVE_LOG.sub(b"", held.read()))
            screen.flush()


@cache
def _screen() -> TextIO:
    """Where Python writes meanwhile. It stays open: another thread may have kept it as its standard error."""
    encoding = sys.__stderr__.encoding if sys.__stderr__ else "utf-8"
    screen = os.fdopen(os.dup(2), "w", 1, encoding, "backslashreplace")
    atexit.register(screen.close)
    return screen
