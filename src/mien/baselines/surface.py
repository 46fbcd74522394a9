"""The rigid surface of a head: a cylinder or an ellipsoid that is fitted to the CANDIDE model of the first frame, as a
grid of points with normals in head axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mien.arrays import Array
from mien.geometry.rotation import exp
from mien.initialization.fit import FirstFrame

ROWS, COLUMNS = 48, 48
"""Grid of surface points: about one per four pixels of a face 60 pixels wide."""
FRONT_DEG = 80.0
"""Extent of the surface around the head to each side."""
CHIN, HAIRLINE = 10, 2
"""Vertices of CANDIDE at the lower and upper end of the face."""
FRONT = (2, 3, 16, 17, 49, 50, 15, 48, 27, 60, 20, 53, 90, 91, 9, 14, 47, 29, 62, 28, 61, 30, 63)
"""Vertices, without the nose, to which the surface is fitted."""

GRAZING = 0.25
"""Cosine between normal and viewing ray below which a point counts as hidden."""


@dataclass(frozen=True)
class Pose:
    """R (3, 3) head -> camera, t (3,) CANDIDE units in camera axes."""

    R: Array
    t: Array

    def moved(self, step: Array) -> Pose:
        """The pose after a step (6,): rotation vector in camera axes about the head's origin, translation."""
        return Pose(exp(step[:3]) @ self.R, self.t + step[3:])


@dataclass(frozen=True)
class Surface:
    """Points (N, 3) and unit normals (N, 3) in head axes, row by row from the top, N = rows * columns.

    angle: (N,) radians around the head, 0 in front.
    """

    points: Array
    normals: Array
    angle: Array

    def seen(self, pose: Pose) -> tuple[Array, Array]:
        """Points (N, 3) in camera axes, and the cosines (N,) between their normals and the viewing rays."""
        X = self.points @ pose.R.T + pose.t
        n = self.normals @ pose.R.T
        return X, -(n * X).sum(axis=1) / np.sqrt((X * X).sum(axis=1))


def cylinder(fit: FirstFrame) -> Surface:
    """Fit a circular cylinder to the face, without the nose, from the chin to the hairline; it is upright in the axes
    of the fitted model, so that the estimated head axes do not change its shape."""
    V = fit.shape @ fit.R_head_fit
    low, high = V[CHIN, 1], V[HAIRLINE, 1]
    x, z = V[list(FRONT), 0], V[list(FRONT), 2]
    # x^2 + (z - c)^2 = r^2 is linear in c and r^2 - c^2.
    (double_c, k), *_ = np.linalg.lstsq(np.column_stack([z, np.ones_like(z)]), x**2 + z**2, rcond=None)
    c = 0.5 * double_c
    r = float(np.sqrt(k + c**2))
    angle, height = _grid()
    normals = np.column_stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)])
    y = 0.5 * (low + high) + 0.5 * (high - low) * height
    points = r * normals + np.column_stack([0 * y, y, c + 0 * y])
    return Surface(points @ fit.R_head_fit.T, normals @ fit.R_head_fit.T, angle)


def ellipsoid(fit: FirstFrame) -> Surface:
    """Fit an ellipsoid, as wide as deep, to the face without the nose and anything above the hairline; upright like the
    cylinder."""
    V = fit.shape @ fit.R_head_fit
    low, high = V[CHIN, 1], V[HAIRLINE, 1]
    middle = 0.5 * (low + high)
    x, y, z = (V[list(FRONT)] - [0, middle, 0]).T
    # x^2 + (z - c)^2 + m y^2 = r^2 is linear in c, m and r^2 - c^2.
    A = np.column_stack([z, -(y**2), np.ones_like(z)])
    (double_c, m, k), *_ = np.linalg.lstsq(A, x**2 + z**2, rcond=None)
    c, m = 0.5 * double_c, float(np.clip(m, 0.05, 1.0))
    r = float(np.sqrt(k + c**2))
    angle, height = _grid()
    y = 0.5 * (high - low) * height
    s = np.sqrt(np.maximum(r**2 - m * y**2, 0.04 * r**2))  # radius at this height
    gradient = np.column_stack([s * np.sin(angle), m * y, s * np.cos(angle)])
    points = np.column_stack([s * np.sin(angle), middle + y, c + s * np.cos(angle)])
    normals = gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
    return Surface(points @ fit.R_head_fit.T, normals @ fit.R_head_fit.T, angle)


def _grid() -> tuple[Array, Array]:
    """Angles in radians, 0 in front, and heights, from -1 at the chin to 1 at the top, (N,) of the grid."""
    front = np.radians(FRONT_DEG)
    height, angle = np.meshgrid(np.linspace(1, -1, ROWS), np.linspace(-front, front, COLUMNS), indexing="ij")
    return angle.ravel(), height.ravel()
