"""The camera that looks at the face: what it sees is the crop in which the face is tracked."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from mien.appearance.crop import resample
from mien.arrays import Array, Float32
from mien.compiled import kernel
from mien.frame import Frame
from mien.geometry.camera import Camera

_LEAST_COSINE = 1e-6


@dataclass(frozen=True)
class FaceCamera:
    """A camera at the place of the real one that has turned towards a face, and rolled with it.

    Its image is that of the real camera up to a homography, and in it nothing but tilt and pan changes how a face
    looks: neither where in the image the face is, which stretches it towards the border, nor distance, nor roll.

    real: the camera that filmed; ray: (3, 3) rotation from the optical axis to the face, see `ray_rotation`; roll: of
    the face as seen along the ray, radians; focal_px: focal length in pixels; size: side of its image in pixels.
    """

    real: Camera
    ray: Array
    roll: float
    focal_px: float
    size: int

    @cached_property
    def scale(self) -> float:
        """Its pixels per pixel of the real image, at the face and across the direction to the optical axis."""
        return self.focal_px * self._cosine / self.real.focal_px

    @cached_property
    def _homographies(self) -> tuple[Array, Array]:
        """`projection`, and from its pixels to those of the real camera (3, 3)."""
        homographies: tuple[Array, Array] = _homographies(
            self.real.vector, self.ray, self.roll, self.focal_px, self._cosine, self.size
        )
        return homographies

    @property
    def projection(self) -> Array:
        """(3, 3) from points in the axes of the real camera to homogeneous pixels."""
        return self._homographies[0]

    def sample(self, frame: Frame, blur: float = 0.0) -> Float32:
        """Its grey image (size, size) float32 of a frame, blurred by a standard deviation in its pixels."""
        return resample(frame, self._homographies[1], self.size, self.scale, blur)

    @property
    def _cosine(self) -> float:
        """Of the angle between ray and optical axis; a face that is lost may be looked for beside the camera."""
        return max(float(self.ray[2, 2]), _LEAST_COSINE)


@kernel()
def _homographies(real: Any, ray: Any, roll: float, focal_px: float, cosine: float, size: int) -> Any:
    """What `FaceCamera` gives: from the axes of the real camera to its homogeneous pixels (3, 3), and from these to
    those of the real camera (3, 3). real: its `Camera.vector`; cosine: of the angle between ray and optical axis."""
    forth, back, middle = np.empty((3, 3)), np.empty((3, 3)), 0.5 * (size - 1)
    c, s, step = np.cos(roll), np.sin(roll), 1.0 / (focal_px * cosine)  # so that in the middle the scale becomes 1
    for k in range(3):
        x, y, z = ray[k, 0], ray[k, 1], ray[k, 2]
        forth[0, k] = focal_px * (c * x + s * y) + middle * z
        forth[1, k] = focal_px * (c * y - s * x) + middle * z
        forth[2, k] = z
        back[k, 0], back[k, 1] = step * (c * x + s * y), step * (c * y - s * x)
        back[k, 2] = z / cosine - middle * (back[k, 0] + back[k, 1])
    for j in range(3):
        for k in range(2):
            back[k, j] = real[0] * back[k, j] + real[1 + k] * back[2, j]
    return forth, back
