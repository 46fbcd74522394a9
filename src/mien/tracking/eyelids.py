"""Blinks are noticed, and the eyes not believed while they last.

A lid that closes carries the look of an eye downwards, in the pixels as in the descriptors, and a tracker takes part of
that for a nod: by a degree and more, at every blink. What closed eyes look like is known from the first frame, in which
`appearance/eyelids.py` closes them. Where what is seen differs from what is expected in that way, and in little else,
the eyes are closing, and the rest of the face says where the head is.
"""

from __future__ import annotations

from mien.appearance.descriptors import Float32
from mien.tracking.state import Mask

_ALIKE = 0.4
"""Correlation, of how eyes look with how closed ones would, from which on they are closing and not behind a hand."""
_LEAST_CHANGE = 0.01
"""Squared change of the descriptors below which the first frame's eyes were closed already."""


def closing(residual: Float32, change: Float32, seen: Mask, least: float) -> bool:
    """Whether eyes are closing.

    residual (n, 128): what was seen of their landmarks less what was expected; change (n, 128): what closed eyes add to
    that; seen (n,): landmarks that can be seen; least: how far they have closed then, 1 being shut.
    """
    looks, closed = residual[seen].ravel(), change[seen].ravel()
    along, length = float(looks @ closed), float(closed @ closed)
    if length < _LEAST_CHANGE or along < least * length:
        return False
    return along * along > _ALIKE**2 * length * float(looks @ looks)
