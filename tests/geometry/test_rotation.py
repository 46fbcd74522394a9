"""Rotations: what holds for all of them, near the identity and near half a turn."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from mien.arrays import Array
from mien.geometry.rotation import (
    FACING,
    angle_between,
    euler_from_matrix,
    euler_jacobian,
    exp,
    hat,
    left_jacobian,
    log,
    matrix_from_euler,
    ray_rotation,
    rotation_onto,
    similarity,
)
from strategies import euler_angles, rotation_vectors, rotations, unit_vectors, vectors


@given(vectors(-5, 5), vectors(-5, 5))
def test_hat_is_the_cross_product(v: Array, w: Array) -> None:
    np.testing.assert_allclose(hat(v) @ w, np.cross(v, w), atol=1e-12)


@given(rotation_vectors())
def test_exp_is_a_rotation_and_its_inverse_turns_back(v: Array) -> None:
    R = exp(v)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1)
    np.testing.assert_allclose(exp(-v), R.T, atol=1e-12)


@given(rotation_vectors())
def test_log_inverts_exp(v: Array) -> None:
    np.testing.assert_allclose(log(exp(v)), v, atol=1e-9)


@given(rotations(np.pi))
def test_exp_after_log(R: Array) -> None:
    np.testing.assert_allclose(exp(log(R)), R, atol=1e-6)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-8, 9e-7, 1.1e-6, 1e-4])
def test_near_the_identity(angle: float) -> None:
    v = angle * np.array([0.6, -0.64, 0.48])
    np.testing.assert_allclose(exp(v), np.eye(3) + hat(v), atol=angle**2 + 1e-15)
    np.testing.assert_allclose(log(exp(v)), v, atol=1e-15, rtol=1e-9)


@given(unit_vectors())
def test_half_a_turn_has_an_axis_of_either_sign(axis: Array) -> None:
    v = log(exp(np.pi * axis))
    assert np.linalg.norm(v) == pytest.approx(np.pi)
    assert abs(v @ axis) == pytest.approx(np.pi)


@pytest.mark.parametrize("gap", [1e-3, 1e-5, 1e-7, 1e-9])
def test_near_half_a_turn(gap: float) -> None:
    v = (np.pi - gap) * np.array([0.36, 0.48, -0.8])
    np.testing.assert_allclose(exp(log(exp(v))), exp(v), atol=1e-6)


def test_quarter_turns_by_hand() -> None:
    np.testing.assert_allclose(exp(np.array([0, 0, np.pi / 2])), [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)
    np.testing.assert_allclose(exp(np.array([np.pi, 0, 0])), FACING, atol=1e-15)


@given(rotation_vectors(3.0), vectors(-1, 1))
def test_left_jacobian_against_differences(v: Array, direction: Array) -> None:
    step = 1e-6 * direction
    turned = log(exp(v + step) @ exp(v - step).T) / 2e-6
    np.testing.assert_allclose(left_jacobian(v) @ direction, turned, atol=1e-6)


@given(euler_angles())
def test_euler_round_trip(angles: Array) -> None:
    np.testing.assert_allclose(euler_from_matrix(matrix_from_euler(angles)), angles, atol=1e-9)


def test_euler_order_by_hand() -> None:
    """Rx(90) Ry(90) sends the z axis to Rx(90) x = x, and the x axis to Rx(90) (-z) = y."""
    R = matrix_from_euler(np.array([np.pi / 2, np.pi / 2, 0]))
    np.testing.assert_allclose(R @ [0, 0, 1], [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(R @ [1, 0, 0], [0, 1, 0], atol=1e-15)


def test_euler_of_a_stack() -> None:
    angles = np.radians([[10.0, -20.0, 30.0], [-5.0, 40.0, 0.0]])
    R = np.stack([matrix_from_euler(a) for a in angles])
    np.testing.assert_allclose(euler_from_matrix(R), angles, atol=1e-12)


@given(euler_angles(), vectors(-1, 1))
def test_euler_jacobian_against_differences(angles: Array, w: Array) -> None:
    R = matrix_from_euler(angles)
    step = 1e-6 * w
    difference = (euler_from_matrix(exp(step) @ R) - euler_from_matrix(exp(-step) @ R)) / 2e-6
    np.testing.assert_allclose(euler_jacobian(R) @ w, difference, atol=1e-6)


@given(rotations(), rotation_vectors())
def test_angle_between_is_the_length_of_the_rotation_vector(R: Array, v: Array) -> None:
    assert angle_between(R, R @ exp(v)) == pytest.approx(np.linalg.norm(v), abs=1e-7)


@pytest.mark.parametrize("X", [[0.0, 0, 5], [1, -0.5, 3], [-2, 2, 1]])
def test_ray_rotation_turns_the_axis_into_the_ray_and_nothing_else(X: list[float]) -> None:
    R, ray = ray_rotation(np.array(X)), np.array(X) / np.linalg.norm(X)
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(R[:, 2], ray, atol=1e-12)
    assert angle_between(R, np.eye(3)) == pytest.approx(np.arccos(ray[2]))


def test_similarity_is_recovered() -> None:
    rng = np.random.default_rng(7)
    source = rng.normal(size=(12, 3))
    R, t = exp(np.array([0.3, -0.8, 2.0])), np.array([1.0, -2.0, 3.0])
    scale, found, shift = similarity(source, 2.5 * source @ R.T + t)
    assert scale == pytest.approx(2.5)
    np.testing.assert_allclose(found, R, atol=1e-9)
    np.testing.assert_allclose(shift, t, atol=1e-9)


def test_points_are_never_mirrored_onto_others() -> None:
    source = np.random.default_rng(8).normal(size=(9, 3)) * [3.0, 2.0, 1.0]
    R, _ = rotation_onto(source, source * [1, 1, -1])
    assert np.linalg.det(R) == pytest.approx(1)
