"""Faces of a frame: found by MediaPipe when the extra `auto` is installed, else by OpenCV with networks of MediaPipe's.

Either sees faces from about an eighth of the image's width on. Where it sees none, a search for distant faces says
where to look closer, down to a twenty-fifth of the width.

The network is asked several times, on slightly turned, scaled and darkened copies of the frame, and its answers are
averaged: everything that follows rests on this one frame. What it sees in the frame and in few of the copies is no
face: a texture that happens to look like one.
"""

from __future__ import annotations

import contextlib
import math
import os
import threading
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from itertools import product
from operator import itemgetter

import cv2
import numpy as np

from mien.frame import Frame, Pixels
from mien.geometry.rotation import Array
from mien.initialization.landmarks import MINIMUM_FACE_PX, Landmarks, Place, Point, place_of
from mien.initialization.mediapipe_mesh import MediaPipeMesh, silenced
from mien.initialization.opencv_mesh import OpenCVMesh, crop_matrix, uncrop

_COPIES = (
    (0.0, 1.0, 1.0), (-8.0, 0.95, 1.6), (8.0, 0.95, 1.6), (-4.0, 1.1, 2.0), (4.0, 1.1, 2.0), (0.0, 0.85, 1.6)
)  # fmt: skip
"""Turn in degrees, scale, and gamma of each copy of the frame."""
_MAXIMUM_FACES = 8
_SAME_PLACE = 0.5
"""Mean distance of two faces' points, over their size, below which the later may be the earlier one."""
_CROP_SIDE, _CROP_PIXELS = 2.2, (256, 640)
"""Side of the crop in which a face is looked at closer, in sizes of the face, and the least and largest in pixels."""
_DISTANT_EVERY = 15
"""Frames of which one is searched for distant faces, which takes five times as long."""
_LARGE_PX, _QUARTER = 750, 0.55
"""Width from which on a face that is large enough to be tracked may be too small to be found in the whole frame; a
quarter's side over the frame's: some more than a half, for the faces between two."""
_BESIDE = 0.75
"""How far from its centre a point is at a face, in sizes of the face."""
_OUTVOTED = 0.22
"""Mean difference of coordinates, in sizes of the face, above which what is seen in a copy is another face."""
_AGREED = 0.004
"""The same, in the median over the copies, up to which a face is upright without question: 0.001 to 0.005 where it is
(once 0.009), and 0.005 to 0.08 where it stands on its head."""


def detect(frame: Frame, at: Point | None = None) -> list[Landmarks]:
    """The faces of a frame, largest first, with depths, scheme `mediapipe478`, or `mediapipe468` where OpenCV finds
    them. at: pixels; only faces there count."""
    found = first_with_a_face([frame], at)
    return [] if found is None else found[1]


def first_with_a_face(frames: Iterable[Frame], at: Point | None = None) -> tuple[Frame, list[Landmarks]] | None:
    """The first frame in which there is a face, with its faces as `detect` gives them; None where none has one."""
    with _finder(_MAXIMUM_FACES) as finder:
        for k, frame in enumerate(frames):
            seen = finder.largest_first(frame, k % _DISTANT_EVERY == 0, at)
            seen_again = (_average(frame, face) for face in seen)
            faces = [_landmarks(frame, face) for face in seen_again if face is not None]
            if faces:
                return frame, faces
    return None


def look(frame: Frame, at: Point | None = None, distant: bool = True) -> list[Landmarks]:
    """The faces of a frame as `detect` gives them, but from a single look, for finding a face again. distant: where
    there is none, also those that are small in the image."""
    with _finder(_MAXIMUM_FACES) as finder:
        return [_landmarks(frame, face) for face in finder.largest_first(frame, distant, at)]


def everybody(frame: Frame) -> list[Landmarks]:
    """All faces of a frame, the largest first, from a single look, also those that are small in the image."""
    with _finder(_MAXIMUM_FACES) as finder:
        return [_landmarks(frame, face) for face in _by_size(finder.distant(frame, finder.near(frame)))]


def follow(face: Landmarks, frames: Iterable[Frame]) -> Iterator[tuple[Frame, Landmarks]]:
    """A face in later frames, from a single look each; frames that show none where it was last are passed over."""
    with _finder(_MAXIMUM_FACES) as finder:
        for frame in frames:
            same = _same(frame, finder.near(frame), face)
            if same is None:
                same = _same(frame, finder.closer(frame, place_of(face.points)), face)
            if same is not None:
                face = same
                yield frame, face


def refine(frame: Frame, face: Landmarks) -> Landmarks | None:
    """A face from a single look, from several; None where they do not show it."""
    assert face.depths is not None, "a detected face has depths"
    seen_again = _average(frame, np.column_stack([face.points, face.depths]))
    return None if seen_again is None else _landmarks(frame, seen_again)


def _same(frame: Frame, faces: list[Array], before: Landmarks) -> Landmarks | None:
    """The face of a frame that is where one was before, None where none is."""
    here = (_landmarks(frame, face) for face in faces)
    nearest = min(here, key=lambda found: _apart(found, before), default=None)
    return nearest if nearest is not None and _apart(nearest, before) < _SAME_PLACE else None


def _apart(a: Landmarks, b: Landmarks) -> float:
    """Mean distance of two faces' points over the size of the second."""
    return float(np.linalg.norm(a.points - b.points, axis=1).mean() / np.ptp(b.points, axis=0).max())


def _landmarks(frame: Frame, face: Array) -> Landmarks:
    return Landmarks(face[:, :2], f"mediapipe{len(face)}", face[:, 2], frame.index, frame.time, "detected face")


def _average(frame: Frame, face: Array) -> Array | None:
    """Mean of one face's points (n, 3) over turned and scaled copies of the image around it; None where less than
    half of the copies show it. In a face that stands on its head the network sees an upright one, in each copy
    somewhere else: where answers differ, those are taken that agree better, upright or not."""
    place = place_of(face)
    upright = _seen_again(frame, place)
    if upright is not None and upright[1] <= _AGREED:
        return upright[0]
    answers = [seen for seen in (upright, _seen_again(frame, place, turn_deg=180.0)) if seen is not None]
    return min(answers, key=itemgetter(1))[0] if answers else None


def _seen_again(frame: Frame, place: Place, turn_deg: float = 0.0) -> tuple[Array, float] | None:
    """Mean (n, 3) of what copies of the image show of the face at a place, if half of them do, all turned by an angle
    beyond their own, and in the median by how much of its size they differ."""
    with _finder(1) as finder:
        seen = (finder.closer(frame, place, turn_deg + turn, scale, gamma) for turn, scale, gamma in _COPIES)
        answers = [faces[0] for faces in seen if faces and _is_among(place, faces[:1])]
    if 2 * len(answers) < len(_COPIES):
        return None
    median = np.median(answers, axis=0)
    apart = [float(np.abs(answer - median)[:, :2].mean()) / place[1] for answer in answers]
    near = [answer for answer, far in zip(answers, apart, strict=True) if far < _OUTVOTED]
    return (np.mean(near, axis=0), float(np.median(apart))) if 2 * len(near) >= len(_COPIES) else None


def _there(faces: list[Array], at: Point | None) -> list[Array]:
    """Those faces (n, 3) that are at a point, or hardly beside it; all where none is given."""
    if at is None:
        return faces
    return [face for face in faces if np.abs(place_of(face)[0] - at).max() < _BESIDE * _size(face)]


def _is_among(place: Place, faces: Iterable[Array]) -> bool:
    """Whether one of the faces (n, 3) is at a place."""
    middle, size = place
    return any(np.linalg.norm(middle - place_of(face)[0]) <= _SAME_PLACE * size for face in faces)


def _by_size(faces: list[Array]) -> list[Array]:
    """The faces (n, 3), the largest first."""
    return sorted(faces, key=lambda face: -float(np.ptp(face[:, :2], axis=0).prod()))


def _size(face: Array) -> float:
    """Larger side of a face (n, 3) in pixels."""
    return place_of(face)[1]


@cache
def _tones(gamma: float, brightest: int) -> Pixels:
    """(256,) what every value of a picture becomes, whose brightest stays as it is: a dark one must not go black."""
    return np.asarray(np.rint(brightest * np.minimum(np.arange(256) / max(brightest, 1), 1.0) ** gamma), np.uint8)


class _Finder:
    """Looks for faces near and far with MediaPipe, or where it is not installed with OpenCV."""

    def __init__(self, faces: int) -> None:
        """faces: the largest number that is looked for."""
        self.mesh: MediaPipeMesh | OpenCVMesh
        try:
            self.mesh = MediaPipeMesh(faces)
        except ImportError:
            self.mesh = OpenCVMesh(faces)

    def largest_first(self, frame: Frame, distant: bool = True, at: Point | None = None) -> list[Array]:
        """Points (n, 3) of every face that is seen, at a point where one is given; distant: where there is none, also
        of those that are small in the image."""
        faces = _there(self.near(frame), at) or (_there(self.distant(frame), at) if distant else [])
        return _by_size(faces)

    def near(self, frame: Frame) -> list[Array]:
        """Points (n, 3) of every face that is large enough in the image to be seen in it."""
        return self.mesh.faces(frame.pixels)

    def distant(self, frame: Frame, near: Sequence[Array] | None = None) -> list[Array]:
        """Points (n, 3) of every face that is seen only in a closer look, and is large enough to be tracked. near:
        where these are given, all faces are wanted: smaller ones are looked for everywhere, and come after these."""
        faces = list(near or ())
        for place in self._places(frame, everywhere=near is not None):
            found = None if _is_among(place, faces) else max(self.closer(frame, place), key=_size, default=None)
            if found is not None and _size(found) >= MINIMUM_FACE_PX and not _is_among(place_of(found), faces):
                faces.append(found)
        return faces

    def closer(
        self, frame: Frame, place: Place, turn_deg: float = 0.0, scale: float = 1.0, gamma: float = 1.0
    ) -> list[Array]:
        """Points (n, 3) in the frame of the faces that are seen in a turned, scaled and darkened copy of its part
        around a place."""
        centre, size = place
        side = _CROP_SIDE * size
        pixels = int(np.clip(side, *_CROP_PIXELS))
        A = crop_matrix(centre, turn_deg, scale * pixels / side, 0.5 * (pixels - 1))
        crop = cv2.warpAffine(frame.pixels, A, (pixels, pixels), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        return [uncrop(face, A) for face in self.mesh.faces(cv2.LUT(crop, _tones(gamma, int(crop.max()))))]

    def _places(self, frame: Frame, everywhere: bool) -> list[Place]:
        """Where there may be a face: in the whole frame, and if there is none, or everywhere, in the quarters of a
        large one."""
        places = self._places_in(frame.pixels, np.zeros(2))
        if (everywhere or not places) and frame.width > _LARGE_PX:
            height, width = (math.ceil(_QUARTER * side) for side in (frame.height, frame.width))
            for y, x in product((0, frame.height - height), (0, frame.width - width)):
                places += self._places_in(frame.pixels[y : y + height, x : x + width], np.array([x, y]))
        return places

    def _places_in(self, pixels: Pixels, corner: Array) -> list[Place]:
        """Where there may be a face in a part of a frame that has its corner (2,) there."""
        return [(corner + centre, size) for centre, size in self.mesh.places(pixels)]


_kept = threading.local()
"""What each thread of each process has made: it takes as long to make as several looks."""


@contextlib.contextmanager
def _finder(faces: int) -> Iterator[_Finder]:
    """A finder of at most so many faces, with what it writes kept off the screen."""
    finders: dict[str, _Finder] = vars(_kept)
    key = f"{os.getpid()} {faces}"
    with silenced():
        if key not in finders:
            finders[key] = _Finder(faces)
        yield finders[key]
