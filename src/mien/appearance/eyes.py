"""Closed eyes, and eyes that look aside, synthesised from a picture of open ones.

A blink or a glance changes the appearance of every landmark around an eye, and a tracker that knows only the eyes of
the first frame takes part of it for a nod or a turn. To close an eye, the skin above it is stretched down over the
opening, like a lid; to turn it, what lies between the lids is moved along the eye, like an eyeball.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from mien.arrays import Array, Pixels

_MARGIN = 0.8
"""Half of the side of the square that is redrawn, in widths of the eye."""
_CREASE = 1.0
"""Height above the upper lid of the skin that is stretched, in openings of the eye."""
_WHITE = 0.85
"""Share of the way from the middle to the end of the opening that shows eyeball."""


def close_eye(pixels: Pixels, corners: Array, lids: Array, share: float) -> Pixels:
    """An image (h, w) or (h, w, 3) with the lid of one eye moved down by a share of the opening.

    corners (2, 2), lids (2, 2): image points of the corners, and of the middles of the upper and lower lid, which are
    taken for parabolas. Without a visible opening the image is returned unchanged.
    """
    eye = _Eye.at(pixels, corners, lids)
    if eye is None:
        return pixels
    arch = np.maximum(1 - (2 * eye.place / eye.width) ** 2, 0)
    lid, opening = eye.upper * arch, (eye.lower - eye.upper) * arch
    crease = lid - _CREASE * (eye.lower - eye.upper) * np.sqrt(arch)  # above it the skin stays
    edge = lid + share * opening
    covered = (eye.depth > crease) & (eye.depth < edge)
    stretch = (lid - crease) / np.maximum(edge - crease, 1e-6)
    return eye.drawn(pixels, np.where(covered, (eye.depth - crease) * (stretch - 1), 0.0), eye.down)


def turn_eye(pixels: Pixels, corners: Array, lids: Array, share: float) -> Pixels:
    """The image with one eye looking aside: what lies between the lids is moved from the first corner towards the
    second, by a share of the eye's width. What appears from behind the lids is as white as what was next to it.
    Arguments as of `close_eye`."""
    eye = _Eye.at(pixels, corners, lids)
    if eye is None:
        return pixels
    edge = np.where(eye.depth < 0, min(eye.upper, -1e-6), max(eye.lower, 1e-6))
    end = 0.5 * eye.width * np.sqrt(np.maximum(1 - eye.depth / edge, 0))  # of the opening, at this depth
    white = _WHITE * end
    source = np.clip(eye.place - share * eye.width, -white, white)
    return eye.drawn(pixels, np.where(np.abs(eye.place) < end, source - eye.place, 0.0), eye.along)


@dataclass(frozen=True)
class _Eye:
    """The pixels in a square around one eye: image coordinates x, y (h, w); place and depth (h, w), along the eye from
    its middle and down from it; along, down (2,), those directions in the image; depths of the middles of the lids."""

    x: Array
    y: Array
    place: Array
    depth: Array
    along: Array
    down: Array
    width: float
    upper: float
    lower: float

    @classmethod
    def at(cls, pixels: Pixels, corners: Array, lids: Array) -> _Eye | None:
        """The eye with these corners and lids; None where none of it lies in the image."""
        middle, width = corners.mean(axis=0), float(np.linalg.norm(corners[1] - corners[0]))
        height, across = pixels.shape[:2]
        left, top = np.maximum(np.floor(middle - _MARGIN * width), 0).astype(int)
        right, bottom = np.minimum(np.ceil(middle + _MARGIN * width), [across, height]).astype(int)
        if width < 1 or right - left < 2 or bottom - top < 2:
            return None
        along = (corners[1] - corners[0]) / width
        down = np.array([-along[1], along[0]])
        down *= np.sign((lids[1] - lids[0]) @ down) or 1.0
        upper, lower = (lids - middle) @ down
        x, y = np.meshgrid(np.arange(left, right), np.arange(top, bottom))
        from_middle = np.stack([x, y], axis=-1) - middle
        return cls(x, y, from_middle @ along, from_middle @ down, along, down, width, float(upper), float(lower))

    def drawn(self, pixels: Pixels, shift: Array, direction: Array) -> Pixels:
        """The image with every pixel of the square taken from a shift (h, w) away in a direction (2,)."""
        x, y = ((axis + shift * d).astype(np.float32) for axis, d in zip((self.x, self.y), direction, strict=True))
        out = pixels.copy()
        out[self.y, self.x] = cv2.remap(pixels, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return out
