"""The summary of many videos: a CSV with one row per face, in which later runs keep other videos and what users add."""

from __future__ import annotations

import csv
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from mien.csv_files import opened_csv
from mien.errors import require, warn
from mien.files import exists, printable, real_path, size_of, whole_file
from mien.output.destination import Destination
from mien.output.track import Track
from mien.output.track_files import read_outline
from mien.tracking.state import Status

SUMMARY = "summary.csv"
TRACKED, KEPT, FAILED, PENDING = "tracked", "kept", "failed", "not yet"
"""State of a video: tracked in this run; kept from an earlier run; failed; not reached before the run was stopped. Rows
of videos that a run is not asked for keep theirs."""
_CSV: Any = {"encoding": "utf-8", "newline": "", "errors": "backslashreplace"}
"""How the summary is written: in names of files that are not valid UTF-8, bytes are replaced by their escapes."""


@dataclass(frozen=True)
class Row:
    """One face of a video in the summary.

    faces: number of faces in the video; duration: seconds from the first frame of the table to the last; lost, unsure:
    number of frames without the face, and of those with it at a confidence below one half; confidence: its mean where
    the face is not lost; begun: time in seconds of the first frame; note: the error, and the warnings.
    """

    video: Path
    table: Path
    state: str = PENDING
    face_id: int = 0
    faces: int | None = None
    frames: int | None = None
    duration: float | None = None
    lost: int | None = None
    unsure: int | None = None
    confidence: float | None = None
    begun: float | None = None
    note: str = ""


_OWN = tuple(field.name for field in fields(Row))
"""The columns of the summary; others are its users'."""


def face_rows(row: Row, faces: int) -> list[Row]:
    """The rows of all faces of a video, of which there are this number; `row` is that of the first. Raises MienError if
    a table is damaged."""
    rows = [_with_counts(replace(row, faces=faces))]
    for face_id in range(1, faces):
        table = Destination(row.table).of_face(face_id).table
        if table is not None and exists(table):
            rows.append(_with_counts(replace(rows[0], table=table, face_id=face_id, note="")))
    return rows


def _with_counts(row: Row) -> Row:
    """The row with the counts and means of its table."""
    track = Track(read_outline(row.table))
    confidence = np.nan_to_num(track.confidence)[[status != Status.LOST for status in track.status]]
    return replace(
        row,
        frames=len(track),
        duration=round(float(np.ptp(track.time)), 6) if len(track) else None,
        lost=track.lost,
        unsure=int(np.sum(confidence < 0.5)),
        confidence=round(float(confidence.mean()), 4) if confidence.size else None,
        begun=track.time[track.status.index(Status.INITIALIZED)] if Status.INITIALIZED in track.status else None,
    )


@dataclass(frozen=True)
class Summary:
    """The summary of the tables in the folder of `path`, with what earlier runs have noted in it, and users have added.

    earlier: the rows of earlier runs, by the table of the first face of their video, as it is written in them.
    """

    path: Path
    earlier: Mapping[str, Sequence[Mapping[str, str]]]

    @classmethod
    def read(cls, path: Path) -> Summary:
        """The summary that earlier runs have left, or an empty one. Raises MienError if the file is another's."""
        earlier: dict[str, list[Mapping[str, str]]] = {}
        for row in _rows(path):
            earlier.setdefault(_table_of_first(row), []).append(row)
        return cls(path, earlier)

    def require_own(self, row: Row) -> None:
        """Raise MienError if the table of a row was made, in an earlier run, of another video that is still there."""
        known = self.earlier.get(self._values(row)["table"], ())
        video = Path(next((face["video"] for face in known if face["video"]), row.video))
        require(
            not exists(row.table) or not exists(video) or real_path(row.video) == real_path(video),
            f"{row.table} is the table of {video}, by {self.path}, and {row.video} would replace it; choose another "
            "folder with -o",
        )

    def warn_of_other_tables(self, rows: Iterable[Row]) -> None:
        """Warn of tables that the videos of these rows had in earlier runs, and that are not those of the rows, as
        another video of the same name has come."""
        now = {known["video"]: known["table"] for known in map(self._values, rows)}
        for table, (first, *_) in self._left.items():
            if now.get(first["video"], table) != table and exists(self.path.parent / table):
                warn(
                    f"{self.path.parent / table} is left from an earlier run; the table of {first['video']} is now "
                    f"{now[first['video']]}"
                )

    def write(self, found: Iterable[Sequence[Row]]) -> None:
        """Write the rows of this run, and below them those of other videos."""
        rows = [[self._values(row) for row in faces] for faces in found]
        tables, videos = ({faces[0][name] for faces in rows} for name in ("table", "video"))
        left = self._left.items()
        others = (faces for table, faces in left if table not in tables and faces[0]["video"] not in videos)
        names = dict.fromkeys(chain(_OWN, *self._added.values()))
        with whole_file(self.path) as file, file.open("w", **_CSV) as stream:
            writer = csv.DictWriter(stream, list(names), lineterminator="\n")
            writer.writeheader()
            writer.writerows(chain.from_iterable([*rows, *others]))

    @cached_property
    def _added(self) -> dict[str | tuple[str, str], dict[str, str]]:
        """The cells of columns that users have added, by the table of their row, and by its video and face, as tables
        get other names where videos of the same name come."""
        rows = list(chain.from_iterable(self.earlier.values()))
        cells = [{name: cell for name, cell in row.items() if name not in _OWN} for row in rows]
        by_face = {(row["video"], row["face_id"]): added for row, added in zip(rows, cells, strict=True)}
        return by_face | {row["table"]: added for row, added in zip(rows, cells, strict=True)}

    @cached_property
    def _left(self) -> dict[str, Sequence[Mapping[str, str]]]:
        """The rows of earlier runs of which the table or the video is still there."""
        return {
            table: faces
            for table, faces in self.earlier.items()
            if exists(self.path.parent / table) or exists(Path(faces[0]["video"]))
        }

    def _values(self, row: Row) -> dict[str, Any]:
        """A row as it is written: the video as an absolute path, the table as one from the folder of the summary."""
        table = printable(row.table.relative_to(self.path.parent).as_posix())
        video = printable(os.path.abspath(row.video))
        added = self._added.get(table, self._added.get((video, str(row.face_id)), {}))
        return vars(row) | {"video": video, "table": table} | added


def _rows(path: Path) -> list[dict[str, str]]:
    """The rows of a summary, none if there is no file. Raises MienError if the file is something else, or has several
    columns of one name, of which all but one would be lost when it is written."""
    if not size_of(path):
        return []
    rows, names, doubled = list[dict[str, str]](), set[str](), set[str]()
    with suppress(ValueError, csv.Error), opened_csv(path) as stream:
        reader = csv.reader(stream)
        header = next(reader, [])
        for cells in reader:
            named = list(zip(header, cells, strict=False))
            doubled |= {name for name, cell in named if cell and header.count(name) > 1}
            rows.append(dict.fromkeys(header, "") | dict(named))
        rows = [row for row in rows if row.get("table")]
        names = set(header)  # only if all of it can be read: what is not is lost when it is written
    require(
        bool(names) or not _is_in_another_encoding(path),
        f"{path} is not in UTF-8, perhaps since a spreadsheet has saved it; save it once more, as CSV UTF-8",
    )
    require(
        names >= {"video", "table", "state", "face_id"},
        f"{path} exists and is not a summary by mien batch; choose another folder with -o, or move it away",
    )
    several = ", ".join(map(repr, sorted(doubled)))
    require(not several, f"{path} has several columns {several}; give each a name of its own")
    return rows


def _is_in_another_encoding(path: Path) -> bool:
    """Whether a file is a summary that was saved in the encoding of a machine instead of UTF-8."""
    content = path.read_bytes()
    with suppress(UnicodeDecodeError):
        content.decode()
        return False
    return b"face_id" in content.partition(b"\n")[0]


def _table_of_first(row: Mapping[str, str]) -> str:
    """The table of the first face of the video of a row, as it is written there; see `Destination.of_face`."""
    stem, face_id = row["table"].removesuffix(".csv"), row["face_id"]
    return f"{stem if face_id == '0' else stem.removesuffix(f'.face{face_id}')}.csv"
