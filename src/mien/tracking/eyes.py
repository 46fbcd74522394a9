"""How far the eyes have closed since the first frame.

What eyes look like that are half closed and shut is known from the first frame, in which `appearance/eyes.py` closes
them. In the space of the descriptors a closing eye goes from the look of the first frame by way of the one to the
other: where along this way is what is seen? The noise about it, from expressions, light or a hand, is different in
every frame and not known, so the posterior is that of Student's t: a look far beside the way says little, and the
prior, that eyes are mostly open, and stay closed for a while where they are not, decides. Eyes that look aside are
drawn as well, and may explain a part.
"""

from __future__ import annotations

import math

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
_BEGINS, _LASTS = 0.07, 0.35
"""Prior probability that eyes are closing, by any amount: where they were open in the last frame, and shut."""
_OPEN_SD = 0.05
"""Standard deviation of what open eyes move along the way."""
_ASIDE = 0.005
"""Prior probability that eyes look aside, times Occam's factor for how far is not known."""
_LEAST_SD, _SHARE_SD = 0.05, 0.25
"""Error of the way itself: standard deviation, and its growth with how far the eyes have closed."""
_LEAST_CHANGE = 0.01
"""Squared change of the descriptors below which the first frame's eyes were closed already."""

_HALF, _BEYOND = np.minimum(2 * _WAY, 1.0), np.maximum(2 * _WAY - 1, 0.0)
_BESIDE = np.stack([np.ones(len(_WAY)), _BEYOND - _HALF, -_BEYOND], axis=1)
"""(31, 3): what is seen, less half closed and shut eyes by their shares, is what lies beside each place."""
_PAIRS = (_BESIDE[:, :, None] * _BESIDE[:, None, :]).reshape(len(_WAY), -1)
_OPEN = np.exp(-0.5 * (_WAY / _OPEN_SD) ** 2)
_OPEN /= _OPEN.sum()
_CLOSED = np.minimum(_WAY / _SHUT, 1.0)


def closing_of(residual: Float32, changes: Float32, seen: Mask, before: Closing | None = None) -> Closing | None:
    """How far eyes have closed that look so; None where nothing of them is seen, or they were closed to begin with.

    residual (n, 128): what was seen of their landmarks less what was expected; changes (4, n, 128): what eyes add to
    that which are half closed, shut, look to one side, and to the other; seen (n,): landmarks that face the camera;
    before: how far they had closed in the last frame.
    """
    looks = np.concatenate([residual[None], changes])[:, seen].reshape(5, -1)
    products = (looks @ looks.T).astype(np.float64)
    if products[2, 2] < _LEAST_CHANGE:
        return None
    ahead = _log_likelihood(products[:3, :3])
    beside = _log_likelihood(_without_glances(products))
    most = max(ahead.max(), beside.max())
    closing = _BEGINS + (_LASTS - _BEGINS) * (before.share if before else 0.0)
    prior = (1 - closing) * _OPEN + closing / len(_WAY)
    probability = prior * (np.exp(ahead - most) + _ASIDE * np.exp(beside - most))
    probability /= probability.sum()
    share = float(probability @ _CLOSED)
    variance = float(probability @ np.square(_CLOSED - share))
    return Closing(share, math.sqrt(variance + _LEAST_SD**2 + (_SHARE_SD * share) ** 2))


def _log_likelihood(products: Array) -> Array:
    """(31,) of each place, from the products (3, 3) of what is seen and of the looks of half closed and shut eyes."""
    distance = _PAIRS @ products.ravel()
    return np.asarray(-0.5 * _DIMENSIONS * np.log(np.maximum(distance, 1e-6)))


def _without_glances(products: Array) -> Array:
    """Products (3, 3) of those looks less what the glances explain of them, by any amount: of (5, 5) with theirs."""
    a, b, c = products[3, 3] + 1e-9, products[3, 4], products[4, 4] + 1e-9
    inverse = np.array([[c, -b], [-b, a]]) / (1.002 * a * c - b * b)  # where both glances look alike it has none
    return np.asarray(products[:3, :3] - products[:3, 3:] @ inverse @ products[3:, :3])
