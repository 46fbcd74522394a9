"""BUFT: the head tracking set of Boston University (La Cascia, Sclaroff and Athitsos, 2000).

Layout: `jam1.avi` or `jam1.mpg`, with `jam1.dat` beside it or in another folder below the same root; the subjects jam,
jim, llm, ssm and vam, with nine sequences each, are the uniform-light set of 45. Sequences in a folder whose name
contains `vary` are of kind `varying-light`, all others of kind `uniform-light`.

A row of a `.dat` contains X, Y, depth, roll, yaw, pitch (degrees), preceded by an index in files with seven columns.
The signs are those of head axes (x to the subject's left, y up, z out of the face): positive pitch nods down, positive
yaw turns the face to the subject's left, positive roll lifts the subject's left. OpenFace's angles are (pitch, -yaw,
-roll). The order in which the angles are composed is not documented; `mien.evaluation.protocols` has both
interpretations.

The sensor wrote one row more than the video has frames, and the published evaluation drops the first: row i + 1 belongs
to frame i. In a file with as many rows as the video has frames, row i belongs to frame i, and the first row is dropped
as well, which leaves frame 0 without truth. Any other length is an error.
"""

from __future__ import annotations

from functools import partial
from glob import escape
from pathlib import Path

import numpy as np

from mien.arrays import Array
from mien.errors import MienError, require
from mien.evaluation.datasets.sequence import (
    Sequence,
    Truth,
    found_in,
    require_finite,
    warn_of_videos_without_truth,
)
from mien.video import VIDEO_SUFFIXES

SUBJECTS = ("jam", "jim", "llm", "ssm", "vam")
UNIFORM, VARYING = "uniform-light", "varying-light"
COMPLETE = tuple(f"{subject}{number}" for subject in SUBJECTS for number in range(1, 10))
"""The 45 sequences of the uniform-light set."""

FOCAL_PER_WIDTH = 500 / 320
"""The camera is not documented; the published OpenFace evaluation uses 500 pixels at 320x240."""


def load(root: Path) -> tuple[Sequence, ...]:
    """Load all sequences in a folder and its subfolders: videos that have a `.dat` of the same name. Warns of those
    without one."""
    videos = [p for p in found_in(root, "**/*") if p.suffix.lower() in VIDEO_SUFFIXES]
    pairs = [(video, dat) for video in videos if (dat := _dat_of(root, video)) is not None]
    require(
        bool(pairs),
        f"{root} contains no sequence of BUFT; it needs videos ({', '.join(VIDEO_SUFFIXES)}), each with a .dat "
        "of the same name beside it or in a separate folder",
    )
    found = tuple(
        Sequence(
            video.stem,
            _kind(root, video),
            video,
            (dat,),
            partial(read_truth, dat),
            focal_per_width=FOCAL_PER_WIDTH,
        )
        for video, dat in pairs
    )
    warn_of_videos_without_truth(root, videos, found, "a .dat of the same name")
    return found


def missing(names: tuple[str, ...]) -> tuple[str, ...]:
    """The sequences of the uniform-light set of 45 that are not among these names."""
    return tuple(n for n in COMPLETE if n not in names)


def read_truth(path: Path, frames: int) -> Truth:
    """Read the angles of a video with this number of frames, aligned as described above. Raises MienError if their
    numbers do not match."""
    angles = read_dat(path)[:, [5, 4, 3]]
    require(
        len(angles) in (frames, frames + 1),
        f"{path} has {len(angles)} rows and its video {frames} frames; it must have one row more than the video has "
        "frames (the first is dropped), or as many: check that they belong together",
    )
    angles = angles[1:]
    if len(angles) < frames:
        angles = np.vstack([np.full((1, 3), np.nan), angles])
    return Truth(frames, angles_deg=angles)


def read_dat(path: Path) -> Array:
    """Read the rows (n, 6) of a `.dat`: X, Y, depth, roll, yaw, pitch. Raises MienError for any other table."""
    try:
        rows = np.loadtxt(path, ndmin=2, encoding="utf-8-sig")
    except ValueError as e:
        raise MienError(f"{path} is not a table of numbers ({e}); BUFT's .dat has 6 or 7 columns") from e
    require(
        rows.shape[1] in (6, 7) and len(rows) > 1,
        f"{path} has {rows.shape[0]} rows of {rows.shape[1]} columns; BUFT's .dat has 6 (X, Y, depth, roll, yaw, "
        "pitch) or 7 (an index first), with a row for every frame",
    )
    require_finite(rows, path, "the truth")
    return np.asarray(rows[:, -6:], dtype=float)


def _dat_of(root: Path, video: Path) -> Path | None:
    beside = video.with_suffix(".dat")
    if beside.exists():
        return beside
    elsewhere = found_in(root, f"**/{escape(beside.name)}")
    same_light = [p for p in elsewhere if _kind(root, p) == _kind(root, video)]
    tables = same_light or elsewhere
    require(len(tables) < 2, f"{video} has several tables, {', '.join(map(str, tables))}; keep one of them")
    return next(iter(tables), None)


def _kind(root: Path, path: Path) -> str:
    folders = (root.name, *path.relative_to(root).parts[:-1])
    return VARYING if any("vary" in f.lower() for f in folders) else UNIFORM
