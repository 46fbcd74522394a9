"""How noisy a picture is, what its noise looks like at another resolution, and how sharp it is."""

from __future__ import annotations

import math

import cv2
import numpy as np

from mien.appearance.crop import blurred
from mien.arrays import Array, Float32, Pixels

_TWICE_TWICE = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
"""Second differences of second differences: zero for edges along rows and columns, and for slopes."""
_NORM = 6.0
"""Square root of the sum of its squares: by how much it multiplies the standard deviation of noise."""
_MEDIAN = 0.6745
"""Median of the absolute value of a Gaussian variable, in standard deviations."""

FINEST = 0.8
"""Standard deviation in pixels of the blur up to which detail is not looked at."""


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


def sharpness(image: Float32) -> float:
    """How much fine detail a crop (size, size) of a face, blurred by `FINEST`, shows in its middle: between blurs of
    0.8 and 1.6 pixels, relative to that between 1.6 and 3.2.

    Of faces in focus, 100 pixels wide in the crop, this is 0.47 to 0.75, whoever they are; of those that were blurred
    by 1.5 and 2.5 pixels where they were 60 pixels wide, 0.35 to 0.4 and 0.3. 1 for a blank image."""
    finer, fine = (blurred(image, FINEST * math.sqrt(k**2 - 1)) for k in (2, 4))
    margin = len(image) // 8
    middle = slice(margin, -margin)
    detail, coarser = (float(np.std((a - b)[middle, middle])) for a, b in ((image, finer), (finer, fine)))
    return detail / coarser if coarser > 1e-3 else 1.0
