"""Faces of a frame found by MediaPipe, when the extra `auto` is installed.

The network is asked several times, on slightly turned and scaled copies of the frame, and its answers are
averaged: everything that follows rests on this one frame. What it sees in the frame and in few of the copies is no
face: a texture that happens to look like one.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterable, Iterator
from importlib import import_module
from types import ModuleType
from typing import Any

import cv2
import numpy as np

from mien.errors import MienError
from mien.geometry.rotation import Array
from mien.initialization.landmarks import Landmarks
from mien.video import Frame

NO_DETECTOR = (
    "no landmarks were given and no face detector is installed: install it with "
    "pip install 'mien[auto]' (Python 3.10 to 3.12), or annotate the first frame and pass --landmarks FILE"
)
_COPIES = ((0.0, 1.0), (-8.0, 0.95), (8.0, 0.95), (-4.0, 1.1), (4.0, 1.1), (0.0, 0.85))
"""Turn in degrees and scale of each copy of the frame."""
_MAXIMUM_FACES = 8
_SAME_PLACE = 0.5
"""Mean distance of two faces' points, over their size, below which the later may be the earlier one."""


def detect(frame: Frame) -> list[Landmarks]:
    """The faces of a frame, largest first, scheme `mediapipe478`, with depths.

    Raises MienError where MediaPipe is not installed.
    """
    found = first_with_a_face([frame])
    return [] if found is None else found[1]


def first_with_a_face(frames: Iterable[Frame]) -> tuple[Frame, list[Landmarks]] | None:
    """The first frame in which there is a face, with the faces of it as `detect` gives them; None where none has one.

    Raises MienError where MediaPipe is not installed.
    """
    with _face_mesh(_MAXIMUM_FACES) as mesh:
        for frame in frames:
            seen_again = (_average(frame, face) for face in _largest_first(mesh, frame))
            faces = [_landmarks(frame, face) for face in seen_again if face is not None]
            if faces:
                return frame, faces
    return None


def detect_once(frame: Frame) -> Landmarks | None:
    """The largest face of a frame from a single look, for finding a face again; None where there is none.

    Raises MienError where MediaPipe is not installed.
    """
    with _face_mesh(_MAXIMUM_FACES) as mesh:
        faces = _largest_first(mesh, frame)
    return _landmarks(frame, faces[0]) if faces else None


def follow(face: Landmarks, frames: Iterable[Frame]) -> Iterator[tuple[Frame, Landmarks]]:
    """A face in later frames, from a single look each; frames that show none where it was last are passed over.

    Raises MienError where MediaPipe is not installed.
    """
    with _face_mesh(_MAXIMUM_FACES) as mesh:
        for frame in frames:
            here = (_landmarks(frame, found) for found in read_faces(mesh, frame.pixels))
            same = min(here, key=lambda found: _apart(found, face), default=face)
            if same is not face and _apart(same, face) < _SAME_PLACE:
                face = same
                yield frame, face


def refine(frame: Frame, face: Landmarks) -> Landmarks | None:
    """A face from a single look, from several; None where they do not show it.

    Raises MienError where MediaPipe is not installed.
    """
    assert face.depths is not None, "a detected face has depths"
    seen_again = _average(frame, np.column_stack([face.points, face.depths]))
    return None if seen_again is None else _landmarks(frame, seen_again)


def _apart(a: Landmarks, b: Landmarks) -> float:
    """Mean distance of two faces' points over the size of the second."""
    return float(np.linalg.norm(a.points - b.points, axis=1).mean() / np.ptp(b.points, axis=0).max())


def _largest_first(mesh: Any, frame: Frame) -> list[Array]:
    return sorted(read_faces(mesh, frame.pixels), key=lambda f: -float(np.ptp(f[:, :2], axis=0).prod()))


def _landmarks(frame: Frame, face: Array) -> Landmarks:
    return Landmarks(face[:, :2], "mediapipe478", face[:, 2], frame.index, frame.time, "detected face")


def _average(frame: Frame, face: Array) -> Array | None:
    """Mean of one face's points (478, 3) over turned and scaled copies of the image around it; None where less than
    half of the copies show it."""
    centre = 0.5 * (face[:, :2].min(axis=0) + face[:, :2].max(axis=0))
    side = 2.2 * float(np.ptp(face[:, :2], axis=0).max())
    size = int(np.clip(side, 256, 640))
    answers = []
    with _face_mesh(1) as mesh:
        for turn_deg, scale in _COPIES:
            A = _crop_matrix(centre, turn_deg, scale * size / side, size)
            crop = cv2.warpAffine(frame.pixels, A, (size, size), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
            found = read_faces(mesh, crop)
            if found:
                answers.append(_uncrop(found[0], A))
    # A copy in which another face or nothing was found is outvoted.
    near = [a for a in answers if np.abs(a[:, :2] - face[:, :2]).mean() < 0.1 * side]
    return np.mean(near, axis=0) if 2 * len(near) >= len(_COPIES) else None


def _crop_matrix(centre: Array, turn_deg: float, scale: float, size: int) -> Array:
    A = cv2.getRotationMatrix2D((float(centre[0]), float(centre[1])), turn_deg, scale)
    A[:, 2] += 0.5 * (size - 1) - centre
    return np.asarray(A, dtype=float)


def _uncrop(points: Array, A: Array) -> Array:
    inverse = cv2.invertAffineTransform(A)
    scale = float(np.sqrt(abs(np.linalg.det(A[:, :2]))))
    return np.column_stack([points[:, :2] @ inverse[:, :2].T + inverse[:, 2], points[:, 2] / scale])


def read_faces(mesh: Any, pixels: Any) -> list[Array]:
    """Points (478, 3) in pixels of every face; the third is depth relative to the head's centre."""
    height, width = pixels.shape[:2]
    answer = mesh.process(np.ascontiguousarray(pixels)).multi_face_landmarks or []
    # Its pixels are counted from the centre of the first: with half a pixel taken off, as from its edge, what is found
    # in a mirrored picture lies half a pixel beside what is found in the picture, however large both are drawn.
    return [np.array([[p.x * width, p.y * height, p.z * width] for p in f.landmark]) for f in answer]


@contextlib.contextmanager
def _face_mesh(faces: int) -> Iterator[Any]:
    with silenced():
        try:
            face_mesh = import_face_mesh()
        except ImportError as e:
            raise MienError(NO_DETECTOR) from e
        mesh = face_mesh(
            static_image_mode=True, max_num_faces=faces, refine_landmarks=True, min_detection_confidence=0.5
        )
        try:
            yield mesh
        finally:
            mesh.close()


def import_face_mesh() -> Any:
    """MediaPipe's class `FaceMesh`. What draws its results comes with it and imports Matplotlib, which takes half a
    second: that is put off until somebody draws.

    Raises ImportError where MediaPipe is not installed.
    """
    names = ("matplotlib", "matplotlib.pyplot")
    later = {} if names[0] in sys.modules else {name: _Later(name) for name in names}
    if later:
        vars(later[names[0]])["pyplot"] = later[names[1]]
    sys.modules.update(later)
    try:
        from mediapipe.python.solutions.face_mesh import FaceMesh
    finally:
        for name in later:
            del sys.modules[name]
    return FaceMesh


class _Later(ModuleType):
    """Stands for a module until something of it is asked for."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(import_module(self.__name__), name)


@contextlib.contextmanager
def silenced() -> Iterator[None]:
    """MediaPipe logs to the process's standard error from C++; keep that off the user's screen, and on it what Python
    writes there."""
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
