"""CANDIDE-3: `g = s R (gbar + S sigma + A alpha) + t`, Eq. (1).

J. Ahlberg, CANDIDE-3: an updated parameterised face, LiTH-ISY-R-2326, Linkoeping University, 2001.
Axes: x to the subject's left, y up, z out of the face. One unit is some 11 cm, half the height of a head.
A perspective camera observes only `s / t`, so mien uses `s = 1` and lengths in CANDIDE units internally;
`mm_per_unit` converts them for output.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from mien.arrays import Array
from mien.errors import require

TRACKED_UNITS = (
    "upper_lip_raiser",
    "jaw_drop",
    "lip_stretcher",
    "brow_lowerer",
    "lip_corner_depressor",
    "outer_brow_raiser",
)
"""The six animation units of the state, Eq. (2), in its order."""
MOVES_MOUTH = np.array(["brow" not in unit for unit in TRACKED_UNITS])
"""(6,) which of them move the mouth; the others move the brows."""

INTERPUPILLARY_MM = 63.0
"""Distance between the pupils that every face is taken to have."""
_PUPILS = ((67, 68, 71, 72), (69, 70, 73, 74))  # iris corners of the left and of the right eye
_EYE_OPENINGS = ((20, 97, 21, 105, 23, 107, 22, 99), (53, 98, 54, 106, 56, 108, 55, 100))
_LID_MEETING_HEIGHT = 0.25
"""Height above the lower lid at which lids meet, as a fraction of the opening, as in CANDIDE-3's `eyes_closed`."""
MOUTH_TRIANGLES = ((88, 81, 83), (83, 81, 40), (40, 81, 87), (87, 82, 40), (40, 82, 84), (84, 82, 89))
"""Triangles between the lips, where CANDIDE has a hole; they are not part of `Candide.triangles`."""


@dataclass(frozen=True, eq=False)
class Candide:
    """The parameterised face: mean shape, shape units, animation units, triangles. Models compare by identity.

    mean: (V, 3) `gbar`; triangles: (T, 3) vertex indices, counter-clockwise seen from outside;
    shape_units: (K, V, 3) `S`; animation_units: (L, V, 3) `A`; names are in the order of the rows.
    """

    mean: Array
    vertex_names: tuple[str, ...]
    triangles: NDArray[np.intp]
    shape_unit_names: tuple[str, ...]
    shape_units: Array
    animation_unit_names: tuple[str, ...]
    animation_units: Array

    @staticmethod
    def default(surfaces: int = 184) -> Candide:
        """The built-in model with 184 surfaces, or with the 168 of version 3.1.3, which has no eyeballs. Trackers have
        the same, so its arrays cannot be written to: work on copies."""
        require(surfaces in (184, 168), f"CANDIDE-3 has 184 or 168 surfaces, not {surfaces}")
        return _built_in(surfaces)

    def vertices(self, sigma: Array | None = None, alpha: Array | None = None) -> Array:
        """`gbar + S sigma + A alpha` of Eq. (1): (K,), (L,) -> (V, 3) in head axes."""
        shape = self.mean
        if sigma is not None:
            shape = shape + np.tensordot(sigma, self.shape_units, axes=1)
        if alpha is not None:
            shape = shape + np.tensordot(alpha, self.animation_units, axes=1)
        return shape

    def pose(self, vertices: Array, R: Array, t: Array, s: float = 1.0) -> Array:
        """`s R g + t` of Eq. (1): (V, 3) head axes -> (V, 3) camera axes."""
        return np.asarray(s * vertices @ R.T + t)

    def with_tracked_units(self) -> Candide:
        """The same model with only the `TRACKED_UNITS`, in their order. Raises MienError if it lacks one."""
        missing = [n for n in TRACKED_UNITS if n not in self.animation_unit_names]
        require(
            not missing,
            f"the model has no animation unit {missing}; it has {list(self.animation_unit_names)}",
        )
        rows = [self.animation_unit_names.index(n) for n in TRACKED_UNITS]
        return replace(self, animation_unit_names=TRACKED_UNITS, animation_units=self.animation_units[rows])

    def with_whole_brows(self) -> Candide:
        """The same model with the inner brow raiser (AU1) added to the outer one (AU2), if it has both: one muscle
        lifts the whole brow, and few people can move only half of it."""
        outer, inner = "outer_brow_raiser", "inner_brow_raiser"
        if not {outer, inner} <= set(self.animation_unit_names):
            return self
        units = self.animation_units.copy()
        units[self.animation_unit_names.index(outer)] += units[self.animation_unit_names.index(inner)]
        return replace(self, animation_units=units)

    def turned(self, R: Array) -> Candide:
        """The same model in rotated axes: every vertex and unit is multiplied by R (3, 3)."""
        return replace(
            self,
            mean=self.mean @ R.T,
            shape_units=self.shape_units @ R.T,
            animation_units=self.animation_units @ R.T,
        )


def mm_per_unit(vertices: Array) -> float:
    """Millimetres per CANDIDE unit for a face (V, 3), whose pupils are `INTERPUPILLARY_MM` apart."""
    left, right = (vertices[list(corners)].mean(axis=0) for corners in _PUPILS)
    return float(INTERPUPILLARY_MM / np.linalg.norm(left - right))


def lid_closing(share: float) -> tuple[float, float]:
    """Displacements of the upper and the lower lid towards each other, as fractions of the eye opening, for an eye
    closure `share`."""
    return share * (1 - _LID_MEETING_HEIGHT), share * _LID_MEETING_HEIGHT


def with_eyes_closed(vertices: Array, share: float) -> Array:
    """The vertices (V, 3), head axes, with both eyes closed by a fraction of their opening.

    CANDIDE-3's unit `eyes_closed` fits the eyes of its mean face only; those of a person may be wider.
    """
    out = vertices.copy()
    for (_, u1, u2, u3, _, l1, l2, l3), iris in zip(_EYE_OPENINGS, _PUPILS, strict=True):
        upper, lower = [u1, u2, u3], [l3, l2, l1]
        opening = vertices[upper] - vertices[lower]
        out[upper] -= lid_closing(share)[0] * opening
        out[lower] += lid_closing(share)[1] * opening
        meet = vertices[l2] + lid_closing(1.0)[1] * (vertices[u2] - vertices[l2])
        out[list(iris), 1] += share * (meet[1] - vertices[list(iris), 1])
    return out


@cache
def _built_in(surfaces: int) -> Candide:
    """What `Candide.default` returns, once for each number of surfaces, as models compare by identity."""
    model = _load_tables() if surfaces == 184 else _close_eyes(_load_tables())
    for array in (model.mean, model.triangles, model.shape_units, model.animation_units):
        array.setflags(write=False)
    return model


def _load_tables() -> Candide:
    vertex_rows = list(_read("vertices.csv"))
    mean = np.array([[float(r[k]) for k in "xyz"] for r in vertex_rows])
    triangles = outward(mean, np.array([[int(r[k]) for k in "abc"] for r in _read("triangles.csv")]))
    shape_names, shape_units = _load_units("shape_units.csv", len(mean))
    animation_names, animation_units = _load_units("animation_units.csv", len(mean))
    names = tuple(r["name"] for r in vertex_rows)
    return Candide(mean, names, triangles, shape_names, shape_units, animation_names, animation_units)


def _load_units(table: str, vertex_count: int) -> tuple[tuple[str, ...], Array]:
    rows = list(_read(table))
    names = tuple(dict.fromkeys(r["unit"] for r in rows))
    units = np.zeros((len(names), vertex_count, 3))
    for r in rows:
        units[names.index(r["unit"]), int(r["vertex"])] = float(r["dx"]), float(r["dy"]), float(r["dz"])
    return names, units


def _read(table: str) -> Iterator[dict[str, str]]:
    with (files("mien.candide") / "data" / table).open(encoding="utf-8") as f:
        yield from csv.DictReader(f)


def _close_eyes(model: Candide) -> Candide:
    """Replace the 28 triangles of the eyeballs by a strip of six across the opening of each eye."""
    iris = [v for eye in _PUPILS for v in eye]
    kept = model.triangles[~np.isin(model.triangles, iris).any(axis=1)]
    strips = []
    for outer, u1, u2, u3, inner, l1, l2, l3 in _EYE_OPENINGS:
        strips += [(outer, u1, l3), (u1, u2, l3), (u2, l2, l3), (u2, u3, l2), (u3, l1, l2), (u3, inner, l1)]
    return replace(model, triangles=np.vstack([kept, outward(model.mean, np.array(strips))]))


def outward(mean: Array, triangles: NDArray[np.intp]) -> NDArray[np.intp]:
    """Order the corners of triangles so that normals point out of the face; the report's lists mix both orders."""
    a, b, c = (mean[triangles[:, k], :2] for k in range(3))
    inward = (b - a)[:, 0] * (c - a)[:, 1] < (b - a)[:, 1] * (c - a)[:, 0]
    return np.where(inward[:, None], triangles[:, [0, 2, 1]], triangles)
