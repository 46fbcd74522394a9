"""The estimates of a whole video as one table."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import pyarrow as pa

from mien.arrays import Array, Integers
from mien.candide.model import TRACKED_UNITS, with_eyes_closed
from mien.errors import MienError, require, warn
from mien.files import json_text, require_ending, user_path, whole_file
from mien.geometry.rotation import FACING, matrix_from_euler
from mien.output.columns import (
    ANIMATION_SD,
    EYES_CLOSED_SD,
    ROTATION,
    ROTATION_SD,
    TRANSLATION,
    estimate_from_row,
    mark_lost,
    move_along_rays,
    rotate_rows,
)
from mien.output.recorder import BATCH, Recorder
from mien.output.track_files import (
    ENDINGS,
    GLTF_ENDINGS,
    PLOT_ENDINGS,
    paths_to_write,
    read_metadata,
    read_table,
    track_paths,
    write_csv,
    write_json,
    write_parquet,
)
from mien.tracking.state import EYES_CLOSED, Estimate, Status

if TYPE_CHECKING:
    import pandas as pd

_Values = TypeVar("_Values", Array, Integers)


@dataclass(frozen=True, eq=False)
class Track:
    """A table with one row per frame, and the metadata to reproduce it. Tracks compare by identity.

    table: the columns of `mien.output.columns`; a quantity that is never estimated has no column, one that is missing
    in a frame is null. metadata: plain values, the content of NAME.json.
    """

    table: pa.Table
    metadata: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def from_estimates(cls, estimates: Iterable[Estimate], metadata: Mapping[str, Any] | None = None) -> Track:
        """The track of these estimates, for example from `mien.stream`. Its metadata include `landmark_names` and
        `mm_per_unit` (millimetres per CANDIDE unit), unless `metadata` overrides them. It has no `mesh`. An error or
        Ctrl-C from within the iterable passes through, and no track is made: keep the estimates in a list where that
        may happen, and make the track of it. Raises MienError, before the first estimate is asked for, if NAME.json
        cannot hold the metadata; warns of estimates of several streams."""
        json_text(metadata or {})
        anew = False
        with Recorder() as recorder:
            for estimate in estimates:
                require(
                    isinstance(estimate, Estimate),
                    f"{type(estimate)} is no estimate; mien.stream yields pairs of a frame and its estimate",
                )
                if estimate.index <= recorder.last_index and not anew:
                    anew = True
                    warn(
                        f"frame {estimate.index} comes after frame {recorder.last_index}, as where a stream was begun "
                        "anew; mien.Track.read takes no two rows for one frame: make a track of each stream"
                    )
                recorder.add(estimate)
            known = {"landmark_names": list(recorder.landmark_names), "mm_per_unit": recorder.mm_per_unit}
            return cls(recorder.table(), known | dict(metadata or {}))

    def __len__(self) -> int:
        return int(self.table.num_rows)

    def __repr__(self) -> str:
        span = f", {self.time[0]:.2f} to {self.time[-1]:.2f} s, {self.lost} lost" if len(self) else ""
        return f"<Track of {len(self)} frames{span}>"

    @cached_property
    def index(self) -> Integers:
        """(n,) index of each frame in its video, from 0."""
        return _fixed(self._numbers("frame").astype(np.int64))

    @cached_property
    def time(self) -> Array:
        """(n,) seconds."""
        return self._numbers("timestamp")

    @cached_property
    def confidence(self) -> Array:
        """(n,) probability in [0, 1] that the rotation is right to 5 degrees and the face the one that was learned."""
        return self._numbers("confidence")

    @cached_property
    def status(self) -> list[str]:
        """Values of `Status`, one per frame."""
        return [str(s) for s in self.table.column("status").to_pylist()]

    @property
    def lost(self) -> int:
        """Number of frames in which the face is lost."""
        return self.status.count(Status.LOST)

    @cached_property
    def euler_deg(self) -> Array:
        """(n, 3) pitch, yaw and roll in degrees, the angles of `Rx Ry Rz`, NaN where the face is lost.

        Positive pitch nods down, positive yaw turns to the left of the image, positive roll tilts clockwise in it.
        """
        known = self._matrix(ROTATION)
        return _fixed(np.full((len(self), 3), np.nan) if known is None else np.degrees(known))

    @cached_property
    def euler_sd_deg(self) -> Array | None:
        """(n, 3) standard deviations of `euler_deg`, None if they are not estimated."""
        sd = self._matrix(ROTATION_SD)
        return None if sd is None else _fixed(np.degrees(sd))

    @cached_property
    def translation_mm(self) -> Array | None:
        """(n, 3) millimetres in camera axes."""
        return self._matrix(TRANSLATION)

    @cached_property
    def animation(self) -> Array | None:
        """(n, 6) in the order of `EXPRESSION_NAMES`, without the last."""
        return self._matrix(TRACKED_UNITS)

    @cached_property
    def animation_sd(self) -> Array | None:
        """(n, 6) standard deviations of `animation`."""
        return self._matrix(ANIMATION_SD)

    @cached_property
    def eyes_closed(self) -> Array | None:
        """(n,) closure of both eyes relative to the first frame of tracking; 1 is shut."""
        return self._vector(EYES_CLOSED)

    @cached_property
    def eyes_closed_sd(self) -> Array | None:
        """(n,) standard deviation of `eyes_closed`."""
        return self._vector(EYES_CLOSED_SD)

    @cached_property
    def landmarks(self) -> Array | None:
        """(n, m, 2) pixels; NaN where the table lacks the column of one."""
        names = self.table.column_names
        numbers = (int(name[2:]) for name in names if re.fullmatch(r"[xy]_\d+", name))
        count = 1 + max((i for i in numbers if i < len(names)), default=-1)  # a column like x_20240131 is a user's own
        if not count:
            return None
        unknown = np.full(len(self), np.nan)
        columns = (self._vector(f"{axis}_{i}") for i in range(count) for axis in "xy")
        known = [unknown if column is None else column for column in columns]
        points: Array = np.stack(known, axis=-1).reshape(len(self), count, 2)
        return _fixed(points)

    @cached_property
    def rest(self) -> tuple[Array, Array] | None:
        """Vertices (V, 3) of the face at rest, as in the first frame, and displacements (6, V, 3) of its animation
        units, millimetres in head axes; None for trackers without a face model and for `metadata` without "mesh", as of
        `from_estimates`. Raises MienError if that is damaged."""
        mesh = self.metadata.get("mesh")
        if mesh is None:
            return None
        try:
            vertices = np.array(mesh["vertices"], float)
            units = np.zeros((len(TRACKED_UNITS), *vertices.shape))
            for name, displacements in zip(TRACKED_UNITS, units, strict=True):
                unit = mesh["units"][name]
                displacements[np.array(unit["moved"], int)] = np.reshape(unit["by"], (-1, 3))
            require(bool(np.isfinite(vertices).all() and np.isfinite(units).all()), "a number is not finite")
        except (LookupError, TypeError, ValueError, OverflowError) as error:
            raise MienError("the `mesh` of the track is not as mien has written it; track the video again") from error
        return _fixed(vertices), _fixed(units)

    def mesh(self, row: int) -> Array | None:
        """Vertices (V, 3) of the face in a row, millimetres in camera axes, with its expression and its lids;
        `mien.Candide.default().triangles` connects them. Its shape is that of the first frame; the landmarks in
        space (columns X_, Y_, Z_), whose depths are learned, lie up to a centimetre before or behind it. None where the
        face is lost, and where `rest` is None."""
        t, a = self.translation_mm, self.animation
        if self.rest is None or t is None or a is None or np.isnan(t[row]).any():
            return None
        vertices, units = self.rest
        vertices = vertices + np.tensordot(a[row], units, axes=1)
        if self.eyes_closed is not None and not np.isnan(self.eyes_closed[row]):
            vertices = with_eyes_closed(vertices, float(self.eyes_closed[row]))
        R = matrix_from_euler(np.radians(self.euler_deg[row])) @ FACING
        return np.asarray(vertices @ R.T + t[row])

    def without(self, reasons: Sequence[str | None]) -> Track:
        """The track with the face marked as lost in the frames that have a reason; a reason or None for each frame."""
        reason = pa.array(reasons, pa.string())
        return replace(self, table=mark_lost(self.table, reason)) if reason.null_count < len(reason) else self

    def turned(self, R: Array) -> Track:
        """The track with the rotation of every frame multiplied from the left by R (3, 3), in camera axes."""
        if not set(ROTATION) <= set(self.table.column_names):
            return self
        return replace(self, table=rotate_rows(self.table, R))

    def with_depths(self, depths: Array) -> Track:
        """The track with its landmarks in space (n, m) at other depths, in millimetres, on the same rays; those whose
        depth is NaN stay."""
        if "Z_0" not in self.table.column_names:
            return self
        return replace(self, table=move_along_rays(self.table, depths))

    def estimates(self) -> Iterator[Estimate]:
        """The estimate of every frame as stored in the table: rounded, and without covariance. Raises MienError if the
        landmark names or the unit of length in the metadata are damaged."""
        names, mm_per_unit = self.metadata.get("landmark_names", ()), self.metadata.get("mm_per_unit", 1.0)
        known = isinstance(names, (list, tuple)) and all(isinstance(name, str) for name in names)
        require(known, f"the `landmark_names` of the track are no list of names, but {names!r}; track the video again")
        positive = isinstance(mm_per_unit, Real) and 0 < float(mm_per_unit) < math.inf
        require(positive, f"the `mm_per_unit` of the track is {mm_per_unit!r}, not positive; track the video again")
        if not names and self.landmarks is not None:  # without its JSON
            names = [f"landmark_{i}" for i in range(self.landmarks.shape[1])]
        for batch in self.table.to_batches(max_chunksize=BATCH):
            for row in batch.to_pylist():
                yield estimate_from_row(row, tuple(names), float(mm_per_unit))

    def to_arrow(self) -> pa.Table:
        """The table, for Arrow, Polars and DuckDB."""
        return self.table

    def to_pandas(self) -> pd.DataFrame:
        """The table as a DataFrame. Raises MienError if pandas is not installed."""
        try:
            frame: pd.DataFrame = self.table.to_pandas()
        except ImportError as error:
            remedy = 'pip install pandas "numpy<2" where MediaPipe is installed, else pip install pandas'
            raise MienError(f"to_pandas needs pandas; install it ({remedy}), or use to_arrow") from error
        return frame

    def save(self, path: str | Path) -> tuple[Path, Path, Path]:
        """Write NAME.csv, NAME.json and NAME.parquet, all or none; `path` is NAME or one of the three.

        Raises MienError if they cannot be written, or `path` is a folder.
        """
        paths = csv, settings, parquet = paths_to_write(path)
        # Files are renamed in reverse order: if the CSV exists, so do the others. Until it is edited, it is the oldest.
        with ExitStack() as stack:
            write_csv(self.table, stack.enter_context(whole_file(csv)))
            write_json(self.metadata, stack.enter_context(whole_file(settings)))
            write_parquet(self.table, stack.enter_context(whole_file(parquet)))
        return paths

    @classmethod
    def read(cls, path: str | Path) -> Track:
        """Read a track from a `.csv` or `.parquet` file, with the metadata of the JSON beside it, if any.

        Raises MienError naming the file if it is missing or not a track.
        """
        path = user_path(path)
        ending = path.suffix.lower()
        if ending not in ENDINGS:
            require(not path.is_file(), f"{path} is not a track; give its .csv or .parquet")
            path = track_paths(path)[0]
        require(path.is_file(), f"{path}: no such file; check the name")
        require(ending != ".json", f"{path} contains the settings; read the .csv or .parquet beside it")
        return cls(read_table(path), read_metadata(path.with_suffix(".json")))

    def plot(self, path: str | Path) -> Path:
        """Plot angles and animation units over time to a PNG, PDF or SVG file, by its suffix; returns its path. Raises
        MienError for another suffix, and if it cannot be written."""
        from mien.output.plots import plot_track

        picture = require_ending(user_path(path), PLOT_ENDINGS)
        plot_track(self, picture)
        return picture

    def save_gltf(self, path: str | Path) -> Path:
        """Write the moving head, and the camera, as binary glTF: to a GLB file for Blender, Unity, Unreal or three.js.

        Where the face is lost, or the confidence below one half, the head goes straight from the pose before to the one
        after; it holds the first and the last. The extras of the animation list these stretches as `untracked`: seconds
        of the first and the last frame of each. A warning tells of a track that is nowhere that sure, and whose head
        moves as it says nevertheless. Raises MienError for a track without a mesh (see `mesh`), or whose face is lost
        in every frame, and for another suffix. Returns its path.
        """
        from mien.output.gltf import write_gltf

        file = require_ending(user_path(path), GLTF_ENDINGS)
        write_gltf(self, file)
        return file

    def _numbers(self, name: str) -> Array:
        column = self.table.column(name).combine_chunks()
        return _fixed(np.array(column.to_numpy(zero_copy_only=False), dtype=float))

    def _vector(self, name: str) -> Array | None:
        return self._numbers(name) if name in self.table.column_names else None

    def _matrix(self, names: Sequence[str]) -> Array | None:
        if not names or not set(names) <= set(self.table.column_names):
            return None
        return _fixed(np.stack([self._numbers(n) for n in names], axis=-1))


def _fixed(values: _Values) -> _Values:
    """The array, which can no longer be written to: the properties of a track are views of its table."""
    values.setflags(write=False)
    return values
