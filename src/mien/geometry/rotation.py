"""Rotations: exponential map, its inverse, and the Euler angles that are reported.

Head axes are CANDIDE's (x to the subject's left, y up, z out of the face); camera axes are x right,
y down, z forward. A head that faces the camera has `R_camera_head = FACING`; all reported angles are those
of `R_camera_head @ FACING`, which is then the identity. Other orders are used inside: tilt, pan and roll of rendered
views in `appearance/views.py`, those of the paper's measures in `evaluation/protocols.py`.
"""

from __future__ import annotations

import math

import numpy as np

from mien.arrays import Array

FACING: Array = np.diag([1.0, -1.0, -1.0])
"""(3, 3) rotation head -> camera of a face that faces the camera."""


def hat(v: Array) -> Array:
    """Cross-product matrix of a vector: `hat(v) @ w == cross(v, w)`. (3,) -> (3, 3)."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def exp(v: Array) -> Array:
    """Rotation by `|v|` radians about `v` (Rodrigues). (3,) -> (3, 3)."""
    v = np.asarray(v, dtype=float)
    angle = float(np.sqrt(v @ v))
    K = hat(v)
    if angle < 1e-6:  # Taylor series: the closed form divides by the angle
        return np.asarray(np.eye(3) + K + 0.5 * K @ K)
    return np.asarray(np.eye(3) + np.sin(angle) / angle * K + (1 - np.cos(angle)) / angle**2 * K @ K)


def log(R: Array) -> Array:
    """Rotation vector of a rotation matrix, its angle in [0, pi]. (3, 3) -> (3,)."""
    w = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine, cosine = float(np.linalg.norm(w)), 0.5 * (float(np.trace(R)) - 1)
    if sine > 1e-6:
        return np.asarray(w * (np.arctan2(sine, cosine) / sine))
    if cosine > 0:
        return w
    # Near pi the antisymmetric part vanishes; the axis is the longest column of R + I.
    B = R + np.eye(3)
    axis = B[:, int(np.argmax(np.diag(B)))]
    return np.asarray(np.pi * axis / np.linalg.norm(axis))


def left_jacobian(v: Array) -> Array:
    """J with `exp(v + dv) = exp(J dv) exp(v)` to first order. (3,) -> (3, 3)."""
    angle = float(np.linalg.norm(v))
    K = hat(v)
    if angle < 1e-5:
        return np.asarray(np.eye(3) + 0.5 * K + K @ K / 6)
    return np.asarray(np.eye(3) + (1 - np.cos(angle)) / angle**2 * K + (angle - np.sin(angle)) / angle**3 * K @ K)


def euler_from_matrix(R: Array) -> Array:
    """Angles (x, y, z) in radians of `R = Rx(x) Ry(y) Rz(z)`, the order of OpenFace. (..., 3, 3) -> (..., 3)."""
    x = np.arctan2(-R[..., 1, 2], R[..., 2, 2])
    y = np.arcsin(np.clip(R[..., 0, 2], -1.0, 1.0))
    z = np.arctan2(-R[..., 0, 1], R[..., 0, 0])
    return np.stack([x, y, z], axis=-1)


def matrix_from_euler(angles: Array) -> Array:
    """`Rx(x) Ry(y) Rz(z)` of angles (x, y, z) in radians. (..., 3) -> (..., 3, 3)."""
    x = np.moveaxis(np.asarray(angles, dtype=float), -1, 0)
    (sx, sy, sz), (cx, cy, cz) = np.sin(x), np.cos(x)
    rows = (
        (cy * cz, -cy * sz, sy),
        (cx * sz + sx * sy * cz, cx * cz - sx * sy * sz, -sx * cy),
        (sx * sz - cx * sy * cz, sx * cz + cx * sy * sz, cx * cy),
    )
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def euler_jacobian(R: Array) -> Array:
    """J with `euler(exp(w) R) = euler(R) + J w` to first order: Euler angles by rotation vector in camera axes.

    (3, 3) -> (3, 3). Singular if the middle angle is 90 degrees.
    """
    x, y, _ = euler_from_matrix(R)
    sx, cx, sy, cy = np.sin(x), np.cos(x), np.sin(y), np.cos(y)
    # Columns: the rotation axes of the angles x, y and z, in camera axes.
    axes = np.array([[1.0, 0.0, sy], [0.0, cx, -sx * cy], [0.0, sx, cx * cy]])
    return np.linalg.inv(axes) if abs(cy) > 1e-6 else np.asarray(np.linalg.pinv(axes))


def ray_rotation(X: Array) -> Array:
    """Smallest rotation (3, 3) of the optical axis onto the ray to a point X (3,) in camera axes."""
    x, y, z = (X / math.sqrt(X @ X)).tolist()
    k = 1 / (1 + z)
    return np.array([[1 - k * x * x, -k * x * y, x], [-k * x * y, 1 - k * y * y, y], [-x, -y, z]])


def angle_between(Ra: Array, Rb: Array) -> Array:
    """Angle in radians of the rotation from `Ra` to `Rb`. (..., 3, 3), (..., 3, 3) -> (...)."""
    relative = np.swapaxes(Ra, -1, -2) @ Rb
    w = np.stack(
        [
            relative[..., 2, 1] - relative[..., 1, 2],
            relative[..., 0, 2] - relative[..., 2, 0],
            relative[..., 1, 0] - relative[..., 0, 1],
        ],
        axis=-1,
    )
    trace = np.trace(relative, axis1=-2, axis2=-1)
    return np.asarray(np.arctan2(np.linalg.norm(w, axis=-1), trace - 1))


def rotation_onto(source: Array, target: Array) -> tuple[Array, float]:
    """Wahba's problem: R (3, 3) that minimises the squares of `target - R source`, for points (n, 3), and the sum of
    the scalar products of `target` and `R source`."""
    U, S, Vt = np.linalg.svd(target.T @ source)
    D = np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    return U @ D @ Vt, float((S * np.diag(D)).sum())


def similarity(source: Array, target: Array) -> tuple[float, Array, Array]:
    """Similarity s, R (3, 3), t (3,) that minimises the squares of `target - (s R source + t)`, for points (n, 3).
    Umeyama 1991.
    """
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    R, overlap = rotation_onto(a, b)
    scale = overlap / float((a**2).sum())
    return scale, R, target.mean(axis=0) - scale * R @ source.mean(axis=0)


def is_rotation(R: object) -> bool:
    """Whether this is a rotation matrix (3, 3), to a ten-thousandth."""
    return (
        isinstance(R, np.ndarray)
        and R.shape == (3, 3)
        and bool(np.allclose(R @ R.T, np.eye(3), atol=1e-4))
        and float(np.linalg.det(R)) > 0
    )
