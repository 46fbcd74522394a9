"""The reported error: a covariance that grows with the turn, a confidence that falls with it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from mien.appearance.views import rotation
from mien.geometry.rotation import FACING, Array, exp
from mien.tracking.uncertainty import (
    MISFIT_DISTANCE,
    NOISE_SCALE,
    TURN_SD,
    confidence,
    state_covariance,
    systematic_variance,
)
from strategies import head_rotations, rotation_vectors

SPREAD = np.diag([1 / 400, 1 / 400, 1 / 2500] + [0.01] * 9)
PERFECT = np.zeros(26)


def test_a_perfect_fit_at_the_first_pose_leaves_the_noise() -> None:
    np.testing.assert_allclose(state_covariance(SPREAD, PERFECT, FACING, FACING), NOISE_SCALE**2 * SPREAD)


def test_landmarks_that_look_wrong_make_everything_less_certain() -> None:
    perfect = state_covariance(SPREAD, PERFECT, rotation(0, 0.5, 0), FACING)
    misfit = state_covariance(SPREAD, np.full(26, MISFIT_DISTANCE), rotation(0, 0.5, 0), FACING)
    np.testing.assert_allclose(misfit, 2 * perfect)


@given(head_rotations(), head_rotations())
def test_it_is_a_covariance_that_the_model_makes_larger(R: Array, R_first: Array) -> None:
    covariance = state_covariance(SPREAD, PERFECT, R, R_first)
    assert np.linalg.eigvalsh(covariance - NOISE_SCALE**2 * SPREAD).min() > -1e-12
    np.testing.assert_array_equal(covariance[3:, 3:], state_covariance(SPREAD, PERFECT, R_first, R_first)[3:, 3:])


def test_systematic_variance_by_hand() -> None:
    """Half a radian of pan: out of the plane by its sine. Of roll: not out of the plane at all."""
    assert systematic_variance(rotation(0, 0.5, 0), FACING) == pytest.approx((TURN_SD * np.sin(0.5)) ** 2)
    assert systematic_variance(rotation(0, 0, 0.5), FACING) == pytest.approx(0, abs=1e-15)


@given(head_rotations(), head_rotations(), rotation_vectors())
def test_it_does_not_matter_from_where_one_looks(R: Array, R_first: Array, v: Array) -> None:
    assert systematic_variance(exp(v) @ R, exp(v) @ R_first) == pytest.approx(systematic_variance(R, R_first), abs=1e-9)


def test_confidence_falls_with_the_spread_and_with_what_is_hidden() -> None:
    spreads = [confidence(scale * np.eye(12), PERFECT, 0.6, FACING, FACING) for scale in (1e-5, 1e-3, 1e-1, 10)]
    assert spreads == sorted(spreads, reverse=True)
    hidden = [confidence(1e-3 * np.eye(12), PERFECT, seen, FACING, FACING) for seen in (1, 0.7, 0.4, 0.1)]
    assert hidden == sorted(hidden, reverse=True)
    assert confidence(1e-4 * np.eye(12), PERFECT, 1.0, FACING, FACING) > 0.99
    assert hidden[-1] < 0.05
    assert confidence(1e9 * np.eye(12), np.zeros(0), 0.0, FACING, FACING) == 0


def test_landmarks_that_all_look_wrong_are_somebody_else() -> None:
    stranger = np.full(26, 55.0)
    assert confidence(1e-5 * np.eye(12), stranger, 1.0, FACING, FACING) < 0.01
    assert confidence(1e-5 * np.eye(12), np.where(np.arange(26) < 9, 10.0, 55.0), 1.0, FACING, FACING) > 0.9
