"""Eq. (7) where the first frame could not say how a landmark would look: at eyes behind spectacles, and where the face
has turned far.

The views that the appearance is learned from turn what the first frame shows as if it were painted on the skin. A rim
stands off it, and what a lens reflects stays where it is; and of a cheek that faces away the first frame shows little.
There means follow what is seen, by an offset that is nil in the first frame's view, to which they stay tied: what looks
as it should is not adapted, and does not drift.

Eyes: a linear function of the turn. A turned face: bumps over tilt and pan, the further from the first frame's view the
more, so that what is learned there says nothing of the front. Elsewhere nothing is adapted: it would be a hand at the
chin, or a grimace, that is learned.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mien.appearance.descriptors import Float32
from mien.config import RealtimeSettings
from mien.geometry.rotation import Array
from mien.tracking.state import Mask

_ENTRIES = 128
_BUMPS = np.radians([(tilt, pan) for tilt in range(-45, 46, 15) for pan in range(-75, 76, 15)])
"""Turns (k, 2) from the first frame's view about which the look of a turned face is learned."""
_BUMP_SD = math.radians(12.0)
_LEAST_BUMP = 0.02
_DAMPING = 0.3
"""Of the step: where bumps are low, near the first frame's view, hardly anything is learned."""


class Adaptation:
    """What is added to the mean descriptors of n landmarks that look strange."""

    def __init__(self, n: int, first: Array, settings: RealtimeSettings) -> None:
        """first: (2,) tilt and pan in radians, as `kernels.view_angles` gives them, of the first frame."""
        self.first = first
        self.settings = settings
        self.slope = np.zeros((2, n * _ENTRIES), np.float32)  # by tilt and by pan
        self.views = np.zeros((len(_BUMPS), n * _ENTRIES), np.float32)
        self.learned = np.zeros((len(_BUMPS), n), np.float32)
        self.nothing = np.zeros((n, _ENTRIES), np.float32)
        self.begun = False

    def offset(self, angles: Array) -> Float32:
        """(n, 128) at a tilt and pan (2,)."""
        turn = (angles - self.first).astype(np.float32)
        near, height = self._bumps(angles)
        return np.asarray((turn @ self.slope + height @ self.views[near]).reshape(self.nothing.shape))

    def share(self, angles: Array) -> Float32:
        """(n,) how far the look of each landmark at a tilt and pan (2,) is learned here: 0 where it is the first
        frame's, 1 where it is what was seen when the face turned there."""
        near, height = self._bumps(angles)
        return np.asarray(np.clip(height @ self.learned[near], 0, 1))

    def learn_eyes(self, angles: Array, residual: Float32, strange: Mask) -> None:
        """Eq. (7) at a tilt and pan (2,), for the k landmarks that are `strange` (n,): residual (k, 128) is what was
        seen of them less the mean with its offset. The step is that of the normalised least mean squares."""
        self.begun = True
        turn = angles - self.first
        near = math.radians(self.settings.adaptation_turn_deg)
        rate = self.settings.forgetting * turn / (turn @ turn + near * near)
        for slope, by_angle in zip(self.slope.reshape(2, *self.nothing.shape), rate.astype(np.float32), strict=True):
            slope[strange] += by_angle * residual

    def learn_view(self, angles: Array, residual: Float32, strange: Mask) -> None:
        """The same of a face that has turned away from the first frame's view."""
        self.begun = True
        near, height = self._bumps(angles)
        missing = (1 - self.share(angles)) * strange
        rate = self.settings.view_rate * height / (height @ height + _DAMPING)
        for k, by_bump in zip(near, rate, strict=True):
            self.views[k].reshape(self.nothing.shape)[strange] += by_bump * residual
            self.learned[k] += by_bump * missing

    def _bumps(self, angles: Array) -> tuple[NDArray[np.intp], Float32]:
        """The bumps (m,) that reach a tilt and pan (2,), and their heights (m,) there."""
        turn = angles - self.first
        away = 1 - math.exp(-0.5 * float(turn @ turn) / math.radians(self.settings.view_turn_deg) ** 2)
        height = away * np.exp(-0.5 * ((turn - _BUMPS) ** 2).sum(axis=1) / _BUMP_SD**2)
        near = np.flatnonzero(height > _LEAST_BUMP)
        return near, height[near].astype(np.float32)
