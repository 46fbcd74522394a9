"""From which of several looks at a face it is best learned: one into the camera, with the face as it mostly is.

What tracking knows of a face is what it sees in one frame. Begun with a turned head, in a blink, with the brows raised,
or in a frame that is blurred or coarsely compressed, as the first one of a video often is, every later angle is worse:
by how much was measured (docs/benchmark.md).
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from mien.frame import Frame
from mien.geometry.camera import Camera, back_project
from mien.geometry.rotation import Array, similarity
from mien.initialization.fit import turned_deg
from mien.initialization.landmarks import LANDMARK_NAMES, Landmarks, rows_by_name

PER_DEGREE, PER_UPPER, PER_LOWER = 1 / 50, 20.0, 3.5
"""What a degree of turn, and the distance of brows and lids, and of the lips, from where they mostly are, in distances
of the eyes, add to the error of a track, that of one begun at rest being 1."""
PER_DETAIL, LEAST_DETAIL = 7.0, 0.8
"""What a missing share of the detail that looks mostly have adds to it, and the share below which it is missing: looks
at one face in clean video differ by a sixth. First frames compressed by x264 at rate factors of 28 and 33, with 0.91
and 0.87 of the detail, make errors of 1.2 and 1.6."""
_DETAIL_PX = 96
"""Side of the picture of a face in which its detail is measured."""
_MORE_TURNED_DEG = 15.0
"""How much more than the least turned look another may be turned to count."""
_NAMES = tuple(name for name in LANDMARK_NAMES if name in rows_by_name("mediapipe478"))
_UPPER = np.array(["brow" in name or "eyelid" in name for name in _NAMES])
_LOWER = np.array(["lip" in name or "mouth" in name for name in _NAMES])
_BONE = ~(_UPPER | _LOWER)


def detail(frame: Frame, look: Landmarks) -> float:
    """How much fine detail a frame has where it shows a face, however large, bright and rich in contrast that is there:
    mean size of the Laplacian over the standard deviation of the grey values."""
    size = np.array([frame.width, frame.height])
    (x0, y0), (x1, y1) = (np.clip(at(look.points, axis=0), 0, size).astype(int) for at in (np.min, np.max))
    if x1 - x0 < 2 or y1 - y0 < 2:
        return 0.0
    part = frame.gray_part(slice(y0, y1), slice(x0, x1)).astype(np.float32)
    smaller = min(part.shape) > _DETAIL_PX
    face = cv2.resize(part, (_DETAIL_PX, _DETAIL_PX), interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR)
    return float(np.abs(cv2.Laplacian(face, cv2.CV_32F)).mean() / max(float(face.std()), 1.0))


def expected_errors(looks: Sequence[Landmarks], details: Sequence[float], camera: Camera, R: Array, t: Array) -> Array:
    """Error (n,) of a track that begins with each of n looks at one face, that of one begun at rest and into the camera
    being 1; infinite for those that are much more turned than another.

    looks: with depths, scheme `mediapipe478`; details (n,): see `detail`; R (3, 3), t (3,): pose of the face in the
    first of them.
    """
    points = [_points(look, camera) for look in looks]
    rotations = [_rotation(p, points[0], R) for p in points]
    turned = np.array([turned_deg(rotation, t) for rotation in rotations])
    # What a turn does to a detected face looks like an expression: who is mostly seen from the side has no other face.
    facing = np.flatnonzero(turned <= turned.min() + _MORE_TURNED_DEG)
    moved, typical = _typical([points[k] for k in facing])
    across = ((moved - typical) @ rotations[facing[0]])[:, :, :2]  # the face, not in depth
    apart = np.linalg.norm(across, axis=2)
    upper, lower = (np.sqrt((apart[:, part] ** 2).mean(axis=1)) for part in (_UPPER, _LOWER))
    errors = np.full(len(looks), np.inf)
    there = np.asarray(details)[facing]
    missing = np.maximum(LEAST_DETAIL - there / max(float(np.median(there)), 1e-6), 0)
    errors[facing] = 1 + PER_DEGREE * turned[facing] + PER_UPPER * upper + PER_LOWER * lower + PER_DETAIL * missing
    return errors


def rotation_of(look: Landmarks, first: Landmarks, camera: Camera, R: Array) -> Array:
    """Rotation (3, 3) of a face in a look, where it is R in the first: two degrees, in the median, from that of a
    fit, in a fortieth of its time."""
    return _rotation(_points(look, camera), _points(first, camera), R)


def _rotation(points: Array, first: Array, R: Array) -> Array:
    return np.asarray(similarity(points[_BONE], first[_BONE])[1].T @ R)


def _points(look: Landmarks, camera: Camera) -> Array:
    """Points (m, 3) in camera axes, as `back_project` puts them there."""
    assert look.depths is not None, "looks are the detector's, and have depths"
    points = back_project(np.column_stack([look.points, look.depths]), camera)
    rows = rows_by_name(look.scheme)
    return np.array([points[rows[name]].mean(axis=0) for name in _NAMES])


def _typical(looks: Sequence[Array], iterations: int = 5) -> tuple[Array, Array]:
    """Several looks (m, 3), n of them, their bone moved to that of the median face, eyes at a distance of 1, and that
    face (m, 3)."""
    typical = looks[0] - looks[0][_BONE].mean(axis=0)
    outer = [_NAMES.index(f"{side}_eye_outer_corner") for side in ("left", "right")]
    for _ in range(iterations):
        typical = typical / np.linalg.norm(typical[outer[0]] - typical[outer[1]])
        moved = np.array([_moved(look, *similarity(look[_BONE], typical[_BONE])[:2]) for look in looks])
        typical = np.median(moved, axis=0)
    return moved, typical


def _moved(points: Array, scale: float, A: Array) -> Array:
    """Points (m, 3) about the centre of their bone, scaled and turned."""
    return np.asarray(scale * (points - points[_BONE].mean(axis=0)) @ A.T)
