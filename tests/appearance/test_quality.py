"""Noise and sharpness of pictures, on some with known ones."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from mien.appearance.crop import blurred
from mien.appearance.quality import noise_image, noise_sd, sharpness
from mien.arrays import Float32, Pixels

Y, X = np.mgrid[:120, :160]
PICTURE = 100 + 0.3 * X + 40 * (Y > 60) - 30 * (X > 90) + 20 * np.sin(X / 15)


def noisy(sd: float) -> Pixels:
    return np.clip(np.round(PICTURE + np.random.default_rng(0).normal(0, sd, PICTURE.shape)), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("sd", [2.0, 6.0, 20.0])
def test_its_strength_is_found_beside_edges(sd: float) -> None:
    assert noise_sd(noisy(sd)) == pytest.approx(sd, rel=0.1)


def test_a_clean_picture_has_hardly_any() -> None:
    assert noise_sd(noisy(0.0)) < 0.5
    assert noise_sd(noisy(20.0)[:2]) == 0


@pytest.mark.parametrize(("scale", "sd"), [(0.5, 5.0), (1.0, 10.0), (3.0, 6.7)])
def test_at_another_resolution_it_is_weaker(scale: float, sd: float) -> None:
    """The mean of four pixels, as it is, and between two pixels in each direction: two thirds on average."""
    noise = noise_image(10.0, 240, scale, np.random.default_rng(0))
    assert noise.shape == (240, 240)
    assert noise.std() == pytest.approx(sd, rel=0.05)


def _crop(blur: float, contrast: float = 1.0) -> Float32:
    """A picture with detail of every size, as a crop that was blurred by 0.8 pixels."""
    rng = np.random.default_rng(0)
    sizes = (cv2.GaussianBlur(rng.normal(0, 1, (112, 112)), (0, 0), sd) * sd for sd in (0.5, 1, 2, 4, 8))
    picture = 128 + 20 * contrast * sum(sizes)
    return blurred(np.asarray(picture, np.float32), math.hypot(blur, 0.8))


def test_a_picture_out_of_focus_is_less_sharp_at_any_contrast() -> None:
    found = [sharpness(_crop(blur)) for blur in (0.0, 1.0, 2.0, 4.0)]
    assert found == sorted(found, reverse=True)
    assert found[0] > 1.5 * found[2]
    assert sharpness(_crop(0.0, 0.2)) == pytest.approx(found[0], rel=1e-3)


def test_a_blank_picture_is_not_out_of_focus() -> None:
    assert sharpness(np.full((112, 112), 7, np.float32)) == 1
