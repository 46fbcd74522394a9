"""The posterior of Eq. (3) as an energy, Eq. (9)."""

from __future__ import annotations

from dataclasses import dataclass

from mien.arrays import Array
from mien.tracking.likelihood import AppearanceLikelihood
from mien.tracking.prior import GaussianPrior


@dataclass(frozen=True)
class Posterior:
    """`-2 log p(b_t | Y_1:t)` without its constant: likelihood, Eq. (6), and prior, Eq. (4)."""

    likelihood: AppearanceLikelihood
    prior: GaussianPrior

    def energy(self, b: Array) -> float:
        """Eq. (9): the function of the state b (12,) that tracking minimises."""
        return self.likelihood.energy(b) + self.prior.energy(b)
