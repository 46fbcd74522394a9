"""The search for the face in one frame: the view it works on, and what it finds."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from mien.appearance.descriptors import orientation_maps
from mien.arrays import Array, Float32, Mask
from mien.compiled import kernel
from mien.initialization.landmarks import LANDMARK_NAMES
from mien.tracking.realtime.definite import inverse_definite
from mien.tracking.realtime.kernels import Linearization
from mien.tracking.realtime.level import Level, Noise
from mien.tracking.realtime.order import insert, median
from mien.tracking.realtime.pose import Pose
from mien.tracking.realtime.pose_geometry import ViewArrays
from mien.tracking.realtime.posterior import PosePosterior

_LEAST_LANDMARKS = 6


@dataclass(frozen=True)
class View:
    """A frame prepared for `kernels.solve`: the grey crop for a pose, its geometry, and the landmarks that face the
    camera. upright: the pose at whose roll and scale descriptors are sampled; all_facing: with the landmarks that
    `of_landmarks` has left out."""

    level: Level
    pose: Pose
    upright: Pose
    image: Float32
    geometry: ViewArrays
    facing: Mask
    all_facing: Mask

    def upright_at(self, pose: Pose) -> View:
        """The same view, with descriptors sampled at the roll and scale of a pose."""
        return replace(self, upright=pose)

    def of_landmarks(self, which: Mask) -> View:
        """The same view of only those landmarks `which` (n,) that face the camera; both share the orientation maps."""
        view = replace(self, facing=self.facing & which)
        vars(view)["maps"] = self.maps
        return view

    @cached_property
    def maps(self) -> Float32:
        """Orientation maps of the crop."""
        return orientation_maps(self.image, self.level.descriptor.cell, self._roll_and_scale[0])

    @property
    def sampling(self) -> tuple[int, float, float, float]:
        """How descriptors are sampled from the maps, as the kernels take it."""
        descriptor = self.level.descriptor
        return descriptor.cell, descriptor.root, *self._roll_and_scale

    @cached_property
    def _roll_and_scale(self) -> tuple[float, float]:
        return self.roll_and_scale(self.upright)

    def roll_and_scale(self, pose: Pose) -> tuple[float, float]:
        """Roll in radians and scale in the crop of a face at a pose: 0 and 1 at the pose for which it was made."""
        roll = math.remainder(pose.roll - self.pose.roll, math.tau)
        return roll, self.pose.distance / pose.distance

    def shift(self, pose: Pose) -> float:
        """Distance across the view between a face at a pose and the one for which the crop was made, CANDIDE units."""
        (x0, y0, z0), (x, y, z) = self.pose.t.tolist(), pose.t.tolist()
        return math.hypot(x * z0 / z - x0, y * z0 / z - y0)


class _Judgement(NamedTuple):
    """What `_judge` returns: misfits (n,), squared distances without noise over the expected ones, and what the
    properties of `Solution` say."""

    d2_without_noise: Array
    seen: Mask
    misfits: Array
    seen_share: float
    seen_d2: float
    misfit: float
    best_misfit: float
    inlier_share: float
    best_d2: float


@dataclass(frozen=True)
class Solution:
    """The lowest point of Eq. (9) that a solve found, and what was observed there.

    posterior: of which it is the lowest point; facing (n,): whether a landmark faces the camera inside the image;
    expected (n,): its usual squared distance; most: squared distance, without noise, up to which a landmark is seen.
    """

    pose: Pose
    energy: float
    at: Linearization
    posterior: PosePosterior
    facing: Mask
    expected: Array
    noise: Noise
    most: float

    def with_pose(self, pose: Pose) -> Solution:
        """The solution with another pose; what was observed, and follows from it, is shared."""
        moved = object.__new__(Solution)
        vars(moved).update(vars(self), pose=pose)
        return moved

    @property
    def d2(self) -> Array:
        """Squared distance (n,) of each landmark from what was expected."""
        return self.at.d2

    @property
    def w(self) -> Array:
        """Robust weight (n,) of each landmark."""
        return self.at.w

    @cached_property
    def step_covariance(self) -> Array:
        """Inverse (12, 12) of the Gauss-Newton matrix: covariance of a pose step, in units of the energy."""
        return inverse_definite(self.at.H)

    @cached_property
    def _judged(self) -> _Judgement:
        """What follows from the squared distances."""
        noise, n = self.noise, len(LANDMARK_NAMES)
        return _Judgement(*_judge(self.at.d2, noise.d2, noise.contrast, self.facing, self.expected, self.most, n))

    @property
    def d2_without_noise(self) -> Array:
        """The squared distances (n,) as they would be without noise, see `Noise`."""
        return self._judged.d2_without_noise

    @property
    def seen(self) -> Mask:
        """Which landmarks (n,) face the camera and are, without noise, at most `most` away."""
        return self._judged.seen

    @property
    def seen_share(self) -> float:
        """Share of all landmarks that are `seen`."""
        return self._judged.seen_share

    @property
    def seen_d2(self) -> float:
        """Median squared distance of the landmarks that are `seen`; 0 without any."""
        return self._judged.seen_d2

    @property
    def misfit(self) -> float:
        """Median, over the landmarks that face the camera, of squared distance over expected one; infinite without
        any."""
        return self._judged.misfit

    @property
    def best_misfit(self) -> float:
        """Lower quartile of what `misfit` is the median of: a quarter may be all that something leaves of a face."""
        return self._judged.best_misfit

    @property
    def inlier_share(self) -> float:
        """Share of the landmarks that face the camera, without the anchors, whose squared distance is at most `most`; 0
        if they are too few to locate a face. Anchors are plain skin, which looks like much else."""
        return self._judged.inlier_share

    @property
    def best_d2(self) -> float:
        """Lower quartile of `d2_without_noise` of the landmarks, without the anchors, that face the camera; infinite
        without any."""
        return self._judged.best_d2

    def misfit_of(self, which: Mask) -> float:
        """`misfit` of the landmarks `which` (n,)."""
        misfit: float = median(self._judged.misfits[which])
        return misfit


@kernel(fastmath={"contract"})
def _judge(d2: Any, noise: Any, contrast: float, facing: Any, expected: Any, most: float, telling: int) -> Any:
    """What squared distances d2 (n,) say of a face.

    noise (n,), contrast: see `Noise`; facing (n,), expected (n,), most: of a `Solution`; telling: how many landmarks,
    the first ones, tell a face from other things. Returns the entries of a `_Judgement`.
    """
    n = d2.size
    clean, seen, misfits = np.empty(n), np.empty(n, np.bool_), np.empty(n)
    of_seen, ratios, of_telling = np.empty(n), np.empty(n), np.empty(n)  # in order
    count, shown, told, inliers = 0, 0, 0, 0
    for i in range(n):
        clean[i] = max(d2[i] - noise[i], 0.0) / (contrast * contrast)
        seen[i] = facing[i] and clean[i] <= most
        misfits[i] = clean[i] / expected[i]
        if seen[i]:
            insert(d2[i], of_seen, count)
            count += 1
        if facing[i]:
            insert(misfits[i], ratios, shown)
            shown += 1
            if i < telling:
                insert(clean[i], of_telling, told)
                told += 1
                inliers += seen[i]
    misfit, best_misfit = (ratios[shown // 2], ratios[shown // 4]) if shown else (np.inf, np.inf)
    inlier_share = inliers / told if inliers >= _LEAST_LANDMARKS else 0.0
    seen_d2, best_d2 = of_seen[count // 2] if count else 0.0, of_telling[told // 4] if told else np.inf
    return clean, seen, misfits, count / n, seen_d2, misfit, best_misfit, inlier_share, best_d2
