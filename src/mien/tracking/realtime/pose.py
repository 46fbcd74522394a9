"""The state of a face in a frame, from where it is seen, and the prior of the next one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mien.appearance.views import CENTRE
from mien.arrays import Array
from mien.tracking.realtime import pose_geometry
from mien.tracking.realtime.pose_geometry import PoseArrays


class _Sight(NamedTuple):
    """What `pose_geometry.sight_of` returns, and the properties of `Pose` say."""

    ray: Array
    angles: Array
    roll: float
    distance: float
    line_of_sight: Array
    seen_from: Array


@dataclass(frozen=True)
class Pose:
    """State of Eq. (2) with its rotation as a matrix: R (3, 3) and t (3,) from the axes of the fitted model, which
    differ from the head's (see `HeadAxes`), to the camera's, animation (6,)."""

    R: Array
    t: Array
    animation: Array

    def moved(self, step: Array) -> Pose:
        """The pose after a step (12,) = [rotation vector in camera axes, translation, animation]."""
        return Pose(*pose_geometry.step_back(self.arrays, -step))

    def with_unit(self, unit: int, value: float) -> Pose:
        """The pose with another value of an animation unit."""
        animation = self.animation.copy()
        animation[unit] = value
        return self.with_animation(animation)

    def with_animation(self, animation: Array) -> Pose:
        """The pose with another animation (6,); both share from where the head is seen."""
        pose = Pose(self.R, self.t, animation)
        if "_sight" in vars(self):
            vars(pose)["_sight"] = self._sight
        return pose

    @cached_property
    def arrays(self) -> PoseArrays:
        """The pose as the kernels take it."""
        return np.ascontiguousarray(self.R), self.t, self.animation

    @cached_property
    def _sight(self) -> _Sight:
        """How the head is seen, along the ray to the middle of the face."""
        return _Sight(*pose_geometry.sight_of(CENTRE, self.arrays[0], self.t))

    @property
    def line_of_sight(self) -> Array:
        """(3,) unit vector to the origin of the head's axes, camera axes."""
        return self._sight.line_of_sight

    @property
    def seen_from(self) -> Array:
        """(3,) the same in head axes: in which direction, away from the camera, the head is seen."""
        return self._sight.seen_from

    @property
    def ray(self) -> Array:
        """(3, 3) rotation from the optical axis to the middle of the face."""
        return self._sight.ray

    @property
    def angles(self) -> Array:
        """(2,) tilt and pan in radians of the face as seen along that ray; see `pose_geometry.view_angles`."""
        return self._sight.angles

    @property
    def roll(self) -> float:
        """Roll in radians of the face as seen along that ray."""
        return self._sight.roll

    @property
    def distance(self) -> float:
        """Distance along that ray of the origin of the head's axes, CANDIDE units."""
        return self._sight.distance

    def step_to(self, other: Pose) -> Array:
        """The step (12,) that leads to another pose, less than half a turn away."""
        step: Array = pose_geometry.step_between(*self.arrays, *other.arrays)
        return step


@dataclass(frozen=True)
class Prediction:
    """The prior of Eq. (9): a pose, and the information (12, 12) of a step away from it. last: pose in the last frame;
    squared_sine: of the angle between where the first frame sees the head and where it was first predicted."""

    pose: Pose
    information: Array
    last: Pose
    squared_sine: float

    def improved(self, pose: Pose, information: Array) -> Prediction:
        """The prediction of the same frame when more is known."""
        return Prediction(pose, information, self.last, self.squared_sine)

    def turned(self, degrees: float) -> float:
        """How far the head has turned from the first frame: the squared sine of that, over the one of some degrees."""
        return self.squared_sine / math.sin(math.radians(degrees)) ** 2

    def trust(self, degrees: float) -> float:
        """Which share counts of what the first frame shows: the further the head has turned, the more it looks
        otherwise by that, and a half after some degrees."""
        return 1 / (1 + self.turned(degrees))
