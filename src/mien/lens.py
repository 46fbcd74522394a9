"""A calibrated lens that bends straight lines, by OpenCV's model, and how its images become straight."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from mien.arrays import Array, Float32, Mask, Pixels

_NOWHERE = -1e4
"""Coordinate outside every image."""
_STEPS = 32
"""Cells along each side of the grid by which a lens is judged."""


@dataclass(frozen=True)
class Lens:
    """camera_matrix: rows of the matrix (3, 3) of `cv2.calibrateCamera`, in pixels; dist_coeffs: its 0, 4, 5, 8, 12 or
    14 distortion coefficients; fisheye: whether both are those of `cv2.fisheye.calibrate`, with 0 or 4 coefficients."""

    camera_matrix: tuple[tuple[float, ...], ...]
    dist_coeffs: tuple[float, ...]
    fisheye: bool = False

    @property
    def straight_matrix(self) -> Array:
        """The matrix (3, 3) of the images that `straighten` gives: square pixels, the middle of the image as large as
        it was."""
        (fx, _, cx), (_, fy, cy), _ = self.camera_matrix
        return np.array([[0.5 * (fx + fy), 0.0, cx], [0.0, 0.5 * (fx + fy), cy], [0.0, 0.0, 1.0]])

    @property
    def bending(self) -> float:
        """By which share of their distance from the middle of the image the distortion moves its corners, if the middle
        is the principal point."""
        (fx, _, cx), (_, fy, cy), _ = self.camera_matrix
        x, y = cx / fx, cy / fy
        corners = np.array([[x, y, 1.0], [-x, y, 1.0], [x, -y, 1.0], [-x, -y, 1.0]])
        none, plain = np.zeros(3), np.eye(3)
        if self.fisheye:
            seen = cv2.fisheye.projectPoints(corners[:, None], none, none, plain, self._coefficients)[0]
        else:
            seen = cv2.projectPoints(corners, none, none, plain, self._coefficients)[0]
        moved = np.linalg.norm(seen.reshape(-1, 2) - corners[:, :2], axis=1)
        return float(moved.max() / max(np.hypot(x, y), 1e-9))

    @property
    def shown_share(self) -> float:
        """The share of a straight image, in whose middle the principal point is, that the lens shows once; the rest is
        an artefact of coefficients that were fitted to what is nearer to the middle."""
        cx, cy = (max(self.camera_matrix[k][2], 1.0) for k in (0, 1))
        scale = np.diag([_STEPS / (2 * cx), _STEPS / (2 * cy), 1.0])
        _, _, shown = self._places(scale @ self.straight_matrix, _STEPS + 1, _STEPS + 1)
        return float(shown.mean())

    def straighten(self, pixels: Pixels) -> Pixels:
        """An image (H, W) or (H, W, 3) as a pinhole camera with `straight_matrix` would have taken it; black where the
        lens shows nothing."""
        height, width = pixels.shape[:2]
        return np.asarray(cv2.remap(pixels, *_maps(self, width, height), cv2.INTER_LINEAR), np.uint8)

    def _places(self, matrix: Array, width: int, height: int) -> tuple[Float32, Float32, Mask]:
        """Columns and rows (H, W) of the lens's image that the pixels of a straight one with a matrix (3, 3) show, and
        which of these (H, W) the lens shows: too far out a polynomial turns back, and would show parts of the image a
        second time, mirrored or upside down."""
        K = np.array(self.camera_matrix, np.float32)
        map_of = cv2.fisheye.initUndistortRectifyMap if self.fisheye else cv2.initUndistortRectifyMap
        columns, rows = map_of(K, self._coefficients, np.eye(3), matrix, (width, height), cv2.CV_32FC1)
        # Neither takes account of a skew.
        columns = columns + K[0, 1] / K[1, 1] * (rows - K[1, 2])
        (c_down, c_right), (r_down, r_right) = np.gradient(columns), np.gradient(rows)
        x, y = np.arange(width) - matrix[0, 2], np.arange(height)[:, None] - matrix[1, 2]
        outwards = (columns - K[0, 2]) * x + (rows - K[1, 2]) * y >= 0
        return columns, rows, outwards & (c_right * r_down > c_down * r_right)

    @property
    def _coefficients(self) -> Array:
        return np.array(self.dist_coeffs or (0.0,) * 4)


@lru_cache(maxsize=4)
def _maps(lens: Lens, width: int, height: int) -> tuple[NDArray[np.int16], NDArray[np.uint16]]:
    """The maps of `cv2.remap` for images of this size, in fixed point, with which it is fastest."""
    columns, rows, shown = lens._places(lens.straight_matrix, width, height)
    whole, fractions = cv2.convertMaps(np.where(shown, columns, np.float32(_NOWHERE)), rows, cv2.CV_16SC2)
    return whole, fractions
