"""A face that somebody has marked, completed by what a detector finds there.

Marked points have no depths, and are too few for a surface. Where a detector finds the same face, its points and their
depths are moved onto the marks as a whole, and the face is learned from them; its landmarks stay where they were
marked. Moved one by one, they would bend the face wherever annotators and detectors mark differently. A face that would
have to be moved far was marked in another frame, or at another size of the image.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mien.arrays import Array
from mien.errors import warn
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.initialization.landmarks import Landmarks, in_common, place_of
from mien.initialization.straight import straightened

_ALIKE = 0.06
"""Root mean square distance of a detected face from the marks, in sizes of the face, up to which it is the same face:
0.015 to 0.02 on rendered heads with exact marks."""
_THERE = 0.1
"""The same before it is moved, up to which it lies where it was marked: 0.021 to 0.024 on those heads."""


def completed(frame: Frame, marks: Landmarks, camera: Camera) -> Landmarks:
    """The points of a detected face, moved onto marks without depths by the affine map that brings them nearest; with
    a warning the marks alone, where no such face is found. Landmarks that have depths are complete."""
    from mien.initialization.detector import detect

    if marks.depths is not None:
        return marks
    x, y = place_of(marks.points)[0].tolist()
    for face in detect(frame, (x, y)):
        moved = _moved_onto(marks, straightened(frame, face, camera))
        if moved is not None:
            return moved
    warn(
        f"{marks.source}: no face is detected where it was marked, so that its depths are not known, and turns are "
        "less certain, as the standard deviations say; check the points, and that they belong to this frame at its size"
    )
    return marks


def _moved_onto(marks: Landmarks, face: Landmarks) -> Landmarks | None:
    """A detected face moved onto marks; None if it is another one, or elsewhere."""
    assert face.depths is not None, "a detected face has depths"
    marked = marks.reported()
    to, at = in_common(marked, face.reported())
    if _distance(at, to) > _THERE * marks.size:
        return None
    at = np.column_stack([at, np.ones(len(at))])
    affine = np.linalg.lstsq(at, to, rcond=None)[0]
    if _distance(at @ affine, to) > _ALIKE * marks.size:
        return None
    return replace(
        marks,
        points=face.points @ affine[:2] + affine[2],
        scheme=face.scheme,
        depths=face.depths * np.sqrt(abs(np.linalg.det(affine[:2]))),
        marked=marked,
    )


def _distance(points: Array, others: Array) -> float:
    """Root mean square distance of points (n, 2) from as many others."""
    return float(np.sqrt(((points - others) ** 2).sum(axis=1).mean()))
