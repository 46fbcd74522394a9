"""Which videos a batch tracks, and where the table of each goes."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import chain
from pathlib import Path

from mien.batch.options import OVERLAY_SUFFIX
from mien.errors import require, warn
from mien.files import real_path, reason_of
from mien.output.summary import SUMMARY
from mien.output.track_files import OVERLAY_ENDINGS
from mien.video import IMAGE_SUFFIXES, VIDEO_SUFFIXES, list_images

_FACE = re.compile(r"(?<=.)\.face[0-9]+$")
"""The suffix that `Destination.of_face` appends to the stem of a table."""


def find_videos(paths: Sequence[Path], out: Path) -> list[tuple[Path, Path]]:
    """All videos among the paths and in the folders among them, each with the path of its table below `out`.

    The table's name includes the suffix of the video if another video in its folder has the same stem, in whatever
    case, as that is no difference on some file systems, or if the table would otherwise be named like that of another
    video's further face, or like the summary. Videos that would share a table have theirs in the folders in which they
    differ. Raises MienError where they differ in none.
    """
    each: dict[Path, tuple[Path, Path]] = {}
    named = {real_path(path) for path in paths}
    for video, place in chain.from_iterable(_videos_of(path, out, named) for path in paths):
        each.setdefault(real_path(video), (video, place))
    places = dict(each.values())
    require(bool(places), f"{', '.join(map(str, paths))}: no video found; mien looks for {', '.join(VIDEO_SUFFIXES)}")
    while shared := _of_one_table(tables := _tables(places)):
        apart = places | dict(chain.from_iterable(_places_apart(alike, places).items() for alike in shared))
        one, other = shared[0][:2]
        require(
            apart != places,
            f"{one} and {other} would share the table {out / tables[one]}; rename one of them, or track one folder at "
            "a time",
        )
        places = apart
    return [(video, out / table) for video, table in tables.items()]


def _tables(places: Mapping[Path, Path]) -> dict[Path, Path]:
    """The table of each video with this place, relative like that."""
    alike = Counter(_caseless(place.with_suffix("")) for place in places.values())
    tables = {}
    for video, place in places.items():
        stem = _caseless(place.with_suffix(""))
        of_another = _FACE.search(stem.name) and stem.with_name(_FACE.sub("", stem.name)) in alike
        taken = alike[stem] > 1 or of_another or _caseless(place.with_suffix(".csv")) == Path(SUMMARY)
        tables[video] = Path(f"{place}.csv") if taken else place.with_suffix(".csv")
    return tables


def _caseless(path: Path) -> Path:
    return Path(str(path).casefold())


def _of_one_table(tables: Mapping[Path, Path]) -> list[list[Path]]:
    """The videos of each table that several have; none if each has its own."""
    videos: dict[Path, list[Path]] = {}
    for video, table in tables.items():
        videos.setdefault(table, []).append(video)
    return [alike for alike in videos.values() if len(alike) > 1]


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
    no hidden folder, and in each folder once; links come last. Warns of a folder that cannot be read."""

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
    return sorted(found, key=lambda file: (file.is_symlink(), file))  # a file has its own place, a link to it none


def _is_overlay(file: Path) -> bool:
    """Whether a video is an overlay of mien: by its name, with the table to which it belongs beside it, or by what the
    file states, whatever its name."""
    from mien.output.overlay_video import is_overlay

    table = file.with_name(f"{file.name.removesuffix(OVERLAY_SUFFIX)}.csv")
    named = file.name.endswith(OVERLAY_SUFFIX) and table.exists()
    readable = file.suffix.lower() in OVERLAY_ENDINGS and file.is_file()  # a pipe would be waited for without end
    return named or (readable and is_overlay(file))
