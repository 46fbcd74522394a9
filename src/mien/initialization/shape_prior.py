"""Prior of the face shape: a Gaussian over the neutral vertices.

Real faces also vary in ways that the shape units S of CANDIDE do not span. The prior adds smooth displacement fields,
mostly symmetric, so that a fit can follow landmarks exactly, and what is not observed (depth, in a frontal view) stays
uncertain instead of wrong.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from mien.arrays import Array
from mien.candide.model import Candide

UNIT_SD = 0.06
"""Standard deviation, in CANDIDE units, of the largest displacement of each shape unit."""
FIELD_SD, FIELD_LENGTH = 0.025, 0.18
"""Standard deviation of a vertex in the symmetric displacement fields, and the length over which they are correlated,
CANDIDE units."""
ASYMMETRY = 0.3
"""Ratio of the standard deviations of antisymmetric and symmetric displacement fields."""
_LEAST_VARIANCE = 0.02
"""Variance of a mode, in those of a vertex, up to which it is left out."""


@dataclass(frozen=True)
class ShapePrior:
    """Vertices = mean + sum_k c_k basis_k with c ~ N(0, I).

    mean: (V, 3); basis: (M, V, 3); the first K of the M fields are the shape units scaled by unit_sd (K,).
    """

    mean: Array
    basis: Array
    unit_sd: Array

    def vertices(self, c: Array) -> Array:
        """Neutral vertices (V, 3) for coefficients (M,)."""
        return np.asarray(self.mean + np.tensordot(c, self.basis, axes=1))

    def sigma(self, c: Array) -> Array:
        """Shape parameters sigma (K,) of Eq. (1), in units of CANDIDE."""
        return np.asarray(c[: len(self.unit_sd)] * self.unit_sd)


def shape_prior(model: Candide) -> ShapePrior:
    """The shape prior of a model: its shape units, and smooth displacement fields."""
    largest = np.linalg.norm(model.shape_units, axis=2).max(axis=1)
    unit_sd = UNIT_SD / np.maximum(largest, 1e-9)
    units = model.shape_units * unit_sd[:, None, None]
    return ShapePrior(model.mean, np.concatenate([units, _smooth_fields(model.mean)]), unit_sd)


def _smooth_fields(vertices: Array) -> Array:
    """Displacement fields (M, V, 3): the scaled principal modes of a Gaussian process over the vertices, in each
    coordinate, with the covariances `sd^2 (near + mirrored)` and `sd^2 (near - mirrored)`."""
    near, mirrored = proximity(vertices, vertices), proximity(vertices, vertices * [-1, 1, 1])
    modes = {sign: np.linalg.eigh(0.5 * (near + sign * mirrored)) for sign in (1.0, -1.0)}
    fields = []
    for axis, parity in product(range(3), (1.0, -1.0)):
        # In a symmetric field, x changes sign between the sides of the face, and y and z do not.
        values, vectors = modes[parity * (-1.0 if axis == 0 else 1.0)]
        kept = values > _LEAST_VARIANCE
        sd = FIELD_SD * (1.0 if parity > 0 else ASYMMETRY) * np.sqrt(2)  # as the modes are of half of that
        block = np.zeros((int(kept.sum()), len(vertices), 3))
        block[:, :, axis] = (vectors[:, kept] * (sd * np.sqrt(values[kept]))).T
        fields.append(block)
    return np.concatenate(fields)


def proximity(a: Array, b: Array, length: float = FIELD_LENGTH) -> Array:
    """exp(-|a - b|^2 / 2 length^2) (m, n) for points (m, 3) and (n, 3): the correlation of their displacements."""
    squared = ((a[:, None] - b[None]) ** 2).sum(axis=2)
    return np.asarray(np.exp(-0.5 * squared / length**2))
