"""How far the eyes have closed since the first frame.

`appearance/eyes.py` closes the eyes of the first frame, so it is known how half closed and shut eyes would look. In
descriptor space a closing eye follows a path from open by way of half closed to shut: where along it is the
observation? The noise around the path, from expressions, light or a hand, differs from frame to frame and is unknown,
so the posterior is Student's t: an observation far from the path says little, and the prior decides, which is that eyes
are mostly open, and stay closed for a while once they are. Eyes that look aside are drawn as well, and may explain a
part.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mien.arrays import Float32, Mask
from mien.compiled import kernel
from mien.tracking.state import Closing

_PATH = np.linspace(0, 1.5, 31)
"""Positions on the path: 0 open, 1 where drawn eyes are shut. Real lids change more than drawn ones."""
_SHUT = 1.25
"""Position of real eyes that are shut. This and the other constants come from eyes whose closing is known
(docs/benchmark.md)."""
_DIMENSIONS = 40
"""Independent entries in the noise of the descriptors of both eyes."""
_BEGINS, _LASTS = 0.05, 0.35
"""Prior probability that eyes are closed, by any amount: where they were open in the last frame, and where they were
shut."""
_OPEN_SD = 0.05
"""Standard deviation of the position of open eyes."""
_ASIDE = 0.005
"""Prior probability that eyes look aside, times the Occam factor of the unknown amount."""
_LEAST_SD, _SHARE_SD = 0.05, 0.25
"""Error of the path itself: its standard deviation, and the growth of that with the closing."""
_LEAST_CHANGE = 0.01
"""Squared change of the descriptors below which the eyes were closed in the first frame already."""

_HALF, _BEYOND = np.minimum(2 * _PATH, 1.0), np.maximum(2 * _PATH - 1, 0.0)
_BESIDE = np.stack([np.ones(len(_PATH)), _BEYOND - _HALF, -_BEYOND], axis=1)
"""(31, 3): combinations of the observation with half closed and shut eyes that give its deviation from each
position."""
_OPEN = np.exp(-0.5 * (_PATH / _OPEN_SD) ** 2)
_OPEN /= _OPEN.sum()
_CLOSED = np.minimum(_PATH / _SHUT, 1.0)


def closing_of(residual: Float32, changes: Float32, seen: Mask, before: Closing | None = None) -> Closing | None:
    """How far eyes have closed; None where they are not seen, or were closed in the first frame.

    residual (n, 128): observed less expected descriptors of the landmarks; changes (4, n, 128): changes of the
    descriptors when eyes are half closed, shut, looking to one side, and to the other; seen (n,): landmarks that face
    the camera; before: the closing in the last frame.
    """
    products = _gram_matrix(residual, changes, seen)
    if products[2, 2] < _LEAST_CHANGE:
        return None
    share, variance = _closing_moments(products, before.share if before else 0.0)
    return Closing(share, math.sqrt(variance + _LEAST_SD**2 + (_SHARE_SD * share) ** 2))


@kernel()
def _gram_matrix(residual: Any, changes: Any, seen: Any) -> Any:
    """Products (5, 5) of the observation and the four known changes with each other."""
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
    """Mean and variance of the closing, from the Gram matrix (5, 5) and the last frame's closing."""
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
    """Log-likelihood of a position on the path, from which the observation deviates by the combination `beside` (3,) of
    what these products are of."""
    squared = 0.0
    for i in range(3):
        for j in range(3):
            squared += beside[i] * beside[j] * products[i, j]
    return -0.5 * _DIMENSIONS * np.log(max(squared, 1e-6))
