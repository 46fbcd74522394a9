"""A search for the face in one frame: where it starts, what it looks at, and what it finds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mien.appearance.crop import Crop
from mien.appearance.descriptors import Float32, orientation_maps
from mien.appearance.views import CENTRE, roll_of
from mien.geometry.rotation import Array
from mien.initialization.landmarks import LANDMARK_NAMES
from mien.tracking import kernels
from mien.tracking.definite import inverse_definite
from mien.tracking.learning import Level
from mien.tracking.state import Mask

_LEAST_LANDMARKS = 6


@dataclass(frozen=True)
class Pose:
    """State of Eq. (2) with its rotation as a matrix: R (3, 3) head -> camera, t (3,), animation (6,)."""

    R: Array
    t: Array
    animation: Array

    def moved(self, step: Array) -> Pose:
        """The pose after a step (12,) = [rotation vector in camera axes, translation, animation]."""
        return Pose(kernels.rotate(step[:3], self.R), self.t + step[3:6], self.animation + step[6:])

    @property
    def arrays(self) -> tuple[Array, Array, Array]:
        """R, t and animation as the kernels take them."""
        return np.ascontiguousarray(self.R), self.t, self.animation

    @cached_property
    def _seen(self) -> tuple[Array, Array]:
        ray, angles = kernels.viewing_angles(CENTRE, self.arrays[0], self.t)
        return ray, angles

    @property
    def ray(self) -> Array:
        """(3, 3) rotation from the optical axis to the middle of the face."""
        return self._seen[0]

    @property
    def angles(self) -> Array:
        """(2,) tilt and pan in radians, as the camera sees them: of `kernels.view_angles`."""
        return self._seen[1]

    def step_to(self, other: Pose) -> Array:
        """The step (12,) that leads to another pose, less than half a turn away."""
        step: Array = kernels.step_between(*self.arrays, *other.arrays)
        return step


@dataclass(frozen=True)
class Prediction:
    """The prior of Eq. (9): a pose, and the information (12, 12) of a step away from it. last: pose in the last
    frame."""

    pose: Pose
    information: Array
    last: Pose


@dataclass(frozen=True)
class View:
    """A frame prepared for `kernels.solve`: the grey image of the crop for a pose, its geometry, landmarks that can
    be seen. upright: the pose for which descriptors are read upright and in its size."""

    level: Level
    pose: Pose
    upright: Pose
    crop: Crop
    image: Float32
    geometry: tuple[Array, ...]
    facing: Mask

    def upright_at(self, pose: Pose) -> View:
        """The same view, whose descriptors are read upright at a pose."""
        return View(self.level, self.pose, pose, self.crop, self.image, self.geometry, self.facing)

    @cached_property
    def maps(self) -> Float32:
        """Orientation maps of the crop."""
        return orientation_maps(self.image, self.level.descriptor.cell, self._roll_and_scale[0])

    @property
    def sampling(self) -> tuple[int, float, float, float]:
        """How descriptors are read from the maps, as the kernels take it."""
        descriptor = self.level.descriptor
        return descriptor.cell, descriptor.root, *self._roll_and_scale

    @cached_property
    def _roll_and_scale(self) -> tuple[float, float]:
        return self.roll_and_scale(self.upright)

    def roll_and_scale(self, pose: Pose) -> tuple[float, float]:
        """Roll in radians and scale in the crop of a face at a pose: 0 and 1 at that for which the crop was made."""
        roll = math.remainder(roll_of(pose.R) - self.crop.angle, math.tau)
        return roll, float(self.pose.t[2] / pose.t[2])

    def shift(self, pose: Pose) -> float:
        """How far across the view a face at a pose is from where the crop was made for it, in CANDIDE units."""
        (x0, y0, z0), (x, y, z) = self.pose.t.tolist(), pose.t.tolist()
        return math.hypot(x * z0 / z - x0, y * z0 / z - y0)


@dataclass(frozen=True)
class Solution:
    """The lowest point of Eq. (9) that a search found, with what was seen there; see `kernels.solve`."""

    pose: Pose
    energy: float
    H: Array
    residual: Float32  # (n, 128): what is seen of each landmark less what is expected
    M: Array
    g: Array
    d2: Array
    B: Array
    w: Array
    facing: Mask  # landmarks that face the camera, inside the image
    expected: Array  # (n,) what d2 is of a look that is as it should be

    @cached_property
    def step_covariance(self) -> Array:
        """Inverse (12, 12) of the Gauss-Newton matrix: covariance of a pose step, in units of the energy."""
        return inverse_definite(self.H)

    @cached_property
    def misfit(self) -> float:
        """Median, over the landmarks that can be seen, of the squared distance over the expected one; infinite where
        there is none."""
        return self.misfit_of(self.facing)

    def misfit_of(self, seen: Mask) -> float:
        """The same of landmarks `seen` (n,)."""
        ratio = sorted((self.d2[seen] / self.expected[seen]).tolist())  # for a few numbers faster than NumPy
        return float(ratio[len(ratio) // 2]) if ratio else math.inf

    def inliers(self, most: float) -> Mask:
        """Landmarks (n,) that can be seen and whose squared distance is at most `most`."""
        return np.asarray(self.facing & (self.d2 <= most))

    @cached_property
    def distinctive_d2(self) -> Array:
        """Squared distances (m,) of what can be seen and tells a face from what is none: the landmarks without the
        anchors, as plain skin looks like much else."""
        n = len(LANDMARK_NAMES)
        return np.asarray(self.d2[:n][self.facing[:n]])

    def inlier_share(self, most: float) -> float:
        """Share of the landmarks that can be seen whose squared distance is at most `most`; 0 where these are too few
        to say where a face is."""
        telling = self.distinctive_d2
        count = np.count_nonzero(telling <= most)
        return count / len(telling) if count >= _LEAST_LANDMARKS else 0.0

    def squared_misplacement(self, most: float) -> Array:
        """Mean square (n,) in pixels of the crop, by axis, of where each landmark alone would be, from where the pose
        puts it, no further than `most`."""
        return np.asarray(kernels.squared_misplacement(self.M, self.g, most))
