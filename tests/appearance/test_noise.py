"""The noise of a picture, on pictures with a known one."""

from __future__ import annotations

import numpy as np
import pytest

from mien.appearance.noise import noise_image, noise_sd
from mien.arrays import Pixels

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
