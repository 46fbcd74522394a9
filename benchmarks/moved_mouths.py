"""Real recordings whose mouths are moved by a known distance: how much of it is followed; as a Markdown table.

`OMP_NUM_THREADS=1 python benchmarks/moved_mouths.py PATH`, with PATH a folder of videos. One after another, for a
second each, the image of the corners of the mouth and the skin around them is drawn outwards (by 0.05 of the distance
of the eyes' outer corners), inwards (0.04), up (0.05) and down (0.04), that of the upper lip up (0.04), and that of the
corners out and up at once, as in a smile (0.05, 0.04). Each recording is tracked as it is and with its mouth moved; the
difference is what was followed: its share along the motion (regression), of `realtime` and, behind a slash, of
MediaPipe. Last, by how many degrees the rotation of the head differs meanwhile. `--seconds 10` is enough.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
from shared.command_line import carry_out, print_heads
from shared.moved import face_image, followed, mean_of, moved_by, print_rows, share_moved, smooth
from shared.recordings import asked

from mien.arrays import Array
from mien.errors import MienWarning
from mien.frame import Frame
from mien.initialization.landmarks import LANDMARK_NAMES
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.state import Estimate


class Motion(NamedTuple):
    """When something begins to move, in seconds, and how far: the corners out and up, and the upper lip up, in
    distances of the eyes' outer corners."""

    begins: float
    moved: tuple[float, float, float]


MOTIONS = {
    "out": Motion(0.5, (0.05, 0, 0)),
    "in": Motion(1.9, (-0.04, 0, 0)),
    "up": Motion(3.3, (0, 0.05, 0)),
    "down": Motion(4.7, (0, -0.04, 0)),
    "lip": Motion(6.1, (0, 0, 0.04)),
    "smile": Motion(7.5, (0.05, 0.04, 0)),
}
PERIOD = 9.0
"""Seconds after which all begins anew."""
LEAST = 5
"""Frames of a motion from which on it counts."""
CORNERS = [f"{side}_mouth_corner_outer" for side in ("right", "left")]


def motion_at(seconds: float) -> tuple[str, Array]:
    """What moves at a time since the beginning, if anything does, and how far (3,)."""
    for name, motion in MOTIONS.items():
        share = share_moved(seconds % PERIOD - motion.begins)
        if share > 0:
            return name, share * np.array(motion.moved)
    return "", np.zeros(3)


def with_mouth(frame: Frame, points: Array, seconds: float) -> Frame:
    """The frame with the mouth of a face moved as at a time. points: (26, 2) of the tracked landmarks."""
    _, (out, up, lip) = motion_at(seconds)
    if not (out or up or lip):
        return frame
    face = face_image(frame, points)
    named, unit = face.named, face.unit
    top, bottom, base = named["upper_lip_outer"], named["lower_lip_outer"], named["nose_base_mid"]
    to_the_right, to_above = np.zeros((2, *face.place.shape[:2]))
    for corner, side in zip((named[name] for name in CORNERS), (-1, 1), strict=True):
        beside, above = side * face.beside(corner), face.above(corner)
        half = max(abs((corner - top) @ face.right) / unit, 0.08)
        share = np.where(beside < 0, np.clip(1 + beside / half, 0, 1), smooth(np.interp(beside, [0.03, 0.28], [1, 0])))
        share = share * smooth(np.interp(np.abs(above), [0.06, 0.26], [1, 0]))
        to_the_right += side * out * share
        to_above += up * share
    beside, above = np.abs(face.beside(top)), face.above(top)
    half = abs((named[CORNERS[1]] - named[CORNERS[0]]) @ face.right) / unit / 2
    thick, gap = max((top - bottom) @ face.upwards / unit, 0.08), max((base - top) @ face.upwards / unit, 0.06)
    share = np.interp(above, [-0.8 * thick, 0, 0.02, gap], [0, 1, 1, 0])
    to_above += lip * share * smooth(np.interp(beside, [0.08, max(half, 0.16)], [1, 0]))
    return moved_by(frame, face.moved(to_the_right, to_above))


def mouth_of(tracker: RealtimeTracker, estimate: Estimate) -> Array:
    """(3,) how far the units move the corners out and up, and the upper lip up; NaN where the face is lost."""
    if estimate.animation is None:
        return np.full(3, np.nan)
    points = np.tensordot(estimate.animation, tracker.person.units, axes=1)[: len(LANDMARK_NAMES)]
    named = dict(zip(LANDMARK_NAMES, points, strict=True))
    neutral = dict(zip(LANDMARK_NAMES, tracker.face.neutral[: len(LANDMARK_NAMES)], strict=True))
    unit = np.linalg.norm(neutral["right_eye_outer_corner"] - neutral["left_eye_outer_corner"])
    right, left = (named[name] for name in CORNERS)
    return np.array([(left[0] - right[0]) / 2, (left[1] + right[1]) / 2, named["upper_lip_outer"][1]]) / unit


def seen_mouths(points: Array) -> Array:
    """(n, 3) the same of MediaPipe's points (n, 468, 3), see `seen_points`."""
    right, left, lip = points[:, [61, 291, 0]].transpose(1, 2, 0)
    return np.column_stack([(left[0] - right[0]) / 2, -(left[1] + right[1]) / 2, -lip[1]])


def share_of(moved: Array, difference: Array) -> float:
    """The share of a motion (n, 3) that a difference (n, 3) follows; NaN if there is hardly any."""
    known = np.isfinite(difference).all(axis=1)
    if known.sum() < LEAST:
        return np.nan
    m, d = moved[known], difference[known]
    return float((m * d).sum() / (m * m).sum())


def row(path: Path, end: float) -> list[float]:
    """What becomes of one recording: the share of each motion, those of MediaPipe, and degrees of rotation."""
    seconds, told, seen, degrees = followed(path, end, with_mouth, mouth_of, seen_mouths)
    motions = [("", np.zeros(3)) if np.isnan(s) else motion_at(s) for s in seconds]
    names, moved = np.array([name for name, _ in motions]), np.array([by for _, by in motions])
    shares = [share_of(moved[names == name], d[names == name]) for d in (told, seen) for name in MOTIONS]
    return [*shares, mean_of(degrees[names != ""])]


def cells_of(figures: list[float]) -> list[str]:
    own, seen, degrees = figures[: len(MOTIONS)], figures[len(MOTIONS) : -1], figures[-1]
    shares = ["" if np.isnan(a) else f"{a:.2f} / {b:.2f}" for a, b in zip(own, seen, strict=True)]
    return [*shares, f"{degrees:.2f}"]


def main() -> None:
    paths, seconds = asked(__doc__)
    warnings.simplefilter("ignore", MienWarning)
    print_heads("recording", *MOTIONS, "degrees")
    print_rows(paths, lambda path: row(path, seconds), cells_of)


if __name__ == "__main__":
    carry_out(main)
