"""Landmarks of the first frame, and the correspondence between points of an annotation and vertices of CANDIDE.

A set of landmarks has a scheme, which fixes the number and the meaning of its points: `candide26` (the tracked
landmarks), `ibug68`, `mediapipe478`, or `mediapipe468` (the same without irises).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mien.arrays import Array, Mask
from mien.errors import MienError, require
from mien.graphics import Graphics

LANDMARK_VERTICES: Mapping[str, int] = MappingProxyType(
    {
        "right_brow_outer": 48,
        "right_brow_top": 49,
        "right_brow_inner": 50,
        "left_brow_inner": 17,
        "left_brow_top": 16,
        "left_brow_outer": 15,
        "right_eye_outer_corner": 53,
        "right_eyelid_upper_mid": 54,
        "right_eye_inner_corner": 56,
        "right_eyelid_lower_mid": 55,
        "left_eye_inner_corner": 23,
        "left_eyelid_upper_mid": 21,
        "left_eye_outer_corner": 20,
        "left_eyelid_lower_mid": 22,
        "nose_bump": 94,
        "nose_tip": 5,
        "right_nostril_outer": 59,
        "nose_base_mid": 6,
        "left_nostril_outer": 26,
        "right_mouth_corner_outer": 64,
        "right_upper_lip_peak": 66,
        "upper_lip_outer": 7,
        "left_upper_lip_peak": 33,
        "left_mouth_corner_outer": 31,
        "lower_lip_outer": 8,
        "chin_boss": 9,
    }
)
"""The 26 landmarks, by name, and their vertices: corners and edges where a gradient histogram responds to
displacement, on every part of the face that the six animation units move. `docs/method.md` gives the reasons."""
LANDMARK_NAMES = tuple(LANDMARK_VERTICES)
EYE_PARTS = ("eye_outer_corner", "eye_inner_corner", "eyelid_upper_mid", "eyelid_lower_mid")
"""The names of the landmarks of an eye, without their side."""
MOUTH_CORNERS = tuple(LANDMARK_NAMES.index(f"{side}_mouth_corner_outer") for side in ("right", "left"))
"""Rows (2,) of the corners of the mouth."""
VERTICES = list(LANDMARK_VERTICES.values())
"""The vertices alone, as an index into all."""

# Point of the annotation, or two whose midpoint it is -> vertex of CANDIDE, for points with the same meaning in both.
_Pairs = Mapping[int | tuple[int, int], int]
_IBUG68: _Pairs = {
    8: 10,  # chin
    17: 48, 19: 49, 21: 50, 22: 17, 24: 16, 26: 15,  # brows
    27: 94, 30: 5, 31: 59, 33: 6, 35: 26,  # nose
    36: 53, 39: 56, 42: 23, 45: 20,  # corners of the eyes
    37: 98, 38: 106, 40: 108, 41: 100, 43: 105, 44: 97, 46: 99, 47: 107,  # lids
    48: 64, 50: 66, 51: 7, 52: 33, 54: 31, 57: 8,  # outer lips
    60: 89, 62: 87, 64: 88, 66: 40,  # inner lips
}  # fmt: skip
_MEDIAPIPE: _Pairs = {
    152: 10,  # chin
    46: 48, 105: 49, 107: 50, 336: 17, 334: 16, 276: 15,  # brows
    6: 94, 4: 5, (97, 98): 59, (94, 164): 6, (326, 327): 26,  # nose
    33: 53, (133, 155): 56, (362, 382): 23, 263: 20,  # corners of the eyes
    159: 54, 145: 55, 386: 21, 374: 22,  # lids
    160: 98, 158: 106, 153: 108, 144: 100, 385: 105, 387: 97, 373: 99, 380: 107,
    61: 64, 37: 66, 0: 7, 267: 33, 291: 31, 17: 8,  # outer lips
    78: 89, 13: 87, 308: 88, 14: 40,  # inner lips
}  # fmt: skip
_CANDIDE26: _Pairs = {i: v for i, v in enumerate(VERTICES)}
_SCHEMES: dict[str, tuple[int, _Pairs]] = {
    "candide26": (26, _CANDIDE26),
    "ibug68": (68, _IBUG68),
    "mediapipe478": (478, _MEDIAPIPE),
    "mediapipe468": (468, _MEDIAPIPE),
}
SCHEMES = tuple(_SCHEMES)
SCHEME_OF_COUNT = {68: "ibug68", 26: "candide26"}
"""Schemes that a file without a name for them is read as, by its number of points."""
_REPORTED: Mapping[str, Mapping[str, tuple[int, int]]] = {
    scheme: {"right_eye_outer_corner": (33, 7), "left_eye_outer_corner": (263, 249)}
    for scheme in ("mediapipe478", "mediapipe468")
}
"""Points at which a landmark is reported where annotators mark it elsewhere than the model is fitted and tracked: they
mark the outer eye corners one percent of their distance lower, at points that move more with the lids
(docs/experiments.md)."""
Point = tuple[float, float]
"""Image coordinates x and y in pixels."""
Place = tuple[Array, float]
"""Centre (2,) and larger side, in pixels, of a face or face candidate."""
SAME_PLACE, _SAME_SIZE = 0.5, 1.6
"""Two faces are the same below this distance of their centres, in sizes of the face, and this ratio of their sizes."""


def count_of_scheme(scheme: str) -> int:
    """Number of points of a scheme."""
    return _SCHEMES[scheme][0]


def rows_of_scheme(scheme: str) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Vertices of CANDIDE (m,), and for each the two annotation points (m, 2) whose midpoint it is, usually twice the
    same point."""
    pairs = _SCHEMES[scheme][1]
    rows = [(row, row) if isinstance(row, int) else row for row in pairs]
    return np.fromiter(pairs.values(), dtype=np.intp), np.array(rows, dtype=np.intp)


def rows_by_name(scheme: str) -> dict[str, NDArray[np.intp]]:
    """The same pairs of annotation points (2,) by landmark name, for those of the 26 landmarks that the scheme has."""
    rows = dict(zip(*rows_of_scheme(scheme), strict=True))
    return {name: rows[vertex] for name, vertex in LANDMARK_VERTICES.items() if vertex in rows}


def rows_reported(scheme: str) -> dict[str, NDArray[np.intp]]:
    """`rows_by_name` for the positions at which landmarks are reported."""
    return rows_by_name(scheme) | {name: np.array(rows) for name, rows in _REPORTED.get(scheme, {}).items()}


def opening_of(points: Mapping[str, Array]) -> float:
    """Height of the eyes between the lids over their width, the mean of both, by the points (2,) or (3,) of the
    landmarks by name."""

    def apart(side: str, one: str, other: str) -> float:
        return math.dist(points[f"{side}_{one}"], points[f"{side}_{other}"])

    shares = [
        apart(side, "eyelid_upper_mid", "eyelid_lower_mid") / apart(side, "eye_outer_corner", "eye_inner_corner")
        for side in ("right", "left")
    ]
    return sum(shares) / 2


MINIMUM_FACE_PX = 40.0
_MOST_BEYOND = 0.25
"""Largest distance of a point that is used beyond the border of the image, over the size of the face."""
_DEEPEST = 4.0
"""Largest range of the depths, over the size of the face."""
_LEAST_WIDTH = 0.01
"""Width of the points that are used, over their length, up to which they lie on one line; 0.2 and more even of a face
in full profile."""
_TRIANGLE = ("right_eye_outer_corner", "left_eye_outer_corner", "lower_lip_outer")
_LEAST_MIRRORED = 0.3
"""Landmarks are mirrored if the eyes are reversed by more than this, over their height above the mouth; below it, they
may be those of a profile with small errors."""


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Annotated or detected points of one face in one frame. They compare by identity.

    points: (n, 2) pixels; scheme: one of `SCHEMES`; depths: (n,) relative depth in pixels, increasing away from the
    camera, if the source estimates it; frame_index, time (seconds): of their frame; source: named in error messages;
    disagreement: how far detections in several copies of the frame are apart, as the median difference of coordinates
    over the face's size, if they were averaged over such; graphics: what stands still before the face in the video;
    marked: where somebody has marked landmarks, (2,) by name, if the points are a detector's. Raises MienError for
    anything else; `check` for landmarks that no tracker can begin with.
    """

    points: Array
    scheme: str
    depths: Array | None = None
    frame_index: int = 0
    time: float = 0.0
    source: str = "landmarks"
    disagreement: float | None = None
    graphics: Graphics | None = None
    marked: Mapping[str, Array] | None = None

    def __post_init__(self) -> None:
        try:
            object.__setattr__(self, "frame_index", int(self.frame_index))  # as a file takes them
            object.__setattr__(self, "time", float(self.time))
            object.__setattr__(self, "disagreement", None if self.disagreement is None else float(self.disagreement))
        except (TypeError, ValueError, OverflowError) as error:
            raise MienError(f"{self.source}: the frame's index, its time or the disagreement is no number") from error
        for name in ("points", "depths"):
            if getattr(self, name) is not None:
                try:
                    object.__setattr__(self, name, np.array(getattr(self, name), dtype=float))
                except (TypeError, ValueError) as error:
                    raise MienError(f"{self.source}: the {name} are not numbers ({error})") from error
        require(self.scheme in SCHEMES, f"{self.source}: unknown scheme {self.scheme!r}; use one of {SCHEMES}")
        count = count_of_scheme(self.scheme)
        require(
            np.shape(self.points) == (count, 2),
            f"{self.source}: {self.scheme} needs {count} points with two coordinates, not {np.shape(self.points)}",
        )
        require(
            bool(np.isfinite(self.points).all()),
            f"{self.source}: a landmark is not a finite number; annotate every point",
        )
        require(
            self.depths is None or (self.depths.shape == (count,) and bool(np.isfinite(self.depths).all())),
            f"{self.source}: `depths` must have one finite number per point; correct or remove it",
        )
        require(
            isinstance(self.graphics, Graphics | None),
            f"{self.source}: the `graphics` are {type(self.graphics)}; remove them",
        )
        if self.marked is not None:
            require(
                isinstance(self.marked, Mapping), f"{self.source}: `marked` needs points by name; correct or remove it"
            )
            object.__setattr__(self, "marked", {name: self._mark(name, point) for name, point in self.marked.items()})
        require(math.isfinite(self.time), f"{self.source}: its frame has the time {self.time:g} s; give it in seconds")

    def _mark(self, name: str, point: Any) -> Array:
        """The point (2,) that is marked for a landmark. Raises MienError if it is none, or for another name."""
        known = np.full(2, np.nan)
        with suppress(TypeError, ValueError):
            known = np.array(point, dtype=float)
        is_mark = name in LANDMARK_VERTICES and known.shape == (2,) and bool(np.isfinite(known).all())
        require(is_mark, f"{self.source}: `marked` has no point for a landmark at {name!r}; correct or remove it")
        return known

    def correspondences(self) -> tuple[NDArray[np.intp], Array, Array | None]:
        """Vertices of CANDIDE (m,), their image points (m, 2), and their depths (m,) if known."""
        vertices, rows = rows_of_scheme(self.scheme)
        depths = None if self.depths is None else self.depths[rows].mean(axis=1)
        return vertices, self.points[rows].mean(axis=1), depths

    def reported(self) -> dict[str, Array]:
        """Where landmarks are reported, (2,) by name, those of the 26 that are known."""
        rows = rows_reported(self.scheme)
        return {name: self.points[pair].mean(axis=0) for name, pair in rows.items()} | dict(self.marked or {})

    @property
    def point_names(self) -> list[str]:
        """The numbers, from 0, of the points that are used, in the order of `correspondences`: 33, or 133/155 where
        that is the midpoint of two."""
        _, rows = rows_of_scheme(self.scheme)
        return ["/".join(map(str, dict.fromkeys(pair))) for pair in rows.tolist()]

    def _beyond(self, width: int, height: int) -> Array:
        """How far the points (m,) that are used lie beyond the border of an image, in pixels; negative inside."""
        return _beyond(self.correspondences()[1], width, height)

    def are_inside(self, width: int, height: int) -> bool:
        """Whether the face lies inside an image, or beyond its border by no more than a quarter of the face's size."""
        _, points, _ = self.correspondences()
        return bool(self._beyond(width, height).max() <= _MOST_BEYOND * np.ptp(points, axis=0).max())

    @property
    def size(self) -> float:
        """Larger side of the face in pixels."""
        return place_of(self.points)[1]

    def are_trackable(self, width: int, height: int) -> bool:
        """Whether the face lies inside an image, is large enough to be tracked, and is no mirrored one."""
        return self.are_inside(width, height) and self.size >= MINIMUM_FACE_PX and not self._mirrored()

    def check(self, width: int, height: int) -> None:
        """Raise MienError for points outside the image, also marked ones, mirrored landmarks, faces too small to track,
        points on one line, and depths that are not in pixels."""
        farthest = self.point_names[int(self._beyond(width, height).argmax())]
        require(
            self.are_inside(width, height),
            f"{self.source}: landmarks lie outside the image of {width}x{height} pixels, point {farthest} farthest; "
            "check that they belong to this video",
        )
        require(
            not self._mirrored(),
            f"{self.source}: the landmarks are mirrored, or an outer corner of an eye is far from its place; right is "
            "the person's own right, usually on the image's left",
        )
        size = self.size
        require(
            size >= MINIMUM_FACE_PX,
            f"{self.source}: the face measures {size:.1f} pixels and tracking needs {MINIMUM_FACE_PX:.0f}; "
            "enlarge or crop the video",
        )
        require(
            not self._in_a_line(),
            f"{self.source}: the landmarks lie on one line; check that each has its own x and y",
        )
        of = self.graphics and (self.graphics.width, self.graphics.height)
        require(
            of in (None, (width, height)),
            f"{self.source}: the `graphics` belong to another size of image than {width}x{height}; remove them",
        )
        depths = 0.0 if self.depths is None else float(np.ptp(self.depths))
        require(
            depths <= _DEEPEST * size,
            f"{self.source}: the depths span {depths:.0f} pixels and the face measures {size:.0f}; give depths in "
            "pixels of the image, or none",
        )
        self._check_marked(width, height)

    def _check_marked(self, width: int, height: int) -> None:
        """Raise MienError for a landmark that is marked outside the image."""
        for name, point in (self.marked or {}).items():
            x, y = point
            require(
                _beyond(np.array([point]), width, height)[0] <= _MOST_BEYOND * self.size,
                f"{self.source}: `marked` has {name} at {x:g}, {y:g}, outside the image of {width}x{height} pixels; "
                "correct or remove it",
            )

    def _in_a_line(self) -> bool:
        """Whether the points that are used have no width across the direction in which they are spread most."""
        _, points, _ = self.correspondences()
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        return bool(spread[1] <= _LEAST_WIDTH * spread[0])

    def _mirrored(self) -> bool:
        """Whether the triangle of right eye, left eye and mouth has the wrong orientation for a face."""
        rows = rows_by_name(self.scheme)
        right, left, mouth = (self.points[rows[name]].mean(axis=0) for name in _TRIANGLE)
        (ax, ay), (bx, by) = left - right, mouth - 0.5 * (left + right)
        return bool(ax * by - ay * bx < -_LEAST_MIRRORED * (bx * bx + by * by))

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "scheme": self.scheme,
            "frame": self.frame_index,
            "time": self.time,
            "points": np.round(self.points, 3).tolist(),
            "depths": None if self.depths is None else np.round(self.depths, 3).tolist(),
            "graphics": None if self.graphics is None else self.graphics.to_dict(),
            "marked": self.marked and {name: np.round(point, 3).tolist() for name, point in self.marked.items()},
        }


def _beyond(points: Array, width: int, height: int) -> Array:
    """How far points (m, 2) lie beyond the border of an image, in pixels; negative inside."""
    return np.asarray(np.maximum(-points, points - [width - 1, height - 1]).max(axis=1))


def place_of(points: Array) -> Place:
    """Centre (2,) and larger side, in pixels, of a face with points (n, 2 or 3)."""
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    return 0.5 * (low + high), float((high - low).max())


def in_common(points: Mapping[str, Array], others: Mapping[str, Array]) -> tuple[Array, Array]:
    """Those of two sets of points (2,) by name that both have, (n, 2) each."""
    names = [name for name in points if name in others]
    one, other = (np.array([of[name] for name in names]) for of in (points, others))
    return one, other


def is_same_place(
    centre: Array, size: Array | float, other_centre: Array, other_size: Array | float, within: float = SAME_PLACE
) -> Mask:
    """Whether faces with centres (..., 2) and sizes (...) have about the positions and sizes of others. within: sizes
    of the face."""
    distance = np.linalg.norm(centre - other_centre, axis=-1)
    similar = np.maximum(size, other_size) < _SAME_SIZE * np.minimum(size, other_size)
    return np.asarray(similar & (distance < within * size))
