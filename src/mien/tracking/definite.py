"""Symmetric positive definite systems, for every frame. `numpy.linalg` takes three times as long for a dozen unknowns,
and wakes a thread for them, which then keeps a second core busy between frames."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dposv

from mien.geometry.rotation import Array


def solve_definite(A: Array, b: Array) -> Array:
    """x (d, ...) with A x = b for a symmetric positive definite A (d, d). Raises LinAlgError where A is singular."""
    _, x, failed = dposv(A.T, b)  # symmetric: its transpose is in the order of LAPACK
    return np.linalg.solve(A, b) if failed else np.asarray(x)  # where rounding has made it indefinite


def inverse_definite(A: Array) -> Array:
    """Inverse (d, d) of a symmetric positive definite A (d, d). Raises LinAlgError where A is singular."""
    return np.ascontiguousarray(solve_definite(A, np.eye(len(A))))
