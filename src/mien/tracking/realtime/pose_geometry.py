"""Poses and projections, compiled: rotations, the landmarks of a face at a pose, and their points in crop and image.

Kernels take arrays, grouped in tuples: `pose`, `person` and `view` are `PoseArrays`, `PersonArrays` and `ViewArrays`. A
pose step is `[w, t, a]`: a rotation vector in camera axes, applied on the left, a translation, animation units.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mien.arrays import Array
from mien.compiled import kernel
from mien.tracking.realtime.definite import transposed_product

STATE_SIZE = 12
"""Entries of the state, Eq. (2), and of a pose step."""


PoseArrays = tuple[Array, Array, Array]
"""A pose for the kernels: R (3, 3) and t (3,) from the model's axes to the camera's, animation (6,)."""
PersonArrays = tuple[Array, Array]
"""A face: landmarks (n, 3) at rest, and their displacements (6, n, 3) by the animation units, in the model's axes."""
ViewArrays = tuple[Array, Array]
"""A crop: projection (3, 3) from points in camera axes to its homogeneous pixels; rotation (3, 3) from the optical axis
to the face."""


@kernel()
def view_angles(M: Any) -> Any:
    """(tilt, pan) of M = Rz(roll) Rx(tilt) Ry(pan), and their derivative (2, 3) by a rotation vector on the left."""
    roll = np.arctan2(-M[0, 1], M[1, 1])
    cr, sr = np.cos(roll), np.sin(roll)
    tilt = np.arcsin(min(max(M[2, 1], -1.0), 1.0))
    pan = np.arctan2(-M[2, 0], M[2, 2])
    ct = max(np.cos(tilt), 1e-3)
    # w = z roll' + Rz x tilt' + Rz Rx y pan', solved for tilt' and pan'.
    J = np.empty((2, 3))
    J[0, 0], J[0, 1], J[0, 2] = cr, sr, 0.0
    J[1, 0], J[1, 1], J[1, 2] = -sr / ct, cr / ct, 0.0
    return tilt, pan, J


@kernel()
def viewing_ray(point: Any, R: Any, t: Any) -> Any:
    """`geometry.rotation.ray_rotation` (3, 3) of a point (3,) in head axes at a pose."""
    x, y, z = rotated(R, point[0], point[1], point[2])
    x, y, z = x + t[0], y + t[1], z + t[2]
    length = np.sqrt(x * x + y * y + z * z)
    x, y, z = x / length, y / length, z / length
    k = 1.0 / (1.0 + z)
    ray = np.empty((3, 3))
    ray[0, 0], ray[0, 1], ray[0, 2] = 1.0 - k * x * x, -k * x * y, x
    ray[1, 0], ray[1, 1], ray[1, 2] = -k * x * y, 1.0 - k * y * y, y
    ray[2, 0], ray[2, 1], ray[2, 2] = -x, -y, z
    return ray


@kernel()
def sight_of(point: Any, R: Any, t: Any) -> Any:
    """How a head is seen: `viewing_ray` (3, 3) of a point; along it tilt and pan (2,) and roll of the head in radians,
    and the distance of its origin; and the unit vector (3,) to its origin in camera and in head axes."""
    ray = viewing_ray(point, R, t)
    angles, sight, seen_from = np.empty(2), np.empty(3), np.empty(3)
    angles[0], angles[1], by_rotation = angles_along_ray(ray, R)
    roll = np.arctan2(by_rotation[0, 1], by_rotation[0, 0])
    length = np.sqrt(t[0] * t[0] + t[1] * t[1] + t[2] * t[2])
    for k in range(3):
        sight[k] = t[k] / length
        seen_from[k] = (R[0, k] * t[0] + R[1, k] * t[1] + R[2, k] * t[2]) / length
    distance = ray[0, 2] * t[0] + ray[1, 2] * t[1] + ray[2, 2] * t[2]
    return ray, angles, roll, distance, sight, seen_from


@kernel()
def angles_along_ray(ray: Any, R: Any) -> Any:
    """`view_angles` of a head with rotation R (3, 3), seen along a ray that is given by the rotation (3, 3) from the
    optical axis to it."""
    M = transposed_product(ray, R)
    for r in range(3):  # times FACING
        M[r, 1], M[r, 2] = -M[r, 1], -M[r, 2]
    return view_angles(M)


@kernel()
def rotated(R: Any, x: float, y: float, z: float) -> Any:
    """R h of a point in head axes."""
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
    )


@kernel()
def rotate(w: Any, R: Any) -> Any:
    """exp(w) R (Rodrigues): (3,), (3, 3) -> (3, 3)."""
    angle = np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    a, b = 1.0, 0.5
    if angle > 1e-6:
        a, b = np.sin(angle) / angle, (1 - np.cos(angle)) / (angle * angle)
    out = np.empty((3, 3))
    for c in range(3):
        x, y, z = R[0, c], R[1, c], R[2, c]
        # K v = w x v and K K v = w (w . v) - |w|^2 v
        along = w[0] * x + w[1] * y + w[2] * z
        keep = 1.0 - b * angle * angle
        out[0, c] = keep * x + a * (w[1] * z - w[2] * y) + b * along * w[0]
        out[1, c] = keep * y + a * (w[2] * x - w[0] * z) + b * along * w[1]
        out[2, c] = keep * z + a * (w[0] * y - w[1] * x) + b * along * w[2]
    return out


@kernel()
def rotation_vector(R: Any, R_from: Any) -> Any:
    """Rotation vector (3,) from one rotation (3, 3) to another, less than about 170 degrees apart."""
    w = np.empty(3)
    w[0], w[1], w[2] = 0.0, 0.0, 0.0
    trace = 0.0  # of R R_from^T, and from its antisymmetric part the sine and the axis
    for c in range(3):
        x, y, z, X, Y, Z = R_from[0, c], R_from[1, c], R_from[2, c], R[0, c], R[1, c], R[2, c]
        w[0] += 0.5 * (y * Z - z * Y)
        w[1] += 0.5 * (z * X - x * Z)
        w[2] += 0.5 * (x * Y - y * X)
        trace += x * X + y * Y + z * Z
    sine = np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    scale = np.arctan2(sine, 0.5 * (trace - 1.0)) / sine if sine > 1e-9 else 1.0
    for k in range(3):
        w[k] *= scale
    return w


@kernel()
def step_between(R: Any, t: Any, a: Any, R_to: Any, t_to: Any, a_to: Any) -> Any:
    """Pose step (12,) from one pose to another, less than about 170 degrees apart."""
    turn, step = rotation_vector(R_to, R), np.empty(STATE_SIZE)
    for k in range(3):
        step[k], step[3 + k] = turn[k], t_to[k] - t[k]
    for k in range(6):
        step[6 + k] = a_to[k] - a[k]
    return step


@kernel()
def step_back(pose: Any, step: Any) -> Any:
    """The pose from which a pose step (12,) leads to this one."""
    R, t, a = pose
    return rotate(-step[:3], R), t - step[3:6], a - step[6:]


@kernel()
def displacement(i: int, units: Any, a: Any) -> Any:
    """Displacement of landmark i by an animation: three coordinates in head axes."""
    x, y, z = 0.0, 0.0, 0.0
    for k in range(a.size):
        x += a[k] * units[k, i, 0]
        y += a[k] * units[k, i, 1]
        z += a[k] * units[k, i, 2]
    return x, y, z


@kernel()
def landmark(i: int, person: Any, a: Any) -> Any:
    """Landmark i of a face with an animation: three coordinates in head axes."""
    neutral, units = person
    x, y, z = displacement(i, units, a)
    return neutral[i, 0] + x, neutral[i, 1] + y, neutral[i, 2] + z


@kernel()
def in_camera(person: Any, pose: Any) -> Any:
    """Landmarks (n, 3) in camera axes."""
    R, t, a = pose
    X = np.empty((person[0].shape[0], 3))
    for i in range(X.shape[0]):
        x, y, z = landmark(i, person, a)
        x, y, z = rotated(R, x, y, z)
        X[i, 0], X[i, 1], X[i, 2] = x + t[0], y + t[1], z + t[2]
    return X


@kernel()
def reported_landmarks(person: Any, offsets: Any, pose: Any, lids: Any, closing: Any, camera: Any) -> Any:
    """The first m landmarks as they are reported: (m, 3) in camera axes, and (m, 2) in the image, NaN behind the
    camera.

    offsets (m, 3): from the landmarks of the model to those reported, head axes; lids (2, k): rows of the upper and the
    lower lids; closing (2,): how far each moves towards the other, as shares of the opening.
    """
    m = offsets.shape[0]
    X, image, R = in_camera(person, pose)[:m], np.empty((m, 2)), pose[0]
    for i in range(m):
        x, y, z = rotated(R, offsets[i, 0], offsets[i, 1], offsets[i, 2])
        X[i, 0], X[i, 1], X[i, 2] = X[i, 0] + x, X[i, 1] + y, X[i, 2] + z
    for k in range(lids.shape[1]):
        for r in range(3):
            upper, lower = X[lids[0, k], r], X[lids[1, k], r]
            X[lids[0, k], r] += closing[0] * (lower - upper)
            X[lids[1, k], r] += closing[1] * (upper - lower)
    for i in range(m):
        if X[i, 2] > 1e-6:
            scale = camera[0] / X[i, 2]
            image[i, 0], image[i, 1] = scale * X[i, 0] + camera[1], scale * X[i, 1] + camera[2]
        else:
            image[i, 0], image[i, 1] = np.nan, np.nan
    return X, image


@kernel()
def facing_camera(X: Any, normals: Any, R: Any, camera: Any, width: int, height: int, least: float) -> Any:
    """Which points X (n, 3) in camera axes, with normals (n, 3) in head axes, lie inside the image and face the camera:
    the cosine of the angle between the normal and the direction to the camera exceeds `least`."""
    seen = np.empty(X.shape[0], np.bool_)
    for i in range(X.shape[0]):
        x, y, z = X[i, 0], X[i, 1], X[i, 2]
        towards = 0.0
        for r in range(3):
            towards -= (R[0, r] * x + R[1, r] * y + R[2, r] * z) * normals[i, r]
        u, v = camera[0] * x + camera[1] * z, camera[0] * y + camera[2] * z
        inside = z > 1e-6 and 0.0 <= u <= (width - 1) * z and 0.0 <= v <= (height - 1) * z
        seen[i] = inside and towards > least * np.sqrt(x * x + y * y + z * z)
    return seen


@kernel()
def head_to_crop(R: Any, t: Any, view: Any) -> Any:
    """From points in head axes at a pose to homogeneous pixels of a crop: a matrix (3, 4) row by row, as numbers, which
    are faster to pass than arrays."""
    P, M = view[0], np.empty((3, 4))
    for r in range(3):
        for c in range(3):
            M[r, c] = P[r, 0] * R[0, c] + P[r, 1] * R[1, c] + P[r, 2] * R[2, c]
        M[r, 3] = P[r, 0] * t[0] + P[r, 1] * t[1] + P[r, 2] * t[2]
    upper = M[0, 0], M[0, 1], M[0, 2], M[0, 3], M[1, 0], M[1, 1], M[1, 2], M[1, 3]
    return *upper, M[2, 0], M[2, 1], M[2, 2], M[2, 3]


@kernel()
def project_to_crop(x: float, y: float, z: float, to_crop: Any) -> Any:
    """(u, v) in the crop of a point in head axes, and the depth that they were divided by."""
    a, b, c, d, e, f, g, h, i, j, k, m = to_crop
    depth = max(i * x + j * y + k * z + m, 0.1)
    return (a * x + b * y + c * z + d) / depth, (e * x + f * y + g * z + h) / depth, depth


@kernel()
def projection_of(view: Any) -> Any:
    """The projection (3, 3) of a view row by row, as numbers."""
    P = view[0]
    return P[0, 0], P[0, 1], P[0, 2], P[1, 0], P[1, 1], P[1, 2], P[2, 0], P[2, 1], P[2, 2]


@kernel()
def gradient_by_pose(gu: float, gv: float, at: Any, Y: Any, projection: Any) -> Any:
    """Gradient, six numbers, by the rotation and translation of a pose step, of a quantity with gradient (gu, gv) by
    crop pixel, at a point R h = Y that `project_to_crop` puts `at` (u, v, depth). The last three are the gradient by
    the point itself."""
    a, b, c, d, e, f, g, h, i = projection
    u, v, depth = at
    gu, gv = gu / depth, gv / depth
    gw = -(u * gu + v * gv)
    x, y, z = a * gu + d * gv + g * gw, b * gu + e * gv + h * gw, c * gu + f * gv + i * gw
    return Y[1] * z - Y[2] * y, Y[2] * x - Y[0] * z, Y[0] * y - Y[1] * x, x, y, z


@kernel()
def project(person: Any, pose: Any, view: Any) -> Any:
    """Landmarks in the crop (n, 2) and their derivative (n, 2, 12) by [rotation vector, t, animation]."""
    (R, t, a), units = pose, person[1]
    n, projection, to_crop = units.shape[1], projection_of(view), head_to_crop(R, t, view)
    q, J = np.empty((n, 2)), np.empty((n, 2, STATE_SIZE))
    for i in range(n):
        x, y, z = landmark(i, person, a)
        Y, at = rotated(R, x, y, z), project_to_crop(x, y, z, to_crop)
        q[i, 0], q[i, 1] = at[0], at[1]
        for r in range(2):
            by_pose = gradient_by_pose(1.0 - r, float(r), at, Y, projection)
            for k in range(6):
                J[i, r, k] = by_pose[k]
            for k in range(units.shape[0]):
                x, y, z = rotated(R, units[k, i, 0], units[k, i, 1], units[k, i, 2])
                J[i, r, 6 + k] = by_pose[3] * x + by_pose[4] * y + by_pose[5] * z
    return q, J
