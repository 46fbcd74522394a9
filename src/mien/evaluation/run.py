"""Run one tracker on one sequence, in this process."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from mien.arrays import Array, Pixels
from mien.errors import require, warn
from mien.evaluation.datasets.sequence import Sequence, Truth
from mien.evaluation.metrics import correlation
from mien.evaluation.protocols import angles_deg
from mien.evaluation.results import SequenceResult, Timing, TrackTable
from mien.evaluation.worst import worst_frames
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING
from mien.initialization.landmarks import Landmarks
from mien.registry import called, checked
from mien.tracking.abilities import FittedTracker, ReplayedTracker, settings_of
from mien.tracking.state import Estimate, Tracker
from mien.video import list_images, open_video

_AGAINST, _LEAST_TURN_DEG = -0.8, 3.0
"""Correlation of an angle with the truth below which one of them has another sign, and the standard deviation from
which on that can be told."""
_LIKE_DEGREES, _ALIKE = (30.0, 110.0), 0.9
"""How many times as much as the track's the angles of a file vary whose degrees are read as radians, which is about 57,
and the correlation above which that can be told."""
WARM_UP_FRAMES = 2
MAXIMUM_TIMED_FRAMES = 1000


def run_sequence(
    tracker: Tracker,
    sequence: Sequence,
    landmarks: Landmarks,
    name: str = "tracker",
    dataset: str = "",
    settings: Mapping[str, Any] | None = None,
) -> SequenceResult:
    """Track every frame of a sequence, starting from these landmarks in its first frame.

    Raises MienError if truth and video do not match, and whatever the tracker, or the reader of the truth, raises.
    """
    frames = count_frames(sequence.video)
    truth = sequence.truth_of(frames)
    estimates: list[Estimate] = []
    meshes: list[Array | None] = []
    for frame, estimate in _estimates(tracker, sequence, landmarks):
        if frame.index == 0:
            _require_inside(truth, frame, sequence)
        estimates.append(estimate)
        meshes.append(_mesh(tracker, estimate, sequence.camera_for(frame.width, frame.height)))
    _warn_of_rows(tracker, sequence, frames)
    track = TrackTable.from_estimates(estimates)
    if not _warn_of_degrees(track, truth, sequence):
        _warn_of_signs(track, truth, sequence)
    worst = worst_frames(track, truth)
    return SequenceResult(
        name,
        dataset,
        sequence.name,
        sequence.kind,
        settings or {},
        settings_of(tracker),
        track=track,
        truth=truth,
        pictures=_pictures(sequence.video, worst),
        meshes={i: mesh for i in worst if (mesh := meshes[i]) is not None},
    )


def time_sequence(
    make_tracker: Callable[[], Tracker],
    sequence: Sequence,
    landmarks: Landmarks,
    name: str = "tracker",
    settings: Mapping[str, Any] | None = None,
) -> Timing:
    """Time each call of a tracker in the first `MAXIMUM_TIMED_FRAMES` frames, without decoding, after a warm-up with
    another instance.

    make_tracker: called without arguments; the warm-up takes what is compiled or loaded once per process.
    """
    for _ in _estimates(make_tracker(), sequence, landmarks, frames=1 + WARM_UP_FRAMES):
        pass
    spent: list[tuple[float, float]] = []
    for _ in _estimates(make_tracker(), sequence, landmarks, MAXIMUM_TIMED_FRAMES, spent):
        pass
    require(len(spent) > 1, f"{sequence.video} has only one frame; there is nothing to time")
    (training, _), *frames = spent
    seconds, processor_seconds = zip(*frames, strict=True)
    busy = sum(processor_seconds) / sum(seconds)
    return Timing(name, sequence.name, seconds, training, peak_memory_mb(), busy, dict(settings or {}))


def count_frames(video: Path) -> int:
    """Number of frames of a video. Raises MienError if none can be decoded, or an image of a folder cannot be read, as
    the truth counts them all."""
    count = sum(1 for _ in open_video(video))
    require(count > 0, f"{video} has no frame that can be decoded; exclude the sequence")
    images = list_images(video) if video.is_dir() else ()
    require(count >= len(images), f"{video} has images that cannot be read; repair or remove them")
    return count


def peak_memory_mb() -> float:
    """Peak resident memory of this process so far, in megabytes."""
    status = Path("/proc/self/status")
    if status.exists():  # unlike ru_maxrss, this excludes the memory of the parent before exec
        line = next(row for row in status.read_text().splitlines() if row.startswith("VmHWM"))
        return int(line.split()[1]) / 1024
    try:
        import resource
    except ImportError:  # on Windows
        return math.nan
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10)


def _estimates(
    tracker: Tracker,
    sequence: Sequence,
    landmarks: Landmarks,
    frames: int | None = None,
    spent: list[tuple[float, float]] | None = None,
) -> Iterator[tuple[Frame, Estimate]]:
    """Each frame with its estimate; spent: gets the seconds of each call, and those of the processors in all threads of
    this process meanwhile."""
    for frame in islice(open_video(sequence.video), frames):
        _ = frame.pixels  # decode before timing
        with called(tracker):
            start, processor_start = time.perf_counter(), time.process_time()
            if frame.index == 0:
                camera = sequence.camera_for(frame.width, frame.height)
                estimate = tracker.initialize(frame, landmarks, camera)
            else:
                estimate = tracker.track(frame)
            if spent is not None:
                spent.append((time.perf_counter() - start, time.process_time() - processor_start))
        yield frame, checked(estimate, tracker, frame)


def _require_inside(truth: Truth, frame: Frame, sequence: Sequence) -> None:
    """Raise MienError for an annotation that was made on images of another size."""
    points = truth.landmarks
    if points is None or not np.isfinite(points).any():
        return
    high = np.nanmax(points.reshape(-1, 2), axis=0)
    require(
        bool(high[0] < 1.5 * frame.width and high[1] < 1.5 * frame.height),
        f"{sequence.source} has points up to {high[0]:.0f}, {high[1]:.0f} and the images have "
        f"{frame.width}x{frame.height} pixels; the annotation was made on images of another size",
    )


def _warn_of_rows(tracker: Tracker, sequence: Sequence, frames: int) -> None:
    """Warn of a track from a file that has rows of frames that the video does not have, or lacks those of some."""
    if not isinstance(tracker, ReplayedTracker):
        return
    rows, there = set(tracker.rows.tolist()), set(range(frames))
    if rows != there:
        warn(
            f"{tracker.source} has {len(rows)} rows and {sequence.video} has {frames} frames, of which "
            f"{len(rows & there)} have a row; check that they belong together"
        )


def _warn_of_degrees(track: TrackTable, truth: Truth, sequence: Sequence) -> bool:
    """Warn of a file with angles in degrees, where radians are read; returns whether it is one."""
    if truth.rotations is None or truth.angles_deg is None:
        return False
    found, true = angles_deg(FACING @ track.rotation, "XYZ"), truth.angles_deg
    both = np.isfinite(found).all(axis=1) & np.isfinite(true).all(axis=1)
    if not both.any():
        return False
    most = int(np.argmax(true[both].std(axis=0)))
    found, true = found[both, most], true[both, most]
    alike, (least, largest) = abs(correlation(found, true)), _LIKE_DEGREES
    if not (alike > _ALIKE and least * found.std() < alike * true.std() < largest * found.std()):
        return False
    times = alike * true.std() / found.std()
    warn(
        f"{sequence.source}: its angles vary {times:.0f} times as much as the track's; they must be in radians, not in "
        "degrees"
    )
    return True


def _warn_of_signs(track: TrackTable, truth: Truth, sequence: Sequence) -> None:
    """Warn of true angles that run against the tracker's, as those of another convention do."""
    if truth.rotations is None:
        return
    both = np.isfinite(track.rotation).all(axis=(1, 2)) & np.isfinite(truth.rotations).all(axis=(1, 2))
    if not both.any():
        return
    since = (R[both][0].T @ R[both] for R in (track.rotation, truth.rotations))
    for name, found, true in zip(("pitch", "yaw", "roll"), *(angles_deg(R, "XYZ").T for R in since), strict=True):
        if min(found.std(), true.std()) > _LEAST_TURN_DEG and np.corrcoef(found, true)[0, 1] < _AGAINST:
            warn(f"{sequence.source}: {name} runs against that of the track; check the sign of it in the truth")


def _mesh(tracker: Tracker, estimate: Estimate, camera: Camera) -> Array | None:
    """Vertices (V, 2) of the tracker's mesh in pixels, None if it has none."""
    vertices = tracker.mesh(estimate) if isinstance(tracker, FittedTracker) else None
    return None if vertices is None else camera.project(vertices)[0]


def _pictures(video: Path, frames: tuple[int, ...]) -> dict[int, Pixels]:
    """JPEG images of these frames, by index."""
    wanted = set(frames)
    out = {}
    for frame in islice(open_video(video), max(wanted, default=-1) + 1):
        if frame.index in wanted:
            bgr = cv2.cvtColor(frame.pixels, cv2.COLOR_RGB2BGR)
            out[frame.index] = np.asarray(cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, 85])[1]).ravel()
    return out
