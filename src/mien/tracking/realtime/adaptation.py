"""Eq. (7) where the first frame could not show how a landmark would look: at eyes behind spectacles, and where the face
has turned far.

The views from which the appearance is learned turn what the first frame shows as if it were painted on the skin. But
the rim of spectacles stands off the skin, reflections in a lens stay where they are, and the first frame shows little
of a cheek that faces away. There the means follow what is seen, by an offset that is zero in the first frame's view and
so tied to it: what looks as it should is not adapted, and does not drift.

The offset of the eyes is a linear function of the turn. That of a turned face is interpolated between views around the
first frame's, each with more weight the further away it is, so that what is learned there says nothing of the front.
Elsewhere nothing is adapted: it would learn a hand at the chin, or a grimace.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mien.appearance.descriptors import LENGTH
from mien.arrays import Array, Float32, Mask
from mien.compiled import kernel
from mien.config.realtime import AdaptationSettings

_TILTS, _PANS = 5, 9
"""Turns from the first frame's view, in tilt and pan, at which the appearance of a turned face is learned."""
_SPACING = math.radians(20.0)
"""Angle in radians from each of these turns to the next."""
_DAMPING = 0.3
"""Of the step: near the first frame's view hardly anything is learned."""


class Adaptation:
    """The offset to the mean descriptors of n landmarks that look strange."""

    def __init__(self, n: int, first: Array, settings: AdaptationSettings) -> None:
        """first: (2,) tilt and pan of the first frame in radians, as of `pose_geometry.view_angles`."""
        self.first = first
        self.settings = settings
        self.slope = np.zeros((2, n * LENGTH), np.float32)  # by tilt and by pan
        self.views = np.zeros((_TILTS * _PANS, n * LENGTH), np.float32)
        self.learned = np.zeros((_TILTS * _PANS, n), np.float32)
        self.near = math.radians(settings.view_turn_deg)
        self.nothing = np.zeros((n, LENGTH), np.float32)
        self.begun = False

    def offset(self, angles: Array) -> Float32:
        """The offset (n, 128) at a tilt and pan (2,)."""
        offset: Float32 = _offset(angles - self.first, self.near, self.slope, self.views)
        return offset.reshape(self.nothing.shape)

    def share(self, angles: Array) -> Float32:
        """(n,) how far the appearance of each landmark at a tilt and pan (2,) was learned here: 0 where it is the first
        frame's, 1 where it is what was seen when the face turned there."""
        if not self.begun:
            return np.zeros(len(self.nothing), np.float32)
        share: Float32 = _share(angles - self.first, self.near, self.learned)
        return share

    def mean_share(self, share: Float32, which: Mask) -> float:
        """Mean of that share (n,) over the landmarks `which` (n,); 0 without any."""
        return float(_mean_of(share, which)) if self.begun else 0.0

    def learn_eyes(self, angles: Array, residual: Float32, strange: Mask) -> None:
        """Eq. (7) at a tilt and pan (2,), for the k landmarks that are `strange` (n,): residual (k, 128) is their
        observed descriptor less the mean with its offset. The step is that of normalised least mean squares."""
        self.begun = True
        turn = angles - self.first
        near = math.radians(self.settings.turn_deg)
        rate = self.settings.forgetting * turn / (turn @ turn + near * near)
        for slope, by_angle in zip(self.slope.reshape(2, *self.nothing.shape), rate.astype(np.float32), strict=True):
            slope[strange] += by_angle * residual

    def learn_view(self, angles: Array, residual: Float32, strange: Mask) -> None:
        """Eq. (7) for a face that has turned away from the first frame's view, at a tilt and pan (2,), for the k
        landmarks that are `strange` (n,), with their residual (k, 128)."""
        self.begun = True
        near = _neighbours(angles - self.first, self.near)
        missing = (1 - self.share(angles)) * strange
        change = np.zeros_like(self.nothing)
        change[strange] = residual
        step = self.settings.view_rate / (sum(weight * weight for _, weight in near) + _DAMPING)
        for k, weight in near:
            self.views[k] += step * weight * change.ravel()
            self.learned[k] += step * weight * missing


@kernel()
def _neighbours(turn: Any, near: float) -> Any:
    """The four views around a turn (2,) from the first frame's view, in tilt and pan, and their weights: bilinear, and
    the smaller the nearer the first frame's view is, within `near` radians."""
    away = 1 - np.exp(-0.5 * (turn[0] * turn[0] + turn[1] * turn[1]) / (near * near))
    row, down = _bracket(turn[0], _TILTS)
    column, right = _bracket(turn[1], _PANS)
    k = row * _PANS + column
    return (
        (k, away * (1 - down) * (1 - right)),
        (k + 1, away * (1 - down) * right),
        (k + _PANS, away * down * (1 - right)),
        (k + _PANS + 1, away * down * right),
    )


@kernel()
def _offset(turn: Any, near: float, slope: Any, views: Any) -> Any:
    """The offset (m,) at a turn (2,): linear in it, by slope (2, m), and interpolated between views (v, m)."""
    total, by_tilt, by_pan = np.empty(slope.shape[1], np.float32), np.float32(turn[0]), np.float32(turn[1])
    for i in range(total.size):
        total[i] = by_tilt * slope[0, i] + by_pan * slope[1, i]
    _add_interpolated(turn, near, views, total)
    return total


@kernel()
def _share(turn: Any, near: float, learned: Any) -> Any:
    """How much was learned (n,) at a turn (2,), interpolated between views (v, n), and at most 1: what was learned near
    the first frame's view counts for more further on."""
    share = np.zeros(learned.shape[1], np.float32)
    _add_interpolated(turn, near, learned, share)
    for i in range(share.size):
        share[i] = min(share[i], np.float32(1.0))
    return share


@kernel()
def _mean_of(values: Any, which: Any) -> float:
    """Mean of those values (n,) that are `which` (n,); 0 without any."""
    total, count = 0.0, 0
    for i in range(which.size):
        if which[i]:
            total += values[i]
            count += 1
    return total / max(count, 1)


@kernel()
def _add_interpolated(turn: Any, near: float, views: Any, total: Any) -> None:
    """Add to total (m,) the views (v, m) around a turn (2,), by their weights."""
    for k, weight in _neighbours(turn, near):
        view, share = views[k], np.float32(weight)
        for i in range(total.size):
            total[i] += share * view[i]


@kernel()
def _bracket(angle: float, count: int) -> Any:
    """Index of the view before an angle, among `count` of them around 0, and the position between it and the next, in
    [0, 1]."""
    place = min(max(angle / _SPACING + (count - 1) / 2, 0.0), count - 1.0)
    before = min(int(place), count - 2)
    return before, place - before
