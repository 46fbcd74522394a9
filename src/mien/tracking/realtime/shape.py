"""Shape as a latent variable: a Gaussian over the positions of the landmarks that every frame sharpens.

A single frontal frame does not show the depth of a face, which dominates the error of the pose. Each frame adds the
information of its own measurements, with pose and animation marginalised (an information filter). Frames at nearly the
same pose repeat each other's systematic errors, and count for less and less.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mien.arrays import Array, Mask
from mien.compiled import kernel
from mien.config.realtime import ShapeSettings
from mien.initialization.shape_prior import proximity
from mien.tracking.realtime.definite import cholesky, solve_definite
from mien.tracking.realtime.kernels import add_landmark
from mien.tracking.realtime.pose_geometry import STATE_SIZE

_ENOUGH = 0.12
"""Novelty of the information added since the mean was last found, at which it is found again: at poses that are known
every few frames."""
_NEAR_SHARE, _OPPOSITE_SHARE, _OWN_SHARE = 0.55, 0.2, 0.25
"""Of the variance of a landmark's depth: what those near it share, what those of the other half of the face share with
their mirror images, and what is its own."""
_STEEPEST = 6.0
"""Slope of the surface beyond which its depth does not become less certain."""


class ShapePosterior:
    """Gaussian over the positions (n, 3) of n landmarks, head axes, CANDIDE units, in information form.

    mean: (n, 3); lean: (2,) tilt and pan in radians by which the depths lean away from those of the first frame;
    relief_sd: standard deviation of the share by which the whole relief may still be too deep or too flat.
    """

    def __init__(self, neutral: Array, normals: Array, eyes: Mask, R: Array, t: Array, settings: ShapeSettings) -> None:
        """neutral, normals: (n, 3); eyes: (n,) which landmarks belong to eyes and brows; R, t: pose of the first
        frame."""
        self.settings = settings
        self.start = neutral.copy()
        covariance = prior_covariance(neutral, normals, eyes, R, t, settings)
        self.information = np.linalg.inv(covariance)
        self.deepening = (_relief(neutral)[:, None] * _rays(neutral, R, t)).ravel()
        # Two right sides: the information vector, which the frames fill, and the whole relief.
        self.right_sides = np.stack([np.zeros(neutral.size), self.deepening], axis=1)
        self.slopes = np.linalg.pinv(np.column_stack([neutral[:, 1], -neutral[:, 0], np.ones(len(neutral))]))[:2]
        self.visits: dict[tuple[int, ...], float] = {}
        self.looks: dict[tuple[int, ...], int] = {}
        self._solve()

    def worth(self, expression: Array) -> float:
        """How much, in [0, 1], a frame with an animation (6,) away from rest can teach: 1 at rest."""
        return 1 / (1 + float(expression @ expression) / self.settings.expression_sd**2)

    def novelty(self, angles: Array, expression: Array) -> float:
        """Share in [0, 1] of a frame's information that is new, at a tilt and pan (2,) in radians and an animation
        (6,) away from rest; counts the frame. 0, and not counted, if that is too little to learn from.

        Frames at a pose count by how much each can teach; but with the same expression all frames repeat each other, or
        a smile that lasts would teach as much as a face at rest."""
        s, (tilt, pan) = self.settings, np.degrees(angles).tolist()
        units: list[float] = (expression / s.expression_sd).tolist()
        worth = self.worth(expression)
        pose = round(tilt / s.bin_deg), round(pan / s.bin_deg)
        look = *pose, *map(round, units)
        visits, alike = self.visits.get(pose, 0.0), self.looks.get(look, 0)
        novelty: float = s.rate * worth / (1 + max(visits, alike))
        if novelty < s.least_novelty:
            return 0.0
        self.visits[pose], self.looks[look] = visits + worth, alike + 1
        return novelty

    def add(self, neutral: Array, Lambda: Array, gradient: Array, novelty: float) -> bool:
        """Add information that was linearised at `neutral`, of the novelty that `novelty` gave; returns whether there
        is a new mean, which is found once enough has been added."""
        _add(self.information, self.right_sides, Lambda, gradient, (neutral - self.start).ravel())
        self.added += novelty
        if self.added < _ENOUGH:
            return False
        self._solve()
        return True

    def _solve(self) -> None:
        """Find `mean`, `lean` and `relief_sd`."""
        self.added = 0.0
        found = solve_definite(self.information, self.right_sides)
        self.relief_sd = math.sqrt(self.deepening @ found[:, 1]) / float(self.deepening @ self.deepening)
        moved = found[:, 0].reshape(-1, 3)
        self.mean: Array = self.start + moved
        self.lean: Array = self.slopes @ moved[:, 2]


@kernel()
def _add(information: Any, right_sides: Any, Lambda: Any, gradient: Any, moved: Any) -> None:
    """Add what `ShapePosterior.add` is given; moved: (3n,) where it was linearised. `@` would wake threads of BLAS."""
    for i in range(moved.size):
        right_side = -gradient[i]
        for j in range(moved.size):
            information[i, j] += Lambda[i, j]
            right_side += Lambda[i, j] * moved[j]
        right_sides[i, 0] += right_side


@kernel()
def shape_information(B: Any, M: Any, g: Any, weight: Any, R: Any, prior: Any) -> Any:
    """Information of one frame on the positions of the landmarks, with pose and animation marginalised.

    B (n, 4, 12), M (n, 4, 4), g (n, 4): as left by `kernels.solve`; weight (n,); R (3, 3); prior: information (12,) and
    gradient (12,) of the pose step's own prior. Returns Lambda (3n, 3n) and the gradient (3n,) by the positions in head
    axes: the Schur complement of the pose step in the joint information.
    """
    n = B.shape[0]
    H, G = np.zeros((STATE_SIZE, STATE_SIZE)), np.zeros(STATE_SIZE)
    Lambda, gradient = np.zeros((3 * n, 3 * n)), np.zeros(3 * n)
    X = np.empty((STATE_SIZE, 3 * n))  # the information of pose step and positions together, later L^-1 of it
    for k in range(STATE_SIZE):
        H[k, k], G[k] = prior[0][k], prior[1][k]
    for i in range(n):
        MB = add_landmark(M[i], g[i], B[i], weight[i], H, G)
        for r in range(3):
            # A landmark's own place moves it as the translation does, but in head axes, and does not move the angles.
            u, v = 0.0, 0.0
            for c in range(3):
                u += weight[i] * B[i, 0, 3 + c] * R[c, r]
                v += weight[i] * B[i, 1, 3 + c] * R[c, r]
            gradient[3 * i + r] = u * g[i, 0] + v * g[i, 1]
            for k in range(STATE_SIZE):
                X[k, 3 * i + r] = u * MB[0, k] + v * MB[1, k]
            for c in range(3):
                for k in range(3):
                    Lambda[3 * i + r, 3 * i + c] += X[3 + k, 3 * i + r] * R[k, c]
    for k in range(STATE_SIZE):
        for j in range(k):
            H[k, j] = H[j, k]
    cholesky(H)
    for k in range(STATE_SIZE):  # L^-1 G takes the place of G
        for j in range(k):
            G[k] -= H[k, j] * G[j]
            for c in range(3 * n):
                X[k, c] -= H[k, j] * X[j, c]
        G[k] /= H[k, k]
        for c in range(3 * n):
            X[k, c] /= H[k, k]
            gradient[c] -= G[k] * X[k, c]
    for r in range(3 * n):
        for k in range(0, STATE_SIZE, 4):  # four at a time, as most of the time goes to fetching them
            a, b, c, d = X[k, r], X[k + 1, r], X[k + 2, r], X[k + 3, r]
            for j in range(3 * n):
                Lambda[r, j] -= a * X[k, j] + b * X[k + 1, j] + c * X[k + 2, j] + d * X[k + 3, j]
    return Lambda, gradient


def prior_covariance(neutral: Array, normals: Array, eyes: Mask, R: Array, t: Array, settings: ShapeSettings) -> Array:
    """(3n, 3n): what the first frame leaves open, which is much along its rays and little across them.

    Depths err together where landmarks are near or mirror each other, and more on steep surfaces; the relief of the
    whole face may be too deep or too flat, or lean forwards or back; and eyes and brows may lie deeper than expected,
    or spectacles stand off before them.
    """
    n = len(neutral)
    rays, relief = _rays(neutral, R, t), _relief(neutral)
    cosine = np.clip(-(rays * normals).sum(axis=1), 0.0, 1.0)
    slope = np.minimum(np.sqrt(1 - cosine**2) / np.maximum(cosine, 1e-3), _STEEPEST)
    sd = np.hypot(settings.depth_sd, settings.slope_sd * slope)
    mirrored = neutral * [-1, 1, 1]
    near, opposite = (proximity(neutral, other, settings.depth_length) for other in (neutral, mirrored))
    together = _NEAR_SHARE * near + _OPPOSITE_SHARE * opposite + _OWN_SHARE * np.eye(n)
    depth = together * np.outer(sd, sd) + settings.relief_sd**2 * np.outer(relief, relief)
    height = neutral[:, 1] - neutral[:, 1].mean()
    depth += settings.lean_sd**2 * np.outer(height, height)
    depth += settings.eyes_sd**2 * np.outer(eyes, eyes)
    across = settings.lateral_sd**2 * np.einsum("ij,kl->ikjl", np.eye(n), np.eye(3))
    along = np.einsum("ij,ik,jl->ikjl", depth, rays, rays)
    return np.asarray((across + along).reshape(3 * n, 3 * n))


def _rays(neutral: Array, R: Array, t: Array) -> Array:
    """Unit vectors (n, 3) in head axes from the camera to landmarks (n, 3) at a pose."""
    X = neutral @ R.T + t
    return np.asarray((X / np.linalg.norm(X, axis=1, keepdims=True)) @ R)


def _relief(neutral: Array) -> Array:
    """Depth (n,) by which landmarks (n, 3) stand out of the face."""
    return np.asarray(neutral[:, 2] - neutral[:, 2].mean())
