"""Real recordings whose brows are moved by a known distance: how much of it is followed; as a Markdown table.

`OMP_NUM_THREADS=1 python benchmarks/moved_brows.py PATH`, with PATH a folder of videos. Every four seconds the image of
the brows, and of the skin between lids and hair, is drawn up by a tenth of the distance of the eyes' outer corners, and
down by 0.06, for a second each. Each recording is tracked as it is and with its brows moved; the difference of how high
they are is what was followed. Columns, of `realtime` and of MediaPipe: which shares of the motion up and down are
followed (regression), and the correlation with it; of `realtime`, by how many degrees the rotation of the head differs
while the brows are up. `--seconds 10` is enough.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from shared.command_line import carry_out, print_heads
from shared.mesh import EYES
from shared.moved import face_image, followed, mean_of, moved_by, print_rows, share_moved, smooth
from shared.recordings import asked

from mien.arrays import Array
from mien.errors import MienWarning
from mien.evaluation.metrics import correlation
from mien.frame import Frame
from mien.initialization.landmarks import LANDMARK_NAMES
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.state import Estimate

PERIOD, MOTIONS = 4.0, ((0.7, 0.1), (2.5, -0.06))
"""Seconds after which all begins anew; when the brows begin to move, and how far up, in distances of the outer corners
of the eyes."""
LEAST = 0.02
"""By how much they have to be away to count."""
BROW_POINTS = [55, 285, 63, 70, 293, 300]
"""Points of MediaPipe on both brows."""
FADES = 0.12
"""Beside the brows their motion fades within this distance, likewise."""


def up(seconds: float) -> float:
    """How far the brows are up at a time since the beginning."""
    return sum(height * share_moved(seconds % PERIOD - begin) for begin, height in MOTIONS)


def with_brows(frame: Frame, points: Array, seconds: float) -> Frame:
    """The frame with the brows of a face as high as at a time. points: (26, 2) of the tracked landmarks."""
    height = up(seconds)
    if not height:
        return frame
    face = face_image(frame, points)
    named = face.named
    share = np.zeros(face.place.shape[:2])
    for side in ("right", "left"):
        brow = np.array([named[f"{side}_brow_{part}"] for part in ("outer", "top", "inner")])
        middle = brow.mean(axis=0)
        eye = (named[f"{side}_eye_outer_corner"] + named[f"{side}_eye_inner_corner"]) / 2
        gap = (middle - eye) @ face.upwards / face.unit
        half = np.abs((brow - middle) @ face.right).max() / face.unit
        beside, above = np.abs(face.beside(middle)), face.above(middle)
        lid = -0.8 * max(gap, 0.1)
        fades = np.interp(above, [lid, min(lid / 2, -0.06), 0.08, 0.42], [0, 1, 1, 0])
        share = np.maximum(share, smooth(fades) * smooth(np.interp(beside, [half, half + FADES], [1, 0])))
    return moved_by(frame, face.moved(0, height * share))


def brow_height(tracker: RealtimeTracker, estimate: Estimate) -> float:
    """How far the units raise the brows, in distances of the outer corners of the eyes; NaN where the face is lost."""
    if estimate.animation is None:
        return np.nan
    brows, corners = ([k for k, name in enumerate(LANDMARK_NAMES) if of in name] for of in ("brow", "eye_outer_corner"))
    raised = np.tensordot(estimate.animation, tracker.person.units[:, brows, 1], axes=1).mean()
    right, left = tracker.face.neutral[corners]
    return float(raised / np.linalg.norm(right - left))


def seen_heights(points: Array) -> Array:
    """(n,) how high MediaPipe's brows are above its eyes, likewise. points: (n, 468, 3) of `seen_points`."""
    y = points[..., 1]
    return np.asarray(y[:, EYES].mean(axis=1) - y[:, BROW_POINTS].mean(axis=1))


def shares_of(height: Array, difference: Array) -> list[float]:
    """The shares of a motion up and down (n,) that a difference (n,) follows, NaN where there is none, and their
    correlation."""
    known, shares = np.isfinite(difference), []
    for counts in (height > LEAST, height < -LEAST):
        h, d = height[counts & known], difference[counts & known]
        shares.append(float(h @ d / (h @ h)) if len(h) else np.nan)
    return [*shares, correlation(height[known], difference[known])]


def row(path: Path, end: float) -> list[float]:
    """What becomes of one recording."""
    seconds, told, seen, degrees = followed(path, end, with_brows, brow_height, seen_heights)
    heights = np.array([0.0 if np.isnan(s) else up(s) for s in seconds])
    return [*shares_of(heights, told), mean_of(degrees[heights > LEAST]), *shares_of(heights, seen)]


def cells_of(figures: list[float]) -> list[str]:
    return ["" if np.isnan(value) else f"{value:.2f}" for value in figures]


def main() -> None:
    paths, seconds = asked(__doc__)
    warnings.simplefilter("ignore", MienWarning)
    print_heads("recording", "up", "down", "r", "degrees", *(f"MediaPipe, {name}" for name in ("up", "down", "r")))
    print_rows(paths, lambda path: row(path, seconds), cells_of)


if __name__ == "__main__":
    carry_out(main)
