"""Statistics of patches, worked out by hand."""

from __future__ import annotations

import numpy as np

from mien.baselines.patch_statistics import PatchStatistics


def test_statistics_by_hand() -> None:
    samples = np.array([[[1.0, 0.0]], [[3.0, 0.0]]], np.float32)  # two views, one landmark, two values
    statistics = PatchStatistics.learn(samples, floor=0.25)
    np.testing.assert_allclose(statistics.mean, [[2, 0]])
    np.testing.assert_allclose(statistics.variance, [[1, 0.25]])
    np.testing.assert_allclose(statistics.squared_distance(np.array([[4.0, 1.0]], np.float32)), [4 + 4])
    np.testing.assert_allclose(statistics.correlation(np.array([[0.6, 0.8]], np.float32)), [0.6])
