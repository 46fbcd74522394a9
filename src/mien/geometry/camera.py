"""The pinhole camera: projection and its Jacobian.

Axes: x right, y down, z forward. Pixel centres have integer coordinates; u points right, v down.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mien.arrays import Array, Mask
from mien.errors import MienError, require
from mien.lens import Lens

DEFAULT_FOV_DEG = 60.0
"""Field of view assumed for an unknown camera along the longer side of its image."""
_WIDEST_DEG = 150.0
"""Horizontal field of view beyond which no real lens follows the pinhole model."""
_NARROWEST_DEG = 1e-3
"""Horizontal field of view that no lens has, with which distances are still told."""
_SQUARE, _STRAIGHT = 0.02, 0.005
"""Largest shares by which the pixels of a calibrated camera may differ from squares, and its lens may move the corners
of the image, so that its images are used as they are."""
_MOSTLY_SHOWN = 0.5
"""Share of a straight image that a lens shows at least."""
UNKNOWN_LOG_SD = 0.35
"""Standard deviation of the logarithm of the focal length of an unknown camera: webcams and phones see 55 to 80 degrees
along the longer side, lenses for interviews 25 to 45."""


@dataclass(frozen=True)
class Camera:
    """Pinhole camera: focal length and principal point (cx, cy), all in pixels. focal_log_sd: standard deviation of the
    logarithm of a focal length that is assumed; 0 for one that is known. Raises MienError for values that are no finite
    numbers, and for a focal length that is not positive.

    lens: what has bent the images of the video, None if nothing has. The camera is that of the images straightened:
    `mien.track` and whatever else opens a video do that.
    """

    focal_px: float
    cx: float
    cy: float
    focal_log_sd: float = 0.0
    lens: Lens | None = None

    def __post_init__(self) -> None:
        values = (self.focal_px, self.cx, self.cy, self.focal_log_sd)
        numbers = all(isinstance(v, Real) and math.isfinite(v) for v in values)
        require(numbers, f"camera {values} contains a value that is not a finite number")
        require(self.focal_px > 0, f"the focal length must be positive, not {self.focal_px:g} pixels")
        require(self.focal_log_sd >= 0, f"the focal length has a standard deviation of {self.focal_log_sd:g}")
        for name, value in zip(("focal_px", "cx", "cy", "focal_log_sd"), values, strict=True):
            object.__setattr__(self, name, float(value))  # NumPy's numbers cannot be saved as JSON

    def require_possible(self, width: int) -> None:
        """Raise MienError if this camera sees more across an image of this width in pixels than a pinhole can, as where
        a focal length is given in millimetres, or next to nothing."""
        widest, narrowest = (0.5 * width / math.tan(math.radians(fov) / 2) for fov in (_WIDEST_DEG, _NARROWEST_DEG))
        require(
            self.focal_px >= widest,
            f"a focal length of {self.focal_px:g} pixels sees more than {_WIDEST_DEG:g} degrees across a width of "
            f"{width} pixels; mien assumes a lens without distortion; correct the focal length",
        )
        require(
            self.focal_px <= narrowest,
            f"a focal length of {self.focal_px:g} pixels sees less than {_NARROWEST_DEG:g} degrees across a width of "
            f"{width} pixels, as no lens does; correct the focal length",
        )

    @classmethod
    def from_fov(cls, width: int, height: int, fov_deg: float = DEFAULT_FOV_DEG) -> Camera:
        """Centred camera for an image of this size in pixels, with a horizontal field of view in degrees. Raises
        MienError if that does not lie between 0 and 180."""
        require(0 < fov_deg < 180, f"the field of view must lie between 0 and 180 degrees, not {fov_deg:g}")
        return cls.centred(0.5 * width / math.tan(math.radians(fov_deg) / 2), width, height)

    @classmethod
    def unknown(cls, width: int, height: int) -> Camera:
        """The camera assumed for an image of this size in pixels of which nothing is known. A phone that is held
        upright sees as much along its longer side as one that is held across."""
        focal_px = cls.from_fov(max(width, height), 1).focal_px
        return replace(cls.centred(focal_px, width, height), focal_log_sd=UNKNOWN_LOG_SD)

    @classmethod
    def centred(cls, focal_px: float, width: int, height: int) -> Camera:
        """Camera with its principal point at the centre of an image of this size in pixels."""
        return cls(float(focal_px), 0.5 * (width - 1), 0.5 * (height - 1))

    @classmethod
    def from_matrix(cls, K: ArrayLike, distortion: ArrayLike | None = None, *, fisheye: bool = False) -> Camera:
        """Camera of a calibration by `cv2.calibrateCamera` or, if `fisheye`, by `cv2.fisheye.calibrate`.

        K: camera matrix (3, 3) in pixels; distortion: none, or 4, 5, 8, 12 or 14 coefficients, of a fisheye 4. Raises
        MienError for anything else, and for coefficients that no lens has.
        """
        matrix = _numbers(K, "camera matrix")
        _check_matrix(matrix)
        coefficients = _numbers(() if distortion is None else distortion, "distortion coefficients").ravel()
        lens = _checked_lens(matrix, coefficients, fisheye)
        (focal, _, cx), (_, _, cy), _ = lens.straight_matrix.tolist()
        (fx, skew, _), (_, fy, _), _ = lens.camera_matrix
        straight = lens.bending <= _STRAIGHT and max(abs(fx - fy), abs(skew)) <= _SQUARE * min(fx, fy)
        return cls(focal, cx, cy, lens=None if straight else lens)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        numbers = {name: getattr(self, name) for name in ("focal_px", "cx", "cy", "focal_log_sd")}
        if self.lens is None:
            return numbers
        calibration: dict[str, Any] = {
            "camera_matrix": [list(row) for row in self.lens.camera_matrix],
            "dist_coeffs": list(self.lens.dist_coeffs),
        }
        return numbers | calibration | ({"distortion_model": "fisheye"} if self.lens.fisheye else {})

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


def _numbers(values: ArrayLike, what: str) -> Array:
    """The array of these values. what: they are meant to be. Raises MienError if they are no numbers in equal rows."""
    try:
        return np.asarray(values, float)
    except (TypeError, ValueError) as error:
        raise MienError(f"{what}: {values!r} is no array of numbers ({error}); correct it") from error


def _check_matrix(K: Array) -> None:
    """Raise MienError if this is no camera matrix (3, 3)."""
    ordinary = K.shape == (3, 3) and np.isfinite(K).all() and K[0, 0] > 0 and K[1, 1] > 0
    ordinary = ordinary and [K[1, 0], *K[2]] == [0, 0, 0, 1]
    require(bool(ordinary), f"{K.tolist()} is no camera matrix; give [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in pixels")


def _checked_lens(K: Array, distortion: Array, fisheye: bool) -> Lens:
    """The lens with a camera matrix and these coefficients. Raises MienError if they are none, or show less of the
    image than a lens does."""
    counts = (0, 4) if fisheye else (0, 4, 5, 8, 12, 14)
    known = ", ".join(map(str, counts[1:]))
    require(
        distortion.size in counts and bool(np.isfinite(distortion).all()),
        f"{distortion.tolist()} are no distortion coefficients{' of a fisheye lens' * fisheye}; give the {known} of "
        "OpenCV",
    )
    lens = Lens(tuple(map(tuple, K.tolist())), tuple(distortion.tolist()), fisheye)
    if fisheye:
        remedy = "if they were not calibrated as a fisheye's, by cv2.fisheye, do not say so"
    else:
        remedy = 'if they were calibrated as a fisheye\'s, by cv2.fisheye, say so: "distortion_model": "fisheye"'
    require(
        lens.shown_share >= _MOSTLY_SHOWN,
        f"with the distortion coefficients {distortion.tolist()} the lens shows {100 * lens.shown_share:.0f} % of the "
        f"image; {remedy}",
    )
    return lens


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
