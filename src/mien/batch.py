"""Many videos: each in a process of its own, so many at a time. What is done is kept, and a second run goes on."""

from __future__ import annotations

import csv
import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from mien._version import __version__
from mien.errors import MienError, require, warn
from mien.files import require_writable, size_of, whole_file
from mien.output.destination import Destination
from mien.output.track import Track
from mien.pipeline import DEFAULT_PRESET
from mien.processes import Call, Ended, Progress, run_commands
from mien.registry import create_tracker, file_of
from mien.start import asked
from mien.video import VIDEO_SUFFIXES, images_of

SUMMARY = "summary.csv"
TRACKED, KEPT, FAILED, NOT_YET = "tracked", "kept", "failed", "not yet"
"""What became of a video: tracked now, or in an earlier run; not to be tracked; not reached before the run was stopped.
"""
_FACE = re.compile(r"\.face[0-9]+$")
"""What `Destination.of_face` puts behind the name of a table."""
_UNHEARD = "done after mien batch had been stopped: what was warned of is not known; --again tracks it anew"
"""The note of a video whose process outlived the run that began it."""
_SPOKEN = "mien: "
"""What the command line puts before its warnings and errors."""


@dataclass(frozen=True)
class Wish:
    """What is asked of every video: as of `mien.track`, pictures to draw, whether to do again what is done."""

    preset: str = DEFAULT_PRESET
    passes: int = 1
    faces: int = 1
    camera: Path | None = None
    focal_px: float | None = None
    fov_deg: float | None = None
    start: float | None = None
    end: float | None = None
    at_once: bool = False
    overlay: bool = False
    plot: bool = False
    again: bool = False

    @property
    def arguments(self) -> list[str]:
        """What of it `mien track` is told."""
        given = {"--preset": self.preset, "--passes": self.passes, "--faces": self.faces, "--camera": self.camera}
        given |= {"--focal": self.focal_px, "--fov": self.fov_deg, "--start": self.start, "--end": self.end}
        pairs = ((name, str(value)) for name, value in given.items() if value is not None)
        return [*chain.from_iterable(pairs), *["--at-once"] * self.at_once]

    def is_met_by(self, metadata: Mapping[str, Any]) -> bool:
        """Whether a track with this NAME.json is what is asked for, from this version of mien."""
        wanted = {"mien": __version__, "complete": True, "preset": self.preset, "passes": self.passes}
        wanted["asked"] = asked(self, self.at_once)
        return metadata.get("faces_wanted", 1) == self.faces and wanted.items() <= metadata.items()

    def files_of(self, table: Path, faces: int) -> list[Path]:
        """Every file that a video with so many faces gets."""
        overlay, plot = _pictures(table)
        files = Destination(table, overlay if self.overlay else None, plot if self.plot else None)
        return [file for face_id in range(faces) for file in files.of_face(face_id).paths()]

    @property
    def inputs(self) -> list[Path]:
        """What `mien track` reads for every video beside it."""
        return [file for file in (file_of(self.preset), self.camera) if file is not None]


@dataclass(frozen=True)
class Row:
    """A face of a video in the summary. faces: how many the video has; lost, unsure: frames without the face, and with
    a confidence below a half; begun: seconds at which it was learned; note: why it failed, or what was warned of."""

    video: Path
    table: Path
    state: str = NOT_YET
    face_id: int = 0
    faces: int | None = None
    frames: int | None = None
    lost: int | None = None
    unsure: int | None = None
    begun: float | None = None
    note: str = ""


def track_all(
    paths: Sequence[Path],
    out: Path,
    wish: Wish | None = None,
    jobs: int | None = None,
    progress: Progress = lambda done, total, name: None,
    forked: bool = False,
) -> list[Row]:
    """Track every video among paths and below the folders among them; their tables go to `out`, in folders as the
    videos', with a summary, which is written first and whenever a video is done: it holds what was noted of each.

    jobs: how many at a time, one for each processor unless given; forked: whether processes may be forked, which begin
    sooner, but import the main module again. Raises MienError where there is nothing to track, or the tables cannot be
    written; a video that cannot be tracked is a row.
    """
    wish = wish or Wish()
    create_tracker(wish.preset)  # an unknown one is told now, and not of every video
    notes = _notes(out / SUMMARY)
    found = [[Row(video, table)] for video, table in find_videos(paths, out)]
    require_writable(out / SUMMARY)
    waiting = []
    for k, (row,) in enumerate(found):
        kept = None if wish.again else _kept(replace(row, note=notes.get(str(row.video), "")), wish)
        if kept is None:
            waiting.append(k)
        else:
            found[k] = kept
    _write(found, out / SUMMARY)
    commands = [_command(found[k][0], wish) for k in waiting]
    started: list[str] = []
    try:
        progress(len(found) - len(waiting), len(found), "")
        for ended in run_commands(commands, jobs or _processors(), started=started.append, forked=forked):
            k = waiting[ended.place]
            found[k] = _outcome(found[k][0], ended)
            with suppress(MienError):  # the next one has it, too, and the last must be written
                _write(found, out / SUMMARY)
            progress(sum(faces[0].state != NOT_YET for faces in found), len(found), started[-1])
    except BaseException:
        done = sum(faces[0].state in (TRACKED, KEPT) for faces in found)
        warn(f"stopped; {done} of {len(found)} videos are done, and the same command goes on from there")
        raise
    finally:
        _write(found, out / SUMMARY)
    return [faces[0] for faces in found]


def find_videos(paths: Sequence[Path], out: Path) -> list[tuple[Path, Path]]:
    """Videos among paths and below the folders among them, and the table of each below `out`. The ending is part of the
    table's name where two in one folder differ by it alone, and where without it the table would be that of another's
    further face, or the summary."""
    found = list(dict.fromkeys(pair for path in paths for pair in _videos_of(path, out)))
    require(bool(found), f"{', '.join(map(str, paths))}: no video is there; mien looks for {', '.join(VIDEO_SUFFIXES)}")
    alike = Counter(place.with_suffix("") for _, place in found)
    tables: dict[Path, Path] = {}
    for video, place in found:
        stem = place.with_suffix("")
        of_another = _FACE.search(stem.name) and stem.with_name(_FACE.sub("", stem.name)) in alike
        taken = alike[stem] > 1 or of_another or place.with_suffix(".csv") == Path(SUMMARY)
        table = out / (f"{place}.csv" if taken else place.with_suffix(".csv"))
        other = tables.setdefault(table, video)
        require(other == video, f"{other} and {video} would have the same table, {table}; track one folder at a time")
    return [(video, table) for table, video in tables.items()]


def _videos_of(path: Path, out: Path) -> Iterator[tuple[Path, Path]]:
    """Videos of a path, each with its place below the folder that was given, which is one itself where it has no video
    but images."""
    known = path.is_dir() or path.is_file()
    require(known, f"{path}: no such file or folder; check the name, and save what comes through a pipe as a file")
    if path.is_file():
        yield path, Path(path.name)
        return
    # What an overlay is, is a video too.
    require(
        not path.resolve().is_relative_to(out.resolve()),
        f"{out} holds the videos; choose another folder for the tables with -o",
    )
    below = (file for file in sorted(path.rglob("*")) if file.suffix.lower() in VIDEO_SUFFIXES)
    shown = (file for file in below if not any(part.startswith(".") for part in file.relative_to(path).parts))
    videos = [file for file in shown if not file.resolve().is_relative_to(out.resolve())]
    yield from ((file, file.relative_to(path)) for file in videos)
    if not videos and images_of(path):
        yield path, Path(f"{path.resolve().name}.images")


def _processors() -> int:
    """How many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _pictures(table: Path) -> tuple[Path, Path]:
    """Overlay and plot beside a table."""
    return table.with_name(f"{table.stem}.overlay.mp4"), table.with_suffix(".png")


def _command(row: Row, wish: Wish) -> Call:
    overlay, plot = _pictures(row.table)
    pictures = [*["--overlay", str(overlay)] * wish.overlay, *["--plot", str(plot)] * wish.plot]
    arguments = ("track", "-o", str(row.table), *pictures, *wish.arguments, "--quiet", "--", str(row.video))
    return Call(row.video.name, "mien.worker:run", arguments)


def _kept(row: Row, wish: Wish) -> list[Row] | None:
    """The rows of a video whose files are all there, whole, no older than it, of as large a video, and from the same
    tracker with the same settings; else None."""
    if not row.table.exists():
        return None
    try:
        track = Track.read(row.table)
    except MienError:
        return None
    known = track.metadata
    if not wish.is_met_by(known) or known.get("video", {}).get("bytes") != size_of(row.video):
        return None
    files = wish.files_of(row.table, known.get("faces", 1))
    read = [row.video, *(images_of(row.video) if row.video.is_dir() else ())]
    if not all(file.exists() for file in files):
        return None
    if min(file.stat().st_mtime for file in files) < max(file.stat().st_mtime for file in (*read, *wish.inputs)):
        return None
    with suppress(MienError):
        return _faces(replace(row, state=KEPT), track)
    return None


def _outcome(row: Row, ended: Ended) -> list[Row]:
    """The rows of a video whose process has ended."""
    said = " ".join(line.removeprefix(_SPOKEN) for line in ended.said if line.startswith(_SPOKEN))
    if ended.reason:
        return [replace(row, state=FAILED, note=said or f"{row.video}: {ended.reason}")]
    try:
        return _faces(replace(row, state=TRACKED, note=said), Track.read(row.table))
    except MienError as error:
        return [replace(row, state=FAILED, note=str(error))]


def _measured(row: Row, track: Track) -> Row:
    """The row with what the video's track says."""
    begun = track.time[track.status.index("initialized")] if "initialized" in track.status else None
    unsure = int((np.nan_to_num(track.confidence) < 0.5).sum())
    faces = track.metadata.get("faces", 1) if row.faces is None else row.faces
    return replace(row, faces=faces, frames=len(track), lost=track.lost, unsure=unsure, begun=begun)


def _faces(row: Row, track: Track) -> list[Row]:
    """The rows of a video's faces, of which the first has this row and track. Raises MienError where a table of another
    is damaged."""
    rows = [_measured(row, track)]
    for face_id in range(1, rows[0].faces or 1):
        table = Destination(row.table).of_face(face_id).table
        if table is not None and table.exists():
            rows.append(_measured(replace(rows[0], table=table, face_id=face_id, note=""), Track.read(table)))
    return rows


def _notes(summary: Path) -> dict[str, str]:
    """What an earlier run's summary notes of each video, by its name, and of one that had not ended then, that nothing
    is known; nothing where there is no summary."""
    if not summary.is_file():
        return {}
    try:
        with summary.open(encoding="utf-8", newline="") as stream:
            rows = [row for row in csv.DictReader(stream) if row.get("face_id") == "0"]
    except (ValueError, csv.Error):
        return {}
    return {row.get("video") or "": _UNHEARD if row.get("state") == NOT_YET else row.get("note") or "" for row in rows}


def _write(found: Sequence[Sequence[Row]], path: Path) -> None:
    """The summary: a row a face, or a video that has none."""
    names = [field.name for field in fields(Row)]
    with whole_file(path) as file, file.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(names)
        for row in chain.from_iterable(found):
            values = (getattr(row, name) for name in names)
            writer.writerow(["" if value is None else value for value in values])
