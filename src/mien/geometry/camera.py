"""The pinhole camera: projection and its Jacobian.

Axes: x right, y down, z forward. Pixel centres have integer coordinates; u points right, v down.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real

import numpy as np

from mien.arrays import Array, Mask
from mien.errors import require

DEFAULT_FOV_DEG = 60.0
"""Field of view assumed for an unknown camera along the longer side of its image."""


@dataclass(frozen=True)
class Camera:
    """Pinhole camera: focal length and principal point (cx, cy), all in pixels."""

    focal_px: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        values = (self.focal_px, self.cx, self.cy)
        numbers = all(isinstance(v, Real) and math.isfinite(v) for v in values)
        require(numbers, f"camera {values} contains a value that is not a finite number")
        require(self.focal_px > 0, f"the focal length must be positive, not {self.focal_px:g} pixels")
        for name, value in zip(("focal_px", "cx", "cy"), values, strict=True):
            object.__setattr__(self, name, float(value))  # NumPy's numbers cannot be saved as JSON

    @classmethod
    def from_fov(cls, width: int, height: int, fov_deg: float = DEFAULT_FOV_DEG) -> Camera:
        """Centred camera for an image of this size in pixels, with a horizontal field of view in degrees."""
        require(0 < fov_deg < 180, f"the field of view must lie between 0 and 180 degrees, not {fov_deg:g}")
        return cls.centred(0.5 * width / math.tan(math.radians(fov_deg) / 2), width, height)

    @classmethod
    def unknown(cls, width: int, height: int) -> Camera:
        """The camera assumed for an image of this size in pixels of which nothing is known. A phone that is held
        upright sees as much along its longer side as one that is held across."""
        return cls.centred(cls.from_fov(max(width, height), 1).focal_px, width, height)

    @classmethod
    def centred(cls, focal_px: float, width: int, height: int) -> Camera:
        """Camera with its principal point at the centre of an image of this size in pixels."""
        return cls(float(focal_px), 0.5 * (width - 1), 0.5 * (height - 1))

    @property
    def vector(self) -> Array:
        """(3,) focal length and principal point, the format of the kernels."""
        return np.array([self.focal_px, self.cx, self.cy], dtype=float)

    @property
    def matrix(self) -> Array:
        """(3, 3) from points in camera axes to homogeneous pixels."""
        return np.array([[self.focal_px, 0.0, self.cx], [0.0, self.focal_px, self.cy], [0.0, 0.0, 1.0]])

    def project(self, X: Array) -> tuple[Array, Mask]:
        """Project points to the image, with a mask of those in front of the camera.

        (..., 3) in camera axes -> (..., 2) in pixels, (...) bool. Points behind the camera are NaN.
        """
        z = X[..., 2:]
        valid = z > 1e-6
        points = X[..., :2] * (self.focal_px / np.where(valid, z, np.nan))
        points += self.vector[1:]
        return points, valid[..., 0]

    def rays(self, points: Array) -> Array:
        """Points (..., 3) in camera axes at a depth of 1 that are seen at pixels (..., 2)."""
        rays = np.ones((*points.shape[:-1], 3))
        rays[..., :2] = (points - [self.cx, self.cy]) / self.focal_px
        return rays

    def in_image(self, X: Array, width: int, height: int) -> Mask:
        """Mask (...) of the points (..., 3), camera axes, that project into an image of this size in pixels."""
        u, v, z = self.focal_px * X[..., 0], self.focal_px * X[..., 1], X[..., 2]
        across = (u >= -self.cx * z) & (u <= (width - 1 - self.cx) * z)
        return np.asarray((z > 1e-6) & across & (v >= -self.cy * z) & (v <= (height - 1 - self.cy) * z))

    def J_pixel_point(self, X: Array) -> Array:
        """Jacobian of `project`: pixels with respect to camera points. (..., 3) -> (..., 2, 3)."""
        x, y, z = X[..., 0], X[..., 1], X[..., 2]
        f_z = self.focal_px / z
        J = np.zeros((*X.shape[:-1], 2, 3))
        J[..., 0, 0] = f_z
        J[..., 1, 1] = f_z
        J[..., 0, 2] = -f_z * x / z
        J[..., 1, 2] = -f_z * y / z
        return J


def line_of_sight(points: Array, camera: Camera) -> Array:
    """Unit vector (3,) in camera axes towards the middle of image points (n, 2), that of a box around them."""
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    ray = camera.rays(middle)
    return np.asarray(ray / np.linalg.norm(ray))


def at_distances(points: Array, distances: Array, sight: Array, camera: Camera) -> Array:
    """Points (n, 3) in camera axes that are seen at image points (n, 2), at distances (n,) along a line of sight
    (3,)."""
    rays = camera.rays(points)
    return np.asarray(rays * (distances / (rays @ sight))[:, None])


def back_project(points: Array, camera: Camera) -> Array:
    """Back-project pixels with relative depths in pixels to camera axes, with the head's centre at a depth of one focal
    length.

    (n, 3) -> (n, 3); there one pixel corresponds to one unit of length. A network that sees a face in a crop gives its
    depths along the line of sight to it, whatever the place in the image.
    """
    sight = line_of_sight(points[:, :2], camera)
    return at_distances(points[:, :2], camera.focal_px / sight[2] + points[:, 2], sight, camera)
