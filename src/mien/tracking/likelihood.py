"""The observation model, Eq. (5) and (6): independent Gaussian descriptors at the projected landmarks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mien.appearance.crop import Crop
from mien.appearance.gaussian import Gaussians
from mien.arrays import Array, Float32
from mien.geometry.camera import Camera
from mien.initialization.fit import FirstFrame
from mien.initialization.landmarks import VERTICES
from mien.tracking.state import unpack


@dataclass(frozen=True)
class LandmarkModel:
    """Landmarks of one person: neutral (n, 3) in head axes and their animation units (6, n, 3)."""

    neutral: Array
    animation_units: Array

    @classmethod
    def of_first_frame(cls, fit: FirstFrame) -> LandmarkModel:
        """The 26 landmarks of the face that was fitted to the first frame."""
        return cls(fit.shape[VERTICES], fit.model.animation_units[:, VERTICES])

    def in_camera(self, b: Array) -> Array:
        """Eq. (1): landmarks (n, 3) in camera axes for a state b."""
        R, t, animation = unpack(b)
        return (self.neutral + np.tensordot(animation, self.animation_units, axes=1)) @ R.T + t


@dataclass(frozen=True)
class AppearanceLikelihood:
    """`-2 log p(Y_t | b)` of Eq. (6) without its constant, for one frame.

    describe: descriptors (n, 128) at crop points (n, 2).
    """

    landmarks: LandmarkModel
    camera: Camera
    crop: Crop
    describe: Callable[[Array], Float32]
    gaussians: Gaussians

    def observe(self, b: Array) -> Float32:
        """Y_t: the descriptors (n, 128) at the landmarks that state b projects."""
        p, _ = self.camera.project(self.landmarks.in_camera(b))
        return self.describe(self.crop.to_crop(np.nan_to_num(p)))

    def energy(self, b: Array) -> float:
        """First term of Eq. (9): a sum, as by Eq. (5) the landmarks are independent."""
        return float(self.gaussians.squared_distance(self.observe(b)).sum())
