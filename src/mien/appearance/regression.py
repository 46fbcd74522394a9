"""Appearance as a function of the pose: the mean of a descriptor is a polynomial of tilt and pan.

Descriptors are sampled in a crop that is normalised for scale and roll, so that only tilt and pan are left of the pose.
The covariance is that of the residuals, as `I floor + low rank`. Residuals are far larger in some views than in others,
so the distance of each view from the mean is kept, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mien.arrays import Array, Float32

_SPARE, _ITERATIONS = 12, 3
"""Of subspace iteration: directions more than are wanted, and multiplications with the squared covariance."""


@dataclass(frozen=True)
class PoseRegression:
    """Means and covariances of the descriptors of n landmarks as functions of the pose.

    coefficients: (n, p, 128) of the p terms of the polynomial; U: (n, k, 128) leading eigenvectors of the residual
    covariance; gain: (n, k) such that `Sigma^-1 = I / floor + U^T diag(gain) U`; inverse_floor: (n,); limit: (2,)
    radians up to which tilt and pan were rendered; lack_of_fit: (views, n) squared distance of each view from the mean.
    """

    coefficients: Float32
    U: Float32
    gain: Float32
    inverse_floor: Float32
    limit: Array
    lack_of_fit: Float32

    @classmethod
    def learn(
        cls,
        samples: Float32,
        terms: Float32,
        weight: Float32,
        limit: Array,
        floor: float,
        rank: int,
        changes: Float32 | None = None,
    ) -> PoseRegression:
        """Weighted least squares for the mean, and the covariance of its residuals with the same weights.

        samples: (views, n, 128); terms: (views, p); weight: (views, n), zero where a landmark is hidden; limit: (2,)
        of tilt and pan, radians; floor: variance of a descriptor's entries in every direction; rank: number of
        directions with more; changes: (k, n, 128) further changes of a descriptor, whose sum of squares goes into the
        covariance and which leave the mean alone.
        """
        # A landmark that is visible in too few views for its coefficients uses them all.
        enough = (weight > 0).sum(axis=0) >= 2 * terms.shape[1]
        weight = np.where(enough, weight, 1).T.astype(np.float32)
        weighted = weight[:, None] * terms.T
        A = weighted.astype(np.float64) @ terms + 1e-3 * np.eye(terms.shape[1])
        seen = np.ascontiguousarray(np.swapaxes(samples, 0, 1))
        coefficients = np.linalg.solve(A, weighted @ seen).astype(np.float32)
        residual: Float32 = seen - terms @ coefficients
        spread = residual * np.sqrt(weight / weight.sum(axis=1, keepdims=True))[:, :, None]
        if changes is not None:
            spread = np.concatenate([spread, np.swapaxes(changes, 0, 1)], axis=1)
        variance, directions = _leading(np.swapaxes(spread, 1, 2) @ spread, rank)
        gain = (1 / (variance + floor) - 1 / floor).astype(np.float32)
        lack_of_fit = _squared_norms(residual, directions, gain, np.full(len(seen), floor, np.float32))
        inverse_floor, by_view = np.full(len(seen), 1 / floor, np.float32), np.ascontiguousarray(lack_of_fit.T)
        return cls(coefficients, directions, gain, inverse_floor, limit, by_view)

    def squared_norms(self, changes: Float32) -> Array:
        """Squared distances (m, n) that changes (m, n, 128) of the descriptors make."""
        return _squared_norms(np.swapaxes(changes, 0, 1), self.U, self.gain, 1 / self.inverse_floor).T.astype(float)


def _squared_norms(x: Float32, U: Float32, gain: Float32, floor: Float32) -> Float32:
    """Squared norms (n, m) of descriptors x (n, m, 128) in the metric `I / floor + U^T diag(gain) U` of each of n
    landmarks, with floor (n,)."""
    along = x @ np.swapaxes(U, 1, 2)
    return np.asarray((x**2).sum(axis=2) / floor[:, None] + (along**2 * gain[:, None]).sum(axis=2), np.float32)


def _leading(covariance: Float32, rank: int) -> tuple[Float32, Float32]:
    """Variances (n, k) and directions (n, k, d) of the `rank` leading eigenvectors of covariances (n, d, d).

    By subspace iteration (N. Halko, P. Martinsson, J. Tropp, SIAM Review 53, 2011), which takes half as long as LAPACK,
    and is right to a thousandth where variances fall off as those of descriptors do: the 32nd is a third of the 20th.
    """
    d = covariance.shape[-1]
    k = min(rank, d)
    basis = np.random.default_rng(0).standard_normal((d, min(k + _SPARE, d)), np.float32)
    squared = covariance @ covariance
    for _ in range(_ITERATIONS):
        basis, _ = np.linalg.qr(squared @ basis)
    variance, directions = np.linalg.eigh(np.swapaxes(basis, 1, 2) @ covariance @ basis)
    leading = np.swapaxes(basis @ directions, 1, 2)[:, ::-1][:, :k]
    return np.maximum(variance[:, ::-1][:, :k], 0), np.ascontiguousarray(leading)
