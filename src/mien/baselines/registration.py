"""Registration of a view: the surface of the head moves until the view at its points matches a template."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mien.arrays import Array
from mien.baselines.surface import GRAZING, Pose, Surface
from mien.baselines.view import Template, View
from mien.geometry.rotation import angle_between

LEAST_POINTS = 100
"""Minimum number of visible points for a registration."""
ITERATIONS, DAMPING = 8, 1e-3
"""Gauss-Newton iterations on each level, and damping as a fraction of the mean diagonal entry."""
LARGEST_TURN_DEG, LARGEST_SHIFT = 30.0, 1.0
"""A registration that moves the head further than this (degrees, CANDIDE units) is rejected."""


@dataclass(frozen=True)
class Residuals:
    """Residuals between a template and the surface at a pose, at its N visible points.

    e: (N,) template minus view, grey values; J: (N, 6) derivative of the view with respect to the step of `Pose.moved`;
    cosine: (N,) the smaller of the viewing cosines of template and view; gradient: (N,) gradient magnitude of the
    template; value: (N,) grey values of the view; rows: (N,) indices of the points in the surface.
    """

    e: Array
    J: Array
    cosine: Array
    gradient: Array
    value: Array
    rows: NDArray[np.intp]


def compare(surface: Surface, template: Template, view: View, pose: Pose, level: int) -> Residuals:
    """Residuals and their Jacobian at a pose."""
    X, cosine = surface.seen(pose)
    rows = np.flatnonzero(template.known & (cosine > GRAZING) & (X[:, 2] > 0))
    X = X[rows]
    p, _ = view.camera.project(X)
    values, inside = view.read(level, p)
    rows, X, values = rows[inside], X[inside], values[inside]
    a = (values[:, 1:, None] * view.camera.J_pixel_point(X)).sum(axis=1)
    x, y, z = (X - pose.t).T
    J = np.column_stack([y * a[:, 2] - z * a[:, 1], z * a[:, 0] - x * a[:, 2], x * a[:, 1] - y * a[:, 0], a])
    e = template.values[level, rows] - values[:, 0]
    lesser = np.minimum(cosine[rows], template.cosine[rows])
    return Residuals(e, J, lesser, template.gradient[rows], values[:, 0], rows)


Weights = Callable[[Residuals], Array]
"""Weights (N,) in [0, 1] of the residuals."""


@dataclass(frozen=True)
class Registration:
    """Pose at which the view matches the template, their weighted correlation, and the covariance (6, 6) of the step
    from least squares, for independent residuals."""

    pose: Pose
    correlation: float
    covariance: Array


def register(
    surface: Surface, template: Template, view: View, start: Pose, weights: Weights, *, coarse: bool = True
) -> Registration | None:
    """Iteratively re-weighted Gauss-Newton from coarse to fine; None if too little is visible or it fails.

    Without `coarse`, only the finest level is used, for a good starting pose.
    """
    pose = start
    for level in range(0 if coarse else len(view.levels) - 1, len(view.levels)):
        for _ in range(ITERATIONS):
            r = compare(surface, template, view, pose, level)
            if len(r.e) < LEAST_POINTS:
                return None
            w = weights(r)
            WJ = r.J * w[:, None]
            H = r.J.T @ WJ
            if not H.any():  # an image without contrast
                return None
            H += DAMPING * np.trace(H) / 6 * np.eye(6)
            step = np.linalg.solve(H, WJ.T @ r.e)
            pose = pose.moved(step)
            if not is_plausible_motion(start, pose):
                return None
            if np.abs(step).max() < 2e-4:
                break
    r = compare(surface, template, view, pose, len(view.levels) - 1)
    if len(r.e) < LEAST_POINTS:
        return None
    w = weights(r)
    H = r.J.T @ (r.J * w[:, None])
    variance = float((w * r.e**2).sum() / w.sum())
    covariance = variance * np.linalg.inv(H + 1e-9 * np.trace(H) * np.eye(6))
    return Registration(pose, correlation(template.values[-1, r.rows], r.value, w), covariance)


def is_plausible_motion(start: Pose, pose: Pose) -> bool:
    """Whether the motion between two poses is plausible within one frame."""
    turn, shift = float(angle_between(start.R, pose.R)), float(np.abs(pose.t - start.t).max())
    return turn < math.radians(LARGEST_TURN_DEG) and shift < LARGEST_SHIFT * max(1.0, 0.1 * float(start.t[2]))


def correlation(a: Array, b: Array, w: Array) -> float:
    """Weighted correlation of two sets of values (N,), 0 if either is constant."""
    a, b = a - np.average(a, weights=w), b - np.average(b, weights=w)
    scale = np.sqrt((w * a * a).sum() * (w * b * b).sum())
    return float((w * a * b).sum() / scale) if scale > 1e-9 else 0.0


def robust_sd(e: Array) -> float:
    """Robust standard deviation of residuals in grey values, at least one."""
    return 1.0 + 1.4826 * float(np.median(np.abs(e)))
