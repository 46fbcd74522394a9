"""Track many videos, each in its own process, several at a time; a second run resumes where the first stopped."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any
from warnings import catch_warnings, simplefilter

from mien._version import __version__
from mien.errors import MienError, MienWarning, require, warn
from mien.files import checksum, exists, real_path, reason_of, require_writable, size_of
from mien.output.destination import OVERLAY_ENDINGS, Destination
from mien.output.sole_use import sole_use
from mien.output.summary import FAILED, KEPT, PENDING, SUMMARY, TRACKED, Row, Summary, face_rows
from mien.output.track import Track
from mien.processes import Call, Ended, Progress, available_processors, run_commands
from mien.registry import DEFAULT_PRESET, code_of, create_tracker, file_of
from mien.start.footage import check_options, read_camera, requested_options
from mien.tracking.abilities import settings_of
from mien.video import IMAGE_SUFFIXES, VIDEO_SUFFIXES, list_images

_FACE = re.compile(r"\.face[0-9]+$")
"""The suffix that `Destination.of_face` appends to the stem of a table."""
_OVERLAY = ".overlay.mp4"
_MESSAGE_PREFIX = "mien: "
"""The prefix of warnings and errors on the command line."""


@dataclass(frozen=True)
class BatchOptions:
    """Options for every video: those of `mien.track`, what to draw, and whether to track finished videos again."""

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
        """The options as command-line arguments of `mien track`."""
        given = {"--preset": self.preset, "--passes": self.passes, "--faces": self.faces, "--camera": self.camera}
        given |= {"--focal": self.focal_px, "--fov": self.fov_deg, "--start": self.start, "--end": self.end}
        pairs = ((name, str(value)) for name, value in given.items() if value is not None)
        return [*chain.from_iterable(pairs), *["--at-once"] * self.at_once]

    def match(self, metadata: Mapping[str, Any], table: Path) -> bool:
        """Whether the track with this NAME.json is complete, from the same options and this version of mien, and has
        the pictures of this table that are wanted."""
        wanted = {"mien": __version__, "complete": True, "preset": self.preset, "passes": self.passes}
        wanted |= {"asked": requested_options(self, self.at_once), **self._contents(metadata.get("video", {}))}
        overlay, plot = _pictures(table)
        wanted |= {"overlay": overlay.name} if self.overlay else {}
        wanted |= {"plot": plot.name} if self.plot else {}
        return metadata.get("faces_wanted", 1) == self.faces and wanted.items() <= metadata.items()

    def files_of(self, table: Path, faces: int) -> list[Path]:
        """All files that are written for a video with this number of faces."""
        overlay, plot = _pictures(table)
        files = Destination(table, overlay if self.overlay else None, plot if self.plot else None)
        return [file for face_id in range(faces) for file in files.of_face(face_id).paths()]

    def _contents(self, video: Mapping[str, Any]) -> dict[str, Any]:
        """The settings of the tracker and the camera that are given by files, as the NAME.json of a video has them, of
        which `video` is the part with the size of its images."""
        known = {"settings": self._settings} if self._settings else {}
        if self.camera is not None:
            size = (video["width"], video["height"]) if {"width", "height"} <= video.keys() else None
            with catch_warnings():
                simplefilter("ignore", MienWarning)  # of images of another size, as tracking has told
                known["camera"] = asdict(read_camera(self.camera, size))
        return known

    @cached_property
    def _settings(self) -> dict[str, Any] | None:
        return None if file_of(self.preset) is None else settings_of(create_tracker(self.preset))

    @property
    def inputs(self) -> list[Path]:
        """The files that `mien track` reads in addition to each video, and whose contents NAME.json does not have."""
        file = None if self._settings else file_of(self.preset)
        return [path for path in (file, code_of(self.preset)) if path is not None]


def track_all(
    paths: Sequence[Path],
    out: Path,
    options: BatchOptions | None = None,
    jobs: int | None = None,
    progress: Progress = lambda done, total, name: None,
    forked: bool = False,
) -> list[Row]:
    """Track all videos among the paths and in the folders among them.

    The tables go to `out`, in the same folder structure as the videos, with a summary that is updated whenever a video
    is finished.

    jobs: number of videos at a time, by default one per processor; forked: whether processes may be forked, which start
    sooner but import the main module again. Raises MienError if there is nothing to track, the tables cannot be
    written, or another run writes into this folder; a video that cannot be tracked becomes a row in the state `failed`.
    """
    options = options or BatchOptions()
    create_tracker(options.preset)  # report wrong options once, now, and not for every video
    check_options(options)
    found = [[Row(video, table)] for video, table in find_videos(paths, out)]
    require_writable(out / SUMMARY)
    with sole_use(out):
        return _track_found(found, Summary.read(out / SUMMARY), options, jobs, progress, forked)


def _track_found(
    found: list[list[Row]],
    summary: Summary,
    options: BatchOptions,
    jobs: int | None,
    progress: Progress,
    forked: bool,
) -> list[Row]:
    """Track the videos that are found, as `track_all`; found: a list of one row for each, which get those of all its
    faces."""
    waiting = []
    for k, (row,) in enumerate(found):
        kept = None if options.again else _kept_rows(replace(row, note=summary.note_of(row)), options)
        if kept is None:
            waiting.append(k)
        else:
            found[k] = kept
    for k in waiting:
        summary.require_own(found[k][0])
    summary.write(found)
    commands = [_command(found[k][0], options) for k in waiting]
    started: list[str] = []
    earlier = _times(file for k in waiting for file in _all_files(found[k][0].table))
    try:
        progress(len(found) - len(waiting), len(found), "")
        for ended in run_commands(commands, jobs or available_processors(), started=started.append, forked=forked):
            k = waiting[ended.index]
            found[k] = _outcome(found[k][0], ended, earlier)
            with suppress(MienError):  # a later write includes it too, and the last one must succeed
                summary.write(found)
            progress(sum(faces[0].state != PENDING for faces in found), len(found), started[-1])
    except BaseException:
        done = sum(faces[0].state in (TRACKED, KEPT) for faces in found)
        warn(f"stopped; {done} of {len(found)} videos are done; run the same command again to continue")
        raise
    finally:
        summary.write(found)
    return [faces[0] for faces in found]


def find_videos(paths: Sequence[Path], out: Path) -> list[tuple[Path, Path]]:
    """All videos among the paths and in the folders among them, each with the path of its table below `out`.

    The table's name includes the suffix of the video if another video in its folder has the same stem, or if the table
    would otherwise be named like that of another video's further face, or like the summary. Videos that would share a
    table have theirs in the folders in which they differ. Raises MienError where they differ in none.
    """
    each: dict[Path, tuple[Path, Path]] = {}
    named = {real_path(path) for path in paths}
    for video, place in chain.from_iterable(_videos_of(path, out, named) for path in paths):
        each.setdefault(real_path(video), (video, place))
    places = dict(each.values())
    require(bool(places), f"{', '.join(map(str, paths))}: no video found; mien looks for {', '.join(VIDEO_SUFFIXES)}")
    while alike := _of_one_table(tables := _tables(places)):
        apart = places | _places_apart(alike, places)
        require(
            apart != places,
            f"{alike[0]} and {alike[1]} would share the table {out / tables[alike[0]]}; rename one of them, or track "
            "one folder at a time",
        )
        places = apart
    return [(video, out / table) for video, table in tables.items()]


def _tables(places: Mapping[Path, Path]) -> dict[Path, Path]:
    """The table of each video with this place, relative like that."""
    alike = Counter(place.with_suffix("") for place in places.values())
    tables = {}
    for video, place in places.items():
        stem = place.with_suffix("")
        of_another = _FACE.search(stem.name) and stem.with_name(_FACE.sub("", stem.name)) in alike
        taken = alike[stem] > 1 or of_another or place.with_suffix(".csv") == Path(SUMMARY)
        tables[video] = Path(f"{place}.csv") if taken else place.with_suffix(".csv")
    return tables


def _of_one_table(tables: Mapping[Path, Path]) -> list[Path]:
    """All videos that have one table, the first that several have; none if each has its own."""
    counts = Counter(tables.values())
    shared = next((table for table, count in counts.items() if count > 1), None)
    return [video for video, table in tables.items() if table == shared]


def _places_apart(videos: Sequence[Path], places: Mapping[Path, Path]) -> dict[Path, Path]:
    """The places of these videos from the deepest folder in which they all are, where that is a longer path."""
    folders = [os.path.dirname(os.path.abspath(video)) for video in videos]
    with suppress(ValueError):  # they are on several drives of Windows
        common = os.path.commonpath(folders)
        below = [Path(os.path.relpath(folder, common)) for folder in folders]
        apart = {video: folder / places[video].name for video, folder in zip(videos, below, strict=True)}
        return {video: place for video, place in apart.items() if len(place.parts) > len(places[video].parts)}
    return {}


def _videos_of(path: Path, out: Path, named: Container[Path]) -> Iterator[tuple[Path, Path]]:
    """The videos of a path, each with its path relative to that folder; a folder of images only is itself a video.
    Warns of those below it that are not among the named ones."""
    known = path.is_dir() or path.is_file()
    require(known, f"{path}: no such file or folder; check the name (the data of a pipe must be saved as a file)")
    if path.is_file():
        yield path, Path(path.name)
        return
    # Overlays are videos too: they must not be tracked in the next run.
    require(
        not real_path(path).is_relative_to(real_path(out)),
        f"{out} holds the videos; choose another folder for the tables with -o",
    )
    files = [file for file in _files_below(path) if not file.name.startswith(".")]
    below = (file for file in files if file.suffix.lower() in VIDEO_SUFFIXES)
    apart = (file for file in below if not real_path(file).is_relative_to(real_path(out)))
    videos = [file for file in apart if not _is_overlay(file)]
    yield from ((file, file.relative_to(path)) for file in videos)
    if not videos and list_images(path):
        yield path, Path(f"{path.resolve().name}.images")
    unnamed = [folder for folder in _folders_of_images(files, [path, *videos]) if real_path(folder) not in named]
    unnamed = [folder for folder in unnamed if not real_path(folder).is_relative_to(real_path(out))]
    if unnamed:
        others = f", as {len(unnamed) - 1} more below {path} do" if len(unnamed) > 1 else ""
        warn(f"{unnamed[0]} holds images{others}; name the folder to track it")


def _folders_of_images(files: Sequence[Path], videos: Iterable[Path]) -> list[Path]:
    """The folders of several images among the files, plots of tables apart, that neither are nor hold one of the
    videos."""
    every = set(files)
    images = (file for file in files if file.suffix.lower() in IMAGE_SUFFIXES and file.with_suffix(".csv") not in every)
    known = {folder for video in videos for folder in (video, *video.parents)}
    counts = Counter(file.parent for file in images)
    return [folder for folder, count in counts.items() if count > 1 and folder not in known]


def _files_below(folder: Path) -> list[Path]:
    """All files in a folder and below it, also where links lead, and folders of images that are named like a video; in
    no hidden folder, and in each folder once. Warns of a folder that cannot be read."""

    def report(error: OSError) -> None:
        warn(f"{error.filename} cannot be read ({reason_of(error)}); its videos are not tracked")

    top, entered = real_path(folder), set[Path]()
    found, waiting = list[Path](), [folder]
    while waiting:  # links come last, so that what lies in the folder itself has its own place
        for root, folders, files in os.walk(waiting.pop(0), onerror=report):
            place = real_path(Path(root))
            if place in entered or (place != top and top.is_relative_to(place)):
                folders.clear()
                continue
            entered.add(place)
            folders[:] = sorted(name for name in folders if not name.startswith("."))
            paths = [Path(root, name) for name in folders]
            waiting += [path for path in paths if path.is_symlink()]
            named = (path for path in paths if path.suffix.lower() in VIDEO_SUFFIXES)
            found += [path for path in named if os.access(path, os.R_OK) and list_images(path)]
            found += [Path(root, name) for name in files]
    return sorted(found)


def _pictures(table: Path) -> tuple[Path, Path]:
    """Paths of the overlay and the plot of a table."""
    return table.with_name(f"{table.stem}{_OVERLAY}"), table.with_suffix(".png")


def _all_files(table: Path) -> tuple[Path, ...]:
    """The table and the pictures that a video may have."""
    return table, *_pictures(table)


def _times(files: Iterable[Path]) -> dict[Path, int]:
    """When those of the files that exist were written, in nanoseconds by the clock of their file system."""
    return {file: file.stat().st_mtime_ns for file in files if exists(file)}


def _is_overlay(file: Path) -> bool:
    """Whether a video is an overlay of mien: by its name, with the table to which it belongs beside it, or by what the
    file states, whatever its name."""
    from mien.output.overlay import is_overlay

    named = file.name.endswith(_OVERLAY) and file.with_name(f"{file.name.removesuffix(_OVERLAY)}.csv").exists()
    return named or (file.suffix.lower() in OVERLAY_ENDINGS and is_overlay(file))


def _command(row: Row, options: BatchOptions) -> Call:
    overlay, plot = _pictures(row.table)
    pictures = [*["--overlay", str(overlay)] * options.overlay, *["--plot", str(plot)] * options.plot]
    arguments = ("track", "-o", str(row.table), *pictures, *options.arguments, "--quiet", "--", str(row.video))
    return Call(row.video.name, "mien.worker:run", arguments)


def _kept_rows(row: Row, options: BatchOptions) -> list[Row] | None:
    """The rows of a video that need not be tracked again, else None.

    All its files must exist, be complete and no older than the video, which must be the same, and come from the same
    tracker with the same settings.
    """
    with suppress(MienError, OSError, AttributeError, LookupError, TypeError):  # whatever somebody made of NAME.json
        track = Track.read(row.table)
        known = track.metadata
        if not options.match(known, row.table) or known["video"]["bytes"] != size_of(row.video):
            return None
        files = options.files_of(row.table, known.get("faces", 1))
        read = [row.video, *(list_images(row.video) if row.video.is_dir() else ()), *options.inputs]
        if min(file.stat().st_mtime for file in files) < max(file.stat().st_mtime for file in read):
            return None
        # A file or a folder that was renamed keeps its time: it may be another video.
        other = known["video"].get("inode") != row.video.stat().st_ino
        if other and known["video"].get("sha256") != checksum(row.video):
            return None
        return face_rows(replace(row, state=KEPT), track)
    return None


def _outcome(row: Row, ended: Ended, earlier: Mapping[Path, int]) -> list[Row]:
    """The rows of a video whose process has ended. earlier: `_times` of its files before."""
    messages = [_message(line, row.video) for line in ended.output if line.startswith(_MESSAGE_PREFIX)]
    old = [file.name for file, time in _times(_all_files(row.table)).items() if earlier.get(file) == time]
    of_earlier_run = [f"{', '.join(old)} {'is' if len(old) == 1 else 'are'} from an earlier run"] * bool(old)
    if ended.reason:
        reason = _message(ended.reason, row.video)
        messages = [reason, *(message for message in messages if message != reason)]
        return [replace(row, state=FAILED, note="; ".join(messages + of_earlier_run))]
    try:
        return face_rows(replace(row, state=TRACKED, note="; ".join(messages + of_earlier_run)), Track.read(row.table))
    except MienError as error:
        return [replace(row, state=FAILED, note=str(error))]


def _message(line: str, video: Path) -> str:
    """A line that the process of a video has printed, without what its row tells: by whom, and of which video."""
    return re.sub(rf"^{re.escape(str(video))}:? ", "", line.removeprefix(_MESSAGE_PREFIX))
