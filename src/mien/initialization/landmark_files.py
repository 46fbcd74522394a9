"""Read and write landmarks: mien's JSON, iBUG-68 `.pts`, a row of an OpenFace CSV.

Pixel coordinates in a `.pts` start at 1, as in 300-W: reading subtracts 1 and writing adds it. In JSON and CSV they
start at 0.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mien.arrays import Array
from mien.csv_files import csv_rows, landmark_count, number_in
from mien.errors import MienError, require
from mien.files import json_text, reason_of, user_path, whole_file
from mien.graphics import Graphics
from mien.initialization.landmarks import SCHEME_OF_COUNT, Landmarks
from mien.video import warn_of_another_size

PTS_ORIGIN = 1.0
TIME_TOLERANCE = 0.5
"""Largest time difference in seconds between a frame and the nearest row of a CSV."""


def read_landmarks(
    path: str | Path, index: int = 0, time: float = 0.0, size: tuple[int, int] | None = None
) -> Landmarks:
    """Read the landmarks of the frame with this index and time (seconds) from a `.json`, `.pts` or `.csv` file.

    A JSON (from `mien landmarks`, or NAME.json of a track) states its own frame; from a CSV, the row nearest in time is
    read, which states its own time, or the row with this index if it has no times. size: width and height of the frame;
    warns if a JSON is that of another. Raises MienError naming the file and the remedy.
    """
    is_path = isinstance(path, (str, Path))
    require(is_path, f"landmarks are {type(path)}; give mien.Landmarks or the name of a landmark file")
    path = user_path(path)
    readers: dict[str, Callable[[Path, int, float], Landmarks]]
    readers = {".json": partial(_read_json, size=size), ".pts": _read_pts, ".csv": _read_csv}
    require(path.is_file(), f"{path}: no such file; check the name, or create one with mien landmarks VIDEO")
    require(path.suffix.lower() in readers, f"{path}: landmarks are read from {', '.join(readers)}")
    try:
        return readers[path.suffix.lower()](path, index, time)
    except (UnicodeDecodeError, csv.Error) as error:
        raise MienError(f"{path} is not a text file; check that it is the landmark file") from error
    except OSError as error:
        raise MienError(f"{path} cannot be read ({reason_of(error)}); check the file") from error


def write_landmarks(path: str | Path, landmarks: Landmarks, size: tuple[int, int] | None = None) -> None:
    """Write a `.json`, or a `.pts` if the scheme is ibug68. size: width and height of their frame, which a `.json`
    states. Raises MienError for any other file, and if it cannot be written."""
    path = user_path(path)
    writers: dict[str, Callable[[Path, Landmarks], str]]
    writers = {".json": partial(_json_text, size=size), ".pts": _pts_text}
    require(path.suffix.lower() in writers, f"{path}: landmarks are written to {' or '.join(writers)}")
    text = writers[path.suffix.lower()](path, landmarks)
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _read_json(path: Path, index: int, time: float, size: tuple[int, int] | None) -> Landmarks:
    text = path.read_text(encoding="utf-8-sig")
    try:
        content: dict[str, Any] = json.loads(text)
        values = content.get("landmarks", content)  # NAME.json of a track contains those of its first frame
        values = {name: value for name, value in values.items() if value is not None}
        points, scheme, depths = values["points"], values["scheme"], values.get("depths")
        points = np.array(points, dtype=float)
        depths = None if depths is None else np.array(depths, dtype=float)
        graphics = None if "graphics" not in values else Graphics.from_dict(values["graphics"])
        elsewhere = int(values.get("frame", index)) != index
        index, time = int(values.get("frame", index)), float(values.get("time", time))
    except json.JSONDecodeError as error:
        raise MienError(f"{path} is not valid JSON ({error}); create it again with mien landmarks") from error
    except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
        raise MienError(
            f"{path} needs `scheme` and `points`, a list of pairs of numbers ({error}); "
            "compare it with the output of mien landmarks"
        ) from error
    require("time" in values or not elsewhere, f"{path} states no time of its frame {index}; add `time`, in seconds")
    if size is not None:
        warn_of_another_size(f"{path} has landmarks", content, size, "find its own with mien landmarks")
    return Landmarks(points, scheme, depths, index, time, str(path), graphics=graphics, marked=values.get("marked"))


def _json_text(path: Path, landmarks: Landmarks, size: tuple[int, int] | None) -> str:
    video = {} if size is None else {"video": dict(zip(("width", "height"), size, strict=True))}  # as NAME.json has it
    return json_text(landmarks.to_dict() | video)


def _read_pts(path: Path, index: int, time: float) -> Landmarks:
    text = path.read_text(encoding="utf-8")
    header, opened, rest = text.partition("{")
    body, closed, _ = rest.partition("}")
    require(
        bool(opened and closed),
        f"{path} has no points between braces; a .pts file is `version: 1`, `n_points: 68`, points in braces",
    )
    points = _numbers(path, body.split())
    require(points.size % 2 == 0, f"{path}: a point lacks a coordinate; each line holds x and y")
    points = points.reshape(-1, 2)
    stated = re.findall(r"^n_points\s*:?\s*(\S*)", header, re.MULTILINE)
    if stated and stated[0] != str(len(points)):
        raise MienError(f"{path} states {stated[0]} points and holds {len(points)}; the file is incomplete")
    return Landmarks(points - PTS_ORIGIN, "ibug68", None, index, time, str(path))


def _pts_text(path: Path, landmarks: Landmarks) -> str:
    require(
        landmarks.scheme == "ibug68",
        f"{path}: a .pts file holds the 68 points of iBUG and these are {landmarks.scheme}; write a .json",
    )
    lines = [f"{x:.3f} {y:.3f}" for x, y in landmarks.points + PTS_ORIGIN]
    return "\n".join(["version: 1", f"n_points: {len(lines)}", "{", *lines, "}", ""])


def _read_csv(path: Path, index: int, time: float) -> Landmarks:
    row, time = _row_of_frame(path, list(csv_rows(path)), index, time)
    count = landmark_count(row)
    require(
        count in SCHEME_OF_COUNT,
        f"{path} has {count} landmark columns x_0, x_1 ..; OpenFace writes 68 of them with -2Dfp",
    )
    names = [f"{axis}_{i}" for i in range(count) for axis in "xy"]
    missing = [n for n in names if n not in row]
    if missing:
        raise MienError(f"{path} lacks the column {missing[0]}; write the file again")
    points = _numbers(path, [row[n] for n in names]).reshape(-1, 2)
    return Landmarks(points, SCHEME_OF_COUNT[count], None, index, time, str(path))


def _row_of_frame(path: Path, rows: list[dict[str, str]], index: int, time: float) -> tuple[dict[str, str], float]:
    """The row for a frame: the most confident face at the nearest time or, without times, the row with this index; and
    its own time in seconds, if it has one."""
    require(bool(rows), f"{path} holds no row; it is not the output of OpenFace")
    if "timestamp" in rows[0]:
        times = _numbers(path, [r["timestamp"] for r in rows])
        differences = np.nan_to_num(np.abs(times - time), nan=np.inf)
        require(
            float(differences.min()) <= TIME_TOLERANCE,
            f"{path} has no row near {time:.2f} s, where tracking begins; choose another start",
        )
        time = float(times[differences.argmin()])
        rows = [r for r, t in zip(rows, times, strict=True) if t == time]
    else:
        require(index < len(rows), f"{path} has {len(rows)} rows and tracking begins at frame {index}")
        rows = [rows[index]]
    confidence = np.nan_to_num(_numbers(path, [r.get("confidence") or "0" for r in rows]))
    row = rows[int(np.argmax(confidence))]
    require(
        bool(_numbers(path, [row.get("success") or "1"])[0] > 0),
        f"{path} has no face at {time:.2f} s, where tracking begins (success is 0); choose another start",
    )
    return row, time


def _numbers(path: Path, words: list[str]) -> Array:
    """The numbers (n,) in words or cells; NaN where a cell is empty."""
    try:
        return np.array([number_in(w) for w in words])
    except ValueError as error:
        raise MienError(f"{path}: a value is not a number ({error}); correct the file") from error
