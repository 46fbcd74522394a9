"""Small square image patches at given points, normalised for brightness and contrast."""

from __future__ import annotations

import cv2
import numpy as np

from mien.arrays import Array, Float32

_FLAT = 1e-3
"""Standard deviation in grey values below which a patch counts as flat."""


def read_patches(gray: Float32, points: Array, size: int, step: float) -> Float32:
    """Patches of zero mean and unit length (n, size * size) around points (n, 2) of an image (H, W).

    size: samples along a side, `step` pixels apart. A flat patch is zero; the border of the image is replicated.
    """
    offsets = step * (np.arange(size) - (size - 1) / 2)
    y, x = np.meshgrid(offsets, offsets, indexing="ij")
    return normalized(sample(gray, points[:, None] + np.stack([x.ravel(), y.ravel()], axis=1)))


def sample(gray: Float32, points: Array) -> Float32:
    """Bilinear samples (...) of an image (H, W) at points (..., 2); the border of the image is replicated."""
    at = np.nan_to_num(points).astype(np.float32).reshape(len(points), -1, 2)
    values = cv2.remap(gray, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(values, np.float32).reshape(points.shape[:-1])


def normalized(patches: Float32) -> Float32:
    """Normalise to zero mean and unit length along the last axis; zero without contrast."""
    centred = patches - patches.mean(axis=-1, keepdims=True)
    length = np.linalg.norm(centred, axis=-1, keepdims=True)
    flat = length < _FLAT * np.sqrt(patches.shape[-1])
    return np.asarray(np.where(flat, 0, centred / np.where(flat, 1, length)), np.float32)
