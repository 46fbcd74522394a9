"""The part of an image that holds the face, resampled to a fixed size of the face."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np

from mien.arrays import Array, Float32, Pixels
from mien.compiled import kernel
from mien.frame import Frame

_BLANK = 1.0
"""Standard deviation of grey values below which an image shows nothing but camera noise."""


@dataclass(frozen=True)
class Crop:
    """A similarity from image to crop: `q = scale * Rot(-angle) (p - centre) + (size - 1) / 2`.

    centre: (2,) image pixels; scale: crop pixels per image pixel; angle: radians, the direction in the image
    that becomes the crop's u axis; size: side of the crop in pixels.
    """

    centre: tuple[float, float]
    scale: float
    angle: float
    size: int

    @cached_property
    def linear(self) -> Array:
        """(2, 2) linear part: crop pixels by image pixels."""
        c, s = self.scale * math.cos(self.angle), self.scale * math.sin(self.angle)
        return np.array([[c, s], [-s, c]])

    @cached_property
    def offset(self) -> Array:
        """(2,) position of the image's origin in the crop."""
        ((c, s), _), (x, y), middle = self.linear.tolist(), self.centre, 0.5 * (self.size - 1)
        return np.array([middle - (c * x + s * y), middle - (c * y - s * x)])

    def to_crop(self, p: Array) -> Array:
        """(..., 2) image pixels -> (..., 2) crop pixels."""
        return np.asarray(p @ self.linear.T + self.offset)

    def sample(self, frame: Frame, blur: float = 0.0) -> Float32:
        """Grey crop (size, size) float32 of a frame; beyond its border the border repeats.

        The cost depends on the size of the crop, not on that of the frame.
        """
        gray, offset, shrink = self._region(frame)
        step = 1 / (self.scale * shrink)  # of the crop's pixels in those that are read
        along, across = step * math.cos(self.angle), step * math.sin(self.angle)
        x, y = ((c - o + 0.5) / shrink - 0.5 for c, o in zip(self.centre, offset, strict=True))
        half = 0.5 * (self.size - 1)
        start = x - half * (along - across), y - half * (along + across)
        crop = np.empty((self.size, self.size), np.float32)
        _resample(gray, start, (along, across), crop)
        return blurred(crop, blur)

    def _region(self, frame: Frame) -> tuple[Pixels, tuple[int, int], int]:
        """The grey pixels that the crop needs, at least two each way, their origin in the frame, and the factor by
        which they were shrunk against aliasing."""
        size = frame.width, frame.height
        reach = int(0.71 * self.size / self.scale) + 3
        x0, y0 = (int(min(max(c - reach, 0), n - 1)) for c, n in zip(self.centre, size, strict=True))
        x1, y1 = (int(min(max(c + reach, 1), n)) for c, n in zip(self.centre, size, strict=True))
        region = frame.gray_part(slice(y0, max(y1, y0 + 1)), slice(x0, max(x1, x0 + 1)))
        shrink = max(int(1 / self.scale), 1)
        if shrink > 1 and min(region.shape) >= shrink:
            h, w = region.shape[0] // shrink, region.shape[1] // shrink
            part = region[: h * shrink, : w * shrink]
            region = np.asarray(cv2.resize(part, (w, h), interpolation=cv2.INTER_AREA), np.uint8)
        else:
            shrink = 1
        if min(region.shape) < 2:
            region = np.pad(region, [(0, n < 2) for n in region.shape], mode="edge")
        return region, (x0, y0), shrink


@kernel()
def _resample(gray: Any, start: Any, step: Any, crop: Any) -> None:
    """Bilinear values of grey pixels (h, w), at least two each way, into crop (size, size); beyond the border the
    border repeats. start: position (x, y) of the crop's first pixel; step: from there to the next one in its row. Takes
    half the time of `cv2.warpAffine`, which rounds positions to a 32nd of a pixel."""
    height, width = gray.shape
    size = crop.shape[0]
    pixels = gray.ravel()
    along, across = np.float32(step[0]), np.float32(step[1])
    right, bottom, zero = np.float32(width - 1), np.float32(height - 1), np.float32(0.0)
    at, fx, fy = np.empty(size, np.int32), np.empty(size, np.float32), np.empty(size, np.float32)
    corners = np.empty((4, size), np.uint8)
    for v in range(size):
        # In three loops, as only the second one takes a pixel at a time.
        x0, y0 = np.float32(start[0] - v * step[1]), np.float32(start[1] + v * step[0])
        for u in range(size):
            x, y = x0 + along * np.float32(u), y0 + across * np.float32(u)
            x, y = min(max(x, zero), right), min(max(y, zero), bottom)
            ix, iy = min(np.int32(x), np.int32(width - 2)), min(np.int32(y), np.int32(height - 2))
            fx[u], fy[u] = x - np.float32(ix), y - np.float32(iy)
            at[u] = iy * np.int32(width) + ix
        for u in range(size):
            k = np.uint64(at[u])
            corners[0, u], corners[1, u] = pixels[k], pixels[k + np.uint64(1)]
            k += np.uint64(width)
            corners[2, u], corners[3, u] = pixels[k], pixels[k + np.uint64(1)]
        for u in range(size):
            a, b = np.float32(corners[0, u]), np.float32(corners[1, u])
            c, d = np.float32(corners[2, u]), np.float32(corners[3, u])
            upper, lower = a + fx[u] * (b - a), c + fx[u] * (d - c)
            crop[v, u] = upper + fy[u] * (lower - upper)


def is_blank(gray: Float32) -> bool:
    """Whether an image shows nothing, judged by every fourth row: descriptors have unit length and would describe its
    noise."""
    return float(cv2.meanStdDev(gray[::4])[1][0, 0]) < _BLANK


def blurred(gray: Float32, sd: float) -> Float32:
    """Gaussian blur with this standard deviation in pixels; the same image for 0."""
    return np.asarray(cv2.GaussianBlur(gray, (0, 0), sd), dtype=np.float32) if sd > 0 else gray
