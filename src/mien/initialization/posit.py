"""POSIT: the pose of a known object from one image.

D. DeMenthon, L. Davis, Model-based object pose in 25 lines of code, IJCV 15, 1995.
"""

from __future__ import annotations

import numpy as np

from mien.arrays import Array
from mien.errors import require
from mien.geometry.camera import Camera

_ITERATIONS = 50
"""At most: they end where the relative depths no longer change."""


def posit(model: Array, image: Array, camera: Camera) -> tuple[Array, Array]:
    """Pose from at least four points that are not coplanar.

    model: (n, 3) head axes; image: (n, 2) pixels. Returns R (3, 3) head -> camera and t (3,), in units of the model.
    Each iteration inverts the scaled orthographic projection linearly, and corrects its error, the relative depth of
    each point, from the pose, until that no longer changes. Raises MienError for degenerate points.
    """
    require(len(model) >= 4, f"POSIT needs four points or more, not {len(model)}")
    origin = int(np.argmin(np.linalg.norm(model - model.mean(axis=0), axis=1)))
    M = model - model[origin]
    singular = np.linalg.svd(M, compute_uv=False)
    require(bool(singular[2] > 1e-6 * singular[0]), "POSIT needs points that do not lie in one plane")
    B = np.linalg.pinv(M)
    xy = camera.rays(image)[:, :2]
    depth_ratio = np.zeros(len(model))  # epsilon_k = Z_k / Z_0 - 1
    for _ in range(_ITERATIONS):
        scaled = xy * (1 + depth_ratio)[:, None] - xy[origin]
        i, j = B @ scaled[:, 0], B @ scaled[:, 1]
        # The two scales agree for exact data; for noisy data their geometric mean works best.
        Z0 = 1 / np.sqrt(np.linalg.norm(i) * np.linalg.norm(j))
        R = _nearest_rotation(i * Z0, j * Z0)
        previous, depth_ratio = depth_ratio, M @ R[2] / Z0
        if np.abs(depth_ratio - previous).max() < 1e-10:
            break
    t_origin = Z0 * np.append(xy[origin], 1.0)
    return R, t_origin - R @ model[origin]


def _nearest_rotation(i: Array, j: Array) -> Array:
    """The rotation whose first two rows are closest to `i` and `j`."""
    U, _, Vt = np.linalg.svd(np.stack([i, j]), full_matrices=False)
    rows = U @ Vt
    return np.vstack([rows, np.cross(rows[0], rows[1])])
