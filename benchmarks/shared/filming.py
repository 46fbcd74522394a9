"""How sequences of our own are filmed: by the camera of the rendered ones, larger than they are kept, before a mottled
background, with noise, and lossless."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from mien.arrays import Array, Float32, Pixels
from mien.evaluation.datasets.rendered import CAMERA
from mien.geometry.camera import Camera

SIZE = (320, 240)
NOISE_SD = 2.0
LAMP = (0.35, -0.45, -0.8)
"""Towards the lamp, in camera axes."""
SWING_DEG, SWING_FRAMES = 60.0, 100
"""How far it swings to either side in sequences of `light`, and how many frames it takes there and back."""


@dataclass(frozen=True)
class Studio:
    """Camera and background (H, W, 3) of pictures that are larger than they are kept."""

    camera: Camera
    background: Float32

    @classmethod
    def build(cls, times: int, rng: np.random.Generator) -> Studio:
        """For pictures that are so many times larger."""
        cx, cy = (times * c + 0.5 * (times - 1) for c in (CAMERA.cx, CAMERA.cy))
        mottled = rng.uniform(30, 200, (12, 16, 3)).astype(np.float32)
        size = (times * SIZE[0], times * SIZE[1])
        camera = Camera(times * CAMERA.focal_px, cx, cy)
        return cls(camera, np.asarray(cv2.resize(mottled, size, interpolation=cv2.INTER_CUBIC), np.float32))


def lamp_at(frame: float) -> Array:
    """Unit vector (3,) towards the lamp, swung about the vertical."""
    angle = np.radians(SWING_DEG) * np.sin(2 * np.pi * frame / SWING_FRAMES)
    x, y, z = LAMP
    lamp = np.array([x * np.cos(angle) + z * np.sin(angle), y, z * np.cos(angle) - x * np.sin(angle)])
    return np.asarray(lamp / np.linalg.norm(lamp))


def taken(large: Float32, rng: np.random.Generator) -> Pixels:
    """The picture as it is kept: shrunk, with noise."""
    image = cv2.resize(large, SIZE, interpolation=cv2.INTER_AREA)
    return np.asarray(np.clip(np.round(image + rng.normal(0, NOISE_SD, image.shape)), 0, 255), np.uint8)


def write_film(path: Path, pictures: Iterable[Pixels]) -> None:
    """Write pictures (H, W, 3) as a lossless video, and say so."""
    writer = None
    for pixels in pictures:
        height, width = pixels.shape[:2]
        writer = writer or cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), 30, (width, height))
        writer.write(pixels[:, :, ::-1])
    if writer:
        writer.release()
    print(path, flush=True)


def triangulated(points: Array, R: Array, t: Array) -> Array:
    """Points (k, 3) of the head from their images (n, k, 2) in n poses R (n, 3, 3), t (n, 3), by least squares."""
    ray = (points - [CAMERA.cx, CAMERA.cy]) / CAMERA.focal_px
    rows = R[:, None, :2] - ray[:, :, :, None] * R[:, None, 2:]
    right = ray * t[:, None, 2:] - t[:, None, :2]
    return np.stack(
        [np.linalg.lstsq(rows[:, k].reshape(-1, 3), right[:, k].ravel(), rcond=None)[0] for k in range(points.shape[1])]
    )
