"""The learned appearance at one resolution, and what is looked up in it by pose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from mien.appearance.regression import PoseRegression
from mien.arrays import Array, Float32
from mien.compiled import kernel
from mien.config import DescriptorSettings


@dataclass(frozen=True)
class Noise:
    """What the noise of the picture does to the squared distances of n landmarks: it adds d2 (n,), and leaves the
    square of a fraction `contrast` of what the difference of two faces makes. Without it they would tell how strange
    the landmarks look, not how badly they are seen."""

    d2: Array
    contrast: float


@dataclass(frozen=True)
class Level:
    """The appearance of n landmarks at one resolution.

    descriptor, size: its crop, and the side of that in pixels; appearance: the descriptors by pose; eyes: (4, n, 128)
    changes of the descriptors when the eyes do what `learning._EYES` says; views: the k tilts and l pans in radians of
    the views; behind: (k, l, n) how far each landmark lies behind the face's own surface there, CANDIDE units; noise:
    of the first frame; learn_turned: learns the level for a face that has turned further than these views; None in that
    level itself.
    """

    descriptor: DescriptorSettings
    size: int
    appearance: PoseRegression
    eyes: Float32
    views: tuple[Array, Array]
    behind: Float32
    noise: Noise
    learn_turned: Callable[[], Level] | None = None

    @cached_property
    def _turned(self) -> Level:
        """Learned when it is first needed: most faces never turn so far, and it takes half as long as the rest."""
        return self if self.learn_turned is None else self.learn_turned()

    def at(self, angles: Array) -> Level:
        """The level for a tilt and pan (2,): near the front, views from far aside would make the regression worse."""
        return self._turned if abs(angles[1]) > self.appearance.limit[1] else self

    def depth_behind(self, angles: Array) -> Float32:
        """How far (n,) the landmarks lie behind the face's own surface in the view nearest to a tilt and pan (2,)."""
        return np.asarray(self.behind[_nearest(self.views[0], angles[0]), _nearest(self.views[1], angles[1])])

    def trust(self, angles: Array, lack_of_fit: float) -> Float32:
        """Factor (n,) of the information of the landmarks at a tilt and pan (2,): a half where the squared distance
        between rendered and predicted descriptors, interpolated between the nearest four views, is `lack_of_fit`."""
        by_view = self.appearance.lack_of_fit.reshape(self.behind.shape)
        trust: Float32 = _trust(by_view, self.views, angles, lack_of_fit)
        return trust


@kernel()
def _nearest(views: Any, angle: float) -> int:
    """Index of the view angle (k,) nearest to an angle."""
    nearest = 0
    for k in range(views.size):
        if abs(views[k] - angle) < abs(views[nearest] - angle):
            nearest = k
    return nearest


@kernel()
def _trust(table: Any, views: Any, angles: Any, usual: float) -> Any:
    """`Level.trust` (n,) at a tilt and pan (2,), from a table (k, l, n) of the squared distances in views from k tilts
    and l pans; constant beyond the last view."""
    row, down = _bracket(views[0], angles[0])
    column, right = _bracket(views[1], angles[1])
    a, b, c, d = table[row, column], table[row, column + 1], table[row + 1, column], table[row + 1, column + 1]
    out = np.empty(a.size, np.float32)
    for i in range(out.size):
        fit = (1 - down) * ((1 - right) * a[i] + right * b[i]) + down * ((1 - right) * c[i] + right * d[i])
        out[i] = usual / (usual + fit)
    return out


@kernel()
def _bracket(views: Any, angle: float) -> Any:
    """Index of the view before an angle, among increasing angles (k,), and the position between it and the next, in [0,
    1]."""
    k = 0
    while k < views.size - 2 and views[k + 1] <= angle:
        k += 1
    return k, min(max((angle - views[k]) / (views[k + 1] - views[k]), 0.0), 1.0)
