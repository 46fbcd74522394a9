"""J. Saragih, S. Lucey and J. Cohn, Deformable model fitting by regularized landmark mean-shift, IJCV 91, 2011.

A constrained local model. A linear expert for each landmark separates its patch from those around it; its output over
a window is a response map, the probability of the landmark's location. The landmarks climb the smoothed maps jointly by
mean-shift, under a 3D point distribution model whose parameters have a Gaussian prior: each step solves
`(rho Lambda^-1 + J^T J) db = J^T v - rho Lambda^-1 b` for the mean-shift vectors v, with decreasing smoothing rho.

Simplifications: the experts are trained on views of the first frame's face instead of on annotated photographs of many
people; the point distribution model is CANDIDE with the shape of the first frame and the six animation units, under a
perspective camera; the experts are logistic regressions on grey patches, selected by the nearest of three pans; there
is no detector for re-initialisation.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np
from scipy.special import expit

from mien.appearance.crop import Crop
from mien.appearance.views import rotation, tilt_pan_of
from mien.arrays import Array, Float32
from mien.baselines.candide_tracker import (
    CandideTracker,
    CroppedFrame,
    SearchResult,
    require_scikit_learn,
)
from mien.baselines.patches import read_patches
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING, exp, hat, log
from mien.tracking.likelihood import LandmarkModel
from mien.tracking.state import unpack

PATCH_SIZE = 11
"""Side of the patches in crop pixels, odd."""
PANS_DEG = (-30.0, 0.0, 30.0)
"""Pans with separate experts, each trained on pans up to 20 degrees to either side."""
TILTS_DEG = (-30.0, -15.0, 0.0, 15.0, 30.0)
NEGATIVE_RADII, NEGATIVE_DIRECTIONS = (3.0, 5.0, 8.0, 12.0), 8
"""Distances of the negative patches from the landmark in crop pixels, and the number of directions."""
EXPERT_C = 10.0
"""Inverse regularisation of the experts: lower values give broad, biased maps, higher values false peaks."""
WINDOW_RADII = (20, 12, 7)
"""Half width in crop pixels of the window of each pass; every pass recomputes the response maps."""
SMOOTHING = (60.0, 25.0, 10.0, 4.0)
"""Successive variances rho, in square pixels, of the mean-shift within a pass."""
STEPS = 3
"""Mean-shift steps for each rho."""
ANIMATION_SD = 0.4


@dataclass(frozen=True)
class Experts:
    """Linear experts of n landmarks: templates (n, size, size) of zero mean and unit length, gain and bias (n,).

    The probability that a patch of zero mean and unit length p belongs to a landmark is
    `sigmoid(gain * template . p + bias)`.
    """

    templates: Float32
    gain: Float32
    bias: Float32

    @classmethod
    def learn(cls, positives: Float32, negatives: Float32) -> Experts:
        """Logistic regressions of positives (n, P, D) against negatives (n, N, D)."""
        from sklearn.linear_model import LogisticRegression

        labels = np.r_[np.ones(positives.shape[1]), np.zeros(negatives.shape[1])]
        weights, bias = [], []
        for positive, negative in zip(positives, negatives, strict=True):
            expert = LogisticRegression(C=EXPERT_C, class_weight="balanced", max_iter=1000)
            expert.fit(np.vstack([positive, negative]), labels)
            weights.append(expert.coef_[0])
            bias.append(expert.intercept_[0])
        # As patches have zero mean, the mean of the weights has no effect; without it they are a template.
        w = np.array(weights) - np.mean(weights, axis=1, keepdims=True)
        gain = np.linalg.norm(w, axis=1)
        size = round(np.sqrt(w.shape[1]))
        templates = (w / gain[:, None]).reshape(-1, size, size)
        return cls(templates.astype(np.float32), gain.astype(np.float32), np.array(bias, np.float32))

    def responses(self, gray: Float32, corners: Array, width: int) -> Float32:
        """Response maps (n, width, width) of an image, whose first values are at the pixels `corners` (n, 2)."""
        half = self.templates.shape[1] // 2
        side = width + 2 * half
        maps = np.empty((len(corners), width, width), np.float32)
        for k, (x, y) in enumerate(corners.astype(int) - half):
            maps[k] = cv2.matchTemplate(_window(gray, x, y, side), self.templates[k], cv2.TM_CCOEFF_NORMED)
        return self.probability(maps)

    def at(self, gray: Float32, points: Array) -> Float32:
        """Probabilities (n,) of the landmarks at the points (n, 2) of an image."""
        patches = read_patches(gray, points, self.templates.shape[1], 1.0)
        return self.probability((patches * self.templates.reshape(len(points), -1)).sum(axis=1))

    def probability(self, scores: Float32) -> Float32:
        """Probabilities (n, ...) from the correlations (n, ...) with the templates."""
        shape = (-1,) + (1,) * (scores.ndim - 1)
        return np.asarray(expit(self.gain.reshape(shape) * scores + self.bias.reshape(shape)), np.float32)


def _window(gray: Float32, x: int, y: int, side: int) -> Float32:
    """The square (side, side) of an image that starts at this pixel; the border of the image is replicated."""
    rows = np.clip(np.arange(y, y + side), 0, gray.shape[0] - 1)
    columns = np.clip(np.arange(x, x + side), 0, gray.shape[1] - 1)
    return np.ascontiguousarray(gray[rows[:, None], columns])


@dataclass(frozen=True)
class MeanShift:
    """Regularised landmark mean-shift in the response maps (n, w, w) of one crop.

    corners: (n, 2) crop pixels of the first values of the maps.
    """

    landmarks: LandmarkModel
    camera: Camera
    crop: Crop
    maps: Float32
    corners: Array

    def step(self, b: Array, rho: float) -> Array:
        """One mean-shift step of a state with smoothing rho (square pixels): b (12,) -> (12,)."""
        p, J = self.points(b)
        v = self.shift(p, rho)
        precision = np.r_[np.zeros(6), np.full(6, rho / ANIMATION_SD**2)]
        parameters = np.r_[np.zeros(6), b[6:]]  # those that have a prior
        A = np.diag(precision) + np.einsum("nij,nik->jk", J, J)
        db = np.linalg.solve(A, np.einsum("nij,ni->j", J, v) - precision * parameters)
        R, t, animation = unpack(b)
        return np.concatenate([log(exp(db[:3]) @ R @ FACING), t + db[3:6], animation + db[6:]])

    def points(self, b: Array) -> tuple[Array, Array]:
        """Crop points (n, 2) of the landmarks, and their Jacobian (n, 2, 12) by [w, t, a], w in camera axes."""
        R, t, _ = unpack(b)
        X = self.landmarks.in_camera(b)
        J_point = np.empty((len(X), 3, 12))
        J_point[:, :, :3] = [-hat(x) for x in X - t]
        J_point[:, :, 3:6] = np.eye(3)
        J_point[:, :, 6:] = np.einsum("ij,mnj->nim", R, self.landmarks.animation_units)
        p, _ = self.camera.project(X)
        J = self.crop.linear @ self.camera.J_pixel_point(X) @ J_point
        return self.crop.to_crop(p), np.asarray(J)

    def shift(self, p: Array, rho: float) -> Array:
        """Mean-shift vectors (n, 2) at crop points (n, 2)."""
        grid = np.arange(self.maps.shape[1])
        d = p[:, :, None] - (self.corners[:, :, None] + grid)
        kernel = np.exp(-0.5 / rho * d**2)
        weights = self.maps * kernel[:, 1, :, None] * kernel[:, 0, None, :]
        total = weights.sum(axis=(1, 2)) + 1e-12
        along_x = (weights.sum(axis=1) * d[:, 0]).sum(axis=1)
        along_y = (weights.sum(axis=2) * d[:, 1]).sum(axis=1)
        return np.asarray(-np.stack([along_x, along_y], axis=1) / total[:, None])


class SaragihTracker(CandideTracker):
    """Constrained local model with regularised landmark mean-shift (Saragih, Lucey and Cohn 2011).

    The similarity is the mean probability from the experts at the landmarks found.
    """

    least_similarity = 0.4

    def __init__(self) -> None:
        require_scikit_learn("saragih-2011")

    def _learn(self, frame: Frame) -> None:
        self.experts = [self._learn_experts(frame, pan) for pan in PANS_DEG]

    def _learn_experts(self, frame: Frame, pan_deg: float) -> Experts:
        pans = pan_deg + np.array([-20.0, -10.0, 0.0, 10.0, 20.0])
        rotations = [rotation(*np.radians([tilt, pan, 0.0])) for tilt, pan in product(TILTS_DEG, pans)]
        views = self._views(frame, rotations)
        samples = np.stack([_training_patches(image, p) for image, p in views], axis=1)  # (n, views, points, D)
        n, D = samples.shape[0], samples.shape[-1]
        return Experts.learn(samples[:, :, 0], samples[:, :, 1:].reshape(n, -1, D))

    def _search(self, frame: Frame) -> SearchResult:
        b = self.b
        for radius in WINDOW_RADII:
            b = self._fit(frame, b, radius)
        cropped, experts = self._crop_and_experts(frame, b)
        return SearchResult(b, float(experts.at(cropped.gray, cropped.points(self.landmarks, b)).mean()))

    def _crop_and_experts(self, frame: Frame, b: Array) -> tuple[CroppedFrame, Experts]:
        """The frame around the face in state b, and the experts for its pan."""
        _, pan = tilt_pan_of(unpack(b)[0])
        nearest = int(np.argmin(np.abs(np.degrees(pan) - np.array(PANS_DEG))))
        return CroppedFrame.around(b, frame, self.camera, upright=False), self.experts[nearest]

    def _fit(self, frame: Frame, b: Array, radius: int) -> Array:
        cropped, experts = self._crop_and_experts(frame, b)
        p, _ = self.camera.project(self.landmarks.in_camera(b))
        corners = np.round(cropped.crop.to_crop(np.nan_to_num(p))) - radius
        maps = experts.responses(cropped.gray, corners, 2 * radius + 1)
        search = MeanShift(self.landmarks, self.camera, cropped.crop, maps, corners)
        for rho in np.repeat(SMOOTHING, STEPS):
            b = search.step(b, float(rho))
        return b


def _training_patches(image: Float32, points: Array) -> Float32:
    """Patches (n, 1 + negatives, D) at the landmarks (n, 2), then displaced from them."""
    angles = 2 * np.pi * np.arange(NEGATIVE_DIRECTIONS) / NEGATIVE_DIRECTIONS
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    offsets = np.concatenate([np.zeros((1, 2)), *(r * ring for r in NEGATIVE_RADII)])
    at = (points[:, None] + offsets).reshape(-1, 2)
    return read_patches(image, at, PATCH_SIZE, 1.0).reshape(len(points), len(offsets), -1)
