"""Tran and others 2013: sparse residuals."""

from __future__ import annotations

import numpy as np

from mien.arrays import Array, Float32
from mien.baselines.tran2013 import SPARSITY, Codebook


def _unit(
    patches: Array,
) -> Float32:
    return np.asarray(patches / np.linalg.norm(patches, axis=-1, keepdims=True), np.float32)


def test_the_residual_of_a_codeword_is_what_sparsity_takes() -> None:
    """min 1/2 (1 - c)^2 + s c is at c = 1 - s, and leaves s^2; of what is orthogonal, everything is left."""
    codebook = Codebook(np.eye(4, dtype=np.float32)[None, :3])
    np.testing.assert_allclose(codebook.residuals(np.array([[0, 1, 0, 0]], np.float32)), SPARSITY**2, rtol=1e-3)
    np.testing.assert_allclose(codebook.residuals(np.array([[0, 0, 0, 1]], np.float32)), 1, rtol=1e-6)


def test_landmarks_do_not_share_codebooks() -> None:
    patches = _unit(np.random.default_rng(0).normal(size=(2, 3, 20)))
    codebook = Codebook(patches)
    own = codebook.residuals(patches[:, 0])
    other = codebook.residuals(patches[::-1, 0])
    assert (own < 0.05).all()
    assert (other > 0.3).all()
    np.testing.assert_allclose(
        Codebook(patches[:1]).residuals(patches[:1, 1]), codebook.residuals(patches[:, 1])[:1], atol=0.01
    )


def test_a_flat_patch_is_not_represented() -> None:
    patches = _unit(np.random.default_rng(0).normal(size=(1, 3, 20)))
    np.testing.assert_allclose(Codebook(patches).residuals(np.zeros((1, 20), np.float32)), 1)
