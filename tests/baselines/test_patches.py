"""Patches: where they are read, and that brightness and contrast leave them as they are."""

from __future__ import annotations

import numpy as np

from mien.baselines.patches import normalized, read_patches, sample


def test_samples_of_a_ramp_are_its_coordinates() -> None:
    y, x = np.mgrid[:20, :30].astype(np.float32)
    points = np.array([[[3.25, 4.5], [10.0, 0.0]], [[29.0, 19.0], [7.5, 2.0]]])
    np.testing.assert_allclose(sample(x, points), points[..., 0], atol=0.02)
    np.testing.assert_allclose(sample(y, points), points[..., 1], atol=0.02)
    assert sample(x, np.array([[100.0, -5.0]]))[0] == 29


def test_a_patch_is_centred_on_its_point() -> None:
    gray = np.zeros((21, 21), np.float32)
    gray[10, 12] = 1
    patch = read_patches(gray, np.array([[12.0, 10.0]]), 5, 1.0).reshape(5, 5)
    assert np.unravel_index(patch.argmax(), patch.shape) == (2, 2)
    shifted = read_patches(gray, np.array([[10.0, 10.0]]), 5, 2.0).reshape(5, 5)
    assert np.unravel_index(shifted.argmax(), shifted.shape) == (2, 3)


def test_brightness_and_contrast_change_nothing() -> None:
    gray = np.random.default_rng(0).uniform(0, 255, (40, 40)).astype(np.float32)
    points = np.random.default_rng(1).uniform(5, 35, (6, 2))
    patches = read_patches(gray, points, 7, 1.5)
    np.testing.assert_allclose(read_patches(0.5 * gray + 20, points, 7, 1.5), patches, atol=1e-5)
    np.testing.assert_allclose(patches.mean(axis=1), 0, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(patches, axis=1), 1, atol=1e-5)


def test_a_flat_patch_is_zero() -> None:
    assert not normalized(np.full((2, 9), 7.0, np.float32)).any()
