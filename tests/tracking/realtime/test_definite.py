"""Small symmetric systems: what NumPy says of them, with one thread."""

from __future__ import annotations

import numpy as np
import pytest

from mien.tracking.realtime.definite import inverse_definite, solve_definite, solve_positive, transposed_product


@pytest.mark.parametrize("size", [1, 12, 93])
def test_it_is_what_numpy_says(size: int) -> None:
    X = np.random.default_rng(size).normal(size=(size, 2 * size))
    A, b = X @ X.T, X[:, :2]
    kept = A.copy()
    np.testing.assert_allclose(solve_definite(A, b), np.linalg.solve(A, b), atol=1e-9)
    np.testing.assert_allclose(solve_definite(A, b[:, 0]), np.linalg.solve(A, b[:, 0]), atol=1e-9)
    inverse = inverse_definite(A)
    np.testing.assert_allclose(inverse, np.linalg.inv(A), atol=1e-9)
    assert inverse.flags.c_contiguous
    np.testing.assert_array_equal(A, kept)


def test_what_rounding_has_made_indefinite_is_solved_all_the_same() -> None:
    A = np.diag([1.0, 2.0, -1e-12])
    np.testing.assert_allclose(solve_definite(A, np.array([1.0, 2.0, 0.0])), [1, 1, 0])
    with pytest.raises(np.linalg.LinAlgError):
        solve_definite(np.zeros((2, 2)), np.ones(2))


def test_kernels_for_small_matrices() -> None:
    rng = np.random.default_rng(3)
    X = rng.normal(size=(12, 24))
    A, B, H, b = rng.normal(size=(4, 3)), rng.normal(size=(4, 12)), X @ X.T, rng.normal(size=12)
    np.testing.assert_allclose(transposed_product(A, B), A.T @ B, atol=1e-12)
    np.testing.assert_allclose(solve_positive(H.copy(), b), np.linalg.solve(H, b), rtol=1e-6)
