"""One sequence of a data set: its video, its camera, its ground truth."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mien.arrays import Array, Mask
from mien.errors import MienError, require, warn
from mien.evaluation.points12 import count_of_points
from mien.geometry.camera import Camera
from mien.initialization.landmarks import SCHEMES, Landmarks

_ROUNDED = 0.05
"""By how much the product of a true rotation matrix with its transpose may differ from the identity, as a file has few
digits."""


@dataclass(frozen=True)
class Truth:
    """Ground truth of n frames. Quantities that the data set lacks are None; frames without truth are NaN.

    rotations: (n, 3, 3) head -> camera; angles_deg: (n, 3) tilt, pan, roll as a file has them, with the signs of head
    axes; the protocol decides their order, unless there are rotations; landmarks: (n, k, 2) pixels in the scheme
    `landmark_scheme`; expression: (n, m) weights of the shapes `expression_names`. Raises MienError for anything else.
    """

    frames: int
    rotations: Array | None = None
    angles_deg: Array | None = None
    landmarks: Array | None = None
    landmark_scheme: str = "ibug68"
    expression: Array | None = None
    expression_names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n, k = self.frames, count_of_points(self.landmark_scheme)
        require(k is not None, f"the truth has landmarks in an unknown scheme, {self.landmark_scheme!r}")
        shapes = {"rotations": (n, 3, 3), "angles_deg": (n, 3), "landmarks": (n, k, 2)}
        shapes |= {"expression": (n, len(self.expression_names))}
        for name, shape in shapes.items():
            values = getattr(self, name)
            found = f"one {values.shape}" if isinstance(values, np.ndarray) else type(values).__name__
            fits = values is None or getattr(values, "shape", None) == shape
            require(fits, f"the {name} of the truth must be an array {shape}, but there is {found}")
        if self.rotations is not None:
            frames, R = np.flatnonzero(self.known), self.rotations[self.known]
            off = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2), initial=0)
            wrong = frames[(off > _ROUNDED) | (np.linalg.det(R) < 0)]
            if wrong.size:
                raise MienError(f"the true rotation of frame {wrong[0]} is no rotation matrix")

    @property
    def has_pose(self) -> bool:
        return self.rotations is not None or self.angles_deg is not None

    @property
    def known(self) -> Mask:
        """(n,) frames that have truth: a pose, or without poses a landmark, or without either any frame."""
        for values in (self.rotations, self.angles_deg):
            if values is not None:
                return np.asarray(np.isfinite(values).reshape(self.frames, -1).all(axis=1))
        if self.landmarks is not None:
            return np.asarray(np.isfinite(self.landmarks).reshape(self.frames, -1).any(axis=1))
        return np.ones(self.frames, dtype=bool)

    def first_landmarks(self, source: str) -> Landmarks:
        """The annotation of frame 0. Raises MienError if there is none."""
        points = None if self.landmarks is None else self.landmarks[0]
        if points is None or self.landmark_scheme not in SCHEMES or not np.isfinite(points).all():
            raise MienError(
                f"{source}: frame 0 has no annotation of a whole face; use detected landmarks (--landmarks detected)"
            )
        return Landmarks(points, self.landmark_scheme, source=source)


@dataclass(frozen=True)
class Sequence:
    """A video (a file or a folder of images) with its ground truth.

    kind: category of the sequence in the tables; truth_files: the files of the truth, if it is in files; read_truth:
    reads the truth, given the number of frames of the video, and raises MienError if they do not match; camera: if
    known; focal_px, focal_per_width: if only the focal length is known; with none of them, `Camera.unknown`.
    """

    name: str
    kind: str
    video: Path
    truth_files: tuple[Path, ...]
    read_truth: Callable[[int], Truth]
    camera: Camera | None = None
    focal_px: float | None = None
    focal_per_width: float | None = None

    @property
    def source(self) -> Path:
        """What messages about the truth name: its first file or, without one, the video."""
        return next(iter(self.truth_files), self.video)

    def truth_of(self, frames: int) -> Truth:
        """The truth, for a video with this number of frames. Raises MienError if there is none, or of other frames."""
        truth = self.read_truth(frames)
        require(
            isinstance(truth, Truth),
            f"{self.source}: the reader of the truth returned {type(truth).__name__}; it must return a Truth",
        )
        require_frames(truth.frames, frames, self.source)
        return truth

    def camera_for(self, width: int, height: int) -> Camera:
        """The camera for images of this size in pixels. Raises MienError for a field of view that no lens has."""
        if self.camera is not None:
            camera = self.camera
        elif self.focal_px is not None:
            camera = Camera.centred(self.focal_px, width, height)
        elif self.focal_per_width is not None:
            camera = Camera.centred(self.focal_per_width * width, width, height)
        else:
            camera = Camera.unknown(width, height)
        camera.require_possible(width)
        return camera

    def with_focal(self, focal_px: float) -> Sequence:
        """The same sequence with another focal length in pixels and an unchanged principal point."""
        if self.camera is not None:
            return replace(self, camera=Camera(focal_px, self.camera.cx, self.camera.cy))
        return replace(self, focal_px=focal_px)


def found_in(root: Path, pattern: str) -> list[Path]:
    """The files and folders below a folder that match a pattern of `Path.glob`, in order; without hidden ones, as macOS
    puts beside each file on a foreign disk."""
    found = (p for p in root.glob(pattern) if not any(part.startswith(".") for part in p.relative_to(root).parts))
    return sorted(found)


def warn_of_videos_without_truth(root: Path, videos: Iterable[Path], sequences: Iterable[Sequence], truth: str) -> None:
    """Warn of the videos below a folder that are no sequence, as they lack their truth; truth: what it would be."""
    known = {sequence.video for sequence in sequences}
    without = [str(video.relative_to(root)) for video in videos if video not in known]
    if without:
        warn(f"{root} has no truth for {', '.join(without)}, without which a video is left out; it needs {truth}")


def require_frames(truth: int, video: int, source: Path) -> None:
    """Raise MienError if truth and video differ in their number of frames: nothing is truncated silently."""
    require(
        truth == video,
        f"{source} describes {truth} frames and its video has {video}; check that they belong together, or trim the "
        "longer one",
    )


def require_finite(values: Array, source: Path, what: str) -> None:
    """Raise MienError naming the first row of the truth that is not finite."""
    bad = np.argwhere(~np.isfinite(values))
    if bad.size:
        raise MienError(
            f"{source}: {what} in row {bad[0, 0]} is not a finite number; repair the file or exclude the sequence"
        )
