"""The noise of a picture: how strong it is, and what it looks like at another resolution."""

from __future__ import annotations

import cv2
import numpy as np

from mien.arrays import Array, Float32, Pixels

_TWICE_TWICE = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
"""Second differences of second differences: zero for edges along rows and columns, and for slopes."""
_NORM = 6.0
_MEDIAN = 0.6745
"""Median of the absolute value of a Gaussian variable, in standard deviations."""


def noise_sd(gray: Pixels) -> float:
    """Standard deviation of the noise of grey values (h, w), as it shows where the picture is smooth.

    J. Immerkaer, Fast noise variance estimation, CVIU 64, 1996, with the median for the mean, which edges would
    raise."""
    if min(gray.shape) < 3:
        return 0.0
    found = cv2.filter2D(gray, cv2.CV_32F, _TWICE_TWICE)[1:-1, 1:-1]
    return float(np.median(np.abs(found))) / (_NORM * _MEDIAN)


def noise_image(sd: float, size: int, scale: float, rng: np.random.Generator) -> Float32:
    """Noise with this standard deviation in each pixel of a picture, as it is seen at `scale` times the picture's
    resolution: (size, size)."""
    side = max(round(size / scale), 1)
    noise: Array = rng.normal(0.0, sd, (side, side))
    how = cv2.INTER_LINEAR if scale >= 1 else cv2.INTER_AREA
    return np.asarray(cv2.resize(noise.astype(np.float32), (size, size), interpolation=how), np.float32)
