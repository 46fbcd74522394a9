"""What a batch is to make of every video, and whether what an earlier run has made is that."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any
from warnings import catch_warnings, simplefilter

from mien._version import __version__
from mien.errors import MienWarning
from mien.output.destination import Destination
from mien.registry import DEFAULT_PRESET, code_of, create_tracker, file_of
from mien.start.footage import read_camera, requested_options
from mien.tracking.abilities import settings_of

OVERLAY_SUFFIX = ".overlay.mp4"


@dataclass(frozen=True)
class BatchOptions:
    """Options for every video: those of `mien.track`, of which `fps` is for those that are folders of images, what to
    draw, and whether to track finished videos again."""

    preset: str = DEFAULT_PRESET
    passes: int = 1
    faces: int = 1
    camera: Path | None = None
    focal_px: float | None = None
    fov_deg: float | None = None
    start: float | None = None
    end: float | None = None
    fps: float | None = None
    at_once: bool = False
    overlay: bool = False
    plot: bool = False
    gltf: bool = False
    again: bool = False

    def arguments(self, video: Path) -> list[str]:
        """The options as command-line arguments of `mien track` for a video."""
        given = {"--preset": self.preset, "--passes": self.passes, "--faces": self.faces, "--camera": self.camera}
        given |= {"--focal": self.focal_px, "--fov": self.fov_deg, "--start": self.start, "--end": self.end}
        given |= {"--fps": self._fps_of(video)}
        pairs = ((name, str(value)) for name, value in given.items() if value is not None)
        return [*chain.from_iterable(pairs), *["--at-once"] * self.at_once]

    def match(self, metadata: Mapping[str, Any], video: Path, table: Path) -> bool:
        """Whether the track of a video with this NAME.json is complete, from the same options and this version of mien,
        and has the drawings of this table that are wanted. Of several faces, `mien track` may have been told which."""
        wanted = {"mien": __version__, "complete": True, "preset": self.preset, "passes": self.passes}
        wanted |= {"asked": requested_options(self, self.at_once, fps=self._fps_of(video))}
        wanted |= self._contents(metadata.get("video", {}))
        wanted |= {name: path.name for name, path in self.drawings(table).items()}
        known = {**metadata, "asked": {**metadata.get("asked", {}), "face": None}}
        return known.get("faces_wanted", 1) == self.faces and wanted.items() <= known.items()

    def files_of(self, table: Path, faces: int) -> list[Path]:
        """All files that are written for a video with this number of faces."""
        files = Destination(table, **self.drawings(table))
        return [file for face_id in range(faces) for file in files.of_face(face_id).paths()]

    def drawings(self, table: Path) -> dict[str, Path]:
        """Those of `drawings_of` a table that are wanted."""
        return {name: path for name, path in drawings_of(table).items() if getattr(self, name)}

    def _fps_of(self, video: Path) -> float | None:
        """At which a video is opened: files have times of their own."""
        return self.fps if video.is_dir() else None

    def _contents(self, video: Mapping[str, Any]) -> dict[str, Any]:
        """The settings of the tracker and the camera that are given by files, as the NAME.json of a video has them, of
        which `video` is the part with the size of its images."""
        known = {"settings": self._settings} if self._settings else {}
        if self.camera is not None:
            size = (video["width"], video["height"]) if {"width", "height"} <= video.keys() else None
            with catch_warnings():
                simplefilter("ignore", MienWarning)  # of images of another size, as tracking has told
                known["camera"] = read_camera(self.camera, size).to_dict()
        return known

    @cached_property
    def _settings(self) -> dict[str, Any] | None:
        return None if file_of(self.preset) is None else settings_of(create_tracker(self.preset))

    @property
    def inputs(self) -> list[Path]:
        """The files that `mien track` reads in addition to each video, and whose contents NAME.json does not have."""
        file = None if self._settings else file_of(self.preset)
        return [path for path in (file, code_of(self.preset)) if path is not None]


def drawings_of(table: Path) -> dict[str, Path]:
    """Paths of the overlay, the plot and the head of a table, by the names of their options."""
    overlay = table.with_name(f"{table.stem}{OVERLAY_SUFFIX}")
    return {"overlay": overlay, "plot": table.with_suffix(".png"), "gltf": table.with_suffix(".glb")}
