"""Rotations, landmarks at a pose and their projections: against NumPy, and Jacobians against differences."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mien.appearance.views import rotation, tilt_pan_of
from mien.arrays import Array
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING, exp, log, ray_rotation
from mien.tracking.realtime import pose_geometry
from strategies import random_person, random_pose, rotation_vectors, rotations, stepped, vectors

CAMERA = np.array([280.0, 159.5, 119.5])
PROJECTION = np.array([[252.0, 84.0, 90.0], [-84.0, 252.0, 75.0], [0.3, -0.2, 0.9]])
"""From camera axes to a crop that looks aside."""
ANGLES = st.floats(-1.2, 1.2)
FEW = settings(max_examples=40)


@pytest.mark.parametrize("seed", range(4))
def test_visible_faces_the_camera_inside_the_image(seed: int) -> None:
    R, t, a = random_pose(seed)
    neutral, units = random_person(seed, 200)
    t = t - [0, 0, 2.5]  # so near that some of it lies outside
    normals = np.random.default_rng(seed).normal(size=(200, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    X = (neutral + np.tensordot(a, units, axes=1)) @ R.T + t
    inside = Camera(*CAMERA).in_image(X, 320, 240)
    towards = -(X * (normals @ R.T)).sum(axis=1) / np.linalg.norm(X, axis=1) > -0.1
    seen = pose_geometry.facing_camera(X, normals, R, CAMERA, 320, 240, -0.1)
    np.testing.assert_array_equal(seen, inside & towards)
    assert 0 < inside.sum() < 200
    assert 0 < towards.sum() < 200


@given(rotation_vectors(3.0), rotations())
@FEW
def test_rotate_is_exp(w: Array, R: Array) -> None:
    np.testing.assert_allclose(pose_geometry.rotate(w, R), exp(w) @ R, atol=1e-9)


@given(rotations(2.9), rotations())
@FEW
def test_rotation_vector_is_log(R: Array, start: Array) -> None:
    np.testing.assert_allclose(pose_geometry.rotation_vector(R @ start, start), log(R), atol=1e-9)


@given(ANGLES, ANGLES, st.floats(-3, 3))
@FEW
def test_view_angles_invert_the_rotation(tilt: float, pan: float, roll: float) -> None:
    R = rotation(tilt, pan, roll)
    found = pose_geometry.view_angles(R @ FACING)
    np.testing.assert_allclose(found[:2], (tilt, pan), atol=1e-9)
    np.testing.assert_allclose(found[:2], tilt_pan_of(R), atol=1e-9)


@given(ANGLES, ANGLES, st.floats(-3, 3), vectors(-1, 1))
@FEW
def test_view_angles_jacobian_against_differences(tilt: float, pan: float, roll: float, w: Array) -> None:
    M = rotation(tilt, pan, roll) @ FACING
    ahead, behind = (np.array(pose_geometry.view_angles(exp(s * 1e-6 * w) @ M)[:2]) for s in (1, -1))
    np.testing.assert_allclose(pose_geometry.view_angles(M)[2] @ w, (ahead - behind) / 2e-6, atol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_projection_and_its_jacobian(seed: int) -> None:
    (R, t, a), (neutral, units) = random_pose(seed), random_person(seed)
    view = (PROJECTION, np.eye(3))
    q, J = pose_geometry.project((neutral, units), (R, t, a), view)
    X = (neutral + np.tensordot(a, units, axes=1)) @ R.T + t
    homogeneous = X @ PROJECTION.T
    np.testing.assert_allclose(q, homogeneous[:, :2] / homogeneous[:, 2:], rtol=1e-9)
    for direction in np.random.default_rng(seed + 10).normal(size=(5, 12)):
        ahead, behind = (
            pose_geometry.project((neutral, units), stepped(R, t, a, s * 1e-6 * direction), view)[0] for s in (1, -1)
        )
        np.testing.assert_allclose(J @ direction, (ahead - behind) / 2e-6, rtol=1e-5, atol=1e-4)


@FEW
@given(rotations(), vectors(-1, 1))
def test_the_ray_to_a_point_of_the_head(R: Array, point: Array) -> None:
    t = np.array([0.3, -0.2, 6.0])
    np.testing.assert_allclose(pose_geometry.viewing_ray(point, R, t), ray_rotation(R @ point + t), atol=1e-12)


def test_a_step_between_poses_leads_from_one_to_the_other() -> None:
    R, t, a = random_pose(5)
    step = np.array([0.03, -0.02, 0.01, 0.01, -0.01, 0.05, 0.05, -0.1, 0.0, 0.1, 0.05, -0.05])
    other = stepped(R, t, a, step)
    np.testing.assert_allclose(pose_geometry.step_between(R, t, a, *other), step, atol=1e-12)
