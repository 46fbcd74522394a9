"""Your own video with ground truth of pose or landmarks in a CSV.

PATH is a video with a CSV of the same name beside it, or a folder of such pairs. The columns are those of
`mien.evaluation.pose_csv`: `frame`, `pose_Rx, pose_Ry, pose_Rz` in radians, `x_0, y_0, ..` in pixels. `frame` starts at
0, or at 1, as in OpenFace, if no row has frame 0 and `timestamp` says so or, if it says nothing, the last frame equals
the number of frames. Without `frame` there must be a row for every frame. Frames without a row, or with `success` 0,
have no truth. The camera has the default field of view of 60 degrees unless a focal length is given.
"""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path

import numpy as np

from mien.arrays import Array
from mien.errors import require, warn
from mien.evaluation.datasets.sequence import (
    Sequence,
    Truth,
    found_in,
    require_frames,
    warn_of_videos_without_truth,
)
from mien.evaluation.pose_csv import PoseTable, read_pose_csv
from mien.geometry.rotation import FACING
from mien.video import VIDEO_SUFFIXES, list_images, open_video

_OTHER_RATE = 0.1
"""Relative difference of frame rates from which they are not the same."""


def load(path: Path) -> tuple[Sequence, ...]:
    """Load every video that has a CSV of the same name beside it. Warns of those that have none."""
    alone = path.is_file() or path.with_name(f"{path.name}.csv").is_file()
    candidates = [path] if alone else found_in(path, "*")
    known = [p for p in candidates if p.is_dir() or p.suffix.lower() in VIDEO_SUFFIXES or p == path]
    pairs = [(p, p.with_name(f"{_name(p)}.csv")) for p in known]
    annotated = [(video, truth) for video, truth in pairs if truth.is_file() and truth != video]
    require(
        bool(annotated),
        f"{path} contains no annotated video; it needs a video ({', '.join(VIDEO_SUFFIXES)}) or a folder of "
        "images with a CSV of the same name beside it",
    )
    found = tuple(_sequence(video, truth) for video, truth in annotated)
    videos = [p for p in known if p.is_file() or (os.access(p, os.R_OK) and list_images(p))]
    warn_of_videos_without_truth(path, videos, found, "a CSV of the same name beside it")
    return found


def _name(video: Path) -> str:
    """The name of a file without its suffix, or of a folder, which has none."""
    return video.name if video.is_dir() else video.stem


def read_truth(path: Path, frames: int, video: Path | None = None) -> Truth:
    """Read the truth of a video with this number of frames. Raises MienError if the rows do not match; warns if their
    times do not, or if they are a track of mien's."""
    table = read_pose_csv(path)
    if table.by_mien:
        warn(f"{path} is a track of mien's own: what is reported as errors are differences from that")
    fps = None if video is None or video.is_dir() or table.rate is None else open_video(video).fps
    if fps is not None and table.rate is not None and abs(table.rate / fps - 1) > _OTHER_RATE:
        warn(
            f"{path} has {table.rate:.4g} frames a second by its timestamps and {video} {fps:.4g}; if `frame` does not "
            "count the frames of the video, the errors are of other frames"
        )
    first = _first_frame(table, frames)
    index = table.frame - first
    require(
        bool(index.size) and int(index.min()) >= 0 and int(index.max()) < frames,
        f"{path} describes frames up to {int(table.frame.max())}, from {int(table.frame.min())} on, and its video has "
        f"{frames}; check that they belong together",
    )
    if table.first is None and first == 0:
        warn(
            f"{path} has no row of the frame 0, and is read as if its frames were counted from 0; if they are counted "
            "from 1, add the column timestamp (seconds), or a row for the last frame"
        )

    def by_frame(values: Array | None) -> Array | None:
        if values is None:
            return None
        out = np.full((frames, *values.shape[1:]), np.nan)
        out[index[table.tracked]] = values[table.tracked]
        return out

    landmarks = by_frame(table.landmarks)
    scheme = "ibug68" if landmarks is None else table.scheme
    angles_deg = None if table.angles is None else np.degrees(table.angles) * FACING.diagonal()
    return Truth(frames, by_frame(table.rotation), by_frame(angles_deg), landmarks, scheme)


def _first_frame(table: PoseTable, frames: int) -> int:
    """The number of the first frame, 0 or 1."""
    if not table.numbered:
        require_frames(len(table.frame), frames, table.source)
    if table.first is not None:
        return table.first
    return 1 if int(table.frame.max()) == frames else 0


def _sequence(video: Path, truth: Path) -> Sequence:
    return Sequence(_name(video), "video", video, (truth,), partial(read_truth, truth, video=video))
