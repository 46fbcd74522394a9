"""Our SIFT kernel: OpenCV's descriptor, its own derivative, what light does not change."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pytest

from mien.appearance.crop import blurred
from mien.appearance.descriptors import (
    LENGTH,
    ORIENTATIONS,
    describe,
    describe_into,
    describe_with_jacobian,
    describe_with_opencv,
    orientation_maps,
)
from mien.arrays import Array, Float32
from mien.synthetic import make_sequence, moved
from small_motion import face

CELLS = range(3, 9)
OPENCV_BLUR = 1.52
"""Standard deviation of the Gaussian, in pixels, with which OpenCV prepares an image for its first octave."""


@cache
def _image(name: str) -> tuple[Float32, Array]:
    """Grey picture and landmarks (n, 2) on pixels: OpenCV reads at the nearest one."""
    if name == "photograph":
        return face().frame.gray.astype(np.float32), np.round(face().landmarks.correspondences()[1])
    states = moved(face(), np.array([[8.0, -20, 10]]), np.zeros((1, 3)), np.zeros((1, 6)))
    sequence = make_sequence(face(), states)
    return sequence.frames[0].gray.astype(np.float32), np.round(sequence.landmarks[0])


def _smooth(seed: int = 0, size: int = 80) -> Float32:
    noise = np.random.default_rng(seed).uniform(0, 255, (size, size)).astype(np.float32)
    image = blurred(noise, 2.0)
    return (image - image.min()) * (255 / np.ptp(image))


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("name", ["photograph", "rendered"])
def test_the_kernel_gives_the_descriptor_of_opencv(name: str, cell: int) -> None:
    gray, points = _image(name)
    ours = describe(orientation_maps(blurred(gray, OPENCV_BLUR), cell), points, cell)
    theirs = describe_with_opencv(gray, points, cell)
    cosine = (ours * theirs).sum(axis=1)
    assert len(cosine) >= 26
    assert cosine.min() > 0.99


def test_descriptors_have_length_one_and_no_entry_far_above_the_clip() -> None:
    gray, points = _image("photograph")
    for descriptors in (describe(orientation_maps(gray, 5), points, 5), describe_with_opencv(gray, points, 5)):
        assert descriptors.shape == (len(points), LENGTH)
        np.testing.assert_allclose(np.linalg.norm(descriptors, axis=1), 1, rtol=1e-5)
        assert descriptors.min() > -1e-5  # running sums leave a little less than nothing
        assert descriptors.max() < 0.4


@pytest.mark.parametrize("orientation", range(ORIENTATIONS))
def test_a_ramp_has_one_orientation(orientation: int) -> None:
    """Grey values that grow in a direction of `orientation` eighths of a turn, from u to v."""
    angle = orientation * np.pi / 4
    v, u = np.mgrid[:64, :64]
    gray = (np.cos(angle) * u + np.sin(angle) * v).astype(np.float32)
    maps = orientation_maps(gray, 4)
    expected = np.zeros(ORIENTATIONS)
    expected[orientation] = 2  # the difference of neighbours at a distance of two
    np.testing.assert_allclose(maps[32, 32], expected, atol=2e-3)


def test_between_two_orientations_the_gradient_is_shared() -> None:
    angle = np.radians(1.25 * 45)
    v, u = np.mgrid[:64, :64]
    maps = orientation_maps((np.cos(angle) * u + np.sin(angle) * v).astype(np.float32), 3)
    np.testing.assert_allclose(maps[32, 32, :3], [0, 1.5, 0.5], atol=2e-3)


@pytest.mark.parametrize("cell", [1, 2, 3, 4, 7])
def test_the_smoothing_is_a_triangle(cell: int) -> None:
    """A single edge: the gradient at two columns becomes the sum of two triangles of half width `cell`."""
    gray = np.zeros((64, 64), np.float32)
    gray[:, 32:] = 1
    profile = orientation_maps(gray, cell)[32, :, 0]
    u = np.arange(64)
    triangle = np.maximum(1 - np.abs(u[None] - np.array([[31], [32]])) / cell, 0) / cell
    np.testing.assert_allclose(profile, triangle.sum(axis=0), atol=1e-6)


@pytest.mark.parametrize(("cell", "shape"), [(4, (20, 31)), (5, (6, 9))])
def test_beyond_the_edges_is_nothing(cell: int, shape: tuple[int, int]) -> None:
    gray = np.random.default_rng(0).uniform(0, 255, shape).astype(np.float32)
    triangle = (cell - np.abs(np.arange(1 - cell, cell))) / cell**2
    smooth = cv2.sepFilter2D(orientation_maps(gray, 1), -1, triangle, triangle, borderType=cv2.BORDER_CONSTANT)
    np.testing.assert_allclose(orientation_maps(gray, cell), smooth, atol=1e-4)


@pytest.mark.parametrize("root", [0.0, 0.01])
@pytest.mark.parametrize("cell", [3, 4, 6])
def test_jacobian_against_differences(cell: int, root: float) -> None:
    """Within a pixel a descriptor is smooth but for the clip at 0.2, so that single entries may differ."""
    maps = orientation_maps(_smooth(), cell)
    rng = np.random.default_rng(1)
    # No sample of the grid may come to lie on a whole pixel, where the derivative jumps.
    points = np.floor(rng.uniform(25, 55, (40, 2))) + rng.uniform(0.2, 0.3, (40, 2))
    value, J = describe_with_jacobian(maps, points, cell, root)
    np.testing.assert_allclose(value, describe(maps, points, cell, root), atol=1e-6)
    step = 0.01
    for axis in range(2):
        shift = step * np.eye(2)[axis]
        ahead, behind = (describe(maps, points + sign * shift, cell, root) for sign in (1, -1))
        difference = (ahead - behind) / (2 * step)
        error = np.linalg.norm(J[:, axis] - difference, axis=1) / np.linalg.norm(difference, axis=1)
        assert np.median(error) < 0.005
        assert error.max() < 0.2


def _stretched(maps: Float32, points: Array, still: Array, follows: Array) -> tuple[Float32, Float32]:
    """Descriptors (n, 128), and their derivative (n, 2, 128), where each cell follows a share of what moves its
    point."""
    value, J = np.empty((len(points), LENGTH), np.float32), np.empty((len(points), 2, LENGTH), np.float32)
    describe_into(maps, points, (4, 0.01, 0.0, 1.0), value, J, (still, follows))
    return value, J


def test_cells_that_follow_a_part_of_the_motion_see_a_stretched_image_as_it_was() -> None:
    """A point is moved, and what is beside it the less, the further away it is, up to 20 pixels."""
    image, still, there = _smooth(), np.array([[40.0, 40.0]]), np.array([[43.0, 40.0]])
    v, u = np.mgrid[:80, :80].astype(np.float32)
    source = u
    for _ in range(20):  # a point of the stretched image comes from where it is, less how far that was moved
        source = u - 3 * np.clip(1 - np.abs(source - 40) / 20, 0, 1)
    after = cv2.remap(image, source, v, cv2.INTER_CUBIC)
    right = np.tile(4 * (np.arange(4) - 1.5), 4)
    follows = (1 - np.abs(right) / 20)[None]
    expected = describe(orientation_maps(image, 4), still, 4, 0.01)
    seen = orientation_maps(after, 4)
    rigid = describe(seen, there, 4, 0.01)
    stretched, _ = _stretched(seen, there, still, follows)
    errors = [np.linalg.norm(value - expected) for value in (rigid, stretched)]
    assert errors[1] < 0.6 * errors[0]


def test_jacobian_of_cells_that_follow_against_differences() -> None:
    maps, rng = orientation_maps(_smooth(), 4), np.random.default_rng(2)
    points, still = rng.uniform(25, 55, (2, 40, 2))
    follows, step = rng.uniform(0, 1, (40, 16)), 0.01
    still = points + 0.1 * (still - points)
    _, J = _stretched(maps, points, still, follows)
    for axis in range(2):
        shift = step * np.eye(2)[axis]
        ahead, behind = (_stretched(maps, points + sign * shift, still, follows)[0] for sign in (1, -1))
        difference = (ahead - behind) / (2 * step)
        error = np.linalg.norm(J[:, axis] - difference, axis=1) / np.linalg.norm(difference, axis=1)
        assert np.median(error) < 0.01


@pytest.mark.parametrize(("gain", "offset"), [(0.5, 0), (1.6, 0), (1, 40), (0.4, 90)])
def test_gain_and_offset_change_nothing(gain: float, offset: float) -> None:
    gray, points = _image("photograph")
    before = describe(orientation_maps(gray, 4), points, 4)
    after = describe(orientation_maps(np.float32(gain) * gray + np.float32(offset), 4), points, 4)
    np.testing.assert_allclose(after, before, atol=1e-4)


def test_a_shift_of_the_image_is_a_shift_of_the_point() -> None:
    gray, points = _image("photograph")
    shifted = np.roll(gray, (3, -5), axis=(0, 1))
    before = describe(orientation_maps(gray, 4), points, 4)
    np.testing.assert_allclose(describe(orientation_maps(shifted, 4), points + np.array([-5, 3]), 4), before, atol=1e-5)


@pytest.mark.parametrize(("turn_deg", "scale"), [(3, 1.0), (-3, 1.0), (20, 1.0), (170, 1.0), (0, 1.04), (-2, 0.97)])
def test_a_grid_that_turns_with_the_image_sees_the_same(turn_deg: float, scale: float) -> None:
    """But for what resampling the image changes, and that the smoothing does not grow with the grid."""
    gray, points = _image("photograph")
    gray, middle = blurred(gray, 1.5), points.mean(axis=0)
    angle = np.radians(turn_deg)
    linear = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    moved_image = cv2.warpAffine(
        gray, np.column_stack([linear, middle - linear @ middle]), gray.shape[::-1], flags=cv2.INTER_CUBIC
    )
    there = (points - middle) @ linear.T + middle
    before = describe(orientation_maps(gray, 6), points, 6, 0.01)
    turned = describe(orientation_maps(moved_image, 6, angle), there, 6, 0.01, angle, scale)
    assert np.median(np.linalg.norm(turned - before, axis=1)) < 0.03  # by half a degree more it would be 0.02 more


def test_a_flat_image_has_no_descriptor_and_no_derivative() -> None:
    maps = orientation_maps(np.full((50, 50), 77, np.float32), 4)
    value, J = describe_with_jacobian(maps, np.array([[25.0, 25.0]]), 4)
    np.testing.assert_array_equal(value, 0)
    np.testing.assert_array_equal(J, 0)


POINTS_OUTSIDE: Array = np.array([[-100.0, 20], [20, -1e6], [1e6, 1e6], [79, 79], [0, 0]])


def test_points_outside_the_image_read_its_edge() -> None:
    gray = _smooth()
    maps = orientation_maps(gray, 4)
    inside = np.clip(POINTS_OUTSIDE, -10, 90)
    np.testing.assert_allclose(describe(maps, POINTS_OUTSIDE, 4), describe(maps, inside, 4), atol=1e-6)
    value, J = describe_with_jacobian(maps, POINTS_OUTSIDE, 4)
    assert np.isfinite(value).all()
    assert np.isfinite(J).all()
    assert np.isfinite(describe_with_opencv(gray, POINTS_OUTSIDE, 4)).all()


def test_the_root_measures_the_distance_of_hellinger() -> None:
    """Where nothing is clipped: entries are square roots of the plain ones, scaled to unit length."""
    maps = orientation_maps(_smooth(), 4)
    points = np.array([[30.3, 40.7], [50.1, 33.3]])
    plain, rooted = describe(maps, points, 4).astype(float), describe(maps, points, 4, 1e-6)
    plain[(plain < 0.01) | (plain > 0.19)] = np.nan  # too small to compare, or touched by the clip
    ratio = rooted**2 / plain
    np.testing.assert_allclose(np.nanmax(ratio, axis=1), np.nanmin(ratio, axis=1), rtol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(rooted, axis=1), 1, rtol=1e-5)
