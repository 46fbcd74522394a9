"""Output files of a track, checked before tracking starts."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from glob import escape
from pathlib import Path
from typing import Any

from mien.errors import MienError, interruption, require, warn
from mien.files import checksum, exists, real_path, require_ending, require_writable, size_of, user_path
from mien.output.track import Track
from mien.output.track_files import (
    ENDINGS,
    GLTF_ENDINGS,
    OVERLAY_ENDINGS,
    PLOT_ENDINGS,
    is_table_of_track,
    paths_to_write,
    read_metadata,
    track_paths,
)
from mien.video import refuse_among_images


@dataclass(frozen=True)
class Destination:
    """Output paths of a track. table: NAME.csv, with NAME.json and NAME.parquet beside it; overlay: a video; plot: a
    picture; gltf: the moving head."""

    table: Path | None = None
    overlay: Path | None = None
    plot: Path | None = None
    gltf: Path | None = None

    @classmethod
    def checked(
        cls,
        save: str | Path | None,
        overlay: str | Path | None,
        plot: str | Path | None,
        gltf: str | Path | None,
        inputs: Iterable[object] = (),
    ) -> Destination:
        """Create missing folders, and check that every file can be written, has a known suffix, and overwrites neither
        an input (the paths among `inputs`) nor another output. Raises MienError otherwise."""
        table = None if save is None else paths_to_write(save)[0]
        others = ((overlay, OVERLAY_ENDINGS), (plot, PLOT_ENDINGS), (gltf, GLTF_ENDINGS))
        self = cls(table, *(None if path is None else require_ending(user_path(path), of) for path, of in others))
        self.check(inputs)
        return self

    def check(self, inputs: Iterable[object]) -> None:
        """Raise MienError if a file cannot be written, or would overwrite an input, another output, or what mien has
        not written."""
        require_free(self.paths(), inputs)
        if self.table is not None:
            _require_own(self.table)
        if self.overlay is not None:
            _require_own_overlay(self.overlay)
        if self.gltf is not None:
            _require_own_gltf(self.gltf)

    def of_face(self, face_id: int) -> Destination:
        """The output of a further face: NAME.face1.csv, its plot and its head; the overlay of the first face shows it
        too."""
        if face_id == 0:
            return self
        table, plot, gltf = (
            path and path.with_name(f"{path.stem}.face{face_id}{path.suffix}")
            for path in (self.table and track_paths(self.table)[0], self.plot, self.gltf)
        )
        return Destination(table, None, plot, gltf)

    def paths(self) -> list[Path]:
        """Every file that will be written."""
        tables = [] if self.table is None else list(track_paths(self.table))
        return tables + [p for p in (self.overlay, self.plot, self.gltf) if p is not None]

    def remove(self) -> None:
        """Remove what was written."""
        _remove(*self.paths())

    def warn_if_stale(self, faces: int) -> None:
        """Warn if an earlier run with more than this number of faces has left tables, naming them all."""
        if stale := [] if self.table is None else _tables_of_faces(self.table, faces):
            left = f"{', '.join(map(str, stale))} {'is' if len(stale) == 1 else 'are'} left from an earlier run"
            warn(f"{left}; this one has {faces} face{'s' if faces > 1 else ''}")

    def write(self, track: Track) -> None:
        """Write the table, the plot and the head; the overlay is written while tracking."""
        self.write_table(track)
        self.write_drawn(track)

    def write_table(self, track: Track) -> None:
        """Write the table, of which NAME.json names the drawings, without the plot and the head of an earlier track: if
        this is stopped, none of them is left with it."""
        _remove(self.plot, self.gltf)
        if self.table is not None:
            drawings = {"overlay": self.overlay, "plot": self.plot, "gltf": self.gltf}
            names = {name: None if path is None else path.name for name, path in drawings.items()}
            replace(track, metadata={**track.metadata, **names}).save(self.table)

    def write_drawn(self, track: Track) -> None:
        """Write the plot and the head."""
        if self.plot is not None:
            track.plot(self.plot)
        if self.gltf is not None:
            track.save_gltf(self.gltf)


def _remove(*paths: Path | None) -> None:
    """Remove these files, if they are there; links to them stay."""
    for path in paths:
        if path is not None:
            real_path(path).unlink(missing_ok=True)


def write_in_any_case(files: Destination, track: Track) -> None:
    """Write a track that has just been made; if that is interrupted, write it from the beginning, and then raise the
    interruption, so that its last second does not cost what took hours."""
    try:
        files.write(track)
    except BaseException as error:
        if isinstance(interruption(error), KeyboardInterrupt):
            files.write(track)
        raise


def require_free(paths: Iterable[Path], inputs: Iterable[object]) -> None:
    """Raise MienError if a file cannot be written, or would overwrite one of the inputs (those that are paths), or
    another one."""
    files = [user_path(p) for p in inputs if isinstance(p, (str, Path))]
    taken = {real_path(file) for file in files}
    for path in paths:
        require(
            real_path(path) not in taken,
            f"{path} would overwrite an input or another output; choose another name"
            + " for the table, beside which it lies" * (path.suffix.lower() in ENDINGS[1:]),
        )
        for file in files:
            refuse_among_images(path, file)
        taken.add(real_path(path))
        require_writable(path)


def require_new(paths: Iterable[Path]) -> None:
    """Raise MienError if one of the files of a recording that cannot be made again exists."""
    for path in paths:
        require(
            not exists(path),
            f"{path} exists, and what a camera has shown cannot be tracked again; choose another name, or move it away",
        )


def require_no_other_video(table: Path, video: Path) -> None:
    """Raise MienError if a table is the track of another video than this one: of another path, with other content."""
    known: object = None
    with suppress(MienError):  # it is another's
        known = read_metadata(track_paths(table)[1]).get("video")
    if not (isinstance(known, dict) and isinstance(known.get("name"), str) and exists(video)):
        return
    elsewhere = real_path(Path(known["name"])) != real_path(video)
    require(
        not (elsewhere and has_other_content(video, known)),
        f"{table} is the track of another video, {known['name']}; choose another name with -o, or move it away",
    )


def has_other_content(video: Path, known: Mapping[str, Any], newer: bool = False) -> bool:
    """Whether a file or a folder differs from the video that a NAME.json describes, as far as that tells: a renamed one
    keeps its number, and a copy its content. newer: whether it was written later, so that its number tells nothing."""
    if known.get("bytes") != size_of(video):
        return True
    same_file = known.get("inode") == video.stat().st_ino and not newer
    return not same_file and known.get("sha256") != checksum(video)


def _tables_of_faces(table: Path, first: int) -> list[Path]:
    """The tables that there are of further faces, from this one on; see `Destination.of_face`."""
    of_face = re.compile(rf"{re.escape(table.stem)}\.face([0-9]+){re.escape(table.suffix)}")
    found = ((of_face.fullmatch(path.name), path) for path in table.parent.glob(f"{escape(table.stem)}.face*"))
    each = {int(match[1]): path for match, path in found if match}
    return [each[face_id] for face_id in sorted(each) if face_id >= first]


def _require_own(table: Path) -> None:
    """Raise MienError if NAME.csv, NAME.json or NAME.parquet exists and is not of a track, like the annotation of a
    video or the table of another tool: those of an earlier track are replaced."""
    csv, settings, parquet = (path if size_of(path) else None for path in track_paths(table))
    own_table = csv is not None and is_table_of_track(csv)
    foreign = [
        None if own_table else csv,
        None if settings is None or own_table or is_json_of_track(settings) else settings,
        None if parquet is None or is_table_of_track(parquet) else parquet,
    ]
    for path in foreign:
        require(
            path is None,
            f"{path} exists and is not the track of a video by mien; choose another name with -o, or move it away",
        )


def _require_own_overlay(path: Path) -> None:
    """Raise MienError if a video exists that mien has not written."""
    from mien.output.overlay_video import is_overlay

    require(
        not size_of(path) or is_overlay(path),
        f"{path} exists and is not an overlay by mien; choose another name with --overlay, or move it away",
    )


def _require_own_gltf(path: Path) -> None:
    """Raise MienError if a file is not of mien, or was exported again by a program in which it was edited."""
    from mien.output.gltf import is_gltf_of_mien

    require(
        not size_of(path) or is_gltf_of_mien(path),
        f"{path} exists and is not as mien wrote it; choose another name, or move it away",
    )


def is_json_of_track(path: Path) -> bool:
    """Whether a file is the NAME.json of a track."""
    with suppress(MienError):
        return "mien" in read_metadata(path)
    return False
