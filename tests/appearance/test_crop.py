"""The crop: where its pixels come from, at every scale and angle, and beyond the edge of the image."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates

from mien.appearance.crop import Crop, blurred
from mien.arrays import Array, Pixels
from mien.frame import Frame
from strategies import vectors

HEIGHT, WIDTH = 72, 96
SLOPE = 2.6431  # not a simple fraction, so that errors of rounding even out


def _frame(gray: Pixels) -> Frame:
    return Frame(np.repeat(gray[..., None], 3, axis=2))


def _ramp(axis: int) -> Pixels:
    """Grey values that are the column (axis 0) or the row (axis 1) times SLOPE."""
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    return np.round(SLOPE * (u, v)[axis]).astype(np.uint8)


def _both(axis: int) -> tuple[Frame, Frame]:
    return _frame(_ramp(axis)), _frame(255 - _ramp(axis))


def _pixels(crop: Crop) -> Array:
    """Image points (size, size, 2) of all pixels of a crop."""
    v, u = np.mgrid[: crop.size, : crop.size].astype(float)
    return _to_image(crop, np.stack([u, v], axis=-1))


def _to_image(crop: Crop, q: Array) -> Array:
    """(..., 2) crop pixels -> (..., 2) image pixels."""
    return np.asarray((q - crop.offset) @ np.linalg.inv(crop.linear).T)


def _misplaced(crop: Crop, margin: float = 3) -> Array:
    """How far the crops of two ramps, along u and v, are from where they should be: mean (2,) in pixels.

    Half the difference of a rising and a falling ramp, since rounding to 8 bits brightens both a little.
    """
    p = _pixels(crop)
    inside = ((p > margin) & (p < np.array([WIDTH, HEIGHT]) - 1 - margin)).all(axis=-1)
    assert inside.any()
    rising, falling = ([crop.sample(image) for image in images] for images in zip(*map(_both, (0, 1)), strict=True))
    read = [(up - down + 255) / 2 / SLOPE for up, down in zip(rising, falling, strict=True)]
    return np.array([(read[axis] - p[..., axis])[inside].mean() for axis in (0, 1)])


crops = st.builds(
    Crop,
    st.tuples(st.floats(0, WIDTH), st.floats(0, HEIGHT)),
    st.floats(0.1, 4),
    st.floats(-np.pi, np.pi),
    st.integers(16, 200),
)


@given(crops, vectors(-50, 400, size=2))
def test_to_crop_is_an_affine_map_about_the_centre(crop: Crop, p: Array) -> None:
    np.testing.assert_allclose(_to_image(crop, crop.to_crop(p)), p, atol=1e-9)
    np.testing.assert_allclose(crop.to_crop(np.array(crop.centre)), 0.5 * (crop.size - 1), atol=1e-9)


def test_the_angle_is_that_of_the_crops_axis_in_the_image() -> None:
    """A quarter turn: the crop's u runs down the image, its v to the left."""
    crop = Crop((100, 50), 2.0, np.pi / 2, 21)
    np.testing.assert_allclose(crop.to_crop(np.array([[100.0, 51], [99, 50]])), [[12, 10], [10, 12]], atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 0.4, -1.2, 3.0])
@pytest.mark.parametrize("scale", [0.3, 0.5, 0.9, 1.0, 2.5])
def test_a_ramp_stays_a_ramp(scale: float, angle: float) -> None:
    np.testing.assert_allclose(_misplaced(Crop((45.3, 36.8), scale, angle, 30)), 0, atol=0.12)


@pytest.mark.parametrize("centre", [(3.0, 4.0), (92.0, 36.0), (40.0, 70.0), (-6.0, 30.0), (99.0, 75.0)])
@pytest.mark.parametrize("scale", [0.4, 1.3])
def test_near_the_edge_a_ramp_stays_a_ramp(centre: tuple[float, float], scale: float) -> None:
    np.testing.assert_allclose(_misplaced(Crop(centre, scale, 0.3, 50)), 0, atol=0.12)


@pytest.mark.parametrize("size", [(HEIGHT, WIDTH), (2, 2), (1, 40), (40, 1), (1, 1)])
@pytest.mark.parametrize("centre", [(30.2, 20.7), (0.0, 1.0), (-3.3, 60.1), (500.0, -400.0)])
@pytest.mark.parametrize("scale", [1.0, 2.7])
def test_values_are_bilinear(size: tuple[int, int], centre: tuple[float, float], scale: float) -> None:
    gray = np.random.default_rng(0).integers(0, 256, size).astype(np.uint8)
    crop = Crop(centre, scale, -0.7, 64)
    u, v = np.moveaxis(_pixels(crop), -1, 0)
    expected = map_coordinates(gray.astype(float), [v, u], order=1, mode="nearest")
    np.testing.assert_allclose(crop.sample(_frame(gray)), expected, atol=0.02)


def test_beyond_the_edge_the_edge_repeats() -> None:
    crop = Crop((0.0, 36.0), 1.0, 0.0, 41)
    sample = crop.sample(_frame(_ramp(1)))
    for column in range(20):
        np.testing.assert_allclose(sample[:, column], sample[:, 20], atol=1)


@pytest.mark.parametrize("centre", [(-500.0, 100.0), (900.0, 100.0), (100.0, -900.0), (100.0, 5000.0)])
@pytest.mark.parametrize("scale", [0.2, 2.0])
def test_a_crop_beside_the_image_shows_the_nearest_of_its_edge(centre: tuple[float, float], scale: float) -> None:
    crop = Crop(centre, scale, 0.2, 32)
    row = np.clip(_pixels(crop)[..., 1], 0, HEIGHT - 1)
    np.testing.assert_allclose(crop.sample(_frame(_ramp(1))), SLOPE * row, atol=1)


def test_shrinking_does_not_alias() -> None:
    """A pattern of single pixels becomes its mean."""
    stripes = np.zeros((HEIGHT, WIDTH), np.uint8)
    stripes[:, ::2] = 200
    sample = Crop((48, 36), 0.25, 0.0, 16).sample(_frame(stripes))
    np.testing.assert_allclose(sample[2:-2, 2:-2], 100, atol=2)


def test_colours_become_luminance() -> None:
    pixels = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    pixels[..., 1] = 100
    np.testing.assert_allclose(Crop((48, 36), 1.0, 0.0, 20).sample(Frame(pixels)), 59, atol=1)


def test_blur() -> None:
    gray = np.zeros((21, 21), np.float32)
    gray[10, 10] = 1
    assert blurred(gray, 0) is gray
    smooth = blurred(gray, 1.5)
    assert smooth.sum() == pytest.approx(1, rel=1e-3)
    u = np.arange(21) - 10
    assert (smooth * u**2).sum() == pytest.approx(1.5**2, rel=0.05)
