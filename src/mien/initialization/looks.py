"""From which of several looks at a face it is best learned: one into the camera, with the face as it mostly is.

What tracking knows of a face is what it sees in one frame. Begun with a turned head, in a blink or with the brows
raised, every later angle is worse: by how much was measured (docs/benchmark.md).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mien.geometry.camera import Camera, back_project
from mien.geometry.rotation import Array, similarity
from mien.initialization.fit import turned_deg
from mien.initialization.landmarks import LANDMARK_NAMES, Landmarks, rows_by_name

PER_DEGREE, PER_UPPER, PER_LOWER = 1 / 50, 20.0, 3.5
"""What a degree of turn, and the distance of brows and lids, and of the lips, from where they mostly are, in distances
of the eyes, add to the error of a track, that of one begun at rest being 1."""
_NAMES = tuple(name for name in LANDMARK_NAMES if name in rows_by_name("mediapipe478"))
_UPPER = np.array(["brow" in name or "eyelid" in name for name in _NAMES])
_LOWER = np.array(["lip" in name or "mouth" in name for name in _NAMES])
_BONE = ~(_UPPER | _LOWER)


def expected_errors(looks: Sequence[Landmarks], camera: Camera, R: Array, t: Array) -> Array:
    """Error (n,) of a track that begins with each of n looks at one face, that of one begun at rest and into the camera
    being 1.

    looks: with depths, scheme `mediapipe478`; R (3, 3), t (3,): pose of the face in the first of them.
    """
    points = [_points(look, camera) for look in looks]
    moves, typical = _typical(points)
    moved = np.array([_moved(p, move) for p, move in zip(points, moves, strict=True)])
    apart = np.linalg.norm(((moved - typical) @ R)[:, :, :2], axis=2)  # across the face, not in depth
    first = moves[0][1] @ R
    turned = np.array([turned_deg(A.T @ first, t) for _, A in moves])
    upper, lower = (np.sqrt((apart[:, part] ** 2).mean(axis=1)) for part in (_UPPER, _LOWER))
    return np.asarray(1 + PER_DEGREE * turned + PER_UPPER * upper + PER_LOWER * lower)


def _points(look: Landmarks, camera: Camera) -> Array:
    """Points (m, 3) in camera axes, as `back_project` puts them there."""
    assert look.depths is not None, "looks are the detector's, and have depths"
    points = back_project(np.column_stack([look.points, look.depths]), camera)
    rows = rows_by_name(look.scheme)
    return np.array([points[rows[name]].mean(axis=0) for name in _NAMES])


def _typical(looks: Sequence[Array], iterations: int = 5) -> tuple[list[tuple[float, Array]], Array]:
    """The median face (m, 3) of several looks (m, 3), eyes at a distance of 1, and the scale and rotation that take
    each look's bone there."""
    typical = looks[0] - looks[0][_BONE].mean(axis=0)
    outer = [_NAMES.index(f"{side}_eye_outer_corner") for side in ("left", "right")]
    for _ in range(iterations):
        typical = typical / np.linalg.norm(typical[outer[0]] - typical[outer[1]])
        moves = [similarity(look[_BONE], typical[_BONE])[:2] for look in looks]
        typical = np.median([_moved(look, move) for look, move in zip(looks, moves, strict=True)], axis=0)
    return moves, typical


def _moved(points: Array, move: tuple[float, Array]) -> Array:
    """Points (m, 3) about the centre of their bone, scaled and turned."""
    scale, A = move
    return np.asarray(scale * (points - points[_BONE].mean(axis=0)) @ A.T)
