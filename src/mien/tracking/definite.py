"""Symmetric positive definite systems in every frame. For a dozen unknowns `numpy.linalg` takes three times as long,
and wakes a thread that keeps a second core busy between frames."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg.lapack import dposv

from mien.compiled import kernel
from mien.geometry.rotation import Array
from mien.tracking.kernels import cholesky, transposed_product


def solve_definite(A: Array, b: Array) -> Array:
    """x (d, ...) with A x = b for a symmetric positive definite A (d, d). Raises LinAlgError where A is singular."""
    _, x, failed = dposv(A.T, b)  # symmetric: its transpose is in the order of LAPACK
    return np.linalg.solve(A, b) if failed else np.asarray(x)  # where rounding has made it indefinite


def inverse_definite(A: Array) -> Array:
    """Inverse (d, d) of a symmetric positive definite A (d, d). Raises LinAlgError where A is singular."""
    inverse, definite = _inverse(A)
    return inverse if definite else np.linalg.inv(A)


@kernel()
def _inverse(A: Any) -> Any:
    """Inverse (d, d), and whether A (d, d) is definite. At half the time of LAPACK for a dozen unknowns."""
    d = A.shape[0]
    L, X = A.copy(), np.zeros((d, d))  # X: L^-1
    definite = cholesky(L)
    for i in range(d):
        X[i, i] = 1.0
        for j in range(i):
            for k in range(j + 1):
                X[i, k] -= L[i, j] * X[j, k]
        for k in range(i + 1):
            X[i, k] /= L[i, i]
    return transposed_product(X, X), definite
