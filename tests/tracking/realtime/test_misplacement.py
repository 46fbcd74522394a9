"""Landmarks that are found elsewhere than they are: the algebra against dense formulas."""

from __future__ import annotations

import numpy as np
import pytest

from mien.arrays import Array
from mien.tracking.realtime.misplacement import marginalize_misplacement, misplacement_variance
from strategies import random_person, random_pose


def _positive(rng: np.random.Generator, n: int) -> Array:
    X = rng.normal(size=(n, 2 * n))
    return X @ X.T


def test_what_an_error_of_the_animation_does_to_the_landmarks() -> None:
    (_, units), a = random_person(6), random_pose(6)[2]
    variance = np.random.default_rng(6).uniform(size=(units.shape[1], 4))
    moved = np.tensordot(a, units, axes=1)
    rest = np.full(6, 0.1)
    # Measured in a crop of twice the resolution.
    found = misplacement_variance(variance, 0.5, units, rest + a / 3, rest, 3.0)
    np.testing.assert_allclose(found[:, :2], 0.25 * variance[:, :2] + (moved**2).sum(axis=1, keepdims=True))
    np.testing.assert_array_equal(found[:, 2:], variance[:, 2:])


def test_marginalizing_against_the_dense_formula() -> None:
    rng = np.random.default_rng(0)
    M, g, d2, precision = _positive(rng, 4), rng.normal(size=4), 30.0, rng.uniform(0.5, 20, 4)
    A = np.linalg.inv(M + np.diag(precision))
    M_new, g_new = M.copy(), g.copy()
    assert marginalize_misplacement(M_new, g_new, d2, 1 / precision) == pytest.approx(d2 - g @ A @ g)
    np.testing.assert_allclose(M_new, M - M @ A @ M, atol=1e-9)
    np.testing.assert_allclose(g_new, g - M @ A @ g, atol=1e-9)


def test_marginalizing_is_the_best_misplacement() -> None:
    """Eliminating e from (x + e)' M (x + e) + 2 g' (x + e) + e' P e leaves the marginalised form, at every x."""
    rng = np.random.default_rng(1)
    M, g, d2, precision = _positive(rng, 4), rng.normal(size=4), 30.0, rng.uniform(0.5, 20, 4)
    M_new, g_new = M.copy(), g.copy()
    d2_new = marginalize_misplacement(M_new, g_new, d2, 1 / precision)
    for x in rng.normal(size=(5, 4)):
        e = -np.linalg.solve(M + np.diag(precision), M @ x + g)
        expected = d2 + (x + e) @ M @ (x + e) + 2 * g @ (x + e) + e * precision @ e
        assert d2_new + x @ M_new @ x + 2 * g_new @ x == pytest.approx(expected)


def test_a_misplacement_that_is_known_to_be_none_changes_nothing() -> None:
    rng = np.random.default_rng(2)
    M, g = _positive(rng, 4), rng.normal(size=4)
    M_new, g_new = M.copy(), g.copy()
    assert marginalize_misplacement(M_new, g_new, 5.0, np.full(4, 1e-12)) == pytest.approx(5)
    np.testing.assert_allclose(M_new, M, atol=1e-8)
    np.testing.assert_allclose(g_new, g, atol=1e-8)
