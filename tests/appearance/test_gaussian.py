"""Learning and updating the Gaussians: Eq. (7) and (8) by hand, and what follows from them."""

from __future__ import annotations

import numpy as np
import pytest

from mien.appearance.gaussian import Gaussians


def _random(seed: int = 0, n: int = 3, dimensions: int = 8) -> Gaussians:
    samples = np.random.default_rng(seed).normal(size=(40, n, dimensions)).astype(np.float32)
    return Gaussians.learn(samples, 1e-3)


def test_learned_mean_and_covariance() -> None:
    samples = np.random.default_rng(1).normal(size=(50, 2, 4)).astype(np.float32)
    gaussians = Gaussians.learn(samples, 1e-9)
    for i in range(2):
        np.testing.assert_allclose(gaussians.mu[i], samples[:, i].mean(axis=0), atol=1e-6)
        np.testing.assert_allclose(gaussians.Sigma[i], np.cov(samples[:, i].T), atol=1e-5)


def test_fewer_views_than_dimensions_leave_no_singular_covariance() -> None:
    samples = np.random.default_rng(2).normal(size=(3, 1, 8)).astype(np.float32)
    S = Gaussians.learn(samples, 0.01).S
    assert S.min() == pytest.approx(0.01)
    assert (S > 0.011).sum() == 2


def test_eq_7_and_8_by_hand() -> None:
    """mu = (1, 0), S = (4, 1), y = (1, 2), alpha = 1/4: mu' = (1, 1/2), |y - mu|^2 = 4, S' = (4, 7/4)."""
    one = Gaussians(np.array([[1, 0]], np.float32), np.eye(2, dtype=np.float32)[None], np.array([[4, 1]], np.float32))
    y = np.array([[1, 2]], np.float32)
    updated = one.update(y, 0.25)
    np.testing.assert_allclose(updated.mu, [[1, 0.5]])
    np.testing.assert_allclose(updated.S, [[4, 1.75]])
    np.testing.assert_allclose(updated.Sigma, [[[4, 0], [0, 1.75]]])
    np.testing.assert_allclose(one.update(y, 0.25, per_dimension=True).S, [[3.5, 1.25]])


def test_the_update_does_not_turn_the_covariance() -> None:
    """`Sigma_t = (1 - alpha) Sigma_t-1 + alpha |y - mu|^2 I`: the same directions, whatever is decomposed again."""
    old = _random()
    y = np.random.default_rng(3).normal(size=(3, 8)).astype(np.float32)
    new = old.update(y, 0.1)
    squared = ((y - old.mu) ** 2).sum(axis=1)
    expected = 0.9 * old.Sigma + 0.1 * squared[:, None, None] * np.eye(8)
    np.testing.assert_allclose(new.Sigma, expected, atol=1e-4)
    again = np.linalg.eigh(new.Sigma.astype(float))
    for i in range(3):
        np.testing.assert_allclose(np.sort(new.S[i]), again.eigenvalues[i], rtol=1e-4)
        np.testing.assert_allclose(np.abs(new.U[i].T @ again.eigenvectors[i]), np.eye(8), atol=1e-2)


def test_squared_distance_is_that_of_mahalanobis() -> None:
    gaussians = _random(4)
    y = np.random.default_rng(5).normal(size=(3, 8)).astype(np.float32)
    expected = [
        d @ np.linalg.inv(Sigma) @ d for d, Sigma in zip(y - gaussians.mu, gaussians.Sigma.astype(float), strict=True)
    ]
    np.testing.assert_allclose(gaussians.squared_distance(y), expected, rtol=1e-4)


def test_an_observation_that_repeats_becomes_the_mean() -> None:
    gaussians, y = _random(6), np.ones((3, 8), np.float32)
    for _ in range(200):
        gaussians = gaussians.update(y, 0.1)
    np.testing.assert_allclose(gaussians.mu, y, atol=1e-5)
