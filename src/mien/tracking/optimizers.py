"""Minimisers of an energy of the state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from mien.arrays import Array


class Energy(Protocol):
    """What is minimised: Eq. (9) or a part of it."""

    def energy(self, b: Array) -> float: ...


@dataclass(frozen=True)
class Minimum:
    """Where a minimiser stopped: state (d,), its energy, how often the energy was evaluated."""

    b: Array
    energy: float
    evaluations: int


@dataclass(frozen=True)
class Simplex:
    """Downhill simplex (Nelder and Mead 1965) from d + 1 points drawn around the start, as in the paper.

    sd: (d,) standard deviations of the draw; the start itself is the first point.
    """

    sd: Array
    evaluations: int
    rng: np.random.Generator

    def minimize(self, problem: Energy, start: Array) -> Minimum:
        """The lowest point found within the evaluations that are allowed."""
        from scipy.optimize import minimize  # a twentieth of a start, and not for `realtime`

        points = start + self.sd * self.rng.standard_normal((len(start) + 1, len(start)))
        points[0] = start
        # In units of `sd` the coordinates are comparable, which the simplex needs.
        result = minimize(
            lambda x: problem.energy(start + self.sd * x),
            np.zeros_like(start),
            method="Nelder-Mead",
            options={
                "initial_simplex": (points - start) / self.sd,
                "maxfev": self.evaluations,
                "xatol": 1e-3,
                "fatol": 1e-3,
                "adaptive": True,
            },
        )
        return Minimum(start + self.sd * result.x, float(result.fun), int(result.nfev))
