"""The summary of many videos: a CSV with one row per face."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from mien.errors import require
from mien.files import exists, real_path, whole_file
from mien.output.destination import Destination
from mien.output.track import Track
from mien.tracking.state import Status

SUMMARY = "summary.csv"
TRACKED, KEPT, FAILED, PENDING = "tracked", "kept", "failed", "not yet"
"""State of a video: tracked in this run; kept from an earlier run; failed; not reached before the run was stopped."""
_WARNINGS_UNKNOWN = "finished after mien batch was stopped, so its warnings are unknown; --again tracks it again"
"""The note of a video whose process outlived the run that started it."""
_CSV: Any = {"encoding": "utf-8", "newline": "", "errors": "backslashreplace"}
"""How the summary is opened: in names of files that are not valid UTF-8, bytes are replaced by their escapes."""


@dataclass(frozen=True)
class Row:
    """One face of a video in the summary.

    faces: number of faces in the video; lost, unsure: number of frames without the face, and of those with it at a
    confidence below one half; begun: time in seconds of the first frame; note: the error, and the warnings.
    """

    video: Path
    table: Path
    state: str = PENDING
    face_id: int = 0
    faces: int | None = None
    frames: int | None = None
    lost: int | None = None
    unsure: int | None = None
    begun: float | None = None
    note: str = ""


def face_rows(row: Row, track: Track) -> list[Row]:
    """The rows of all faces of a video; `row` and `track` are those of the first. Raises MienError if the table of
    another is damaged."""
    rows = [_with_counts(row, track)]
    for face_id in range(1, rows[0].faces or 1):
        table = Destination(row.table).of_face(face_id).table
        if table is not None and exists(table):
            rows.append(_with_counts(replace(rows[0], table=table, face_id=face_id, note=""), Track.read(table)))
    return rows


def _with_counts(row: Row, track: Track) -> Row:
    """The row with the counts from a track of its video."""
    begun = track.time[track.status.index(Status.INITIALIZED)] if Status.INITIALIZED in track.status else None
    sure = np.nan_to_num(track.confidence) >= 0.5
    unsure = sum(status != Status.LOST and not of for status, of in zip(track.status, sure, strict=True))
    faces = track.metadata.get("faces", 1) if row.faces is None else row.faces
    return replace(row, faces=faces, frames=len(track), lost=track.lost, unsure=unsure, begun=begun)


def require_own_tables(found: Mapping[Path, Path], rows: Iterable[Mapping[str, str]], summary: Path) -> None:
    """Raise MienError if a table is, by the rows of an earlier run's summary, another video's that is still there.
    found: videos by their tables."""
    for row in rows:
        table, video = Path(row.get("table") or ""), Path(row.get("video") or "")
        own = found.get(table)
        require(
            own is None or not exists(table) or not video.exists() or real_path(own) == real_path(video),
            f"{table} is the table of {video}, by {summary}, and {own} would replace it; choose another folder with -o",
        )


def notes_of(rows: Iterable[Mapping[str, str]]) -> dict[str, str]:
    """The notes in the rows of an earlier run's summary, by video. The note of a video that had not finished then says
    that its warnings are unknown."""
    return {
        row.get("video") or "": _WARNINGS_UNKNOWN if row.get("state") == PENDING else row.get("note") or ""
        for row in rows
    }


def read_summary(summary: Path) -> list[dict[str, str]]:
    """The rows of an earlier summary, one for each video; none without a summary."""
    if not summary.is_file():
        return []
    try:
        with summary.open(**_CSV) as stream:
            return [row for row in csv.DictReader(stream) if row.get("face_id") == "0"]
    except (ValueError, csv.Error):
        return []


def as_written(video: Path) -> str:
    """The path of a video as the summary has it."""
    return str(video).encode(_CSV["encoding"], _CSV["errors"]).decode(_CSV["encoding"])


def write_summary(found: Sequence[Sequence[Row]], path: Path) -> None:
    """Write the summary: one row per face, or per video without one."""
    names = [field.name for field in fields(Row)]
    with whole_file(path) as file, file.open("w", **_CSV) as stream:
        writer = csv.writer(stream)
        writer.writerow(names)
        for row in chain.from_iterable(found):
            values = (getattr(row, name) for name in names)
            writer.writerow(["" if value is None else value for value in values])
