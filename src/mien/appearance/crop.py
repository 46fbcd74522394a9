"""The part of an image that holds the face, resampled to a fixed size of the face."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from mien.geometry.rotation import Array
from mien.video import Frame, Pixels

Float32 = NDArray[np.float32]

_BLANK = 1.0
"""Standard deviation of grey values below which an image shows nothing but the noise of a camera."""


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

    def to_crop(self, p: Array) -> Array:
        """(..., 2) image pixels -> (..., 2) crop pixels."""
        return np.asarray((p - np.array(self.centre)) @ self.linear.T + 0.5 * (self.size - 1))

    def to_image(self, q: Array) -> Array:
        """(..., 2) crop pixels -> (..., 2) image pixels."""
        inverse = np.linalg.inv(self.linear)
        return np.asarray((q - 0.5 * (self.size - 1)) @ inverse.T + np.array(self.centre))

    def sample(self, frame: Frame, blur: float = 0.0) -> Float32:
        """Grey crop (size, size) float32 of a frame; beyond its edge the edge repeats.

        Costs what the crop costs, whatever the size of the frame.
        """
        gray, offset, shrink = self._region(frame)
        A = np.empty((2, 3))
        A[:, :2] = self.linear * shrink
        A[:, 2] = 0.5 * (self.size - 1) - self.linear @ (np.array(self.centre) - offset - 0.5 * (shrink - 1))
        crop = cv2.warpAffine(gray, A, (self.size, self.size), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return blurred(crop.astype(np.float32), blur)

    def _region(self, frame: Frame) -> tuple[Pixels, Array, int]:
        """The grey pixels that the crop needs, where they begin, and by how much they were shrunk against aliasing."""
        size = frame.width, frame.height
        reach = int(0.71 * self.size / self.scale) + 3
        x0, y0 = (int(min(max(c - reach, 0), n - 1)) for c, n in zip(self.centre, size, strict=True))
        x1, y1 = (int(min(max(c + reach, 1), n)) for c, n in zip(self.centre, size, strict=True))
        region = frame.gray_part(slice(y0, max(y1, y0 + 1)), slice(x0, max(x1, x0 + 1)))
        shrink = max(int(1 / self.scale), 1)
        if shrink > 1 and min(region.shape[:2]) >= shrink:
            h, w = region.shape[0] // shrink, region.shape[1] // shrink
            part = region[: h * shrink, : w * shrink]
            region = np.asarray(cv2.resize(part, (w, h), interpolation=cv2.INTER_AREA), np.uint8)
        else:
            shrink = 1
        return region, np.array([x0, y0], dtype=float), shrink


def is_blank(gray: Float32) -> bool:
    """Whether nothing is to be seen in an image, by every fourth row: descriptors have unit length and would describe
    its noise."""
    return float(cv2.meanStdDev(gray[::4])[1][0, 0]) < _BLANK


def blurred(gray: Float32, sd: float) -> Float32:
    """Gaussian blur with this standard deviation in pixels; the same image for 0."""
    return np.asarray(cv2.GaussianBlur(gray, (0, 0), sd), dtype=np.float32) if sd > 0 else gray
