"""Skin that moves with lips and brows: where it looks as in the first frame, there they are.

A mouth that opens, or bares its teeth, shows what the first frame did not, so that the landmarks of the lips look
strange wherever they are. The skin between lower lip and chin, which the jaw carries, stays as it is; that between nose
and upper lip stretches between them; that around the corners of the mouth moves over the face with them, and so do the
brows, over which the forehead folds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

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

_LEAST_CONTRAST = 1e-6
"""Squared grey values: added to sums of such, or the least of them, so that skin without contrast is like nothing."""
_SPACING = 0.022
"""CANDIDE units between the points of a lattice of `SlidingRegion`."""


@dataclass(frozen=True)
class SlidingRegion:
    """Skin on either side that slides over the face with a landmark, on a lattice of points: how many of them it
    extends from the landmark towards the middle of the face, away from it, up and down; and by how many it is looked
    for elsewhere in these directions. landmark: its name without its side."""

    landmark: str
    inner: int
    outer: int
    above: int
    below: int
    inwards: int
    outwards: int
    up: int
    down: int

    @cached_property
    def sides(self) -> tuple[Region, Region]:
        """The lattices around the right and the left landmark, row by row, each from the middle of the face outwards;
        they stay where they are."""
        outwards = _SPACING * np.arange(-self.inner - self.inwards, self.outer + self.outwards + 1)
        down = _SPACING * np.arange(-self.above - self.up, self.below + self.down + 1)
        unit = 0  # none moves them: the first frame's animation is what they are looked at with
        right = _region(f"right_{self.landmark}", unit, -outwards, down)
        return right, _region(f"left_{self.landmark}", unit, outwards, down)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of a lattice."""
        rows = self.up + self.above + 1 + self.below + self.down
        return rows, self.inwards + self.inner + 1 + self.outer + self.outwards

    @property
    def skin(self) -> tuple[slice, slice]:
        """Rows and columns of the lattice that hold the skin in the first frame."""
        rows = slice(self.up, self.up + self.above + 1 + self.below)
        return rows, slice(self.inwards, self.inwards + self.inner + 1 + self.outer)


CORNERS = SlidingRegion("mouth_corner_outer", inner=4, outer=6, above=9, below=7, inwards=5, outwards=8, up=6, down=6)
"""The surroundings of the corners of the mouth."""
BROWS = SlidingRegion("brow_top", inner=6, outer=6, above=6, below=5, inwards=1, outwards=1, up=10, down=8)
"""The middles of the brows."""


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


class SlidingSkin:
    """What the skin of a `SlidingRegion` looks like in the first frame, and how far it has moved over the face.
    outwards, down: distances (k,), (m,) at which it is looked for, CANDIDE units."""

    def __init__(
        self,
        region: SlidingRegion,
        points: Array,
        image: Float32,
        person: PersonArrays,
        pose: PoseArrays,
        view: ViewArrays,
    ) -> None:
        """points: (2, j, 3) of its sides, relative to their carriers, head axes; image, pose, view: the crop of the
        first frame, and the face in it."""
        self.shape, self.first = region.shape, pose[2].copy()
        right, left = (Skin(*of_side, image, person, pose, view) for of_side in zip(region.sides, points, strict=True))
        self.where = right.where, left.where
        self.templates = np.array([side.values.reshape(region.shape)[region.skin] for side in (right, left)])
        for template in self.templates:
            template /= math.sqrt(center(template.reshape(-1)) + _LEAST_CONTRAST)
        self.outwards = _SPACING * np.arange(-region.inwards, region.outwards + 1)
        self.down = _SPACING * np.arange(-region.up, region.down + 1)

    def likeness(self, image: Float32, person: PersonArrays, pose: PoseArrays, view: ViewArrays) -> Array:
        """Correlations (m, k), mean of both sides, of the skin in the first frame with what a crop, in which the face
        is at a pose, shows where it would be if it had moved `down` and `outwards`."""
        R, t, _ = pose
        likeness: Array = _sliding_likeness(
            image, person, self.where, (R, t, self.first), view, self.templates, self.shape
        )
        return likeness


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
    squared = _LEAST_CONTRAST
    for j in range(learned.size):
        squared += learned[j] * learned[j]
    for k in range(values.size):
        _look(image, person, skin, pose, values[k], view, shown)
        norm = center(shown) + _LEAST_CONTRAST
        product = 0.0
        for j in range(learned.size):
            product += shown[j] * learned[j]
        out[k] = product / np.sqrt(squared * norm)
    return out


@kernel()
def _sliding_likeness(image: Any, person: Any, skins: Any, pose: Any, view: Any, templates: Any, shape: Any) -> Any:
    """What `SlidingSkin.likeness` returns. skins: of both sides, as `_look` takes them; templates (2, i, j): of the
    first frame, less their mean, over their norm; shape: rows and columns of the lattices."""
    _, height, width = templates.shape
    rows, columns, stride = shape[0] - height + 1, shape[1] - width + 1, shape[1]
    out, shown = np.zeros((rows, columns)), np.empty(shape[0] * stride, np.float32)
    # Row behind row, as if the lattice were one long row: at some places the template reaches over the end of a row.
    in_rows = shown.size - width + 1
    places = in_rows - stride * (height - 1)
    for side in range(2):
        _look(image, person, skins[side], pose, skins[side][-1], view, shown)
        center(shown)
        product = np.zeros(places, np.float32)
        total, squared = np.zeros(in_rows, np.float32), np.zeros(in_rows, np.float32)
        for j in range(width):
            _add_sums(shown[j:], total, squared)
            for i in range(height):
                _add_product(templates[side, i, j], shown[i * stride + j :], product)
        for r in range(rows):
            for k in range(columns):
                first, second = np.float32(0.0), np.float32(0.0)
                for i in range(height):
                    first += total[(r + i) * stride + k]
                    second += squared[(r + i) * stride + k]
                spread = max(second - first * first / (height * width), _LEAST_CONTRAST)
                out[r, k] += 0.5 * product[r * stride + k] / np.sqrt(spread)
    return out


@kernel()
def _add_sums(values: Any, total: Any, squared: Any) -> None:
    """Add values and their squares to the first of them (k,)."""
    for k in range(total.size):
        total[k] += values[k]
        squared[k] += values[k] * values[k]


@kernel()
def _add_product(factor: float, values: Any, product: Any) -> None:
    """Add a multiple of values to the first of them (k,)."""
    for k in range(product.size):
        product[k] += factor * values[k]
