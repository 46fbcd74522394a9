"""The posterior of Eq. (3) as an energy, Eq. (9)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mien.arrays import Array
from mien.tracking import kernels
from mien.tracking.likelihood import AppearanceLikelihood
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


@dataclass(frozen=True)
class PosePosterior:
    """Eq. (9) with an appearance that follows the pose, robust, with derivatives; the fields are arguments of
    `kernels.solve`.

    maps (H, W, 8) and sampling: orientation maps, and how descriptors are sampled from them; person: neutral landmarks
    and animation units; appearance: regression, adaptation and systematic error; active (n,): landmarks that take part;
    scale (n,): squared distances at which a weight is a quarter; prior: predicted state, its information, and the rest
    of the animation; view: camera and crop.
    """

    maps: Any
    sampling: tuple[int, float, float, float]
    person: tuple[Any, ...]
    appearance: tuple[Any, ...]
    active: Array
    scale: Array
    prior: tuple[Any, ...]
    view: tuple[Any, ...]

    def energy(self, b: Array) -> float:
        """Energy of a state b (12,), Eq. (2)."""
        R, t, a = unpack(b)
        return float(self.solve(R, t, a, 1, 0.0)[3])

    def solve(self, R: Array, t: Array, a: Array, iterations: int, tolerance: float) -> tuple[Any, ...]:
        """`kernels.solve` from a state."""
        solution: tuple[Any, ...] = kernels.solve(
            np.ascontiguousarray(R), t, a, self.maps, self.sampling, self.person, self.appearance, self.active,
            self.scale, self.prior, self.view, iterations, tolerance, kernels.workspace(len(self.active)),
        )  # fmt: skip
        return solution
