"""Closed eyes, drawn from a picture of open ones.

A blink changes what every landmark around an eye looks like, and a tracker that has seen open eyes alone takes part of
it for a nod. The skin above the eye is stretched down over the opening, as an eyelid is.
"""

from __future__ import annotations

import cv2
import numpy as np

from mien.geometry.rotation import Array
from mien.video import Pixels

_MARGIN = 0.8
"""Half of the side of the square that is drawn anew, in widths of the eye."""
_CREASE = 1.0
"""Height over the upper lid of the skin that is stretched, in openings of the eye."""


def close_eye(pixels: Pixels, corners: Array, lids: Array, share: float) -> Pixels:
    """An image (h, w) or (h, w, 3) with the lid of one eye moved down by a share of the opening.

    corners (2, 2), lids (2, 2): image points of the corners, and of the middles of the upper and the lower lid. The
    lids are parabolas through them. Where no opening is seen, the image stays as it is.
    """
    middle, width = corners.mean(axis=0), float(np.linalg.norm(corners[1] - corners[0]))
    height, across = pixels.shape[:2]
    left, top = np.maximum(np.floor(middle - _MARGIN * width), 0).astype(int)
    right, bottom = np.minimum(np.ceil(middle + _MARGIN * width), [across, height]).astype(int)
    if width < 1 or right - left < 2 or bottom - top < 2:
        return pixels
    along = (corners[1] - corners[0]) / width
    down = np.array([-along[1], along[0]])
    down *= np.sign((lids[1] - lids[0]) @ down) or 1.0
    upper, lower = (lids - middle) @ down
    x, y = np.meshgrid(np.arange(left, right), np.arange(top, bottom))
    from_middle = np.stack([x, y], axis=-1) - middle
    depth = from_middle @ down
    arch = np.maximum(1 - (2 * (from_middle @ along) / width) ** 2, 0)
    lid, opening = upper * arch, (lower - upper) * arch
    crease = lid - _CREASE * (lower - upper) * np.sqrt(arch)  # above it the skin stays
    edge = lid + share * opening
    covered = (depth > crease) & (depth < edge)
    stretch = (lid - crease) / np.maximum(edge - crease, 1e-6)
    shift = np.where(covered, (depth - crease) * (stretch - 1), 0.0)
    source = [(axis + shift * d).astype(np.float32) for axis, d in zip((x, y), down, strict=True)]
    closed = pixels.copy()
    closed[top:bottom, left:right] = cv2.remap(
        pixels, source[0], source[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return closed
