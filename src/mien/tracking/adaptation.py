"""Eq. (7) where the first frame could not say how a landmark would look: at eyes behind spectacles.

The views that the appearance is learned from turn what the first frame shows as if it were painted on the skin. A rim
stands off it, and what a lens reflects stays where it is: landmarks behind them look strange in every turn, and say
nothing. Where one does so though its patch has long moved with the face, its mean follows what is seen, as a linear
function of the turn that is nil in the first frame's view, to which it stays tied: what looks as it should is not
adapted, and does not drift. Only the eyes are: elsewhere it would be a hand at the chin, or a grimace, that is learned.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mien.appearance.descriptors import Float32
from mien.config import RealtimeSettings
from mien.geometry.rotation import Array

_ENTRIES = 128


class Adaptation:
    """What is added to the mean descriptors of landmarks that look strange, n in all."""

    def __init__(self, n: int, first: Array, settings: RealtimeSettings) -> None:
        """first: (2,) tilt and pan in radians, as `kernels.view_angles` gives them, of the first frame."""
        self.first = first
        self.settings = settings
        self.slope = np.zeros((2, n * _ENTRIES), np.float32)  # by tilt and by pan
        self.nothing = np.zeros((n, _ENTRIES), np.float32)
        self.begun = False

    def offset(self, angles: Array) -> Float32:
        """(n, 128) at a tilt and pan (2,)."""
        turn = (angles - self.first).astype(np.float32)
        return np.asarray((turn @ self.slope).reshape(self.nothing.shape))

    def learn(self, angles: Array, residual: Float32, strange: NDArray[np.bool_]) -> None:
        """Eq. (7) at a tilt and pan (2,), for the k landmarks that are `strange` (n,): residual (k, 128) is what was
        seen of them less the mean with its offset. The step is that of the normalised least mean squares."""
        self.begun = True
        turn = angles - self.first
        near = math.radians(self.settings.adaptation_turn_deg)
        rate = self.settings.forgetting * turn / (turn @ turn + near * near)
        for slope, by_angle in zip(self.slope.reshape(2, *self.nothing.shape), rate.astype(np.float32), strict=True):
            slope[strange] += by_angle * residual
