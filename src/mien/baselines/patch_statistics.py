"""Statistics of the patches around landmarks: the local features of Chen and Davoine, the structure of Lefevre and
Odobez."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from mien.arrays import Array, Float32
from mien.baselines.patches import read_patches

PATCH_SIZE, PATCH_STEP = 9, 2.0
VARIANCE_FLOOR = 2e-3


def landmark_patches(gray: Float32, points: Array) -> Float32:
    """Patches (n, D) around landmarks (n, 2) of an image (H, W)."""
    return read_patches(gray, points, PATCH_SIZE, PATCH_STEP)


@dataclass(frozen=True)
class PatchStatistics:
    """Mean (n, D) and variance (n, D) of the patch of each of n landmarks over the views."""

    mean: Float32
    variance: Float32

    @classmethod
    def of_views(cls, views: Iterable[tuple[Float32, Array]]) -> PatchStatistics:
        """Statistics over views, each an image and the landmarks (n, 2) in it."""
        return cls.learn(np.stack([landmark_patches(image, p) for image, p in views]), VARIANCE_FLOOR)

    @classmethod
    def learn(cls, samples: Float32, floor: float) -> PatchStatistics:
        """Statistics of samples (views, n, D); a variance is at least `floor`."""
        return cls(samples.mean(axis=0), np.maximum(samples.var(axis=0), np.float32(floor)))

    def squared_distance(self, patches: Float32) -> Float32:
        """Squared distances (n,) of patches (n, D) from their means, in standard deviations."""
        return np.asarray(((patches - self.mean) ** 2 / self.variance).sum(axis=1))

    def correlation(self, patches: Float32) -> Float32:
        """Correlation (n,) of patches (n, D) with their means."""
        return np.asarray((patches * self.mean).sum(axis=1) / np.linalg.norm(self.mean, axis=1))
