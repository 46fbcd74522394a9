"""Convert estimates to table columns, with the names, units and signs of OpenFace where it has the same quantity.

Lengths are in millimetres, angles in radians, image points in pixels, all in camera axes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np
import pyarrow as pa

from mien.arrays import Array
from mien.candide.model import TRACKED_UNITS
from mien.geometry.rotation import FACING, euler_from_matrix, matrix_from_euler
from mien.tracking.state import EYES_CLOSED, Closing, Estimate, Status, TrackedLandmarks

TRANSLATION = ("pose_Tx", "pose_Ty", "pose_Tz")
ROTATION = ("pose_Rx", "pose_Ry", "pose_Rz")
TEXT_COLUMNS = ("status", "reason")
_FRAME_COLUMNS = ("frame", "face_id", "timestamp")
_INTEGER_COLUMNS = ("frame", "face_id", "success")
_CSV_SAFE = str.maketrans({",": ";", '"': "'", "\n": " ", "\r": " "})


@dataclass(frozen=True)
class _Group:
    """Columns that are estimated together: their names (or the stem of numbered columns), decimals and values."""

    names: tuple[str, ...] | str
    decimals: int
    values: Callable[[Estimate], Array | None]

    @property
    def stems(self) -> tuple[str, ...]:
        """The names of its columns, without the numbers of those that are numbered."""
        return (self.names,) if isinstance(self.names, str) else self.names

    def column_names(self, count: int) -> tuple[str, ...]:
        return tuple(f"{self.names}_{i}" for i in range(count)) if isinstance(self.names, str) else self.names


def _sd(names: Sequence[str]) -> tuple[str, ...]:
    return tuple(f"{n}_sd" for n in names)


ROTATION_SD, ANIMATION_SD = _sd(ROTATION), _sd(TRACKED_UNITS)
(EYES_CLOSED_SD,) = _sd([EYES_CLOSED])


def _state_sd(e: Estimate, part: slice) -> Array | None:
    return None if e.covariance is None else np.sqrt(np.maximum(np.diag(e.covariance)[part], 0.0))


def _translation_sd(e: Estimate) -> Array | None:
    sd = _state_sd(e, slice(3, 6))
    return None if sd is None else sd * e.mm_per_unit


def _image(axis: int) -> Callable[[Estimate], Array | None]:
    return lambda e: None if e.landmarks is None else e.landmarks.image[:, axis]


def _camera(axis: int) -> Callable[[Estimate], Array | None]:
    def values(e: Estimate) -> Array | None:
        known = e.landmarks
        return None if known is None or known.camera is None else known.camera[:, axis] * e.mm_per_unit

    return values


_POSE = (_Group(TRANSLATION, 3, lambda e: e.translation_mm), _Group(ROTATION, 6, lambda e: e.euler))
_OTHER = (
    _Group(TRACKED_UNITS, 5, lambda e: e.animation),
    _Group((EYES_CLOSED,), 3, lambda e: None if e.closing is None else np.array([e.closing.share])),
    *(_Group(name, 3, _image(k)) for k, name in enumerate("xy")),
    *(_Group(name, 3, _camera(k)) for k, name in enumerate("XYZ")),
    _Group(_sd(TRANSLATION), 3, _translation_sd),
    _Group(ROTATION_SD, 6, lambda e: e.euler_sd),
    _Group(ANIMATION_SD, 5, lambda e: _state_sd(e, slice(6, None))),
    _Group((EYES_CLOSED_SD,), 3, lambda e: None if e.closing is None else np.array([e.closing.sd])),
    _Group("visibility", 3, lambda e: None if e.landmarks is None else e.landmarks.visibility),
)


@cache
def import_pandas() -> None:
    """Import pandas, if installed, in advance: Arrow imports it when it first converts an array, and would swallow an
    interrupt during that import."""
    with suppress(ImportError):
        import_module("pandas")


def table_from_estimates(estimates: Sequence[Estimate], face_id: int) -> pa.Table:
    """A table with one row per estimate of a face. Quantities that no estimate has get no column; cells of a lost face
    are null."""
    import_pandas()
    columns: dict[str, pa.Array] = {
        "frame": pa.array([e.index for e in estimates], pa.int64()),
        "face_id": pa.array([face_id] * len(estimates), pa.int64()),
        "timestamp": pa.array(np.round([e.time for e in estimates], 6)),
        "confidence": pa.array(np.round([float(e.confidence) for e in estimates], 4)),
        "success": pa.array([int(e.status.success) for e in estimates], pa.int64()),
    }
    columns |= _columns(_POSE, estimates)
    columns["status"] = pa.array([e.status.value for e in estimates])
    columns["reason"] = pa.array([e.reason.translate(_CSV_SAFE) or None for e in estimates], pa.string())
    return pa.table(columns | _columns(_OTHER, estimates))


def estimate_from_row(row: Mapping[str, Any], landmark_names: tuple[str, ...], mm_per_unit: float) -> Estimate:
    """The estimate in a table row, given by column name; without the covariance, which the table does not contain."""
    status = Status(row["status"])
    index, time = int(row["frame"]), float(row["timestamp"])
    if not status.success:
        return Estimate(index, time, status, mm_per_unit=mm_per_unit, reason=row.get("reason") or "")

    def values(names: Sequence[str]) -> Array | None:
        known = [row.get(name) for name in names]
        return None if all(value is None for value in known) else np.array(known, float)

    def points(axes: str) -> Array | None:
        columns = [values([f"{axis}_{i}" for i in range(len(landmark_names))]) for axis in axes]
        known = [column for column in columns if column is not None]
        return np.stack(known, axis=1) if len(known) == len(axes) else None

    angles, shift, image, camera = values(ROTATION), values(TRANSLATION), points("xy"), points("XYZ")
    landmarks = None
    if image is not None:
        visibility = values([f"visibility_{i}" for i in range(len(landmark_names))])
        camera = None if camera is None else camera / mm_per_unit
        landmarks = TrackedLandmarks(landmark_names, image, camera, visibility)
    closed, closed_sd = row.get(EYES_CLOSED), row.get(EYES_CLOSED_SD)
    return Estimate(
        index,
        time,
        status,
        rotation=None if angles is None else matrix_from_euler(angles) @ FACING,
        translation=None if shift is None else shift / mm_per_unit,
        animation=values(TRACKED_UNITS),
        landmarks=landmarks,
        confidence=float(row["confidence"]),
        mm_per_unit=mm_per_unit,
        closing=None if closed is None or closed_sd is None else Closing(closed, closed_sd),
    )


def mark_lost(table: pa.Table, reason: pa.Array) -> pa.Table:
    """The table with the face marked as lost in the rows that have a reason."""
    from pyarrow import compute

    kept = reason.is_null()
    fixed = {"confidence": 0.0, "success": 0, "status": Status.LOST.value}
    columns = {name: table.column(name) for name in table.column_names}
    for name in columns.keys() - set(_FRAME_COLUMNS):
        columns[name] = compute.if_else(kept, columns[name], pa.scalar(fixed.get(name), columns[name].type))
    before = columns.get("reason", pa.nulls(len(table), reason.type))
    columns["reason"] = compute.if_else(kept, before, reason)
    return pa.table({name: columns[name] for name in sort_columns(list(columns))})


def rotate_rows(table: pa.Table, R: Array) -> pa.Table:
    """The table with every rotation multiplied from the left by R (3, 3), in camera axes, a rotation of a few degrees:
    standard deviations stay as they are."""
    angles = np.stack([table.column(name).to_numpy() for name in ROTATION], axis=1)
    known = ~np.isnan(angles).any(axis=1)
    turned = R @ matrix_from_euler(angles[known])
    angles[known] = euler_from_matrix(turned)
    return _with_columns(table, dict(zip(ROTATION, angles.T, strict=True)))


def move_along_rays(table: pa.Table, depths: Array) -> pa.Table:
    """The table with landmark k of every row at a depth (n, m) in millimetres, on the ray on which it is; those whose
    depth is NaN stay."""
    moved: dict[str, Array] = {}
    for k, wanted in enumerate(depths.T):
        points = {f"{axis}_{k}": table.column(f"{axis}_{k}").to_numpy() for axis in "XYZ"}
        ratio = np.where(np.isnan(wanted), 1.0, wanted / points[f"Z_{k}"])
        moved |= {name: values * ratio for name, values in points.items()}
    return _with_columns(table, moved)


def _with_columns(table: pa.Table, columns: Mapping[str, Array]) -> pa.Table:
    """The table with other numbers (n,) in columns that it has, rounded as theirs are; NaN is null."""
    decimals = {stem: group.decimals for group in (*_POSE, *_OTHER) for stem in group.stems}
    for name, values in columns.items():
        stem = name if name in decimals else name.rpartition("_")[0]
        rounded = pa.array(np.round(values, decimals[stem]), from_pandas=True)
        table = table.set_column(table.column_names.index(name), name, rounded)
    return table


def column_type(name: str) -> pa.DataType | None:
    """Type of the column with this name; None for a column that is not mien's."""
    if _stem_and_number(name) is None:
        return None
    return pa.string() if name in TEXT_COLUMNS else pa.int64() if name in _INTEGER_COLUMNS else pa.float64()


def sort_columns(names: Sequence[str]) -> list[str]:
    """Sort column names in the order of the file; a table may have only some of them, and its own after them."""
    return sorted(names, key=_column_position)


def _stems_of(groups: Sequence[_Group]) -> list[str]:
    return [stem for group in groups for stem in group.stems]


_STEMS = (*_FRAME_COLUMNS, "confidence", "success", *_stems_of(_POSE), *TEXT_COLUMNS, *_stems_of(_OTHER))
"""All column names in the order of the file; the stem for numbered columns."""
_NUMBERED = {group.names for group in _OTHER if isinstance(group.names, str)}
"""The stems of numbered columns, which alone are the names of none."""


def _stem_and_number(name: str) -> tuple[str, int] | None:
    """`x_12` -> `x`, 12, and `status` -> `status`, 0; None for a column that is not mien's."""
    stem, _, number = name.rpartition("_")
    if stem in _NUMBERED and number.isdecimal():
        return stem, int(number)
    return (name, 0) if name in _STEMS and name not in _NUMBERED else None


def _column_position(name: str) -> tuple[int, int]:
    known = _stem_and_number(name)
    return (len(_STEMS), 0) if known is None else (_STEMS.index(known[0]), known[1])


def _columns(groups: Sequence[_Group], estimates: Sequence[Estimate]) -> dict[str, pa.Array]:
    columns: dict[str, pa.Array] = {}
    for group in groups:
        rows = [None if e.status is Status.LOST else group.values(e) for e in estimates]
        count = max((len(r) for r in rows if r is not None), default=0)
        if count == 0:
            continue
        empty = np.full(count, np.nan)
        matrix = np.round(np.array([empty if r is None else r for r in rows], float), group.decimals)
        for k, name in enumerate(group.column_names(count)):
            # A numbered group is there as a whole: without one of its columns the others would be misread.
            if not np.isnan(matrix[:, k] if name in _STEMS else matrix).all():
                columns[name] = pa.array(matrix[:, k], from_pandas=True)
    return columns
