"""Track many videos, each in its own process, several at a time; a second run resumes where the first stopped."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from pathlib import Path
from time import monotonic
from typing import Any

from mien.batch.options import BatchOptions, drawings_of
from mien.batch.videos import find_videos
from mien.errors import MienError, require, warn
from mien.files import exists, require_writable
from mien.output.destination import has_other_content
from mien.output.sole_use import sole_use
from mien.output.summary import FAILED, KEPT, PENDING, SUMMARY, TRACKED, Row, Summary, face_rows
from mien.output.track_files import read_metadata
from mien.pipeline.track import check_faces, check_mesh, check_passes
from mien.processes import Call, Ended, Progress, available_processors, run_commands
from mien.registry import create_tracker
from mien.start.footage import check_options
from mien.video import check_fps, list_images

_MESSAGE_PREFIX = "mien: "
"""The prefix of warnings and errors on the command line."""
_SHARE_OF_WRITING = 0.05
"""The share of the time in which the summary is written at most: it has a row for every video, and is written anew for
as many."""


def track_all(
    paths: Sequence[Path],
    out: Path,
    options: BatchOptions | None = None,
    jobs: int | None = None,
    progress: Progress = lambda done, total, name: None,
    forked: bool = False,
) -> list[Row]:
    """Track all videos among the paths and in the folders among them.

    The tables go to `out`, in the same folder structure as the videos, with a summary that is updated as videos are
    finished.

    jobs: number of videos at a time, by default one per processor; forked: whether processes may be forked, which start
    sooner but import the main module again. Raises MienError if there is nothing to track, the tables cannot be
    written, or another run writes into this folder; a video that cannot be tracked becomes a row in the state `failed`.
    """
    options = options or BatchOptions()
    tracker = create_tracker(options.preset)  # report wrong options once, now, and not for every video
    check_passes(options.passes, tracker, options.preset)
    check_mesh("--gltf" if options.gltf else None, tracker, options.preset)
    check_faces(options.faces)
    check_options(options)
    check_fps(options.fps)
    jobs = available_processors() if jobs is None else jobs
    require(jobs >= 1, f"{jobs} videos at a time; give 1 or more, or omit it")
    found = [[Row(video, table)] for video, table in find_videos(paths, out)]
    require_writable(out / SUMMARY)
    with sole_use(out):
        return _track_found(found, Summary.read(out / SUMMARY), options, jobs, progress, forked)


def _track_found(
    found: list[list[Row]],
    summary: Summary,
    options: BatchOptions,
    jobs: int,
    progress: Progress,
    forked: bool,
) -> list[Row]:
    """Track the videos that are found, as `track_all`; found: a list of one row for each, which get those of all its
    faces."""
    waiting = []
    for k, (row,) in enumerate(found):
        kept = None if options.again else _kept_rows(row, options)
        if kept is None:
            waiting.append(k)
        else:
            found[k] = kept
            progress(k + 1 - len(waiting), len(found), "")
    for k in waiting:
        summary.require_own(found[k][0])
    summary.warn_of_other_tables(faces[0] for faces in found)
    summary.write(found)
    commands = [_command(found[k][0], options) for k in waiting]
    started: list[str] = []
    earlier = _times(file for k in waiting for file in _all_files(found[k][0].table))
    due = monotonic()
    try:
        progress(len(found) - len(waiting), len(found), "")
        for ended in run_commands(commands, jobs, started=started.append, forked=forked):
            k = waiting[ended.index]
            found[k] = _outcome(found[k][0], ended, earlier)
            if (begun := monotonic()) >= due:
                with suppress(MienError):  # a later write includes it too, and the last one must succeed
                    summary.write(found)
                due = monotonic() + (monotonic() - begun) / _SHARE_OF_WRITING
            progress(sum(faces[0].state != PENDING for faces in found), len(found), started[-1])
    except BaseException:
        _note_stopped(found, options, earlier)
        raise
    finally:
        summary.write(found)
    return [faces[0] for faces in found]


def _note_stopped(found: list[list[Row]], options: BatchOptions, earlier: Mapping[Path, int]) -> None:
    """Note which of the videos that are pending have been finished by their processes meanwhile, and warn of how many
    are done. earlier: `_times` of their files before."""
    for k, (row, *_) in enumerate(found):
        if row.state == PENDING:
            finished = _times([row.table]).get(row.table) != earlier.get(row.table)
            found[k] = (finished and _kept_rows(row, options)) or [row]
    done = sum(faces[0].state in (TRACKED, KEPT) for faces in found)
    how = "the same command tracks all of them again" if options.again else "run the same command again to continue"
    warn(f"stopped; {done} of {len(found)} videos are done; {how}")


def _all_files(table: Path) -> tuple[Path, ...]:
    """The table and the drawings that a video may have."""
    return table, *drawings_of(table).values()


def _times(files: Iterable[Path]) -> dict[Path, int]:
    """When those of the files that exist were written, in nanoseconds by the clock of their file system."""
    return {file: file.stat().st_mtime_ns for file in files if exists(file)}


def _command(row: Row, options: BatchOptions) -> Call:
    drawings = chain.from_iterable((f"--{name}", str(path)) for name, path in options.drawings(row.table).items())
    given = "-o", str(row.table), *drawings, *options.arguments(row.video), "--quiet"
    return Call(row.video.name, "mien.worker:run", ("track", *given, "--", str(row.video)))


def _kept_rows(row: Row, options: BatchOptions) -> list[Row] | None:
    """The rows of a video that need not be tracked again, else None.

    All its files must exist, be complete, come from the same tracker with the same settings, and be no older than what
    the options name; the video must be the same.
    """
    with suppress(MienError, OSError, AttributeError, LookupError, TypeError):  # whatever somebody made of NAME.json
        known = read_metadata(row.table.with_suffix(".json"))
        if not options.match(known, row.video, row.table):
            return None
        faces = known.get("faces", 1)
        if faces not in range(1, options.faces + 1):
            return None
        oldest = min(file.stat().st_mtime for file in options.files_of(row.table, faces))
        if any(_changed(file) > oldest for file in options.inputs):
            return None
        images = list_images(row.video) if row.video.is_dir() else ()
        newer = any(_changed(file) > oldest for file in (row.video, *images))
        if has_other_content(row.video, known["video"], newer):  # if it is older, too: what is renamed keeps its time
            return None
        return face_rows(replace(row, state=KEPT, note=_note(row, known)), faces)
    return None


def _changed(file: Path) -> float:
    """When a file was written, or replaced by one with an older time, in seconds; on Windows the former alone."""
    known = file.stat()
    return max(known.st_mtime, known.st_ctime)


def _outcome(row: Row, ended: Ended, earlier: Mapping[Path, int]) -> list[Row]:
    """The rows of a video whose process has ended. earlier: `_times` of its files before."""
    if not ended.reason:
        try:
            known = read_metadata(row.table.with_suffix(".json"))
            return face_rows(replace(row, state=TRACKED, note=_note(row, known)), known.get("faces", 1))
        except MienError as error:
            return [replace(row, state=FAILED, note=str(error))]
    old = [file for file, time in _times(_all_files(row.table)).items() if earlier.get(file) == time]
    said = (line.removeprefix(_MESSAGE_PREFIX) for line in ended.output if line.startswith(_MESSAGE_PREFIX))
    reason = ended.reason.removeprefix(_MESSAGE_PREFIX)
    return [replace(row, state=FAILED, note=_joined([reason, *said], str(row.video), old))]


def _note(row: Row, known: Mapping[str, Any]) -> str:
    """What was warned of when the table with this NAME.json was made, and which drawings are not of it."""
    drawings = drawings_of(row.table).items()
    others = [file for name, file in drawings if file.name != known.get(name) and exists(file)]
    return _joined(known.get("warnings", ()), known.get("video", {}).get("name", ""), others)


def _joined(messages: Iterable[str], video: str, old: Sequence[Path]) -> str:
    """Messages of a video as a note, each once and without the name of the video, which its row tells. old: files that
    an earlier run has left."""
    told = dict.fromkeys(re.sub(rf"^{re.escape(video)}:? ", "", message) for message in messages)
    left = [f"{', '.join(file.name for file in old)} {'is' if len(old) == 1 else 'are'} from an earlier run"]
    return "; ".join([*told, *left * bool(old)])
