"""A Gaussian for the descriptor of every landmark, and its update, Eq. (7) and (8)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mien.arrays import Float32


@dataclass(frozen=True)
class Gaussians:
    """Means `mu` (n, D) and covariances `Sigma = U S U^T` of n landmarks: U (n, D, D), S (n, D)."""

    mu: Float32
    U: Float32
    S: Float32

    @classmethod
    def learn(cls, samples: Float32, floor: float) -> Gaussians:
        """Mean and covariance over views: (views, n, D). Eigenvalues are at least `floor`: there are
        more dimensions than independent views, so the sample covariance has none to speak of in many directions.
        """
        mu = samples.mean(axis=0)
        centred = np.swapaxes(samples - mu, 0, 1).astype(np.float64)
        Sigma = np.swapaxes(centred, 1, 2) @ centred / max(len(samples) - 1, 1)
        S, U = np.linalg.eigh(Sigma)
        return cls(mu.astype(np.float32), U.astype(np.float32), np.maximum(S, floor).astype(np.float32))

    @property
    def Sigma(self) -> Float32:
        """Covariances (n, D, D)."""
        return np.asarray((self.U * self.S[:, None, :]) @ np.swapaxes(self.U, 1, 2))

    def squared_distance(self, y: Float32) -> Float32:
        """Squared Mahalanobis distance of each landmark's descriptor: (n, D) -> (n,). The terms of Eq. (9)."""
        z = np.matmul((y - self.mu)[:, None, :], self.U)[:, 0]
        return np.asarray((z * z / self.S).sum(axis=1))

    def update(self, y: Float32, alpha: float, per_dimension: bool = False) -> Gaussians:
        """Eq. (7) and (8): descriptors (n, D) of the frame that was tracked last move mean and eigenvalues.

        The eigenvalues change and the singular vectors stay, so the decomposition of Sigma, made when it was
        learned, holds for good: adding a multiple of the identity does not turn it. `per_dimension` divides
        the squared norm by D.
        """
        squared = ((y - self.mu) ** 2).sum(axis=1, keepdims=True)
        if per_dimension:
            squared = squared / y.shape[1]
        mu = (1 - alpha) * self.mu + alpha * y  # Eq. (7)
        S = (1 - alpha) * self.S + alpha * squared  # Eq. (8)
        return Gaussians(mu.astype(np.float32), self.U, S.astype(np.float32))
