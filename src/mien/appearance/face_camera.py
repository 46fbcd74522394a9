"""The camera that looks at the face: what it sees is the crop in which the face is tracked."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mien.appearance.crop import resample
from mien.arrays import Array, Float32
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
    def projection(self) -> Array:
        """(3, 3) from points in the axes of the real camera to homogeneous pixels."""
        f, middle = self.focal_px, 0.5 * (self.size - 1)
        c, s = f * math.cos(self.roll), f * math.sin(self.roll)
        return np.asarray(np.array([[c, s, middle], [-s, c, middle], [0, 0, 1]]) @ self.ray.T)

    def sample(self, frame: Frame, blur: float = 0.0) -> Float32:
        """Its grey image (size, size) float32 of a frame, blurred by a standard deviation in its pixels."""
        step, middle = 1 / (self.focal_px * self._cosine), 0.5 * (self.size - 1)  # in the middle w becomes 1
        c, s = step * math.cos(self.roll), step * math.sin(self.roll)
        back = np.array([[c, -s, (s - c) * middle], [s, c, -(s + c) * middle], [0, 0, self.focal_px * step]])
        return resample(frame, self.real.matrix @ (self.ray @ back), self.size, self.scale, blur)

    @property
    def _cosine(self) -> float:
        """Of the angle between ray and optical axis; a face that is lost may be looked for beside the camera."""
        return max(float(self.ray[2, 2]), _LEAST_COSINE)
