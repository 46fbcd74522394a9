"""Symmetric positive definite systems in every frame. For a dozen unknowns `numpy.linalg` takes three times as long,
and wakes a thread that keeps a second core busy between frames."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg.lapack import dposv

from mien.arrays import Array
from mien.compiled import kernel


def solve_definite(A: Array, b: Array) -> Array:
    """x (d, ...) with A x = b for a symmetric positive definite A (d, d). Raises LinAlgError where A is singular."""
    _, x, failed = dposv(A.T, b)  # symmetric: its transpose is in the order of LAPACK
    return np.linalg.solve(A, b) if failed else np.asarray(x)  # where rounding has made it indefinite


def inverse_definite(A: Array) -> Array:
    """Inverse (d, d) of a symmetric positive definite A (d, d). Raises LinAlgError where A is singular."""
    found, definite = inverse(A)
    return found if definite else np.linalg.inv(A)


@kernel()
def inverse(A: Any) -> Any:
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


@kernel()
def transposed_product(A: Any, B: Any) -> Any:
    """A^T B of small matrices, without a call to BLAS: (k, m), (k, n) -> (m, n)."""
    out = np.empty((A.shape[1], B.shape[1]))
    for i in range(A.shape[1]):
        for j in range(B.shape[1]):
            s = 0.0
            for k in range(A.shape[0]):
                s += A[k, i] * B[k, j]
            out[i, j] = s
    return out


@kernel()
def cholesky(A: Any) -> bool:
    """Replace the lower triangle of a symmetric positive definite A (d, d), which alone is read, by L with A = L L^T;
    returns whether A was definite: if not, L belongs to a matrix near it."""
    definite = True
    for i in range(A.shape[0]):
        for j in range(i + 1):
            s = A[i, j]
            for k in range(j):
                s -= A[i, k] * A[j, k]
            if i == j:
                definite = definite and s > 0.0
            A[i, j] = np.sqrt(max(s, 1e-12)) if i == j else s / A[j, j]
    return definite


@kernel()
def solve_positive(A: Any, b: Any) -> Any:
    """x with A x = b for a symmetric positive definite A (d, d), which is overwritten."""
    d = b.size
    x = b.copy()
    cholesky(A)
    for i in range(d):
        for k in range(i):
            x[i] -= A[i, k] * x[k]
        x[i] /= A[i, i]
    for i in range(d - 1, -1, -1):
        for k in range(i + 1, d):
            x[i] -= A[k, i] * x[k]
        x[i] /= A[i, i]
    return x
