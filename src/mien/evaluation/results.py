"""The result files of a run: one `.npz` per tracker and sequence, the only input of a report."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mien.arrays import Array, Mask, Pixels
from mien.errors import MienError
from mien.evaluation.datasets.sequence import Truth
from mien.files import whole_file
from mien.tracking.state import EXPRESSION_NAMES, Estimate, Status, landmark_names_with

REMEDY = "run mien evaluate again, which replaces it"
"""For a file that is damaged, or from another version."""


@dataclass(frozen=True)
class TrackTable:
    """A tracker's estimates of n frames as arrays; missing values are NaN.

    time: (n,) seconds; status: (n,) values of `Status`; rotation: (n, 3, 3) head -> camera;
    rotation_covariance: (n, 3, 3) of the rotation vector in camera axes; expression: (n, 7); confidence: (n,);
    landmarks: (n, k, 2) pixels, with k names; reasons: (n,) why a frame is lost.
    """

    time: Array
    status: tuple[str, ...]
    rotation: Array
    rotation_covariance: Array
    expression: Array
    confidence: Array
    landmarks: Array
    landmark_names: tuple[str, ...] = ()
    reasons: tuple[str, ...] = ()

    @property
    def frames(self) -> int:
        return len(self.time)

    @property
    def lost(self) -> Mask:
        return np.array([s == Status.LOST.value for s in self.status], dtype=bool)

    @property
    def landmarks_alone(self) -> bool:
        """Whether the tracker found faces, but gave no pose for any."""
        return not self.lost.all() and not bool(np.isfinite(self.rotation).any())

    @classmethod
    def from_estimates(cls, estimates: Sequence[Estimate]) -> TrackTable:
        """The arrays of these estimates, one per frame. Raises MienError if their landmarks differ."""
        names = tuple[str, ...]()
        for e in estimates:
            names = landmark_names_with(names, e)
        return cls(
            time=np.array([e.time for e in estimates]),
            status=tuple(e.status.value for e in estimates),
            rotation=_stack([e.rotation for e in estimates], (3, 3)),
            rotation_covariance=_stack(
                [None if e.covariance is None else e.covariance[:3, :3] for e in estimates], (3, 3)
            ),
            expression=_stack([e.expression for e in estimates], (len(EXPRESSION_NAMES),)),
            confidence=np.array([e.confidence for e in estimates]),
            landmarks=_stack([None if e.landmarks is None else e.landmarks.image for e in estimates], (len(names), 2)),
            landmark_names=names,
            reasons=tuple(e.reason for e in estimates),
        )


@dataclass(frozen=True)
class SequenceResult:
    """One tracker on one sequence: its track and the truth, or the reason for a failure.

    settings: those of the run, by which a later run decides whether the result is still valid; tracker_settings: those
    of the tracker; warnings: what the run warned of; pictures: JPEG images of the frames with the largest errors, by
    frame; meshes: (V, 2) pixels of the vertices of CANDIDE in these frames, if the tracker has them.
    """

    tracker: str
    dataset: str
    sequence: str
    kind: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    tracker_settings: Mapping[str, Any] = field(default_factory=dict)
    failure: str = ""
    warnings: tuple[str, ...] = ()
    track: TrackTable | None = None
    truth: Truth | None = None
    pictures: Mapping[int, Pixels] = field(default_factory=dict)
    meshes: Mapping[int, Array] = field(default_factory=dict)

    def save(self, path: Path) -> None:
        """Write the result, atomically."""
        meta = {k: getattr(self, k) for k in ("tracker", "dataset", "sequence", "kind", "failure", "warnings")}
        meta |= {"settings": dict(self.settings), "tracker_settings": dict(self.tracker_settings)}
        arrays: dict[str, Any] = {"meta": json.dumps(meta)}
        arrays |= _arrays_of("track", self.track) | _arrays_of("truth", self.truth)
        arrays |= {f"picture.{frame}": jpeg for frame, jpeg in self.pictures.items()}
        arrays |= {f"mesh.{frame}": np.asarray(points, np.float32) for frame, points in self.meshes.items()}
        with whole_file(path) as temporary, temporary.open("wb") as f:
            np.savez_compressed(f, **arrays)

    @classmethod
    def load(cls, path: Path) -> SequenceResult:
        """Read a result. Raises MienError if the file is not one."""
        try:
            with path.open("rb") as stream, np.load(stream) as file:
                values = {name: file[name] for name in file.files}
            meta = json.loads(str(values["meta"]))
            return cls(
                **{**meta, "warnings": tuple(meta.get("warnings", ()))},
                track=_from_arrays(TrackTable, "track", values),
                truth=_from_arrays(Truth, "truth", values),
                pictures=_by_frame("picture", values),
                meshes=_by_frame("mesh", values),
            )
        except Exception as e:  # for a damaged file, NumPy, zip and zlib raise errors of many types
            raise MienError(f"{path} is damaged or not a result of this version ({e}); {REMEDY}") from e


@dataclass(frozen=True)
class Timing:
    """The cost of one tracker on one sequence, from a separate run.

    frame_seconds: duration of `track` for each frame that was timed after the first, without decoding;
    training_seconds: duration of `initialize`; peak_mb: peak resident memory of the process, including interpreter and
    libraries; busy_cores: processor time of all threads of the process during these frames, over their duration.
    """

    tracker: str
    sequence: str
    frame_seconds: tuple[float, ...]
    training_seconds: float
    peak_mb: float
    busy_cores: float
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def frames_per_second(self) -> float:
        return len(self.frame_seconds) / sum(self.frame_seconds)

    def save(self, path: Path) -> None:
        with whole_file(path) as temporary:
            temporary.write_text(json.dumps(self.__dict__, indent=1), encoding="utf-8")

    @classmethod
    def load(cls, path: Path) -> Timing:
        """Read a timing. Raises MienError if the file is not one."""
        try:
            values = json.loads(path.read_text(encoding="utf-8"))
            return cls(**{**values, "frame_seconds": tuple(values["frame_seconds"])})
        except (OSError, ValueError, KeyError, TypeError) as e:
            raise MienError(f"{path} is damaged or not a timing of this version ({e}); {REMEDY}") from e


def _stack(values: Sequence[Array | None], shape: tuple[int, ...]) -> Array:
    """Stack to (n, *shape), with NaN for missing values."""
    blank = np.full(shape, np.nan)
    return np.array([blank if v is None else v for v in values], dtype=float).reshape(len(values), *shape)


def _arrays_of(prefix: str, value: TrackTable | Truth | None) -> dict[str, Any]:
    if value is None:
        return {}
    members = {f.name: getattr(value, f.name) for f in fields(value)}
    return {f"{prefix}.{k}": np.asarray(v) for k, v in members.items() if v is not None}


def _from_arrays(cls: type[Any], prefix: str, values: Mapping[str, Any]) -> Any:
    members: dict[str, Any] = {}
    for name, value in values.items():
        if name.startswith(f"{prefix}."):
            members[name.split(".", 1)[1]] = _plain(value)
    return cls(**members) if members else None


def _by_frame(prefix: str, values: Mapping[str, Any]) -> dict[int, Any]:
    return {int(k.split(".")[1]): v for k, v in values.items() if k.startswith(f"{prefix}.")}


def _plain(value: NDArray[Any]) -> Any:
    """Convert text and scalars to Python types, so that what is read equals what was written."""
    if value.ndim == 0:
        return value.item()
    return tuple(str(v) for v in value) if value.dtype.kind == "U" or (value.size == 0 and value.ndim == 1) else value
