"""How far the eyes have closed since the first frame.

What eyes look like that are half closed and shut is known from the first frame, in which `appearance/eyelids.py` closes
them. In the space of the descriptors a closing eye goes from the look of the first frame by way of the one to the
other: where along this way is what is seen? The noise about it, from gaze, light or a hand, is different in every frame
and not known, so the posterior is that of Student's t: a look far beside the way says little, and the prior, that
eyes are mostly open, decides.
"""

from __future__ import annotations

import numpy as np

from mien.appearance.descriptors import Float32
from mien.geometry.rotation import Array
from mien.tracking.state import Closing, Mask

_WAY = np.linspace(0, 1.5, 31)
"""Places on the way: 0 open, 1 where drawn eyes are shut. Real lids change more than drawn ones."""
_SHUT = 1.25
"""Where real eyes are shut. This and the rest are from eyes whose closing is known (docs/benchmark.md)."""
_DIMENSIONS = 40
"""Independent entries in the noise of both eyes' descriptors."""
_CLOSING = 0.15
"""Prior probability that eyes are closing, by any amount."""
_OPEN_SD = 0.05
"""Standard deviation of what open eyes move along the way."""
_LEAST_SD, _SHARE_SD = 0.05, 0.25
"""Error of the way itself: standard deviation, and its growth with how far the eyes have closed."""
_LEAST_CHANGE = 0.01
"""Squared change of the descriptors below which the first frame's eyes were closed already."""

_HALF, _BEYOND = np.minimum(2 * _WAY, 1.0), np.maximum(2 * _WAY - 1, 0.0)
_MIX = np.stack([_HALF - _BEYOND, _BEYOND], axis=1)
"""(31, 2): shares of half closed and of shut eyes at each place."""
_OPEN = np.exp(-0.5 * (_WAY / _OPEN_SD) ** 2)
_PRIOR = (1 - _CLOSING) * _OPEN / _OPEN.sum() + _CLOSING / len(_WAY)
_CLOSED = np.minimum(_WAY / _SHUT, 1.0)


def closing_of(residual: Float32, changes: Float32, seen: Mask) -> Closing | None:
    """How far eyes have closed that look so; None where nothing of them is seen, or they were closed to begin with.

    residual (n, 128): what was seen of their landmarks less what was expected; changes (2, n, 128): what eyes that are
    half closed and shut add to that; seen (n,): landmarks that face the camera.
    """
    looks, way = residual[seen].ravel(), changes[:, seen].reshape(2, -1)
    if float(way[1] @ way[1]) < _LEAST_CHANGE:
        return None
    probability = _posterior(looks, way)
    share = float(probability @ _CLOSED)
    variance = float(probability @ np.square(_CLOSED - share))
    return Closing(share, float(np.sqrt(variance + _LEAST_SD**2 + (_SHARE_SD * share) ** 2)))


def _posterior(looks: Float32, way: Float32) -> Array:
    """Probability (31,) of each place: looks (k,), way (2, k) the looks of half closed and of shut eyes."""
    products = way @ way.T
    distance = looks @ looks - 2 * _MIX @ (way @ looks) + np.einsum("wi,ij,wj->w", _MIX, products, _MIX)
    likelihood = -0.5 * _DIMENSIONS * np.log(np.maximum(distance, 1e-6))
    probability = _PRIOR * np.exp(likelihood - likelihood.max())
    return np.asarray(probability / probability.sum())
