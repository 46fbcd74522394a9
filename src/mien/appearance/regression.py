"""Appearance as a function of the pose: the mean of a descriptor is a polynomial of tilt and pan.

Descriptors are read in a crop that is normalised for scale and roll, so tilt and pan are all that is left of
the pose. The covariance is that of what the polynomial leaves, as `I floor + low rank`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mien.geometry.rotation import Array

Float32 = NDArray[np.float32]


@dataclass(frozen=True)
class PoseRegression:
    """Means and covariances of n landmarks' descriptors as functions of the pose.

    coefficients: (n, p, 128) of the polynomial's p terms; U: (n, k, 128) leading eigenvectors of the residual
    covariance; gain: (n, k) such that `Sigma^-1 = I / floor + U^T diag(gain) U`; inverse_floor: (n,);
    limit: (2,) radians up to which tilt and pan were seen.
    """

    coefficients: Float32
    U: Float32
    gain: Float32
    inverse_floor: Float32
    limit: Array

    @classmethod
    def learn(
        cls,
        samples: Float32,
        terms: Float32,
        visible: NDArray[np.bool_],
        limit: Array,
        floor: float,
        rank: int,
        changes: Float32 | None = None,
    ) -> PoseRegression:
        """Least squares over the views in which a landmark is visible.

        samples: (views, n, 128); terms: (views, p); visible: (views, n); changes: (k, n, 128) what else may come to a
        descriptor; the sum of their squares goes into the covariance, and nothing of them into the mean.
        """
        n = samples.shape[1]
        # A landmark that is visible in too few views for its coefficients uses them all.
        weight = np.where(visible.sum(axis=0) >= 2 * terms.shape[1], visible, True).astype(np.float64)
        A = np.einsum("vp,vn,vq->npq", terms, weight, terms, optimize=True) + 1e-3 * np.eye(terms.shape[1])
        b = np.einsum("vp,vn,vnc->npc", terms, weight, samples, optimize=True)
        coefficients = np.linalg.solve(A, b)
        residual = samples - np.einsum("vp,npc->vnc", terms, coefficients, optimize=True)
        residual = np.swapaxes(residual * np.sqrt(weight / weight.sum(axis=0))[:, :, None], 0, 1)
        if changes is not None:
            residual = np.concatenate([residual, np.swapaxes(changes, 0, 1)], axis=1)
        variance, directions = np.linalg.eigh(np.swapaxes(residual, 1, 2) @ residual)
        variance = np.maximum(variance[:, ::-1][:, :rank], 0)  # the leading ones
        directions = np.swapaxes(directions, 1, 2)[:, ::-1][:, :rank]
        return cls(
            coefficients.astype(np.float32),
            np.ascontiguousarray(directions, dtype=np.float32),
            (1 / (variance + floor) - 1 / floor).astype(np.float32),
            np.full(n, 1 / floor, np.float32),
            limit,
        )
