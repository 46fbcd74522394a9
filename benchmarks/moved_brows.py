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
from itertools import takewhile
from pathlib import Path

import cv2
import numpy as np
from expressions import EYES, laid_over, mesh
from shared.command_line import carry_out, print_heads
from shared.recordings import asked

from mien.arrays import Array
from mien.errors import MienError, MienWarning
from mien.evaluation.metrics import correlation
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import angle_between
from mien.initialization.detector import first_with_a_face, follow
from mien.initialization.landmarks import LANDMARK_NAMES, Landmarks
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.state import Estimate
from mien.video import open_video

PERIOD, MOTIONS = 4.0, ((0.7, 0.1), (2.5, -0.06))
"""Seconds after which all begins anew; when the brows begin to move, and how far up, in distances of the outer corners
of the eyes."""
LASTS, RAMP = 1.0, 0.25
"""Seconds for which they are away, and in which they go and come."""
LEAST = 0.02
"""By how much they have to be away to count."""
BROW_POINTS = [55, 285, 63, 70, 293, 300]
"""Points of MediaPipe on both brows."""
STEPS, DAMPING = 20, 0.3
"""Steps towards where the pixels of a moved image come from, and the share of what is missing that each goes."""
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


def with_brows(frame: Frame, points: Array, height: float) -> Frame:
    """The frame with the brows of a face moved up. points: (26, 2) of the tracked landmarks."""
    named = dict(zip(LANDMARK_NAMES, points, strict=True))
    across = named["left_eye_outer_corner"] - named["right_eye_outer_corner"]
    unit = float(np.linalg.norm(across))
    right = across / unit
    upwards = np.array([right[1], -right[0]])
    place = np.stack(np.meshgrid(*map(np.arange, (frame.width, frame.height))), axis=-1).astype(float)
    share = np.zeros(place.shape[:2])
    for side in ("right", "left"):
        brow = np.array([named[f"{side}_brow_{part}"] for part in ("outer", "top", "inner")])
        middle = brow.mean(axis=0)
        eye = (named[f"{side}_eye_outer_corner"] + named[f"{side}_eye_inner_corner"]) / 2
        gap, half = (middle - eye) @ upwards / unit, np.abs((brow - middle) @ right).max() / unit
        beside, above = np.abs((place - middle) @ right) / unit, (place - middle) @ upwards / unit
        lid = -0.8 * max(gap, 0.1)
        fades = np.interp(above, [lid, min(lid / 2, -0.06), 0.08, 0.42], [0, 1, 1, 0])
        share = np.maximum(share, smooth(fades) * smooth(np.interp(beside, [half, half + FADES], [1, 0])))
    return moved_by(frame, (share * height * unit)[..., None] * upwards)


def smooth(share: Array) -> Array:
    """A share (n, m) that begins and ends gradually."""
    return np.asarray(share * share * (3 - 2 * share))


def moved_by(frame: Frame, moved: Array) -> Frame:
    """A frame whose pixels are moved by (h, w, 2), right and down."""
    by = np.ascontiguousarray(moved, np.float32)
    start = np.stack(np.meshgrid(np.arange(frame.width), np.arange(frame.height)), axis=-1).astype(np.float32)
    source = start  # where each pixel comes from: damped, as skin is stretched to several times its size below a brow
    for _ in range(STEPS):
        missing = start - source - cv2.remap(by, source, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        source = source + DAMPING * missing
    pixels = cv2.remap(frame.pixels, source, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return Frame(np.asarray(pixels, np.uint8), frame.index, frame.time)


def begun(path: Path, seconds: float) -> tuple[list[Frame], Landmarks]:
    """The frames of a recording from the first one with a face on, and that. In RGB, as moved ones are."""
    frames = list(takewhile(lambda frame: frame.time <= seconds, open_video(path)))
    found = first_with_a_face(frames)
    if found is None:
        raise MienError(f"{path}: no face was found; leave it out")
    first, (face, *_) = found
    return [Frame(f.pixels, f.index, f.time) for f in frames if f.index >= first.index], face


def tracked(frames: list[Frame], face: Landmarks) -> tuple[RealtimeTracker, list[Estimate]]:
    tracker, first = RealtimeTracker(), frames[0]
    begun = tracker.initialize(first, face, Camera.unknown(first.width, first.height))
    return tracker, [begun, *(tracker.track(frame) for frame in frames[1:])]


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
    heights, start = np.full(len(frames), np.nan), mesh(face)
    unit = np.linalg.norm(start[EYES[0]] - start[EYES[3]])
    rows = {frame.index: k for k, frame in enumerate(frames)}
    for frame, seen in follow(face, frames):
        y = laid_over(mesh(seen), start)[:, 1] / unit
        heights[rows[frame.index]] = y[EYES].mean() - y[BROW_POINTS].mean()
    return heights


def followed(height: Array, difference: Array) -> list[float]:
    """The shares of a motion up and down (n,) that a difference (n,) follows, NaN where there is none, and their
    correlation."""
    known, shares = np.isfinite(difference), []
    for counts in (height > LEAST, height < -LEAST):
        h, d = height[counts & known], difference[counts & known]
        shares.append(float(h @ d / (h @ h)) if len(h) else np.nan)
    return [*shares, correlation(height[known], difference[known])]


def turned_by(before: list[Estimate], after: list[Estimate]) -> Array:
    """(n,) degrees between two tracks of the same frames; NaN where either is lost."""
    rotations = ((a.rotation, b.rotation) for a, b in zip(before, after, strict=True))
    return np.array([np.nan if A is None or B is None else np.degrees(angle_between(A, B)) for A, B in rotations])


def mean_of(values: Array) -> float:
    """Mean of those that are known; NaN of none."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else np.nan


def row(path: Path, seconds: float) -> list[float]:
    """What becomes of one recording."""
    frames, face = begun(path, seconds)
    tracker, before = tracked(frames, face)
    heights = np.array([0.0 if e.landmarks is None else up(e.time - frames[0].time) for e in before])
    moved = [
        with_brows(frame, e.landmarks.image, h) if h and e.landmarks is not None else frame
        for frame, e, h in zip(frames, before, heights, strict=True)
    ]
    moved_tracker, after = tracked(moved, face)
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
