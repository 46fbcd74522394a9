"""A frame turned so that a face that lies on its side, or upside down, is upright: as detectors know faces."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from mien.arrays import Array
from mien.frame import Frame
from mien.initialization.landmarks import Landmarks, Point, rows_by_name

_COUNTERCLOCKWISE = {1: cv2.ROTATE_90_COUNTERCLOCKWISE, 2: cv2.ROTATE_180, 3: cv2.ROTATE_90_CLOCKWISE}
_UP = ("mouth_corner_outer", "eye_outer_corner")
"""A way up through the face."""


def quarters_of(roll: float) -> int:
    """How many quarter turns, 0 to 3, a face has rolled, clockwise in the image. roll: radians."""
    return round(roll / (0.5 * math.pi)) % 4


def roll_of(face: Landmarks) -> float:
    """How far a face has rolled, radians, clockwise in the image: by the way from its mouth up to its eyes."""
    at = {name: face.points[rows].mean(axis=0) for name, rows in rows_by_name(face.scheme).items()}
    mouth, eyes = (np.mean([at[f"{side}_{part}"] for side in ("right", "left")], axis=0) for part in _UP)
    x, y = eyes - mouth
    return math.atan2(x, -y)


@dataclass(frozen=True, eq=False)
class Upright:
    """A frame in which a face has rolled by quarter turns, and the same turned back by these, `frame`."""

    seen: Frame
    quarters: int

    @cached_property
    def frame(self) -> Frame:
        """The frame turned counterclockwise."""
        if self.quarters == 0:
            return self.seen
        turned = np.asarray(cv2.rotate(self.seen.pixels, _COUNTERCLOCKWISE[self.quarters]), np.uint8)
        return Frame(turned, self.seen.index, self.seen.time)

    def points_seen(self, points: Array) -> Array:
        """Points (n, 2) of `frame` where the camera has seen them."""
        return np.asarray((points - _middle(self.frame)) @ self._turn.T + _middle(self.seen))

    def points_upright(self, points: Array) -> Array:
        """Points (n, 2) that the camera has seen where they are in `frame`."""
        return np.asarray((points - _middle(self.seen)) @ self._turn + _middle(self.frame))

    def seen_by_camera(self, face: Landmarks) -> Landmarks:
        """Landmarks of `frame` where the camera has seen them."""
        return replace(face, points=self.points_seen(face.points)) if self.quarters else face

    def turned_upright(self, face: Landmarks) -> Landmarks:
        """Landmarks that the camera has seen where they are in `frame`."""
        return replace(face, points=self.points_upright(face.points)) if self.quarters else face

    def point(self, at: Point | None) -> Point | None:
        """Where a point that the camera has seen is in `frame`."""
        if at is None or self.quarters == 0:
            return at
        ((x, y),) = self.points_upright(np.array([at]))
        return float(x), float(y)

    @property
    def _turn(self) -> Array:
        """Clockwise in the image, (2, 2)."""
        return np.linalg.matrix_power(np.array([[0.0, -1.0], [1.0, 0.0]]), self.quarters)


def _middle(frame: Frame) -> Array:
    return 0.5 * (np.array([frame.width, frame.height]) - 1)
