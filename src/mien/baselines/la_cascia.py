"""La Cascia, Sclaroff, Athitsos 2000: a textured cylinder, registered in its unrolled texture.

M. La Cascia, S. Sclaroff, V. Athitsos, "Fast, reliable head tracking under varying illumination: an approach
based on registration of texture-mapped 3D models", IEEE Transactions on Pattern Analysis and Machine
Intelligence 22(4), 2000.

The frame, unrolled from the cylinder at a pose, differs from the texture of the first frame by a combination
of warping templates, the texture's change per parameter of motion, and of illumination templates. Both are
fixed on the first frame. Weighted, regularised least squares gives the combination, a confidence map by the
angle of the surface the weights; the motion part corrects the pose.

Simplifications: the illumination templates of the paper are the principal components of a corpus of faces
under many lights. There is no corpus here: they are the texture times the lowest harmonics of the cylinder's
normals, made orthogonal, which is what any distant light does to a matt cylinder. The radius
and first pose of the cylinder come from the fitted CANDIDE instead of a face detector's window, and a lost
head is searched for by the normalised correlation of the first face.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mien.baselines.rigid_head import RigidHead
from mien.baselines.surface import Pose, Surface, Template, View, correlation, cylinder, look, look_first, near, take
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import Array, exp
from mien.initialization.fit import fit_first_frame
from mien.initialization.landmarks import Landmarks
from mien.tracking.state import Estimate, Status

ITERATIONS = 12
SMALLEST_STEP = 5e-4
"""Radians and CANDIDE units."""
DIFFERENCES = (0.03, 0.06)
"""Displacements (radians, CANDIDE units) whose central differences, averaged, are the warping templates."""
MOTION_REGULARISATION = 1e-3
"""Of the six parameters, as a part of the mean of their information."""
ILLUMINATION_SD = 100.0
"""Prior standard deviation of the coefficient of an illumination template of unit norm, in grey values."""
GREY_SD = 8.0
"""Standard deviation of what is left of the texture, in grey values."""
LEAST_COSINE = 0.45
"""Cosine of the surface's angle to the line of sight below which nothing is trusted."""
LEAST_CORRELATION = 0.65
"""Below it the unrolled frame is not the face's texture."""
LEAST_CONFIDENT = 0.15
"""Share of the first frame's confidence that must be left for a registration."""


@dataclass(frozen=True)
class Unrolled:
    """What is fixed on the first frame, per level: texture (N,), warping templates (N, 6), illumination (N, k)."""

    texture: Array
    warping: Array
    illumination: Array


@dataclass(frozen=True)
class Trial:
    """A pose, the motion (6,) away from the first texture that the templates see there, the weighted mean squared
    error of the texture in grey values squared, and its weighted correlation, both after the light is explained."""

    pose: Pose
    motion: Array
    error: float
    correlation: float


class LaCasciaTracker:
    """Textured cylinder with warping templates and, with `use_illumination`, illumination templates."""

    def __init__(self, *, use_illumination: bool = True) -> None:
        self.use_illumination = use_illumination

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        """Unroll the first frame; its texture, and how that changes with motion and light, are fixed here."""
        landmarks.check(frame.width, frame.height)
        fit = fit_first_frame(landmarks, camera)
        surface = cylinder(fit)
        self.head = RigidHead.of(frame, fit, camera, surface)
        self.pose, self.status = self.head.first, Status.INITIALIZED
        view = look_first(frame, self.pose, camera)
        first = take(surface, view, self.pose)
        self.confidence = confidence(first)
        warping = warping_templates(surface, view, self.pose)
        self.levels = [
            Unrolled(texture, B, self._illumination(surface, texture))
            for texture, B in zip(first.values, warping, strict=True)
        ]
        return self.head.estimate(frame, self.status, self.pose)

    def track(self, frame: Frame) -> Estimate:
        """Correct the pose until the unrolled frame is the first texture in another light."""
        pose = self._registered(frame, self.pose)
        if pose is None and self.status is Status.LOST:
            pose = self._registered(frame, self.head.relocated(frame))
        if pose is None or not self.head.in_sight(frame, pose):
            return self._lost(frame)
        self.pose = pose
        self.status = Status.RECOVERED if self.status is Status.LOST else Status.TRACKED
        return self.head.estimate(frame, self.status, self.pose)

    def _registered(self, frame: Frame, start: Pose) -> Pose | None:
        """The pose at which the frame shows the texture; None where it does not."""
        view = look(frame, start, self.head.camera)
        best = None
        for level in range(len(self.levels)):
            best = None if view is None else self._descend(view, start if best is None else best.pose, level)
            if best is None or not near(start, best.pose):
                return None
        return best.pose if best is not None and best.correlation >= LEAST_CORRELATION else None

    def _descend(self, view: View, start: Pose, level: int) -> Trial | None:
        """The best pose on the way that the templates point; a step that does not help is halved."""
        best = self._try(view, start, level)
        scale = 1.0
        for _ in range(ITERATIONS):
            if best is None or scale * np.abs(best.motion).max() < SMALLEST_STEP:
                break
            trial = self._try(view, displaced(best.pose, -scale * best.motion), level)
            if trial is not None and trial.error < best.error:
                best, scale = trial, 1.0
            else:
                scale *= 0.5
        return best

    def _try(self, view: View, pose: Pose, level: int) -> Trial | None:
        """The texture at a pose against the first one; None where too little of that is in sight."""
        now = take(self.head.surface, view, pose)
        w = confidence(now) * self.confidence
        if w.sum() < LEAST_CONFIDENT * (self.confidence**2).sum():
            return None
        motion, explained = solve(self.levels[level], now.values[level], w)
        error = float(np.average((now.values[level] - explained) ** 2, weights=w))
        return Trial(pose, motion, error, correlation(now.values[level], explained, w))

    def _illumination(self, surface: Surface, texture: Array) -> Array:
        if not self.use_illumination:
            return np.zeros((len(texture), 0))
        return illumination_templates(surface, texture, self.confidence)

    def _lost(self, frame: Frame) -> Estimate:
        self.status = Status.LOST
        return self.head.lost(frame, self.pose)


def displaced(pose: Pose, motion: Array) -> Pose:
    """The pose after a motion (6,): rotation vector in head axes, translation in camera axes.

    In head axes a rotation changes the texture of a cylinder in the same way at every pose, which is why
    templates of the first frame serve for all others.
    """
    return Pose(pose.R @ exp(motion[:3]), pose.t + motion[3:])


def warping_templates(surface: Surface, view: View, pose: Pose) -> Array:
    """Change of the texture per parameter of motion, by central differences: (levels, N, 6)."""
    columns = []
    for axis in np.eye(6):
        slopes = []
        for size in DIFFERENCES:
            plus, minus = (take(surface, view, displaced(pose, s * size * axis)).values for s in (1, -1))
            slopes.append((plus - minus) / (2 * size))
        columns.append(np.mean(slopes, axis=0))
    return np.stack(columns, axis=-1)


def illumination_templates(surface: Surface, texture: Array, weight: Array) -> Array:
    """(N, 5) orthonormal under the weights: the texture times the light that a matt cylinder can be in.

    R. Basri, D. W. Jacobs 2003: nine harmonics of the normal make up almost any distant light on a matt surface;
    on an upright cylinder five of them differ.
    """
    a = surface.angle
    light = np.column_stack([np.ones_like(a), np.cos(a), np.sin(a), np.cos(2 * a), np.sin(2 * a)])
    root = np.sqrt(weight + 1e-6)
    Q, _ = np.linalg.qr(root[:, None] * light * texture[:, None])
    return np.asarray(Q / root[:, None])


def confidence(unrolled: Template) -> Array:
    """(N,) in [0, 1]: how much of each piece of the texture the camera sees, 0 where it sees nothing."""
    return np.where(unrolled.known & (unrolled.cosine > LEAST_COSINE), unrolled.cosine, 0.0)


def solve(unrolled: Unrolled, texture: Array, w: Array) -> tuple[Array, Array]:
    """Motion (6,) of a texture (N,) away from the first one, and the texture without it: weights w (N,).

    Regularised least squares of `texture - first = warping q + illumination c`.
    """
    A = np.hstack([unrolled.warping, unrolled.illumination])
    WA = A * w[:, None]
    H = WA.T @ A
    H[np.diag_indices(6)] += MOTION_REGULARISATION * np.trace(H[:6, :6]) / 6
    k = np.arange(6, len(H))
    H[k, k] += (GREY_SD / ILLUMINATION_SD) ** 2
    x = np.linalg.solve(H, WA.T @ (texture - unrolled.texture))
    return x[:6], unrolled.texture + unrolled.illumination @ x[6:]
