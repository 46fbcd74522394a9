"""The twelve points of the paper's Fig. 3, around eyes, nose and mouth, in every scheme of landmarks.

| point | iBUG-68 | MediaPipe |
|---|---|---|
| outer and inner corner of the right eye | 36, 39 | between 33 and 7, 133 and 155 |
| inner and outer corner of the left eye | 42, 45 | between 362 and 382, 263 and 249 |
| tip of the nose, its base | 30, 33 | 4, between 94 and 164 |
| under the right and the left nostril | 31, 35 | between 97 and 98, 326 and 327 |
| right and left corner of the mouth | 48, 54 | 61, 291 |
| middle of the outer upper and lower lip | 51, 57 | 0, 17 |

The figure shows the points without numbers; these twelve are those that both annotations define. "Right" is the
subject's right.
"""

from __future__ import annotations

import numpy as np

from mien.arrays import Array
from mien.initialization.landmarks import SCHEMES, count_of_scheme, rows_by_name, rows_reported

POINT_NAMES = (
    "right_eye_outer_corner",
    "right_eye_inner_corner",
    "left_eye_inner_corner",
    "left_eye_outer_corner",
    "nose_tip",
    "nose_base_mid",
    "right_nostril_outer",
    "left_nostril_outer",
    "right_mouth_corner_outer",
    "left_mouth_corner_outer",
    "upper_lip_outer",
    "lower_lip_outer",
)


TWELVE = "points12"
"""Scheme of an annotation with exactly these twelve points."""


def count_of_points(scheme: str) -> int | None:
    """Number of points of a landmark scheme; None if there is no such scheme."""
    if scheme == TWELVE:
        return len(POINT_NAMES)
    return count_of_scheme(scheme) if scheme in SCHEMES else None


def points_of_names(points: Array, names: tuple[str, ...]) -> Array | None:
    """(n, k, 2) with k names -> (n, 12, 2); None if one of the twelve is missing."""
    if any(name not in names for name in POINT_NAMES):
        return None
    return points[:, [names.index(name) for name in POINT_NAMES]]


def points_of_scheme(points: Array, scheme: str) -> Array:
    """(n, k, 2) in a landmark scheme -> (n, 12, 2)."""
    if scheme == TWELVE:
        return points
    rows = rows_reported(scheme)
    return np.asarray(points[:, [rows[name] for name in POINT_NAMES]].mean(axis=2))


def names_of_scheme(scheme: str, count: int) -> tuple[str, ...]:
    """The name of each point of a scheme: that of the CANDIDE landmark, or its number."""
    names = {int(a): name for name, (a, b) in rows_by_name(scheme).items() if a == b}
    return tuple(names.get(i, f"{scheme}_{i}") for i in range(count))


def outer_eye_distance(points12: Array) -> Array:
    """(n, 12, 2) -> (n,): distance between the outer corners of the eyes in pixels."""
    return np.asarray(np.linalg.norm(points12[:, 0] - points12[:, 3], axis=-1))
