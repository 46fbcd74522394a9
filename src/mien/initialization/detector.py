"""Face detection: by MediaPipe if the extra `auto` is installed, else by OpenCV with MediaPipe's networks.

Both detect faces from about an eighth of the image width. If there is none, a search for distant faces proposes places
to examine in a crop, down to a twenty-fifth of the width.

The landmarks are averaged over slightly rotated, scaled and darkened copies of the frame, as everything later depends
on this one frame. A detection in the frame that few of the copies confirm is a false positive: a face-like texture.
"""

from __future__ import annotations

import contextlib
import math
import os
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from itertools import product

import cv2
import numpy as np

from mien.arrays import Array, Pixels
from mien.frame import Frame
from mien.initialization.landmarks import MINIMUM_FACE_PX, Landmarks, Place, Point, place_of
from mien.initialization.mediapipe_mesh import MediaPipeMesh
from mien.initialization.opencv_mesh import OpenCVMesh, crop_matrix, uncrop
from mien.initialization.upright import Upright, quarters_of, roll_of

_COPIES = (
    (0.0, 1.0, 1.0), (-8.0, 0.95, 1.6), (8.0, 0.95, 1.6), (-4.0, 1.1, 2.0), (4.0, 1.1, 2.0), (0.0, 0.85, 1.6)
)  # fmt: skip
"""In-plane rotation in degrees, scale and gamma of each copy of the frame."""
MAXIMUM_FACES = 8
_SAME_PLACE = 0.5
"""Mean distance of two faces' points, over their size, below which they may be the same face."""
_CROP_SIDE, _CROP_PIXELS = 2.2, (256, 640)
"""Side of the crop around a face, in sizes of the face, and its minimum and maximum in pixels."""
_THOROUGH_EVERY = 15
"""One frame in this many is searched for distant and for turned faces, which takes eight times as long."""
_LARGE_PX, _QUARTER = 750, 0.55
"""Longer side of a frame above which a trackable face may be too small to be found in the whole frame; and the side of
a quarter over that of the frame, more than a half so that quarters overlap."""
_NEAR = 0.75
"""Largest distance of a point on a face from its centre, in sizes of the face."""
_OUTLIER = 0.22
"""Mean coordinate difference, in sizes of the face, above which the detection in a copy is another face."""
_AGREEMENT = 0.004
"""The same difference, as the median over the copies, up to which a face is certainly upright. Measured: 0.001 to 0.005
(once 0.009) for upright faces, 0.005 to 0.08 for faces upside down."""
TURNED_AGREEMENT, _FAR_BETTER = 0.006, 0.5
"""A face is upside down if the turned copies differ by less: if the upright ones show no face, and else as a fraction
of their difference. Measured: 0.001 to 0.006 and mostly below 0.4 for faces upside down, 0.7 to 1 for upright faces
that the border cuts below the nose."""


def detect(frame: Frame, at: Point | None = None) -> list[Landmarks]:
    """The faces of a frame, largest first, with depths, in the scheme `mediapipe478`, or `mediapipe468` without
    MediaPipe. at: pixels; only faces at this point count."""
    found = first_with_a_face([frame], at)
    return [] if found is None else found[1]


def first_with_a_face(frames: Iterable[Frame], at: Point | None = None) -> tuple[Frame, list[Landmarks]] | None:
    """The first frame with a face that can be tracked, and its faces as from `detect`; if all are too small, the first
    with one of these; None if no frame has any. A face that lies further beyond the border of the image than
    `Landmarks.are_inside` allows does not count: nothing could be learned of that part."""
    too_small: tuple[Frame, list[Landmarks]] | None = None
    with open_finder(MAXIMUM_FACES) as finder:
        for k, frame in enumerate(frames):
            thorough = k % _THOROUGH_EVERY == 0
            faces = _confirmed(finder, frame, thorough, at)
            if not faces and thorough:
                faces = _turned(finder, frame, at)
            if any(face.are_trackable(frame.width, frame.height) for face in faces):
                return frame, faces
            if faces and too_small is None:
                too_small = frame, faces
    return too_small


def _confirmed(finder: Finder, frame: Frame, distant: bool, at: Point | None) -> list[Landmarks]:
    """The faces of a frame, largest first, that its copies confirm and that are inside; distant, at: as of `Finder`."""
    averaged = (_average(frame, face) for face in finder.largest_first(frame, distant, at))
    found = (landmarks_of(frame, *face) for face in averaged if face is not None)
    return [face for face in found if face.are_inside(frame.width, frame.height)]


def _turned(finder: Finder, frame: Frame, at: Point | None) -> list[Landmarks]:
    """The faces of a frame in which no upright one is seen, by the first turn of it that shows some."""
    for view in (Upright(frame, quarters) for quarters in (2, 1, 3)):
        faces = _confirmed(finder, view.frame, False, view.point(at))
        # In a face upside down an upright one is seen, which the copies rarely confirm so well.
        sure = [view.seen_by_camera(face) for face in faces if (face.disagreement or 0.0) <= TURNED_AGREEMENT]
        if sure:
            return sure
    return []


def detect_once(frame: Frame, at: Point | None = None, distant: bool = True) -> list[Landmarks]:
    """The faces of a frame as from `detect`, but from a single detection without averaging, for finding a face again.
    distant: if there is none, also search for small faces."""
    with open_finder(MAXIMUM_FACES) as finder:
        return [landmarks_of(frame, face) for face in finder.largest_first(frame, distant, at)]


def detect_all(frame: Frame) -> list[Landmarks]:
    """All faces of a frame, largest first, including small ones, from a single detection without averaging."""
    with open_finder(MAXIMUM_FACES) as finder:
        return [landmarks_of(frame, face) for face in _by_size(finder.distant(frame, finder.near(frame)))]


def follow(face: Landmarks, frames: Iterable[Frame]) -> Iterator[tuple[Frame, Landmarks]]:
    """Follow a face through later frames, by a single detection in each, turned so that the face is upright; skips
    frames without a face at its last place."""
    with open_finder(MAXIMUM_FACES) as finder:
        for frame in frames:
            view = Upright(frame, quarters_of(roll_of(face)))
            before = view.turned_upright(face)
            same = _match(view.frame, finder.near(view.frame), before)
            if same is None:
                same = _match(view.frame, finder.in_crop(view.frame, place_of(before.points)), before)
            if same is not None:
                face = view.seen_by_camera(same)
                yield frame, face


def refine(frame: Frame, face: Landmarks) -> Landmarks | None:
    """Average the landmarks of a single detection over copies of the frame; None if the copies do not confirm it."""
    assert face.depths is not None, "a detected face has depths"
    averaged = _average(frame, np.column_stack([face.points, face.depths]))
    return None if averaged is None else landmarks_of(frame, *averaged)


def _match(frame: Frame, faces: list[Array], before: Landmarks) -> Landmarks | None:
    """The face of a frame at the place of an earlier one, None if there is none."""
    candidates = (landmarks_of(frame, face) for face in faces)
    nearest = min(candidates, key=lambda found: _relative_distance(found, before), default=None)
    return nearest if nearest is not None and _relative_distance(nearest, before) < _SAME_PLACE else None


def _relative_distance(a: Landmarks, b: Landmarks) -> float:
    """Mean distance between the points of two faces, over the size of the second."""
    return float(np.linalg.norm(a.points - b.points, axis=1).mean() / b.size)


def landmarks_of(frame: Frame, face: Array, disagreement: float | None = None) -> Landmarks:
    """The landmarks of a detected face, points (n, 3) in pixels and depth; disagreement: see `Landmarks`."""
    scheme, source = f"mediapipe{len(face)}", "detected face"
    return Landmarks(face[:, :2], scheme, face[:, 2], frame.index, frame.time, source, disagreement)


def _average(frame: Frame, face: Array) -> tuple[Array, float] | None:
    """Mean points (n, 3) of a face over rotated and scaled copies of the image around it, and how far these disagree,
    see `_consensus`; None if less than half of the copies show it, or if it may be upright or upside down.

    The copies of a face that lies on its side are turned upright, as the network knows faces. In a face upside down it
    sees an upright one, at a different place in each copy: if the copies disagree, they are rotated by 180 degrees as
    well, and taken so if they then agree far better. In a face that the border cuts below the nose, they disagree
    either way.
    """
    place, upright_deg = place_of(face), 90.0 * quarters_of(roll_of(landmarks_of(frame, face)))
    upright = _consensus(frame, place, upright_deg)
    if upright is not None and upright[1] <= _AGREEMENT:
        return upright
    turned = _consensus(frame, place, upright_deg + 180.0)
    if turned is None or (upright is not None and upright[1] <= turned[1]):
        return upright
    if upright is None:
        return turned if turned[1] <= TURNED_AGREEMENT else None
    sideways = float(np.abs(turned[0] - upright[0])[:, :2].mean()) < _OUTLIER * place[1]  # found alike either way
    return turned if sideways or turned[1] < _FAR_BETTER * upright[1] else None


def _consensus(frame: Frame, place: Place, turn_deg: float = 0.0) -> tuple[Array, float] | None:
    """Mean points (n, 3) of the face at a place over the copies of the image, without outliers, and the median
    difference between the copies over the face's size; None if less than half of the copies show it. turn_deg: an
    in-plane rotation of all copies in addition to their own."""
    with open_finder(1) as finder:
        seen = (finder.in_crop(frame, place, turn_deg + turn, scale, gamma) for turn, scale, gamma in _COPIES)
        found = [faces[0] for faces in seen if faces and _is_among(place, faces[:1])]
    if 2 * len(found) < len(_COPIES):
        return None
    median = np.median(found, axis=0)
    differences = [float(np.abs(face - median)[:, :2].mean()) / place[1] for face in found]
    inliers = [face for face, difference in zip(found, differences, strict=True) if difference < _OUTLIER]
    if 2 * len(inliers) < len(_COPIES):
        return None
    return np.mean(inliers, axis=0), float(np.median(differences))


def _at_point(faces: list[Array], at: Point | None) -> list[Array]:
    """The faces (n, 3) at or near a point; all faces without one."""
    if at is None:
        return faces
    return [face for face in faces if np.abs(place_of(face)[0] - at).max() < _NEAR * _size(face)]


def _is_among(place: Place, faces: Iterable[Array]) -> bool:
    """Whether one of the faces (n, 3) is at a place."""
    centre, size = place
    return any(np.linalg.norm(centre - place_of(face)[0]) <= _SAME_PLACE * size for face in faces)


def _by_size(faces: list[Array]) -> list[Array]:
    """The faces (n, 3), largest first."""
    return sorted(faces, key=lambda face: -float(np.ptp(face[:, :2], axis=0).prod()))


def _size(face: Array) -> float:
    """Larger side of a face (n, 3) in pixels."""
    return place_of(face)[1]


@cache
def _tones(gamma: float, brightest: int) -> Pixels:
    """Lookup table (256,) of a gamma curve that keeps the brightest value, so that a dark image does not turn black."""
    return np.asarray(np.rint(brightest * np.minimum(np.arange(256) / max(brightest, 1), 1.0) ** gamma), np.uint8)


class Finder:
    """Finds near and distant faces with MediaPipe, or with OpenCV if it is not installed."""

    def __init__(self, faces: int) -> None:
        """faces: maximum number of faces."""
        self.mesh: MediaPipeMesh | OpenCVMesh
        try:
            self.mesh = MediaPipeMesh(faces)
        except ImportError:
            self.mesh = OpenCVMesh(faces)

    def largest_first(self, frame: Frame, distant: bool, at: Point | None) -> list[Array]:
        """Points (n, 3) of every face, or of every face at a point; distant: if there is none, also search for small
        faces."""
        faces = _at_point(self.near(frame), at) or (_at_point(self.distant(frame), at) if distant else [])
        return _by_size(faces)

    def near(self, frame: Frame) -> list[Array]:
        """Points (n, 3) of every face that is large enough to be detected in the whole image."""
        return self.mesh.faces(frame.pixels)

    def distant(self, frame: Frame, near: Sequence[Array] | None = None) -> list[Array]:
        """Points (n, 3) of every face that is detected only in a crop, and is large enough to be tracked.

        near: faces that are already known; if given, the whole frame is searched for others, which are appended.
        """
        faces = list(near or ())
        for place in self._places(frame, everywhere=near is not None):
            found = None if _is_among(place, faces) else max(self.in_crop(frame, place), key=_size, default=None)
            if found is not None and _size(found) >= MINIMUM_FACE_PX and not _is_among(place_of(found), faces):
                faces.append(found)
        return faces

    def in_crop(
        self, frame: Frame, place: Place, turn_deg: float = 0.0, scale: float = 1.0, gamma: float = 1.0
    ) -> list[Array]:
        """Points (n, 3), in frame coordinates, of the faces in a rotated, scaled and darkened crop around a place."""
        centre, size = place
        side = _CROP_SIDE * size
        pixels = int(np.clip(side, *_CROP_PIXELS))
        A = crop_matrix(centre, turn_deg, scale * pixels / side, 0.5 * (pixels - 1))
        crop = cv2.warpAffine(frame.pixels, A, (pixels, pixels), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        return [uncrop(face, A) for face in self.mesh.faces(cv2.LUT(crop, _tones(gamma, int(crop.max()))))]

    def _places(self, frame: Frame, everywhere: bool) -> list[Place]:
        """Candidate places of faces: in the whole frame, and in the quarters of a large frame if there is none or
        `everywhere` is set."""
        places = self._places_in(frame.pixels, np.zeros(2))
        if (everywhere or not places) and max(frame.width, frame.height) > _LARGE_PX:
            height, width = (math.ceil(_QUARTER * side) for side in (frame.height, frame.width))
            for y, x in product((0, frame.height - height), (0, frame.width - width)):
                places += self._places_in(frame.pixels[y : y + height, x : x + width], np.array([x, y]))
        return places

    def _places_in(self, pixels: Pixels, corner: Array) -> list[Place]:
        """Candidate places, in frame coordinates, in the part of a frame that has its top left corner (2,) there."""
        return [(corner + centre, size) for centre, size in self.mesh.places(pixels)]


_idle: defaultdict[tuple[int, int], list[Finder]] = defaultdict(list)
"""Finders that no thread uses, by process and number of faces: creating one takes as long as several detections, and
MediaPipe's keep threads and memory of their own."""


@contextlib.contextmanager
def open_finder(faces: int) -> Iterator[Finder]:
    """A finder for at most this many faces, which no other thread has meanwhile."""
    idle = _idle[os.getpid(), faces]
    try:
        finder = idle.pop()
    except IndexError:
        finder = Finder(faces)
    try:
        yield finder
    finally:
        idle.append(finder)
