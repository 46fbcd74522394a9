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
from shared.moved import compared, face_image, mean_of, moved_by, seen_points, smooth, turned_by
from shared.recordings import asked

from mien.arrays import Array
from mien.errors import MienWarning
from mien.evaluation.metrics import correlation
from mien.frame import Frame
from mien.initialization.landmarks import LANDMARK_NAMES, Landmarks
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.state import Estimate

PERIOD, MOTIONS = 4.0, ((0.7, 0.1), (2.5, -0.06))
"""Seconds after which all begins anew; when the brows begin to move, and how far up, in distances of the outer corners
of the eyes."""
LASTS, RAMP = 1.0, 0.25
"""Seconds for which they are away, and in which they go and come."""
LEAST = 0.02
"""By how much they have to be away to count."""
BROW_POINTS = [55, 285, 63, 70, 293, 300]
"""Points of MediaPipe on both brows."""
FADES = 0.12
"""Beside the brows their motion fades within this distance, likewise."""


def up(seconds: float) -> float:
    """How far the brows are up at a time since the beginning."""
    total = 0.0
    for begin, height in MOTIONS:
        since = seconds % PERIOD - begin
        share = min(max(min(since, LASTS - since) / RAMP, 0), 1)
        total += height * (1 - np.cos(np.pi * share)) / 2
    return total


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


def seen_heights(frames: list[Frame], face: Landmarks) -> Array:
    """(n,) how high MediaPipe's brows are above its eyes, likewise, after laying the points of every frame over those
    of the first; NaN where it sees none."""
    y = seen_points(frames, face)[..., 1]
    return np.asarray(y[:, EYES].mean(axis=1) - y[:, BROW_POINTS].mean(axis=1))


def followed(height: Array, difference: Array) -> list[float]:
    """The shares of a motion up and down (n,) that a difference (n,) follows, NaN where there is none, and their
    correlation."""
    known, shares = np.isfinite(difference), []
    for counts in (height > LEAST, height < -LEAST):
        h, d = height[counts & known], difference[counts & known]
        shares.append(float(h @ d / (h @ h)) if len(h) else np.nan)
    return [*shares, correlation(height[known], difference[known])]


def row(path: Path, seconds: float) -> list[float]:
    """What becomes of one recording."""
    face, frames, moved, tracker, moved_tracker, before, after = compared(path, seconds, with_brows)
    heights = np.array([0.0 if e.landmarks is None else up(e.time - frames[0].time) for e in before])
    own = np.array([brow_height(moved_tracker, e) for e in after]) - [brow_height(tracker, e) for e in before]
    turned = turned_by(before, after)[heights > LEAST]
    seen = seen_heights(moved, face) - seen_heights(frames, face)
    return [*followed(heights, own), mean_of(turned), *followed(heights, seen)]


def cells_of(figures: list[float]) -> list[str]:
    return ["" if np.isnan(value) else f"{value:.2f}" for value in figures]


def main() -> None:
    paths, seconds = asked(__doc__)
    warnings.simplefilter("ignore", MienWarning)
    print_heads("recording", "up", "down", "r", "degrees", *(f"MediaPipe, {name}" for name in ("up", "down", "r")))
    figures = []
    for path in paths:
        figures.append(row(path, seconds))
        print(f"| {path.stem} | {' | '.join(cells_of(figures[-1]))} |", flush=True)
    print(f"| mean | {' | '.join(cells_of(np.nanmean(figures, axis=0).tolist()))} |")


if __name__ == "__main__":
    carry_out(main)
