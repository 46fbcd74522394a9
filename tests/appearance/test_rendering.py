"""The renderer against triangles worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from mien.appearance.rendering import Texture, depth_buffer, render, vertex_normals
from mien.arrays import Array, Float32
from mien.geometry.camera import Camera

CAMERA = Camera(10, 0, 0)
FRONT = np.array([[0, 1, 2]])
"""Counter-clockwise seen from the camera, where v points down: (0, 0), then below it, then right of it."""


def _lifted(points: list[tuple[float, float]], z: list[float]) -> Array:
    """Camera points (n, 3) that CAMERA sees at these pixels at these depths."""
    return np.array([(u * d / 10, v * d / 10, d) for (u, v), d in zip(points, z, strict=True)])


def _ramp(width: int = 9, height: int = 9) -> Float32:
    """Texture whose first channel is its u and whose second its v."""
    v, u = np.mgrid[:height, :width].astype(np.float32)
    return np.stack([u, v], axis=2)


def test_coverage_is_the_triangle_with_its_edges() -> None:
    """Pixel centres in or on the triangle (0, 0), (0, 4), (4, 0): u + v <= 4, fifteen of them."""
    X = _lifted([(0, 0), (0, 4), (4, 0)], [2, 2, 2])
    drawn = render(X, FRONT, Texture(np.full((1, 1, 1), 7, np.float32), np.zeros((3, 2))), CAMERA, 8, 6, background=1)
    v, u = np.mgrid[:6, :8]
    np.testing.assert_array_equal(np.isfinite(drawn.depth), u + v <= 4)
    np.testing.assert_array_equal(drawn.image[..., 0], np.where(u + v <= 4, 7, 1))
    np.testing.assert_allclose(drawn.depth[np.isfinite(drawn.depth)], 2)


@pytest.mark.parametrize("tip", [0.0, 1e-300, -1e-300, 1e-18])
def test_an_edge_that_is_all_but_level(tip: float) -> None:
    X = _lifted([(1, 1), (1, 3), (5, 1)], [2, 2, 2])
    X[2, 1] += tip
    drawn = render(X, FRONT, Texture(np.full((1, 1, 1), 7, np.float32), np.zeros((3, 2))), CAMERA, 8, 6)
    v, u = np.mgrid[:6, :8]
    np.testing.assert_array_equal(np.isfinite(drawn.depth), (u >= 1) & (v >= 1) & (u - 1 + 2 * (v - 1) <= 4))


@pytest.mark.parametrize("seed", range(5))
def test_coverage_of_random_triangles(seed: int) -> None:
    """Where all three edges have the pixel on their inner side."""
    corners = np.random.default_rng(seed).uniform(-3, 11, (3, 2))
    (ax, ay), (bx, by), (cx, cy) = corners
    if (bx - ax) * (cy - ay) > (cx - ax) * (by - ay):  # faces away
        corners = corners[::-1]
    drawn = depth_buffer(_lifted([tuple(c) for c in corners], [2, 2, 2]), FRONT, CAMERA, 8, 6)
    v, u = np.mgrid[:6, :8]
    edges = zip(corners, np.roll(corners, -1, axis=0) - corners, strict=True)
    sides = [along[0] * (v - a[1]) - along[1] * (u - a[0]) for a, along in edges]
    np.testing.assert_array_equal(np.isfinite(drawn), np.max(sides, axis=0) <= 0)


def test_interpolation_is_correct_in_perspective() -> None:
    """Corners at depths 1, 1, 2 and u of the texture 0, 0, 8. Half way in the image from the first to the last
    1/Z is 3/4, so Z = 4/3, and u = (1/2 * 8 / 2) * 4/3 = 8/3, where a linear map would give 4."""
    X = _lifted([(0, 0), (0, 4), (4, 0)], [1, 1, 2])
    uv = np.array([[0.0, 0], [0, 8], [8, 0]])
    drawn = render(X, FRONT, Texture(_ramp(), uv), CAMERA, 8, 6)
    assert drawn.depth[0, 2] == pytest.approx(4 / 3)
    np.testing.assert_allclose(drawn.image[0, 2], [8 / 3, 0], rtol=1e-6)
    # In the middle of the far edge, (2, 2): weights 1/2 of the corners at depths 1 and 2.
    np.testing.assert_allclose(drawn.image[2, 2], [4 / 2 * 4 / 3, 4 / 1 * 4 / 3], rtol=1e-6)


def test_the_texture_is_read_between_its_pixels() -> None:
    image = np.array([[[0.0], [4]], [[8], [20]]], np.float32)
    X = _lifted([(0, 0), (0, 4), (4, 0)], [1, 1, 1])
    drawn = render(X, FRONT, Texture(image, np.full((3, 2), [0.25, 0.5])), CAMERA, 8, 6)
    assert drawn.image[1, 1, 0] == pytest.approx(0.5 * (0.75 * 0 + 0.25 * 4) + 0.5 * (0.75 * 8 + 0.25 * 20))


def test_light_falls_on_a_second_image() -> None:
    """Lights of 1, 1 and 3 at the corners, so 2 half way to the last; the first image is the texture alone."""
    X = _lifted([(0, 0), (0, 4), (4, 0)], [1, 1, 1])
    texture = Texture(np.full((1, 1, 1), 7, np.float32), np.zeros((3, 2)))
    drawn = render(X, FRONT, texture, CAMERA, 8, 6, background=5, light=np.array([1.0, 1, 3]))
    assert (drawn.image[0, 2, 0], drawn.lit[0, 2, 0]) == (7, 14)
    assert (drawn.image[5, 7, 0], drawn.lit[5, 7, 0]) == (5, 5)
    assert render(X, FRONT, texture, CAMERA, 8, 6).lit[0, 2, 0] == 7


def test_what_faces_away_is_not_drawn() -> None:
    X = _lifted([(0, 0), (0, 4), (4, 0)], [2, 2, 2])
    assert np.isinf(depth_buffer(X, FRONT[:, ::-1], CAMERA, 8, 6)).all()


def test_what_is_behind_the_camera_is_not_drawn() -> None:
    X = _lifted([(0, 0), (0, 4), (4, 0)], [2, 2, -2])
    assert np.isinf(depth_buffer(X, FRONT, CAMERA, 8, 6)).all()
    assert np.isinf(depth_buffer(X, FRONT[:, ::-1], CAMERA, 8, 6)).all()


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
def test_the_nearer_surface_hides_the_other(order: list[int]) -> None:
    corners: list[tuple[float, float]] = [(0, 0), (0, 4), (4, 0)]
    X = np.vstack([_lifted(corners, [2, 2, 2]), _lifted([(0, 0), (0, 2), (2, 0)], [1, 1, 1])])
    triangles = np.array([[0, 1, 2], [3, 4, 5]])[order]
    image = np.array([[[10.0], [20]]], np.float32)
    uv = np.array([[0.0, 0]] * 3 + [[1.0, 0]] * 3)
    drawn = render(X, triangles, Texture(image, uv), CAMERA, 8, 6)
    assert drawn.image[1, 1, 0] == 20
    assert drawn.image[1, 3, 0] == 10
    assert drawn.depth[1, 1] == 1


def test_only_what_is_in_the_image_is_drawn() -> None:
    """A triangle that holds the whole image and reaches far beyond it."""
    X = _lifted([(-100, -100), (-100, 300), (300, -100)], [2, 2, 2])
    assert (depth_buffer(X, FRONT, CAMERA, 8, 6) == 2).all()


def test_normals_are_weighted_by_area() -> None:
    """Around the first vertex a surface of area 1 with normal z and one of area 2 with normal x."""
    X = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 2], [9, 9, 9]])
    normals = vertex_normals(X, np.array([[0, 1, 2], [0, 2, 3]]))
    np.testing.assert_allclose(normals[0], np.array([2, 0, 1]) / np.sqrt(5))
    np.testing.assert_allclose(normals[1], [0, 0, 1])
    np.testing.assert_allclose(normals[3], [1, 0, 0])
    np.testing.assert_array_equal(normals[4], 0)
