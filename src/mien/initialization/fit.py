"""The first frame: pose, shape and animation from landmarks, section 3.1 of the paper.

POSIT gives the pose of the mean face; then pose, shape and animation are fitted jointly, as the maximum of a posterior
with a robust Gaussian likelihood of the landmarks and the shape prior. As heads differ, this leaves the facing
direction uncertain by a few degrees; a prior that people look into the camera at the start reduces that.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from mien.arrays import Array
from mien.candide.model import Candide, mm_per_unit
from mien.errors import require
from mien.geometry.camera import Camera, line_of_sight
from mien.geometry.rotation import FACING, euler_from_matrix, exp, hat, left_jacobian, matrix_from_euler, ray_rotation
from mien.initialization.landmarks import Landmarks
from mien.initialization.posit import posit
from mien.initialization.shape_prior import ShapePrior, shape_prior

LANDMARK_SD = 0.012
"""Standard deviation of a landmark's image position, as a length on the face in CANDIDE units."""
DEPTH_SD = 0.03
"""The same for a landmark's relative depth, if the source estimates one."""
ANIMATION_SD = 0.2
"""Prior standard deviation of the animation units in the first frame, which is mostly neutral."""
LEAN_DEG = 2.0
"""CANDIDE's z axis points this much further up than that of 3D head models; measured on three subjects, whose heads
differ from each other by as much (docs/method.md)."""
AXES_SD_DEG = (3.0, 1.5, 0.8)
"""Standard deviation of a person's own head axes (tilt, pan, roll) from those of the fitted model: these maximise the
likelihood of later rotations, over first frames at 0 to 45 degrees of nine people (docs/benchmark.md)."""
FRONTAL_SHARE, FRONTAL_SD_DEG, ELSEWHERE_SD_DEG = 0.5, 3.0, 20.0
"""Prior of the facing direction in the first frame: this fraction of people look into the camera, with the first
standard deviation in degrees; the others look elsewhere, with the second."""
LARGEST_MISFIT = 0.15
"""Root mean square of the residuals, over the size of the face, beyond which the landmarks are not those of a face: of
a detected one even the worst point is off by 0.08 at most. The fit withstands single outliers, but not one that is
several faces away."""
_ITERATIONS = 30


@dataclass(frozen=True)
class FirstFrame:
    """Face model and state of the first frame.

    R: (3, 3) head -> camera; t: (3,); animation: (6,); shape: (V, 3) neutral vertices in head axes;
    coefficients: (M,) of the shape prior; distances_px: (m,) of the landmarks that are used from the fitted face;
    model: in head axes; R_head_fit: (3, 3), from the axes in which the shape was fitted, see `mien.geometry`; axes_sd:
    (3,) radians, standard deviations of the head axes in tilt, pan and roll.
    """

    R: Array
    t: Array
    animation: Array
    shape: Array
    coefficients: Array
    distances_px: Array
    mm_per_unit: float
    model: Candide
    prior: ShapePrior
    R_head_fit: Array
    axes_sd: Array

    @property
    def residual_px(self) -> float:
        """Root mean square of `distances_px`."""
        return float(np.sqrt(np.mean(self.distances_px**2)))

    @property
    def sigma(self) -> Array:
        """Shape parameters of Eq. (1)."""
        return self.prior.sigma(self.coefficients)

    def vertices(self, animation: Array | None = None) -> Array:
        """Vertices (V, 3) in head axes, by default with the animation of the first frame."""
        a = self.animation if animation is None else animation
        return np.asarray(self.shape + np.tensordot(a, self.model.animation_units, axes=1))

    def in_camera(self) -> Array:
        """Vertices (V, 3) of the first frame in camera axes."""
        return self.model.pose(self.vertices(), self.R, self.t)

    def mesh(self, R: Array | None, t: Array | None, animation: Array | None) -> Array | None:
        """Vertices (V, 3) in camera axes at a pose R (3, 3), t (3,); None without one. An animation (6,) that is not
        known is that of the first frame."""
        return None if R is None or t is None else self.model.pose(self.vertices(animation), R, t)


def tracked_model(model: Candide) -> tuple[Candide, ShapePrior]:
    """The model with the six animation units of the state, upright, and its shape prior. Raises MienError if it lacks a
    unit."""
    upright = model.with_tracked_units().turned(exp(np.array([np.radians(-LEAN_DEG), 0, 0])))
    return upright, shape_prior(upright)


@cache
def _default_model() -> tuple[Candide, ShapePrior]:
    return tracked_model(Candide.default())


def fit_first_frame(landmarks: Landmarks, camera: Camera, model: Candide | None = None) -> FirstFrame:
    """Fit a face model, with the six tracked animation units, to the landmarks of the first frame.

    model: by default the package's own; another must have the vertices of CANDIDE-3, in its order, and its animation
    units by name, as from `read_wfm(path).model`. Raises MienError for a model that lacks any, and for landmarks that
    no face fits.
    """
    model, prior = _default_model() if model is None else tracked_model(model)
    vertices, points, depths = landmarks.correspondences()
    require(
        len(model.mean) >= len(Candide.default().mean),
        f"the face model has {len(model.mean)} vertices; tracking needs the {len(Candide.default().mean)} of CANDIDE-3",
    )
    R, t = posit(model.mean[vertices], points, camera)
    sight = line_of_sight(landmarks.points, camera)
    problem = _Problem(camera, prior, model.animation_units, vertices, points, depths, sight, R, float(t[2]))
    x0 = np.zeros(problem.size)
    x0[3:6] = t
    x = _minimize(problem, x0)
    distances_px = np.linalg.norm(problem.image(x) - points, axis=1)
    farthest = landmarks.point_names[int(distances_px.argmax())]
    require(
        bool(np.sqrt(np.mean(distances_px**2)) <= LARGEST_MISFIT * np.ptp(points, axis=0).max()),  # not if it is NaN
        f"{landmarks.source}: no face fits the landmarks; correct point {farthest}, which lies farthest from where it "
        "belongs, and others that lie far from there",
    )
    R_fit, t = exp(x[:3]) @ R, x[3:6]
    R, axes_sd = most_likely_facing(R_fit, t)
    R_head_fit = R.T @ R_fit
    shape = prior.vertices(x[problem.shape_slice]) @ R_head_fit.T
    return FirstFrame(
        R=R,
        t=t,
        animation=x[problem.animation_slice],
        shape=shape,
        coefficients=x[problem.shape_slice],
        distances_px=distances_px,
        mm_per_unit=mm_per_unit(shape),
        model=model.turned(R_head_fit),
        prior=prior,
        R_head_fit=R_head_fit,
        axes_sd=axes_sd,
    )


def most_likely_facing(
    R: Array, t: Array, axes_sd_deg: tuple[float, float, float] = AXES_SD_DEG
) -> tuple[Array, Array]:
    """Expected rotation (3, 3) of a head, given the pose R (3, 3), t (3,) of its fitted model, camera axes, and the
    standard deviations (3,) of its tilt, pan and roll in radians. axes_sd_deg: of the head axes from the model's.

    The prior is a mixture: a person looks nearly into the camera, or anywhere. A head that is clearly turned away is
    left as fitted. One that lies on its side or upside down, or whose camera does, looks into the camera all the same.
    """
    upright = ray_rotation(t)
    seen = euler_from_matrix(upright.T @ R @ FACING)
    quarters = round(float(seen[2]) / (0.5 * np.pi))
    if quarters:
        upright = upright @ exp(np.array([0.0, 0.0, 0.5 * np.pi * quarters]))
        seen = euler_from_matrix(upright.T @ R @ FACING)
    angles = np.degrees(seen)
    axes = np.square(axes_sd_deg)
    frontal, elsewhere = (axes + sd**2 for sd in (FRONTAL_SD_DEG, ELSEWHERE_SD_DEG))
    odds = (1 - FRONTAL_SHARE) / FRONTAL_SHARE * np.sqrt(np.prod(frontal / elsewhere))
    exponent = 0.5 * float((angles**2 * (1 / frontal - 1 / elsewhere)).sum())
    looks = 1 / (1 + odds * np.exp(min(exponent, 500.0)))
    # The broad prior for looking elsewhere is neglected: it would shrink the angles by only one percent.
    gain = axes / frontal
    expected = angles * (1 - looks * gain)
    variance = looks * axes * (1 - gain) + (1 - looks) * axes + looks * (1 - looks) * (angles * gain) ** 2
    return np.asarray(upright @ matrix_from_euler(np.radians(expected)) @ FACING), np.radians(np.sqrt(variance))


def turned_deg(R: Array, t: Array) -> float:
    """Angle in degrees between the facing direction of a pose R (3, 3), t (3,) and the direction to the camera."""
    return float(np.degrees(np.arccos(np.clip(-(R[:, 2] @ t) / np.linalg.norm(t), -1, 1))))


def _minimize(problem: _Problem, x: Array) -> Array:
    """Levenberg-Marquardt on the robust (pseudo-Huber) sum of squares."""
    damping = 1e-4
    r = problem.residuals(x)
    for _ in range(_ITERATIONS):
        J = problem.jacobian(x)
        # Weights of rho(s) = 2 (sqrt(1 + s) - 1); the prior's rows, at the end, stay quadratic.
        w = np.where(np.arange(len(r)) < problem.measurements, 1 / np.sqrt(1 + r * r), 1.0)
        H, g = (J.T * w) @ J, J.T @ (w * r)
        step = -np.linalg.solve(H + damping * np.diag(np.diag(H)), g)
        candidate = problem.residuals(x + step)
        if problem.cost(candidate) < problem.cost(r):
            gain = problem.cost(r) - problem.cost(candidate)
            x, r, damping = x + step, candidate, 0.1 * damping
            if gain < 1e-4:
                break
        else:
            damping *= 30
    return x


class _Problem:
    """Residuals, in standard deviations, of x = [rotation (3), translation (3), animation, shape, depth offset]."""

    def __init__(
        self,
        camera: Camera,
        prior: ShapePrior,
        animation_units: Array,
        vertices: NDArray[np.intp],
        points: Array,
        depths: Array | None,
        sight: Array,
        R: Array,
        distance: float,
    ) -> None:
        """vertices: (n,) that are seen at points (n, 2), pixels, with depths (n,), pixels, along sight (3,); R: (3, 3)
        and distance, CANDIDE units, are those of the beginning."""
        self.camera, self.points, self.depths, self.R = camera, points, depths, R
        self.sight = sight
        self.mean = prior.mean[vertices]
        self.fields = np.concatenate([animation_units[:, vertices], prior.basis[:, vertices]])
        self.prior_sd = np.concatenate([np.full(len(animation_units), ANIMATION_SD), np.ones(len(prior.basis))])
        a, m = len(animation_units), len(prior.basis)
        self.animation_slice, self.shape_slice = slice(6, 6 + a), slice(6 + a, 6 + a + m)
        self.pixels_per_unit = camera.focal_px / distance
        self.size = 6 + a + m + (0 if depths is None else 1)

    @property
    def measurements(self) -> int:
        """Number of measurement rows; the rest are the prior's."""
        return len(self.points) * (2 if self.depths is None else 3)

    def cost(self, r: Array) -> float:
        """Robust sum of squared residuals."""
        measured, prior = r[: self.measurements], r[self.measurements :]
        return float((2 * (np.sqrt(1 + measured**2) - 1)).sum() + (prior**2).sum())

    def camera_points(self, x: Array) -> tuple[Array, Array]:
        """Points (n, 3) in camera axes, and the same without the translation."""
        X = self.mean + np.tensordot(x[6 : 6 + len(self.fields)], self.fields, axes=1)
        rotated = X @ (exp(x[:3]) @ self.R).T
        return rotated + x[3:6], rotated

    def image(self, x: Array) -> Array:
        """Image points (n, 2)."""
        return self.camera.project(self.camera_points(x)[0])[0]

    def residuals(self, x: Array) -> Array:
        """Residuals (k,) at x (size,): those of the measurements, and then of the prior of animation and shape."""
        X, _ = self.camera_points(x)
        p = self.camera.project(X)[0]
        r = [((p - self.points) / (LANDMARK_SD * self.pixels_per_unit)).ravel()]
        if self.depths is not None:
            r.append((X @ self.sight - x[-1] - self.depths / self.pixels_per_unit) / DEPTH_SD)
        r.append(x[6 : 6 + len(self.fields)] / self.prior_sd)
        return np.concatenate(r)

    def jacobian(self, x: Array) -> Array:
        """Derivatives (k, size) of the residuals."""
        X, rotated = self.camera_points(x)
        R = exp(x[:3]) @ self.R
        n = len(X)
        J_point = np.zeros((n, 3, self.size))  # of the camera points with respect to x
        J_left = left_jacobian(x[:3])
        for k in range(n):
            J_point[k, :, :3] = -hat(rotated[k]) @ J_left
        J_point[:, :, 3:6] = np.eye(3)
        J_point[:, :, 6 : 6 + len(self.fields)] = np.einsum("ij,mnj->nim", R, self.fields)
        J_pixel = np.einsum("nij,njk->nik", self.camera.J_pixel_point(X), J_point)
        rows = [J_pixel.reshape(2 * n, -1) / (LANDMARK_SD * self.pixels_per_unit)]
        if self.depths is not None:
            J_depth = np.einsum("i,nij->nj", self.sight, J_point)
            J_depth[:, -1] = -1.0
            rows.append(J_depth / DEPTH_SD)
        J_prior = np.zeros((len(self.fields), self.size))
        J_prior[:, 6 : 6 + len(self.fields)] = np.diag(1 / self.prior_sd)
        rows.append(J_prior)
        return np.concatenate(rows)
