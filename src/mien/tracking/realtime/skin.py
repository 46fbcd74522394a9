"""Skin beside the lips, which moves with them: where it looks as in the first frame, there the lip is.

A mouth that opens, or bares its teeth, shows what the first frame did not, so that the landmarks of the lips look
strange wherever they are. The skin between lower lip and chin, which the jaw carries, stays as it is; that between nose
and upper lip stretches between them; that around the corners of the mouth moves over the face with them.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import cv2
import numpy as np

from mien.arrays import Array, Float32
from mien.candide.model import TRACKED_UNITS
from mien.compiled import kernel
from mien.initialization.landmarks import LANDMARK_NAMES
from mien.tracking.prior import JAW_DROP
from mien.tracking.realtime.motion import bilinear, center
from mien.tracking.realtime.pose_geometry import (
    PersonArrays,
    PoseArrays,
    ViewArrays,
    head_to_crop,
    landmark,
    project_to_crop,
)


class Region(NamedTuple):
    """Where m points of skin lie from a landmark, the carrier, in the image of a face that looks into the camera:
    offsets (m, 2), right and down, CANDIDE units; and which share (m,) of the motion of the carrier by an animation
    unit they follow."""

    carrier: int
    unit: int
    offsets: Array
    shares: Array


def _region(carrier: str, unit: int, right: Array, down: Array, follows: float = math.inf) -> Region:
    """Skin at all distances right and down from a landmark, which follows it entirely, or up to this far above it the
    less, the further it is."""
    offsets = np.stack(np.meshgrid(right, down), axis=-1).reshape(-1, 2)
    shares = np.clip(1 + offsets[:, 1] / follows, 0, 1)
    return Region(LANDMARK_NAMES.index(carrier), unit, offsets, shares)


CHIN = _region("lower_lip_outer", JAW_DROP, np.linspace(-0.2, 0.2, 9), np.linspace(0.02, 0.36, 8))
"""The skin below the lower lip."""
UPPER_LIP = _region(
    "upper_lip_outer",
    TRACKED_UNITS.index("upper_lip_raiser"),
    np.linspace(-0.2, 0.2, 11),
    np.linspace(-0.14, 0.03, 9),
    follows=0.15,
)
"""The border of the upper lip, and the skin above it, as far as the nose."""

_SPACING = 0.022
"""CANDIDE units between the points of the lattice around a corner of the mouth."""
_INNER, _OUTER, _ABOVE, _BELOW = 4, 6, 9, 7
"""How many of these the skin that is looked for extends from the corner: towards the mouth, away from it, up and
down."""
_IN, _OUT, _UP_DOWN = 5, 8, 6
"""By how many of these it is looked for elsewhere: towards the mouth, away from it, and up or down."""
_ROWS, _COLUMNS = _ABOVE + _BELOW + 1, _INNER + _OUTER + 1
"""Size of that skin, in points."""


def _corner(side: str, outwards: int) -> Region:
    """The lattice around a corner of the mouth, row by row, each from the mouth outwards; it stays on the face."""
    out = outwards * _SPACING * np.arange(-_INNER - _IN, _OUTER + _OUT + 1)
    down = _SPACING * np.arange(-_ABOVE - _UP_DOWN, _BELOW + _UP_DOWN + 1)
    return _region(f"{side}_mouth_corner_outer", TRACKED_UNITS.index("lip_stretcher"), out, down)


CORNERS = _corner("right", -1), _corner("left", 1)
"""The surroundings of the right and the left corner of the mouth."""


class Skin:
    """What a region of skin looks like in the first frame, and how much a crop shows the same."""

    def __init__(
        self, region: Region, points: Array, image: Float32, person: PersonArrays, pose: PoseArrays, view: ViewArrays
    ) -> None:
        """points: (m, 3) of the region, relative to its carrier, head axes; image, pose, view: the crop of the first
        frame, and the face in it."""
        first = float(pose[2][region.unit])
        self.where = points.T.copy(), region.shares, region.carrier, region.unit, first
        self.values = self.look(image, person, pose, view)
        center(self.values)

    def look(self, image: Float32, person: PersonArrays, pose: PoseArrays, view: ViewArrays) -> Float32:
        """Values (m,) that a crop, in which the face is at a pose, shows where the skin lies with its unit as in the
        first frame."""
        shown = np.empty(self.where[0].shape[1], np.float32)
        _look(image, person, self.where, pose, self.where[-1], view, shown)
        return shown

    def likeness(
        self, image: Float32, person: PersonArrays, pose: PoseArrays, view: ViewArrays, values: Array
    ) -> Array:
        """Correlations (k,) of the skin in the first frame with what a crop, in which the face is at a pose, shows
        where values (k,) of the region's unit would have carried it."""
        likeness: Array = _likeness(image, person, self.where, pose, values, view, self.values)
        return likeness


class Corners:
    """The skin around the corners of the mouth in the first frame, and how far it has moved over the face. shifts:
    (14,) distances outwards at which it is looked for, CANDIDE units."""

    shifts = _SPACING * np.arange(-_IN, _OUT + 1)

    def __init__(self, points: Array, image: Float32, person: PersonArrays, pose: PoseArrays, view: ViewArrays) -> None:
        """points: (2, j, 3) of `CORNERS`, relative to their carriers, head axes; image, pose, view: the crop of the
        first frame, and the face in it."""
        self.first = pose[2].copy()
        self.skins = [Skin(*of_side, image, person, pose, view) for of_side in zip(CORNERS, points, strict=True)]
        rows, columns = slice(_UP_DOWN, _UP_DOWN + _ROWS), slice(_IN, _IN + _COLUMNS)
        self.templates = [_lattice(skin.values)[rows, columns].copy() for skin in self.skins]

    def likeness(self, image: Float32, person: PersonArrays, pose: PoseArrays, view: ViewArrays) -> Array:
        """Correlations (13, 14), mean of both corners, of the skin around them in the first frame with what a crop, in
        which the face is at a pose, shows where it would be if it had moved down and outwards."""
        R, t, _ = pose
        shown = [_lattice(skin.look(image, person, (R, t, self.first), view)) for skin in self.skins]
        right, left = (
            cv2.matchTemplate(of_side, template, cv2.TM_CCOEFF_NORMED)
            for of_side, template in zip(shown, self.templates, strict=True)
        )
        return np.asarray((right + left) / 2)


def _lattice(values: Float32) -> Float32:
    """Values (j,) at the points of a corner, as rows of them."""
    return values.reshape(_ROWS + 2 * _UP_DOWN, -1)


@kernel()
def _look(image: Any, person: Any, skin: Any, pose: Any, value: float, view: Any, out: Any) -> None:
    """The values (m,) that a crop shows where skin lies at a pose with another value of its unit. skin: points (3, m)
    and shares (m,) of a region, its carrier and unit, and the value of that in the first frame."""
    points, shares, carrier, unit, first = skin
    R, t, a = pose
    before, after = a.copy(), a.copy()
    before[unit], after[unit] = first, value
    to_crop = head_to_crop(R, t, view)
    x0, y0, z0 = landmark(carrier, person, before)
    x1, y1, z1 = landmark(carrier, person, after)
    for j in range(out.size):
        f = shares[j]
        x, y, z = x0 + f * (x1 - x0), y0 + f * (y1 - y0), z0 + f * (z1 - z0)
        u, v, _ = project_to_crop(x + points[0, j], y + points[1, j], z + points[2, j], to_crop)
        out[j] = bilinear(image, u, v)[0]


@kernel()
def _likeness(image: Any, person: Any, skin: Any, pose: Any, values: Any, view: Any, learned: Any) -> Any:
    """What `Skin.likeness` returns; learned: (m,) of the first frame, less their mean."""
    out, shown = np.empty(values.size), np.empty(learned.size, np.float32)
    squared = 1e-6
    for j in range(learned.size):
        squared += learned[j] * learned[j]
    for k in range(values.size):
        _look(image, person, skin, pose, values[k], view, shown)
        norm = center(shown) + 1e-6
        product = 0.0
        for j in range(learned.size):
            product += shown[j] * learned[j]
        out[k] = product / np.sqrt(squared * norm)
    return out
