"""The posterior of Eq. (3) as an energy, Eq. (9)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mien.arrays import Array, Float32
from mien.tracking import kernels
from mien.tracking.kernels import AppearanceArrays, Linearization, PriorArrays
from mien.tracking.likelihood import AppearanceLikelihood
from mien.tracking.pose_geometry import PersonArrays, PoseArrays, ViewArrays
from mien.tracking.prior import GaussianPrior
from mien.tracking.state import unpack


@dataclass(frozen=True)
class Posterior:
    """`-2 log p(b_t | Y_1:t)` without its constant: likelihood, Eq. (6), and prior, Eq. (4)."""

    likelihood: AppearanceLikelihood
    prior: GaussianPrior

    def energy(self, b: Array) -> float:
        """Eq. (9): the function of the state b (12,) that tracking minimises."""
        return self.likelihood.energy(b) + self.prior.energy(b)


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
    `descriptors.describe`; active (n,): 1 for landmarks that take part; scale (n,): squared distances at which a weight
    is a quarter.
    """

    maps: Float32
    sampling: tuple[int, float, float, float]
    person: PersonArrays
    appearance: AppearanceArrays
    active: Array
    scale: Array
    prior: PriorArrays
    geometry: ViewArrays

    def energy(self, b: Array) -> float:
        """Energy of a state b (12,), Eq. (2)."""
        R, t, a = unpack(b)
        return self.solve((np.ascontiguousarray(R), t, a), 1, 0.0).energy

    def solve(self, start: PoseArrays, iterations: int, tolerance: float) -> LowestPoint:
        """The lowest point that Levenberg-Marquardt finds from a pose; see `kernels.solve`."""
        buffers = kernels.buffers(len(self.active))
        pose, energy, lowest, evaluations = kernels.solve(start, self, iterations, tolerance, buffers)
        at = Linearization(*(both[lowest] for both in buffers))
        return LowestPoint(pose, energy, at, evaluations)
