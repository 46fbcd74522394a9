"""Lenses that bend straight lines."""

from __future__ import annotations

import numpy as np
import pytest

from mien.arrays import Array
from mien.lens import Lens
from videos import bent, gradient

K = ((80.0, 0.0, 31.5), (0.0, 80.0, 23.5), (0.0, 0.0, 1.0))


@pytest.mark.parametrize("dist_coeffs", [(-0.4, 0.1, 0.0, 0.0), (0.2, 0.0, 0.01, -0.02, 0.0), ()])
@pytest.mark.parametrize("skew", [0.0, 4.0])
def test_what_a_lens_has_bent_becomes_straight(dist_coeffs: tuple[float, ...], skew: float) -> None:
    """In an image without detail, but for its border, which a lens may not show."""
    lens = Lens(((80.0, skew, 31.5), (0.0, 84.0, 23.5), (0.0, 0.0, 1.0)), dist_coeffs)
    image = gradient(3)
    inside = (slice(6, -6), slice(8, -8))
    straight = lens.straighten(bent(image, lens))
    assert np.abs(straight[inside].astype(int) - image[inside]).max() <= 2
    assert np.abs(bent(image, lens)[inside].astype(int) - image[inside]).max() > 2
    np.testing.assert_array_equal(lens.straighten(image[..., 0]), lens.straighten(image)[..., 0])


def test_a_fisheye_shows_angles_as_distances() -> None:
    """Also without coefficients; what becomes straight is as with them."""
    lens = Lens(K, (), fisheye=True)
    tangent = np.hypot(31.5, 23.5) / 80
    assert lens.bending == pytest.approx(1 - np.arctan(tangent) / tangent)
    assert lens.shown_share == 1
    for coefficients in ((), (-0.1, 0.05, 0.0, 0.0)):
        lens = Lens(K, coefficients, fisheye=True)
        straight = lens.straighten(bent(gradient(3), lens))
        inside = (slice(6, -6), slice(8, -8))
        assert np.abs(straight[inside].astype(int) - gradient(3)[inside]).max() <= 2


def test_the_middle_keeps_its_place_and_size() -> None:
    matrix: Array = Lens(((80.0, 0.0, 31.0), (0.0, 84.0, 23.0), (0.0, 0.0, 1.0)), ()).straight_matrix
    np.testing.assert_array_equal(matrix, [[82, 0, 31], [0, 82, 23], [0, 0, 1]])


def test_bending_is_that_of_the_corners() -> None:
    corner = (31.5**2 + 23.5**2) / 80**2  # squared tangent of their angle
    assert Lens(K, (-0.4, 0.0, 0.0, 0.0)).bending == pytest.approx(0.4 * corner)
    assert Lens(K, ()).bending == 0


def test_what_is_too_far_out_for_its_polynomial_is_black() -> None:
    """It would turn back, and show the image once more."""
    lens = Lens(K, (-2.5, 0.0, 0.0, 0.0))  # its radius is greatest at a tangent of 0.365
    straight = lens.straighten(np.full((48, 64), 200, np.uint8))
    rows, columns = np.mgrid[:48, :64]
    tangent = np.hypot(columns - 31.5, rows - 23.5) / 80
    assert (straight[tangent < 0.34] == 200).all()
    assert (straight[tangent > 0.39] == 0).all()
    assert lens.shown_share == pytest.approx((tangent < 0.365).mean(), abs=0.03)
