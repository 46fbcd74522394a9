"""Read poses and landmarks from CSV files with OpenFace's columns: by OpenFace, by mien, or made by hand.

The columns are all optional, except that there must be a pose or landmarks: `frame`, `face_id`, `timestamp` (s),
`confidence`, `success`; `pose_Rx, pose_Ry, pose_Rz` (radians, `R = Rx Ry Rz` in camera axes, zero when facing the
camera); `pose_Tx..` (mm); `x_0.., y_0..` pixels of 68 (iBUG) or 26 (CANDIDE) landmarks; mien's animation units by name,
`eyes_closed` and `eyes_closed_sd`. OpenFace puts a space before most names and values.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mien.arrays import Array, Mask
from mien.candide.model import TRACKED_UNITS
from mien.csv_files import csv_rows, landmark_count, number_in
from mien.errors import MienError, require, warn
from mien.files import reason_of
from mien.geometry.rotation import FACING, matrix_from_euler
from mien.initialization.landmarks import SCHEME_OF_COUNT
from mien.output.columns import ROTATION, TRANSLATION

_LARGEST_RAD = 2 * math.pi + 1e-6
_CLOSING = ("eyes_closed", "eyes_closed_sd")
_TIME_SD, _CLOSE, _EVEN = 7e-4, 0.25, 0.5
"""Error of a time in seconds, as most are rounded to milliseconds; the error in frames with which the times still say
how frames are numbered; and by how many frames at most one lies beside a line, if they come at an even rate."""


@dataclass(frozen=True)
class PoseTable:
    """The rows of one face in a CSV. Missing columns are None; a row whose `success` is 0 is not `tracked`.

    frame: (n,) as numbered in the file, or the row number if it has no numbers (numbered is False); first: number of
    the video's first frame, 0 as in mien's files or 1 as in OpenFace's, None if the file does not say; rotation:
    (n, 3, 3) head -> camera; translation_mm: (n, 3); landmarks: (n, k, 2) pixels; animation: (n, 6); eyes_closed:
    (n, 2) eye closure and its standard deviation, each NaN if unknown; time: (n,) seconds, NaN if unknown; rate: frames
    per second by the times, None without; by_mien: whether mien has written the file; angles: (n, 3) radians, of the
    columns of the pose.
    """

    source: Path
    frame: NDArray[np.intp]
    numbered: bool
    first: int | None
    tracked: Mask
    confidence: Array
    time: Array
    rotation: Array | None = None
    translation_mm: Array | None = None
    landmarks: Array | None = None
    animation: Array | None = None
    eyes_closed: Array | None = None
    rate: float | None = None
    by_mien: bool = False
    angles: Array | None = None

    @property
    def index(self) -> NDArray[np.intp]:
        """(n,) indices of the frames, from 0; without any other evidence the file is numbered as OpenFace's."""
        return self.frame - (1 if self.first is None else self.first)

    @property
    def scheme(self) -> str:
        """Scheme of the landmarks."""
        assert self.landmarks is not None
        return SCHEME_OF_COUNT[self.landmarks.shape[1]]


def read_pose_csv(path: Path) -> PoseTable:
    """Read the first face of a CSV. Raises MienError if it is not such a table, or a value is not a number; warns of
    what is not read."""
    rows = _rows(path)
    names = list(rows[0])
    count = landmark_count(names)
    has_pose = set(ROTATION) <= set(names)
    require(
        has_pose or count in SCHEME_OF_COUNT,
        f"{path} has neither the columns {', '.join(ROTATION)} nor the landmarks x_0, y_0 .. of 68 or 26 points",
    )
    _warn_of_what_is_not_read(path, names, count)
    tracked = np.nan_to_num(_column(path, rows, "success", 1.0)) > 0
    frame, numbered = _frame_numbers(path, rows), "frame" in names
    angles = _columns(path, rows, ROTATION) if has_pose else None
    points = [f"{axis}_{i}" for i in range(count) for axis in "xy"]
    landmarks = _columns(path, rows, points) if count in SCHEME_OF_COUNT else None
    _require_plausible(path, angles, landmarks, tracked)
    by_mien = "status" in names
    from_zero = bool((frame == 0).any()) or by_mien
    time = _column(path, rows, "timestamp", np.nan)
    rate, first = _rate_and_first(frame, time)
    closing = [_column(path, rows, name, np.nan) for name in _CLOSING]
    return PoseTable(
        source=path,
        frame=frame.astype(np.intp),
        numbered=numbered,
        first=0 if from_zero else first,
        tracked=tracked,
        confidence=np.nan_to_num(_column(path, rows, "confidence", 1.0)),
        time=time,
        rotation=None if angles is None else _rotations(angles),
        translation_mm=_columns(path, rows, TRANSLATION) if set(TRANSLATION) <= set(names) else None,
        landmarks=None if landmarks is None else landmarks.reshape(len(rows), count, 2),
        animation=_columns(path, rows, TRACKED_UNITS) if set(TRACKED_UNITS) <= set(names) else None,
        eyes_closed=np.stack(closing, axis=1) if _CLOSING[0] in names else None,
        rate=rate,
        by_mien=by_mien,
        angles=angles,
    )


def _warn_of_what_is_not_read(path: Path, names: Sequence[str], count: int) -> None:
    """Warn of landmarks, of which there are this number, or of a pose, that a CSV with these columns has in vain."""
    if count and count not in SCHEME_OF_COUNT:
        warn(f"{path}: only its pose is read, and none of its {count} landmarks, as they are neither 68 nor 26")
    lacking = set(ROTATION) - set(names)
    if lacking and any(name.lower().startswith("pose") for name in names):
        warn(f"{path}: only its landmarks are read, and no pose, as it lacks the column {min(lacking)}")


def _frame_numbers(path: Path, rows: Sequence[dict[str, str]]) -> Array:
    """The frame (n,) of each row as numbered in the file, or the number of the row. Raises MienError where a number is
    missing, broken or there twice."""
    if "frame" not in rows[0]:
        return np.arange(len(rows), dtype=float)
    frame = _columns(path, rows, ("frame",))[:, 0]
    require(bool(np.isfinite(frame).all()), f"{path}: a row has no frame number; number all rows or none")
    broken = frame[frame % 1 != 0]
    if broken.size:
        raise MienError(f"{path}: the frame {broken[0]:g} is no whole number; a time is a timestamp")
    once = len(np.unique(frame)) == len(frame)
    require(once, f"{path} has two rows for one frame; keep one of them, or the rows of one face")
    return frame


def _require_plausible(path: Path, angles: Array | None, landmarks: Array | None, tracked: Mask) -> None:
    """Raise MienError for poses (n, 3) or landmarks (n, k) of tracked rows that are not finite, and for degrees."""
    for what, values in (("the pose", angles), ("a landmark", landmarks)):
        if values is None:
            continue
        bad = np.flatnonzero(tracked & ~np.isfinite(values).all(axis=1))
        if bad.size:
            raise MienError(f"{path}: {what} in row {bad[0] + 1} is not a finite number; correct it, or delete the row")
    largest = 0.0 if angles is None else float(np.abs(angles[tracked]).max(initial=0.0))
    require(
        largest <= _LARGEST_RAD,
        f"{path}: an angle is {largest:.4g}, more than a full turn; pose_Rx, pose_Ry, pose_Rz are in radians",
    )


def _rate_and_first(frame: Array, time: Array) -> tuple[float | None, int | None]:
    """Frames per second, and the number of the frame at time zero, 0 or 1, by the times (n,) of the frames (n,) in
    seconds: that of its own row or, at an even rate, by a line through the others; None if they do not say."""
    frame, time = frame[np.isfinite(time)], time[np.isfinite(time)]
    if len(set(time.tolist())) < 2 or len(set(frame.tolist())) < 2:
        return None, None
    # About the means: seconds since 1970 leave a line through zero without digits.
    middle, since, counted = float(time.mean()), time - time.mean(), frame - frame.mean()
    spread = float(since @ since)
    rate = float(since @ counted) / spread
    at_zero = float(frame.mean()) - rate * middle
    sd = _TIME_SD * abs(rate) * math.sqrt(1 / len(time) + middle * middle / spread)
    of_zero, nearest = frame[np.abs(time) < _TIME_SD], round(at_zero)
    even = float(np.abs(counted - rate * since).max()) < _EVEN
    first = nearest if even and max(abs(at_zero - nearest), 3 * sd) < _CLOSE else None
    first = int(of_zero[0]) if len(of_zero) else first
    return rate, first if first in (0, 1) else None


def _rows(path: Path) -> list[dict[str, str]]:
    require(path.is_file(), f"{path}: no such file; check the name")
    try:
        rows = list(csv_rows(path))
    except (UnicodeDecodeError, csv.Error) as e:
        raise MienError(f"{path} is not a readable CSV ({e}); save it again, as UTF-8") from e
    except OSError as e:
        raise MienError(f"{path} cannot be read ({reason_of(e)}); check the file") from e
    require(bool(rows), f"{path} has no rows; it needs one for every frame")
    faces = [row.get("face_id", "0") for row in rows]
    if len(set(faces)) > 1:
        warn(f"{path} has several faces, of which the one of its first row is read, face_id {faces[0].strip()}")
    return [row for row, face in zip(rows, faces, strict=True) if face == faces[0]]


def _column(path: Path, rows: Sequence[dict[str, str]], name: str, default: float) -> Array:
    if name not in rows[0]:
        return np.full(len(rows), default)
    return _columns(path, rows, (name,))[:, 0]


def _columns(path: Path, rows: Sequence[dict[str, str]], names: Sequence[str]) -> Array:
    """The numbers (n, k) of these columns; empty cells and those of R that hold NA are NaN."""
    missing = [n for n in names if n not in rows[0]]
    if missing:
        raise MienError(f"{path} lacks the column {missing[0]}; write the file again")
    try:
        return np.array([[number_in(row[n]) for n in names] for row in rows])
    except ValueError as e:
        raise MienError(f"{path}: a cell is not a number ({e}); correct the file") from e


def _rotations(angles: Array) -> Array:
    known = np.isfinite(angles).all(axis=1)
    return np.where(known[:, None, None], matrix_from_euler(np.where(known[:, None], angles, 0)) @ FACING, np.nan)
