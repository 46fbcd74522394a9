"""One sequence of a data set: its video, its camera, its truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mien.errors import require
from mien.geometry.camera import Camera
from mien.geometry.rotation import Array
from mien.initialization.landmarks import SCHEMES, Landmarks


@dataclass(frozen=True)
class Truth:
    """What is known of n frames. What the data set does not have is None; a frame without truth is NaN.

    rotations: (n, 3, 3) head -> camera; angles_deg: (n, 3) tilt, pan, roll as a sensor's file gives them,
    with the signs of head axes, where the order of the angles is the protocol's to say; landmarks: (n, k, 2)
    pixels of the scheme `landmark_scheme`; expression: (n, m) of the shapes `expression_names`.
    """

    frames: int
    rotations: Array | None = None
    angles_deg: Array | None = None
    landmarks: Array | None = None
    landmark_scheme: str = "ibug68"
    expression: Array | None = None
    expression_names: tuple[str, ...] = ()

    @property
    def has_pose(self) -> bool:
        return self.rotations is not None or self.angles_deg is not None

    def first_landmarks(self, source: str) -> Landmarks:
        """The annotation of frame 0. Raises MienError where there is none."""
        usable = self.landmarks is not None and self.landmark_scheme in SCHEMES
        points = self.landmarks[0] if usable and self.landmarks is not None else None
        require(
            points is not None and bool(np.isfinite(points).all()),
            f"{source}: frame 0 has no annotation of a whole face; take them from the detector (--landmarks detected)",
        )
        return Landmarks(np.asarray(points, dtype=float), self.landmark_scheme, source=source)


@dataclass(frozen=True)
class Sequence:
    """A video (a file or a folder of images) with its truth.

    kind: what the sequence stresses, a row of the table by kind; truth_files: what the truth is read from;
    read_truth: the truth of a video of so many frames, MienError where it does not fit; camera: where it is
    known, focal_px or focal_per_width where only that is known; with none of them, a field of view of 60
    degrees.
    """

    name: str
    kind: str
    video: Path
    truth_files: tuple[Path, ...]
    read_truth: Callable[[int], Truth]
    camera: Camera | None = None
    focal_px: float | None = None
    focal_per_width: float | None = None

    def camera_for(self, width: int, height: int) -> Camera:
        """The camera of images of this size in pixels."""
        if self.camera is not None:
            return self.camera
        if self.focal_px is not None:
            return Camera.centred(self.focal_px, width, height)
        if self.focal_per_width is not None:
            return Camera.centred(self.focal_per_width * width, width, height)
        return Camera.from_fov(width, height)

    def with_focal(self, focal_px: float) -> Sequence:
        """The same sequence with another focal length in pixels, the principal point as it was."""
        if self.camera is not None:
            return replace(self, camera=Camera(focal_px, self.camera.cx, self.camera.cy))
        return replace(self, focal_px=focal_px)


def require_frames(truth: int, video: int, source: Path) -> None:
    """Refuse truth of another number of frames than the video's: nothing is cut silently."""
    require(
        truth == video,
        f"{source} describes {truth} frames and its video has {video}; check that they belong together, or trim the "
        "longer one",
    )


def require_finite(values: Array, source: Path, what: str) -> None:
    """Refuse truth that is not a number, and say in which row."""
    bad = np.argwhere(~np.isfinite(values))
    row = int(bad[0][0]) if len(bad) else 0
    require(
        len(bad) == 0,
        f"{source}: {what} in row {row} is not a finite number; repair the file or leave the sequence out",
    )
