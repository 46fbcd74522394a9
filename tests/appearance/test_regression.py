"""Appearance by pose: a polynomial is found again, and the inverse covariance is one."""

from __future__ import annotations

import numpy as np
import pytest

from mien.appearance.regression import PoseRegression
from mien.arrays import Float32
from mien.tracking.realtime.kernels import POLYNOMIAL_TERMS, polynomial

LIMIT = np.array([0.7, 0.5])
N, RANK, FLOOR = 2, 5, 4e-3
GRID = [(x, y) for x in np.linspace(-0.7, 0.7, 9) for y in np.linspace(-0.5, 0.5, 9)]
TERMS = np.array([polynomial(x, y, LIMIT)[0] for x, y in GRID])
EVERYWHERE = np.ones((len(GRID), N), np.float32)


def _truth() -> Float32:
    return np.random.default_rng(0).normal(size=(N, POLYNOMIAL_TERMS, 128)).astype(np.float32)


def _noise(sd: float = 0.1) -> Float32:
    return np.random.default_rng(1).normal(0, sd, (len(GRID), N, 128)).astype(np.float32)


def _uneven_noise() -> Float32:
    """Noise whose variance falls off from direction to direction, to a third over twelve of them, as that of
    descriptors does."""
    directions = np.linalg.qr(np.random.default_rng(2).normal(size=(128, 128)))[0]
    return np.asarray(_noise() * 3 ** (-np.arange(128) / 24) @ directions.T, np.float32)


def _values(truth: Float32) -> Float32:
    return np.asarray(np.einsum("vp,npc->vnc", TERMS, truth), np.float32)


def _assert_agree(learned: PoseRegression, truth: Float32) -> None:
    for tilt, pan in [(0.0, 0.0), (0.2, -0.4), (-0.6, 0.6)]:
        terms = polynomial(tilt, pan, LIMIT)[0]
        np.testing.assert_allclose(terms @ learned.coefficients, terms @ truth, atol=0.02)


def test_a_polynomial_is_recovered() -> None:
    truth = _truth()
    learned = PoseRegression.learn(_values(truth), TERMS, EVERYWHERE, LIMIT, FLOOR, RANK)
    _assert_agree(learned, truth)
    np.testing.assert_allclose(learned.gain, 0, atol=5)  # nothing is left: the covariance is the floor


def test_views_in_which_a_landmark_is_hidden_do_not_count() -> None:
    truth = _truth()
    samples = _values(truth)
    weight = EVERYWHERE.copy()
    weight[::3, 0] = 0
    samples[::3, 0] = 9
    learned = PoseRegression.learn(samples, TERMS, weight, LIMIT, FLOOR, RANK)
    _assert_agree(learned, truth)


def test_a_landmark_that_is_seldom_visible_uses_every_view() -> None:
    truth = _truth()
    weight = EVERYWHERE.copy()
    weight[2 * POLYNOMIAL_TERMS - 1 :, 1] = 0  # in fewer views than twice the terms
    learned = PoseRegression.learn(_values(truth), TERMS, weight, LIMIT, FLOOR, RANK)
    _assert_agree(learned, truth)


def test_the_inverse_covariance_against_a_dense_one() -> None:
    """Sigma = I floor + the leading part of the residuals' covariance."""
    samples = _values(_truth()) + _uneven_noise()
    learned = PoseRegression.learn(samples, TERMS, EVERYWHERE, LIMIT, FLOOR, RANK)
    residual = samples - np.einsum("vp,npc->vnc", TERMS, learned.coefficients)
    for i in range(N):
        values, vectors = np.linalg.eigh(residual[:, i].T.astype(float) @ residual[:, i] / len(samples))
        leading = vectors[:, -RANK:] * values[-RANK:] @ vectors[:, -RANK:].T
        inverse = learned.inverse_floor[i] * np.eye(128) + learned.U[i].T * learned.gain[i] @ learned.U[i]
        np.testing.assert_allclose(inverse @ (FLOOR * np.eye(128) + leading), np.eye(128), atol=2e-3)


def test_views_count_by_their_weights() -> None:
    """A view that weighs 4 counts as four views do."""
    samples, weight = _values(_truth()) + _noise(), EVERYWHERE.copy()
    weight[:5] = 4
    learned = PoseRegression.learn(samples, TERMS, weight, LIMIT, FLOOR, RANK)
    again = np.r_[np.repeat(np.arange(5), 3), np.arange(len(GRID))]
    every = np.ones((len(again), N), np.float32)
    repeated = PoseRegression.learn(samples[again], TERMS[again], every, LIMIT, FLOOR, RANK)
    np.testing.assert_allclose(learned.coefficients, repeated.coefficients, atol=1e-4)
    np.testing.assert_allclose(learned.gain, repeated.gain, rtol=1e-3)


def test_what_the_mean_leaves_of_each_view() -> None:
    """The squared distance of Eq. (6), by the inverse covariance."""
    samples, weight = _values(_truth()) + _noise(), EVERYWHERE.copy()
    samples[7, 1] += 1
    weight[7] = 0.01
    learned = PoseRegression.learn(samples, TERMS, weight, LIMIT, FLOOR, RANK)
    residual = samples - np.einsum("vp,npc->vnc", TERMS, learned.coefficients)
    for i in range(N):
        inverse = learned.inverse_floor[i] * np.eye(128) + learned.U[i].T * learned.gain[i] @ learned.U[i]
        np.testing.assert_allclose(
            learned.lack_of_fit[:, i], np.sum(residual[:, i] @ inverse * residual[:, i], axis=1), rtol=1e-3
        )
    assert learned.lack_of_fit[:, 1].argmax() == 7


def test_rank_zero_is_the_floor_alone() -> None:
    learned = PoseRegression.learn(_values(_truth()) + _noise(), TERMS, EVERYWHERE, LIMIT, FLOOR, 0)
    assert learned.U.shape == (N, 0, 128)
    assert learned.inverse_floor == pytest.approx(1 / FLOOR)


def test_changes_are_allowed_for_and_move_no_mean() -> None:
    samples = _values(_truth())
    blink = np.random.default_rng(2).normal(0, 0.3, (1, N, 128)).astype(np.float32)
    plain = PoseRegression.learn(samples, TERMS, EVERYWHERE, LIMIT, FLOOR, RANK)
    learned = PoseRegression.learn(samples, TERMS, EVERYWHERE, LIMIT, FLOOR, RANK, blink)
    np.testing.assert_array_equal(learned.coefficients, plain.coefficients)
    for i in range(N):
        change = blink[0, i].astype(float)
        along = learned.U[i] @ change
        squared = change @ change / FLOOR + along**2 @ learned.gain[i]
        assert squared == pytest.approx(change @ change / (FLOOR + change @ change), rel=0.01)
