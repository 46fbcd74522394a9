"""Shared by the trackers with a rigid surface: the surface, the view of the head, and their registration.

The surface is a cylinder or an ellipsoid fitted to the CANDIDE model of the first frame, as a grid of points with
normals in head axes. A view is the part of a frame that contains the head, blurred at coarse to fine levels.
Registration moves the surface until the view at its points matches a template.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mien.arrays import Array, Float32, Mask
from mien.errors import MienError
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import angle_between, exp
from mien.initialization.fit import FirstFrame

ROWS, COLUMNS = 48, 48
"""Grid of surface points: about one per four pixels of a face 60 pixels wide."""
FRONT_DEG = 80.0
"""Extent of the surface around the head to each side."""
CHIN, HAIRLINE = 10, 2
"""Vertices of CANDIDE at the lower and upper end of the face."""
FRONT = (2, 3, 16, 17, 49, 50, 15, 48, 27, 60, 20, 53, 90, 91, 9, 14, 47, 29, 62, 28, 61, 30, 63)
"""Vertices, without the nose, to which the surface is fitted."""

REACH = 1.7
"""Half the side of a view, in CANDIDE units: the head, with room to move between two frames."""
MAXIMUM_PIXELS_PER_UNIT = 100.0
"""A larger head is first shrunk by an integer factor, as the grid of points would alias."""
BLURS = (0.06, 0.02)
"""Standard deviations of the Gaussians of a view, coarse to fine, in CANDIDE units."""

GRAZING = 0.25
"""Cosine between normal and viewing ray below which a point counts as hidden."""
LEAST_POINTS = 100
"""Minimum number of visible points for a registration."""
ITERATIONS, DAMPING = 8, 1e-3
"""Gauss-Newton iterations on each level, and damping as a fraction of the mean diagonal entry."""
LARGEST_TURN_DEG, LARGEST_SHIFT = 30.0, 1.0
"""A registration that moves the head further than this (degrees, CANDIDE units) is rejected."""


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
    return Surface(points @ fit.R_head_fit.T, normals @ fit.R_head_fit.T, angle, height)


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
    return Surface(points @ fit.R_head_fit.T, normals @ fit.R_head_fit.T, angle, height)


def _grid() -> tuple[Array, Array]:
    """Angles and heights (N,) of the grid."""
    front = np.radians(FRONT_DEG)
    height, angle = np.meshgrid(np.linspace(1, -1, ROWS), np.linspace(-front, front, COLUMNS), indexing="ij")
    return angle.ravel(), height.ravel()


@dataclass(frozen=True)
class View:
    """The part of a frame around the head: its camera, and for each level the grey value and its gradient (h, w, 3)."""

    camera: Camera
    levels: tuple[Float32, ...]

    def read(self, level: int, p: Array) -> tuple[Array, Mask]:
        """Grey value and gradient (N, 3) at pixels (N, 2) of the view, and a mask of those inside it."""
        image = self.levels[level]
        q = p.astype(np.float32)
        if not len(q):
            return np.zeros((0, 3)), np.zeros(0, dtype=bool)
        values = cv2.remap(image, q[None, :, 0], q[None, :, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[0]
        inside = (p[:, 0] >= 0) & (p[:, 1] >= 0) & (p[:, 0] <= image.shape[1] - 1) & (p[:, 1] <= image.shape[0] - 1)
        return values.astype(np.float64), inside


def look(frame: Frame, pose: Pose, camera: Camera) -> View | None:
    """The view of a frame around a head with this pose; None if the head is not in the image."""
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
    """The view of the first frame. Raises MienError if its landmarks place the head outside the image."""
    view = look(frame, pose, camera)
    if view is None:
        raise MienError("the landmarks place the head outside the image; check that they belong to this video")
    return view


def _with_gradient(image: Float32, sd: float) -> Float32:
    """(h, w) -> (h, w, 3): the blurred image and its derivatives with respect to u and v."""
    smooth = cv2.GaussianBlur(image, (0, 0), max(sd, 0.5))
    du = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    dv = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8)
    return np.asarray(np.dstack([smooth, du, dv]), np.float32)


@dataclass(frozen=True)
class Template:
    """Appearance of the surface at a pose: grey values (levels, N), gradient magnitude (N,) on the finest level, cosine
    (N,) between normal and viewing ray, known (N,) mask of visible points."""

    values: Array
    gradient: Array
    cosine: Array
    known: Mask


def take_template(surface: Surface, view: View, pose: Pose) -> Template:
    """Sample the appearance of the surface at a pose from a view."""
    X, cosine = surface.seen(pose)
    p, _ = view.camera.project(X)
    read = [view.read(level, p) for level in range(len(view.levels))]
    gradient = np.hypot(read[-1][0][:, 1], read[-1][0][:, 2])
    values = np.stack([values[:, 0] for values, _ in read])
    return Template(values, gradient, cosine, (cosine > GRAZING) & read[-1][1])


@dataclass(frozen=True)
class Residuals:
    """Residuals between a template and the surface at a pose, at its N visible points.

    e: (N,) template minus view, grey values; J: (N, 6) derivative of the view with respect to the step of `Pose.moved`;
    cosine: (N,) the smaller of the viewing cosines of template and view; gradient: (N,) gradient magnitude of the
    template; rows: indices of the points.
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
