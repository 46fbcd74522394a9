"""La Cascia, Sclaroff, Athitsos 2000: a textured cylinder, registered in its unrolled texture.

M. La Cascia, S. Sclaroff, V. Athitsos, "Fast, reliable head tracking under varying illumination: an approach
based on registration of texture-mapped 3D models", IEEE Transactions on Pattern Analysis and Machine
Intelligence 22(4), 2000.

The texture of a frame, unrolled from the cylinder at a pose, differs from that of the first frame by a linear
combination of warping templates (the derivatives of the texture with respect to the motion parameters) and of
illumination templates. Both are computed in the first frame. Weighted, regularised least squares gives the
coefficients, with weights from a confidence map based on the surface angle; those of the motion correct the pose.

Simplifications: the illumination templates of the paper are the principal components of a corpus of faces
under many lights. Without a corpus, they are here the texture times the lowest harmonics of the cylinder's
normals, orthogonalised, which is the effect of any distant light on a Lambertian cylinder. The radius and initial pose
of the cylinder come from the fitted CANDIDE instead of a face detector's window, and a lost head is searched for by
the normalised correlation of the first face.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mien.arrays import Array
from mien.baselines.registration import correlation, is_plausible_motion
from mien.baselines.rigid_tracker import RigidTracker
from mien.baselines.surface import Pose, Surface, cylinder
from mien.baselines.view import Template, View, take_template
from mien.geometry.rotation import exp

ITERATIONS = 12
SMALLEST_STEP = 5e-4
"""Radians and CANDIDE units."""
DIFFERENCES = (0.03, 0.06)
"""Displacements (radians, CANDIDE units) for the central differences whose mean is the warping templates."""
MOTION_REGULARISATION = 1e-3
"""Regularisation of the six motion parameters, as a fraction of their mean information."""
ILLUMINATION_SD = 100.0
"""Prior standard deviation of the coefficient of an illumination template of unit norm, in grey values."""
GREY_SD = 8.0
"""Standard deviation of the texture residuals, in grey values."""
LEAST_COSINE = 0.45
"""Cosine between normal and viewing ray below which the confidence is zero."""
LEAST_CORRELATION = 0.65
"""Correlation below which the unrolled frame is not the texture of the face."""
LEAST_CONFIDENT = 0.15
"""Fraction of the first frame's confidence that a registration needs."""


@dataclass(frozen=True)
class Unrolled:
    """Texture (N,), warping templates (N, 6) and illumination templates (N, k) of the first frame, for one level."""

    texture: Array
    warping: Array
    illumination: Array


@dataclass(frozen=True)
class Trial:
    """A pose, the remaining motion (6,) according to the templates, the weighted mean squared error of the texture in
    grey values squared, and its weighted correlation, both after compensating illumination."""

    pose: Pose
    motion: Array
    error: float
    correlation: float


class LaCasciaTracker(RigidTracker):
    """Textured cylinder with warping templates and, with `use_illumination`, illumination templates."""

    surface_of = staticmethod(cylinder)

    def __init__(self, *, use_illumination: bool = True) -> None:
        self.use_illumination = use_illumination

    def _learn(self, view: View) -> None:
        first = take_template(self.head.surface, view, self.pose)
        self.confidence = confidence(first)
        warping = warping_templates(self.head.surface, view, self.pose)
        self.levels = [
            Unrolled(texture, B, self._illumination(texture)) for texture, B in zip(first.values, warping, strict=True)
        ]

    def _follow(self, view: View) -> Pose | None:
        return self._matched(view, self.pose)

    def _recover(self, view: View, start: Pose) -> Pose | None:
        return self._matched(view, start)

    def _matched(self, view: View, start: Pose) -> Pose | None:
        """The pose at which the view matches the texture up to illumination; None if there is none."""
        pose, best = start, None
        for level in range(len(self.levels)):
            best = self._descend(view, pose, level)
            if best is None or not is_plausible_motion(start, best.pose):
                return None
            pose = best.pose
        return best.pose if best is not None and best.correlation >= LEAST_CORRELATION else None

    def _descend(self, view: View, start: Pose, level: int) -> Trial | None:
        """The best pose along the motion given by the templates; a step that does not reduce the error is halved."""
        best = self._evaluate(view, start, level)
        scale = 1.0
        for _ in range(ITERATIONS):
            if best is None or scale * np.abs(best.motion).max() < SMALLEST_STEP:
                break
            trial = self._evaluate(view, displaced(best.pose, -scale * best.motion), level)
            if trial is not None and trial.error < best.error:
                best, scale = trial, 1.0
            else:
                scale *= 0.5
        return best

    def _evaluate(self, view: View, pose: Pose, level: int) -> Trial | None:
        """Compare the texture at a pose with the first one; None if too little of it is visible."""
        now = take_template(self.head.surface, view, pose)
        w = confidence(now) * self.confidence
        if w.sum() < LEAST_CONFIDENT * (self.confidence**2).sum():
            return None
        motion, explained = solve(self.levels[level], now.values[level], w)
        error = float(np.average((now.values[level] - explained) ** 2, weights=w))
        return Trial(pose, motion, error, correlation(now.values[level], explained, w))

    def _illumination(self, texture: Array) -> Array:
        if not self.use_illumination:
            return np.zeros((len(texture), 0))
        return illumination_templates(self.head.surface, texture, self.confidence)


def displaced(pose: Pose, motion: Array) -> Pose:
    """The pose after a motion (6,): rotation vector in head axes, translation in camera axes.

    In head axes a rotation changes the texture of a cylinder in the same way at every pose, so that the templates of
    the first frame are valid for all others.
    """
    return Pose(pose.R @ exp(motion[:3]), pose.t + motion[3:])


def warping_templates(surface: Surface, view: View, pose: Pose) -> Array:
    """Derivatives (levels, N, 6) of the texture with respect to the motion parameters, by central differences."""
    columns = []
    for axis in np.eye(6):
        slopes = []
        for size in DIFFERENCES:
            plus, minus = (take_template(surface, view, displaced(pose, s * size * axis)).values for s in (1, -1))
            slopes.append((plus - minus) / (2 * size))
        columns.append(np.mean(slopes, axis=0))
    return np.stack(columns, axis=-1)


def illumination_templates(surface: Surface, texture: Array, weight: Array) -> Array:
    """Templates (N, 5), orthonormal under the weights: the texture times the possible shading of a Lambertian cylinder.

    R. Basri, D. W. Jacobs 2003: nine harmonics of the normal span the effect of almost any distant light on a
    Lambertian surface; on an upright cylinder five of them differ.
    """
    a = surface.angle
    light = np.column_stack([np.ones_like(a), np.cos(a), np.sin(a), np.cos(2 * a), np.sin(2 * a)])
    root = np.sqrt(weight + 1e-6)
    Q, _ = np.linalg.qr(root[:, None] * light * texture[:, None])
    return np.asarray(Q / root[:, None])


def confidence(unrolled: Template) -> Array:
    """Confidence (N,) in [0, 1] of each texture point, by its viewing angle; 0 if it is hidden."""
    return np.where(unrolled.known & (unrolled.cosine > LEAST_COSINE), unrolled.cosine, 0.0)


def solve(unrolled: Unrolled, texture: Array, w: Array) -> tuple[Array, Array]:
    """Motion (6,) of a texture (N,) relative to the first one, and the first texture under its illumination; w: (N,)
    weights.

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
