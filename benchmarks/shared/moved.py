"""Recordings whose faces are moved by a known distance, for `moved_brows.py` and `moved_mouths.py`."""

from __future__ import annotations

from collections.abc import Callable
from itertools import takewhile
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from shared.mesh import EYES, laid_over, mesh

from mien.arrays import Array
from mien.errors import MienError
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import angle_between
from mien.initialization.detector import first_with_a_face, follow
from mien.initialization.landmarks import LANDMARK_NAMES, Landmarks
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.state import Estimate
from mien.video import open_video

LASTS, RAMP = 1.0, 0.25
"""Seconds for which a motion lasts, and in which it comes and goes."""
STEPS, DAMPING = 20, 0.3
"""Steps towards where the pixels of a moved image come from, and the share of what is missing that each goes."""


class FaceImage(NamedTuple):
    """A face in an image: its landmarks (2,) by name, the distance of the eyes' outer corners in pixels, the directions
    (2,) right and up, and the place (h, w, 2) of every pixel."""

    named: dict[str, Array]
    unit: float
    right: Array
    upwards: Array
    place: Array

    def beside(self, point: Array) -> Array:
        """How far to the right of a point (2,) every pixel (h, w) is, in distances of the eyes."""
        return np.asarray((self.place - point) @ self.right / self.unit)

    def above(self, point: Array) -> Array:
        """How far above a point (2,) every pixel (h, w) is, likewise."""
        return np.asarray((self.place - point) @ self.upwards / self.unit)

    def moved(self, right: Array | float, up: Array | float) -> Array:
        """(h, w, 2) pixels of motions (h, w) to the right and up, likewise."""
        along = np.broadcast_to(right, self.place.shape[:2])[..., None] * self.right
        return np.asarray(self.unit * (along + np.broadcast_to(up, self.place.shape[:2])[..., None] * self.upwards))


def face_image(frame: Frame, points: Array) -> FaceImage:
    """The face of a frame. points: (26, 2) of the tracked landmarks."""
    named = dict(zip(LANDMARK_NAMES, points, strict=True))
    across = named["left_eye_outer_corner"] - named["right_eye_outer_corner"]
    unit = float(np.linalg.norm(across))
    right = across / unit
    place = np.stack(np.meshgrid(*map(np.arange, (frame.width, frame.height))), axis=-1).astype(float)
    return FaceImage(named, unit, right, np.array([right[1], -right[0]]), place)


def share_moved(since: float) -> float:
    """Which share of a motion is made, some seconds since it began."""
    share = min(max(min(since, LASTS - since) / RAMP, 0), 1)
    return float(1 - np.cos(np.pi * share)) / 2


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


class Followed(NamedTuple):
    """What followed when the face of a recording of n frames was moved: the seconds since the first frame of each, NaN
    where the face was lost; the difference of what the tracker told of it, and of what MediaPipe saw, NaN where either
    lost it; and by how many degrees the rotation differs."""

    seconds: Array
    told: Array
    seen: Array
    degrees: Array


def followed(
    path: Path,
    end: float,
    move: Callable[[Frame, Array, float], Frame],
    told: Callable[[RealtimeTracker, Estimate], Any],
    seen: Callable[[Array], Array],
) -> Followed:
    """A recording until `end`, in seconds, tracked as it is and with its face moved where it is tracked. move: makes
    the moved frame of one, of its landmarks (26, 2), and of the seconds since the first; told: what an estimate says of
    what is moved; seen: what `seen_points` say of it."""
    frames, face = begun(path, end)
    tracker, before = tracked(frames, face)
    seconds = np.array([np.nan if e.landmarks is None else e.time - frames[0].time for e in before])
    moved = [
        frame if e.landmarks is None else move(frame, e.landmarks.image, float(s))
        for frame, e, s in zip(frames, before, seconds, strict=True)
    ]
    moved_tracker, after = tracked(moved, face)
    own = np.array([told(moved_tracker, e) for e in after]) - np.array([told(tracker, e) for e in before])
    difference = seen(seen_points(moved, face)) - seen(seen_points(frames, face))
    return Followed(seconds, own, difference, turned_by(before, after))


def turned_by(before: list[Estimate], after: list[Estimate]) -> Array:
    """(n,) degrees between two tracks of the same frames; NaN where either is lost."""
    rotations = ((a.rotation, b.rotation) for a, b in zip(before, after, strict=True))
    return np.array([np.nan if A is None or B is None else np.degrees(angle_between(A, B)) for A, B in rotations])


def mean_of(values: Array) -> float:
    """Mean of those that are known; NaN of none."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else np.nan


def seen_points(frames: list[Frame], face: Landmarks) -> Array:
    """(n, 468, 3) MediaPipe's points, those of every frame laid over those of the first, in distances of the outer
    corners of the eyes; NaN where it sees no face."""
    start = mesh(face)
    points, unit = np.full((len(frames), *start.shape), np.nan), np.linalg.norm(start[EYES[0]] - start[EYES[3]])
    rows = {frame.index: k for k, frame in enumerate(frames)}
    for frame, seen in follow(face, frames):
        points[rows[frame.index]] = laid_over(mesh(seen), start) / unit
    return points


def print_rows(
    paths: list[Path], row: Callable[[Path], list[float]], cells_of: Callable[[list[float]], list[str]]
) -> None:
    """The rows of a table in Markdown, as each recording ends, and their mean."""
    figures = []
    for path in paths:
        figures.append(row(path))
        print(f"| {path.stem} | {' | '.join(cells_of(figures[-1]))} |", flush=True)
    print(f"| mean | {' | '.join(cells_of(np.nanmean(figures, axis=0).tolist()))} |")
