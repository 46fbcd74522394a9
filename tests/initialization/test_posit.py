"""POSIT: the pose of exact projections, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from mien.arrays import Array
from mien.candide.model import Candide
from mien.errors import MienError
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING
from mien.initialization.landmarks import VERTICES
from mien.initialization.posit import posit
from strategies import cameras, head_rotations, head_translations

FACE = Candide.default().mean[VERTICES]
CAMERA = Camera(280, 159.5, 119.5)


def _image(model: Array, R: Array, t: Array, camera: Camera = CAMERA) -> Array:
    return camera.project(model @ R.T + t)[0]


@given(head_rotations(60), head_translations(), cameras())
def test_projected_poses_are_recovered(R: Array, t: Array, camera: Camera) -> None:
    R_found, t_found = posit(FACE, _image(FACE, R, t, camera), camera)
    np.testing.assert_allclose(R_found, R, atol=1e-6)
    np.testing.assert_allclose(t_found, t, atol=1e-6)


def test_four_points_are_enough() -> None:
    """The corner of a cube, two sides of it in front of the camera, by hand: frontal, at (1, -1, 10)."""
    corner = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    t = np.array([1.0, -1, 10])
    R_found, t_found = posit(corner, _image(corner, FACING, t), CAMERA)
    np.testing.assert_allclose(R_found, FACING, atol=1e-6)
    np.testing.assert_allclose(t_found, t, atol=1e-6)


def test_it_gives_a_rotation_for_noisy_points_too() -> None:
    rng = np.random.default_rng(0)
    R, t = posit(FACE, _image(FACE, FACING, np.array([0.0, 0, 6])) + rng.normal(0, 2, (len(FACE), 2)), CAMERA)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(R) == pytest.approx(1)
    assert t[2] == pytest.approx(6, rel=0.1)


def test_three_points_are_refused() -> None:
    with pytest.raises(MienError, match="four points or more, not 3"):
        posit(FACE[:3], np.zeros((3, 2)), CAMERA)


@pytest.mark.parametrize("normal", [[0.0, 0, 1], [1, 2, 3]])
def test_points_in_one_plane_are_refused(normal: list[float]) -> None:
    n = np.array(normal) / np.linalg.norm(normal)
    flat = FACE - (FACE @ n)[:, None] * n
    with pytest.raises(MienError, match="one plane"):
        posit(flat, _image(FACE, FACING, np.array([0.0, 0, 6])), CAMERA)
