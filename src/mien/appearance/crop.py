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

_AHEAD = 1e-3
"""Least scale of a homogeneous point: those behind the camera are put far away in the image."""
_MARGIN = 2
"""Pixels that are read beyond the outermost ones."""
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
        """Grey crop (size, size) float32 of a frame; see `resample`."""
        to_image = np.eye(3)
        to_image[:2, :2] = np.linalg.inv(self.linear)
        to_image[:2, 2] = -to_image[:2, :2] @ self.offset
        return resample(frame, to_image, self.size, self.scale, blur)


def resample(frame: Frame, to_image: Array, size: int, scale: float, blur: float = 0.0) -> Float32:
    """Grey values (size, size) float32 of a frame; beyond its border the border repeats.

    to_image: (3, 3) homography from the pixels of the result to those of the frame; scale: pixels of the result for one
    of the frame; blur: standard deviation in pixels of the result. The cost does not depend on the size of the frame.
    """
    gray, origin, shrink = _region(frame, to_image, size, scale)
    out = np.empty((size, size), np.float32)
    _resample(gray, to_image, origin, shrink, out)
    return blurred(out, blur)


def _region(frame: Frame, to_image: Array, size: int, scale: float) -> tuple[Pixels, tuple[int, int], int]:
    """The grey pixels that `resample` needs, at least two each way, their origin in the frame, and the factor by which
    they were shrunk against aliasing."""
    x0, y0, x1, y1 = _bounds(to_image, size, frame.width, frame.height)
    region = frame.gray_part(slice(y0, y1), slice(x0, x1))
    shrink = max(int(1 / scale), 1)
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
def _bounds(to_image: Any, size: int, width: int, height: int) -> Any:
    """Left, upper, right and lower bound of the pixels of an image that a homography (3, 3) puts into (size, size), at
    least one each way."""
    left, upper, right, lower = float(width), float(height), 0.0, 0.0
    for corner in range(4):
        u, v = (size - 1.0) * (corner % 2), (size - 1.0) * (corner // 2)
        w = max(to_image[2, 0] * u + to_image[2, 1] * v + to_image[2, 2], _AHEAD)
        x = (to_image[0, 0] * u + to_image[0, 1] * v + to_image[0, 2]) / w
        y = (to_image[1, 0] * u + to_image[1, 1] * v + to_image[1, 2]) / w
        left, right = min(left, x), max(right, x)
        upper, lower = min(upper, y), max(lower, y)
    x0, y0 = int(min(max(left - _MARGIN, 0.0), width - 1.0)), int(min(max(upper - _MARGIN, 0.0), height - 1.0))
    x1, y1 = int(min(max(right + _MARGIN, 1.0), width)), int(min(max(lower + _MARGIN, 1.0), height))
    return x0, y0, max(x1, x0 + 1), max(y1, y0 + 1)


@kernel()
def _resample(gray: Any, to_image: Any, origin: Any, shrink: int, out: Any) -> None:
    """Bilinear values of grey pixels (h, w), at least two each way, into out (size, size); beyond the border the border
    repeats. to_image: (3, 3) homography from there to the pixels of an image, of which the grey ones are those from
    `origin` on, shrunk. Takes half the time of `cv2.warpPerspective`, which rounds positions to a 32nd of a pixel."""
    height, width = gray.shape
    size = out.shape[0]
    half = 0.5 * (1 - shrink)  # the middle of what becomes a pixel
    to_gray = np.empty((3, 3))
    for j in range(3):
        w = to_image[2, j]
        to_gray[0, j], to_gray[1, j] = to_image[0, j] + (half - origin[0]) * w, to_image[1, j] + (half - origin[1]) * w
        to_gray[2, j] = shrink * w
    pixels = gray.ravel()
    right, bottom, zero = np.float32(width - 1), np.float32(height - 1), np.float32(0.0)
    ahead = np.float32(_AHEAD)
    dx, dy, dw = np.float32(to_gray[0, 0]), np.float32(to_gray[1, 0]), np.float32(to_gray[2, 0])
    at, fx, fy = np.empty(size, np.int32), np.empty(size, np.float32), np.empty(size, np.float32)
    corners = np.empty((4, size), np.uint8)
    for v in range(size):
        # In three loops, as only the second one takes a pixel at a time.
        x0 = np.float32(to_gray[0, 1] * v + to_gray[0, 2])
        y0 = np.float32(to_gray[1, 1] * v + to_gray[1, 2])
        w0 = np.float32(to_gray[2, 1] * v + to_gray[2, 2])
        for u in range(size):
            scale = np.float32(1.0) / max(w0 + dw * np.float32(u), ahead)
            x, y = (x0 + dx * np.float32(u)) * scale, (y0 + dy * np.float32(u)) * scale
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
            out[v, u] = upper + fy[u] * (lower - upper)


@kernel()
def is_blank(gray: Any) -> bool:
    """Whether a grey image (h, w) shows nothing, judged by every fourth row: descriptors have unit length and would
    describe its noise."""
    total, squared, count = 0.0, 0.0, 0
    for y in range(0, gray.shape[0], 4):
        for x in range(gray.shape[1]):
            value = gray[y, x] - gray[0, 0]
            total += value
            squared += value * value
            count += 1
    mean = total / count
    return bool(squared / count - mean * mean < _BLANK * _BLANK)


def blurred(gray: Float32, sd: float) -> Float32:
    """Gaussian blur with this standard deviation in pixels; the same image for 0."""
    return np.asarray(cv2.GaussianBlur(gray, (0, 0), sd), dtype=np.float32) if sd > 0 else gray
