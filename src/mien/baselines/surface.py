"""What the trackers with a rigid surface share: the surface, the image near the head, their registration.

The surface is a cylinder or an ellipsoid fitted to the CANDIDE of the first frame, as a grid of points with
normals in head axes. A view is the part of a frame that holds the head, blurred from coarse to fine. A
registration moves the surface until the view under it looks like a template.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mien.appearance.crop import Float32
from mien.errors import MienError
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import Array, angle_between, exp
from mien.initialization.fit import FirstFrame
from mien.tracking.state import Mask

ROWS, COLUMNS = 48, 48
"""Points of the surface: one for about every four pixels of a face 60 pixels wide."""
FRONT_DEG = 80.0
"""How far the surface reaches around the head to each side."""
CHIN, HAIRLINE = 10, 2
"""Vertices of CANDIDE: lower and upper end of the face."""
FRONT = (2, 3, 16, 17, 49, 50, 15, 48, 27, 60, 20, 53, 90, 91, 9, 14, 47, 29, 62, 28, 61, 30, 63)
"""Vertices without the nose, through which the surface is laid."""

REACH = 1.7
"""Half the side of a view, in CANDIDE units: the head, and room for it to move within a frame."""
MAXIMUM_PIXELS_PER_UNIT = 100.0
"""A larger head is shrunk by a whole number first: a grid of points would alias."""
BLURS = (0.06, 0.02)
"""Standard deviations of the Gaussians of a view, coarse to fine, in CANDIDE units."""

GRAZING = 0.25
"""Cosine of the angle between normal and line of sight below which a point counts as hidden."""
LEAST_POINTS = 100
"""A registration needs so many visible points."""
ITERATIONS, DAMPING = 8, 1e-3
"""Of Gauss-Newton on each level; the damping is a part of the mean of the diagonal."""
LARGEST_TURN_DEG, LARGEST_SHIFT = 30.0, 1.0
"""A registration that moves the head further (degrees, CANDIDE units) has found something else."""


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

    angle: (N,) radians around the head, 0 in front; height: (N,) from -1 at the chin to 1 at the top.
    """

    points: Array
    normals: Array
    angle: Array
    height: Array

    def seen(self, pose: Pose) -> tuple[Array, Array]:
        """Points in camera axes (N, 3) and the cosine (N,) between their normals and the line of sight."""
        X = self.points @ pose.R.T + pose.t
        n = self.normals @ pose.R.T
        return X, -(n * X).sum(axis=1) / np.sqrt((X * X).sum(axis=1))


def cylinder(fit: FirstFrame) -> Surface:
    """A circular cylinder through the face, without the nose, from the chin to the hairline; upright in the axes in
    which the face was fitted: where it is taken to look does not change what it is."""
    V = fit.shape @ fit.turn
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
    return Surface(points @ fit.turn.T, normals @ fit.turn.T, angle, height)


def ellipsoid(fit: FirstFrame) -> Surface:
    """An ellipsoid through the face, as wide as deep; the nose and what lies above the hairline left out; upright as
    the cylinder is."""
    V = fit.shape @ fit.turn
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
    return Surface(points @ fit.turn.T, normals @ fit.turn.T, angle, height)


def _grid() -> tuple[Array, Array]:
    """Angles and heights (N,) of the grid."""
    front = np.radians(FRONT_DEG)
    height, angle = np.meshgrid(np.linspace(1, -1, ROWS), np.linspace(-front, front, COLUMNS), indexing="ij")
    return angle.ravel(), height.ravel()


@dataclass(frozen=True)
class View:
    """The part of a frame around the head: its camera, and per level (h, w, 3) grey value and its gradient."""

    camera: Camera
    levels: tuple[Float32, ...]

    def read(self, level: int, p: Array) -> tuple[Array, Mask]:
        """Grey value and gradient (N, 3) at pixels (N, 2) of the view, and which of them lie inside."""
        image = self.levels[level]
        q = p.astype(np.float32)
        if not len(q):
            return np.zeros((0, 3)), np.zeros(0, dtype=bool)
        values = cv2.remap(image, q[None, :, 0], q[None, :, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[0]
        inside = (p[:, 0] >= 0) & (p[:, 1] >= 0) & (p[:, 0] <= image.shape[1] - 1) & (p[:, 1] <= image.shape[0] - 1)
        return values.astype(np.float64), inside


def look(frame: Frame, pose: Pose, camera: Camera) -> View | None:
    """The view of a frame around a head at this pose; None where the head is not in the image."""
    pixels_per_unit = camera.focal_px / pose.t[2]
    if not 0 < pixels_per_unit < max(frame.width, frame.height):
        return None
    centre, _ = camera.project(pose.t)
    reach = REACH * pixels_per_unit
    size = np.array([frame.width, frame.height])
    (x0, y0), (x1, y1) = (np.clip(np.round(centre + s * reach), 0, size).astype(int) for s in (-1, 1))
    shrink = int(np.ceil(pixels_per_unit / MAXIMUM_PIXELS_PER_UNIT))
    width, height = int(x1 - x0) // shrink, int(y1 - y0) // shrink
    if min(width, height) * shrink < 0.25 * reach:
        return None
    region = frame.gray[y0 : y0 + height * shrink, x0 : x0 + width * shrink].astype(np.float32)
    if shrink > 1:
        region = cv2.resize(region, (width, height), interpolation=cv2.INTER_AREA)
    cx, cy = (camera.cx - x0 + 0.5) / shrink - 0.5, (camera.cy - y0 + 0.5) / shrink - 0.5
    blurs = (blur * pixels_per_unit / shrink for blur in BLURS)
    return View(Camera(camera.focal_px / shrink, cx, cy), tuple(_with_gradient(region, sd) for sd in blurs))


def look_first(frame: Frame, pose: Pose, camera: Camera) -> View:
    """The view of the first frame. Raises MienError where its landmarks put the head outside the image."""
    view = look(frame, pose, camera)
    if view is None:
        raise MienError("the landmarks put the head outside the image; check that they belong to this video")
    return view


def _with_gradient(image: Float32, sd: float) -> Float32:
    """(h, w) -> (h, w, 3): the blurred image and its derivatives by u and v."""
    smooth = cv2.GaussianBlur(image, (0, 0), max(sd, 0.5))
    du = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    dv = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8)
    return np.asarray(np.dstack([smooth, du, dv]), np.float32)


@dataclass(frozen=True)
class Template:
    """How the surface looked at a pose: values (levels, N) grey, gradient (N,) its size in the finest level,
    cosine (N,) of the line of sight, known (N,) where it was seen."""

    values: Array
    gradient: Array
    cosine: Array
    known: Mask


def take(surface: Surface, view: View, pose: Pose) -> Template:
    """The surface at a pose as a view shows it."""
    X, cosine = surface.seen(pose)
    p, _ = view.camera.project(X)
    read = [view.read(level, p) for level in range(len(view.levels))]
    gradient = np.hypot(read[-1][0][:, 1], read[-1][0][:, 2])
    values = np.stack([values[:, 0] for values, _ in read])
    return Template(values, gradient, cosine, (cosine > GRAZING) & read[-1][1])


@dataclass(frozen=True)
class Residuals:
    """The surface at a pose against a template, at its N visible points.

    e: (N,) template minus view, grey values; J: (N, 6) view by step of `Pose.moved`; cosine: (N,) the smaller
    of the cosines of both lines of sight; gradient: (N,) size of the template's gradient; rows: the points.
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
    """Pose at which the view looks like the template, the weighted correlation of the two, and the covariance
    (6, 6) of the step as least squares states it, for residuals that are independent."""

    pose: Pose
    correlation: float
    covariance: Array


def register(
    surface: Surface, template: Template, view: View, start: Pose, weights: Weights, *, coarse: bool = True
) -> Registration | None:
    """Iteratively re-weighted Gauss-Newton from coarse to fine; None where too little is visible or it fails.

    Without `coarse` the finest level alone, for a start that is already good.
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
            H += DAMPING * np.trace(H) / 6 * np.eye(6)
            step = np.linalg.solve(H, WJ.T @ r.e)
            pose = pose.moved(step)
            if not near(start, pose):
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


def near(start: Pose, pose: Pose) -> bool:
    """Whether the head can have moved so between two frames."""
    turn, shift = float(angle_between(start.R, pose.R)), float(np.abs(pose.t - start.t).max())
    return turn < math.radians(LARGEST_TURN_DEG) and shift < LARGEST_SHIFT * max(1.0, 0.1 * float(start.t[2]))


def correlation(a: Array, b: Array, w: Array) -> float:
    """Weighted correlation of two sets of values (N,), 0 where one of them is flat."""
    a, b = a - np.average(a, weights=w), b - np.average(b, weights=w)
    scale = np.sqrt((w * a * a).sum() * (w * b * b).sum())
    return float((w * a * b).sum() / scale) if scale > 1e-9 else 0.0
