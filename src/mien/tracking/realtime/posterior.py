"""Eq. (9) of the real-time tracker, and its minimum by Levenberg-Marquardt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from mien.appearance.descriptors import StretchArrays
from mien.arrays import Array, Float32
from mien.tracking.optimizers import Minimum
from mien.tracking.realtime import kernels
from mien.tracking.realtime.kernels import AppearanceArrays, Linearization, PriorArrays
from mien.tracking.realtime.pose_geometry import PersonArrays, PoseArrays, ViewArrays
from mien.tracking.state import pack, unpack


class LowestPoint(NamedTuple):
    """What a search found: a pose, and energy and linearisation of the lowest point that was evaluated, which is that
    pose or the one before the last step."""

    pose: PoseArrays
    energy: float
    at: Linearization
    evaluations: int


class PosePosterior(NamedTuple):
    """Eq. (9) with an appearance that follows the pose, robust, with derivatives: what `kernels.solve` minimises.

    maps (H, W, 8) and sampling: orientation maps, and how descriptors are sampled from them, see
    `descriptors.describe`; active (n,): 1 for landmarks that take part, 0 for those that are not looked at, and next to
    0 for those that are but take no part; scale (n,): squared distances at which a weight is a quarter; stretch: how
    the face stretches around each landmark.
    """

    maps: Float32
    sampling: tuple[int, float, float, float]
    person: PersonArrays
    appearance: AppearanceArrays
    active: Array
    scale: Array
    prior: PriorArrays
    view: ViewArrays
    stretch: StretchArrays

    def energy(self, b: Array) -> float:
        """Energy of a state b (12,), Eq. (2)."""
        R, t, a = unpack(b)
        return self.solve((np.ascontiguousarray(R), t, a), 1, 0.0).energy

    def solve(self, start: PoseArrays, iterations: int, tolerance: float) -> LowestPoint:
        """The lowest point that Levenberg-Marquardt finds from a pose; see `kernels.solve`."""
        buffers = kernels.workspace(len(self.active))
        pose, energy, lowest, evaluations = kernels.solve(start, self.plain, iterations, tolerance, buffers)
        at = Linearization(*(both[lowest] for both in buffers))
        return LowestPoint(pose, energy, at, evaluations)

    @property
    def plain(self) -> tuple[Any, ...]:
        """The posterior as the kernels take it."""
        maps, sampling, person, appearance, active, scale, prior, view, stretch = self
        return maps, sampling, person, tuple(appearance), active, scale, tuple(prior), view, stretch


@dataclass(frozen=True)
class LevenbergMarquardt:
    """Gauss-Newton with damping, by the analytic derivatives of an energy that has them; to be exchanged with
    `optimizers.Simplex`, which minimises the same energy without them.

    tolerance: least gain of an iteration, in units of the energy.
    """

    iterations: int
    tolerance: float

    def minimize(self, problem: PosePosterior, start: Array) -> Minimum:
        """The lowest point found within the iterations that are allowed."""
        found = problem.solve(unpack(start), self.iterations, self.tolerance)
        return Minimum(pack(*found.pose), found.energy, found.evaluations)
