"""The evolution model: `p(b_t | b_{t-1}) = N(b_t; b_{t-1}, Psi)`, Eq. (4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mien.arrays import Array
from mien.candide.model import TRACKED_UNITS

JAW_DROP = TRACKED_UNITS.index("jaw_drop")


@dataclass(frozen=True)
class GaussianPrior:
    """Mean (d,) and standard deviations (d,), the square roots of the diagonal of Psi."""

    mean: Array
    sd: Array

    def energy(self, b: Array) -> float:
        """Second term of Eq. (9): `|b - mean|^2` in the metric of Psi^-1."""
        return float((((b - self.mean) / self.sd) ** 2).sum())


def state_sd(
    rotation_deg: float, translation: float, depth: float, animation: float, jaw: float | None = None
) -> Array:
    """Standard deviations (12,) of the entries of b, Eq. (2), in radians, CANDIDE units and animation units a frame.
    translation: across the view; depth: along it; jaw: that of jaw_drop, if it differs from the other units'."""
    sd = np.array([np.radians(rotation_deg)] * 3 + [translation, translation, depth] + [animation] * 6)
    sd[6 + JAW_DROP] = animation if jaw is None else jaw
    return sd
