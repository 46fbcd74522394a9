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
from typing import Any

import numpy as np

from mien.appearance.descriptors import Float32
from mien.compiled import kernel
from mien.tracking.state import Closing, Mask

_PATH = np.linspace(0, 1.5, 31)
"""Places on the way: 0 open, 1 where drawn eyes are shut. Real lids change more than drawn ones."""
_SHUT = 1.25
"""Where real eyes are shut. This and the rest are from eyes whose closing is known (docs/benchmark.md)."""
_DIMENSIONS = 40
"""Independent entries in the noise of both eyes' descriptors."""
_BEGINS, _LASTS = 0.05, 0.35
"""Prior probability that eyes are closing, by any amount: where they were open in the last frame, and shut."""
_OPEN_SD = 0.05
"""Standard deviation of what open eyes move along the way."""
_ASIDE = 0.005
"""Prior probability that eyes look aside, times Occam's factor for how far is not known."""
_LEAST_SD, _SHARE_SD = 0.05, 0.25
"""Error of the way itself: standard deviation, and its growth with how far the eyes have closed."""
_LEAST_CHANGE = 0.01
"""Squared change of the descriptors below which the first frame's eyes were closed already."""

_HALF, _BEYOND = np.minimum(2 * _PATH, 1.0), np.maximum(2 * _PATH - 1, 0.0)
_BESIDE = np.stack([np.ones(len(_PATH)), _BEYOND - _HALF, -_BEYOND], axis=1)
"""(31, 3): what is seen, less half closed and shut eyes by their shares, is what lies beside each place."""
_OPEN = np.exp(-0.5 * (_PATH / _OPEN_SD) ** 2)
_OPEN /= _OPEN.sum()
_CLOSED = np.minimum(_PATH / _SHUT, 1.0)


def closing_of(residual: Float32, changes: Float32, seen: Mask, before: Closing | None = None) -> Closing | None:
    """How far eyes have closed that look so; None where nothing of them is seen, or they were closed to begin with.

    residual (n, 128): what was seen of their landmarks less what was expected; changes (4, n, 128): what eyes add to
    that which are half closed, shut, look to one side, and to the other; seen (n,): landmarks that face the camera;
    before: how far they had closed in the last frame.
    """
    products = _gram_matrix(residual, changes, seen)
    if products[2, 2] < _LEAST_CHANGE:
        return None
    share, variance = _closing_moments(products, before.share if before else 0.0)
    return Closing(share, math.sqrt(variance + _LEAST_SD**2 + (_SHARE_SD * share) ** 2))


@kernel()
def _gram_matrix(residual: Any, changes: Any, seen: Any) -> Any:
    """Products (5, 5) of the looks with each other: what is seen, and the four that are known."""
    products = np.zeros((5, 5))
    for i in range(seen.size):
        if not seen[i]:
            continue
        for a in range(5):
            first = residual[i] if a == 0 else changes[a - 1, i]
            for b in range(a, 5):
                second = residual[i] if b == 0 else changes[b - 1, i]
                s = np.float32(0.0)
                for c in range(first.size):
                    s += first[c] * second[c]
                products[a, b] += s
                products[b, a] = products[a, b]
    return products


@kernel()
def _closing_moments(products: Any, before: float) -> Any:
    """Mean and variance of how far the eyes have closed, from those products (5, 5) and how far they had before."""
    # What glances explain of the looks, by any amount, is taken off; where both look alike there is no inverse.
    a, b, c = products[3, 3] + 1e-9, products[3, 4], products[4, 4] + 1e-9
    determinant = 1.002 * a * c - b * b
    without = np.empty((3, 3))
    for i in range(3):
        left, right = products[i, 3], products[i, 4]
        for j in range(3):
            explained = products[3, j] * (c * left - b * right) + products[4, j] * (a * right - b * left)
            without[i, j] = products[i, j] - explained / determinant
    n = _PATH.size
    ahead, beside = np.empty(n), np.empty(n)  # log-likelihood of each place
    most = -np.inf
    for k in range(n):
        ahead[k], beside[k] = _log_likelihood(_BESIDE[k], products), _log_likelihood(_BESIDE[k], without)
        most = max(most, ahead[k], beside[k])
    closing = _BEGINS + (_LASTS - _BEGINS) * before
    total, mean, square = 0.0, 0.0, 0.0
    for k in range(n):
        prior = (1 - closing) * _OPEN[k] + closing / n
        probability = prior * (np.exp(ahead[k] - most) + _ASIDE * np.exp(beside[k] - most))
        total += probability
        mean += probability * _CLOSED[k]
        square += probability * _CLOSED[k] * _CLOSED[k]
    mean /= total
    return mean, max(square / total - mean * mean, 0.0)


@kernel()
def _log_likelihood(beside: Any, products: Any) -> Any:
    """Of a place on the way, beside which lies what `beside` (3,) combines of the looks with these products."""
    squared = 0.0
    for i in range(3):
        for j in range(3):
            squared += beside[i] * beside[j] * products[i, j]
    return -0.5 * _DIMENSIONS * np.log(max(squared, 1e-6))
