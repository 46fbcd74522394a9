"""Data sets of a few small frames in every layout, and trackers that behave and misbehave.

The trackers are found as `evaluation.tiny:CLASS`, also by the processes that the benchmark starts.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path

import cv2
import numpy as np

from mien.arrays import Array
from mien.errors import warn
from mien.evaluation.datasets.sequence import Truth
from mien.evaluation.points12 import POINT_NAMES
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING, matrix_from_euler
from mien.initialization.landmarks import Landmarks
from mien.tracking.state import Estimate, Status, TrackedLandmarks
from videos import gradient, write_video

FRAMES = 6
ROOT = Path(__file__).parent.parent


def face68() -> Array:
    """(68, 2) points in an image of 64x48 that could be a face: all different, all inside."""
    i = np.arange(68)
    return np.column_stack([8 + 0.7 * i, 6 + (7 * i % 37)]).astype(float)


def angles_deg(frames: int = FRAMES) -> Array:
    """(n, 3) tilt, pan, roll that begin at zero."""
    t = np.arange(frames)
    return np.column_stack([2.0 * t, -3.0 * t, 1.5 * t])


def head_rotations(angles: Array) -> Array:
    """(n, 3, 3) rotations in head axes of tilt, pan, roll in degrees, `Rx Ry Rz`."""
    return np.array([matrix_from_euler(np.radians(a)) for a in angles])


def video(path: Path, frames: int = FRAMES) -> Path:
    return write_video(path, [gradient(i) for i in range(frames)])


def write_dat(path: Path, angles: Array, columns: int = 7) -> Path:
    """BUFT's table with a first row to drop."""
    rows = np.vstack([np.zeros(3), angles])
    table = np.column_stack([np.arange(len(rows)), np.zeros((len(rows), 3)), rows[:, [2, 1, 0]]])
    np.savetxt(path, table[:, 7 - columns :], fmt="%.6f")
    return path


def buft(root: Path, names: tuple[str, ...] = ("jam1",), frames: int = FRAMES) -> Path:
    root.mkdir(parents=True, exist_ok=True)
    for name in names:
        video(root / f"{name}.avi", frames)
        write_dat(root / f"{name}.dat", angles_deg(frames))
    return root


def rendered(root: Path, names: tuple[str, ...] = ("a_uniform1",), angles: Array | None = None) -> Path:
    root.mkdir(parents=True, exist_ok=True)
    angles = np.zeros((FRAMES, 3)) if angles is None else angles
    for name in names:
        video(root / f"{name}.avi", len(angles))
        np.savez(
            root / f"{name}_truth.npz",
            R=head_rotations(angles),
            t=np.tile([0.0, 0.0, 100.0], (len(angles), 1)),
            landmarks68=np.tile(face68() + 0.25, (len(angles), 1, 1)),  # beside the picture, as in the real ones
            expression=np.zeros((len(angles), 2)),
            expression_names=np.array(["jawOpen", "browDown_L"]),
            focal=500.0,
        )
    return root


def pts(points: Array, origin: float = 1.0) -> str:
    lines = [f"{x:.4f} {y:.4f}" for x, y in points + origin]
    return "\n".join(["version: 1", f"n_points: {len(points)}", "{", *lines, "}", ""])


def talking_face(root: Path, points: Array, text: str, annotated: tuple[int, ...], as_video: bool = False) -> Path:
    """Images or a video, and point files of the annotated frames, all the same."""
    root.mkdir(parents=True, exist_ok=True)
    if as_video:
        video(root / "franck.mkv")
    else:
        for i in range(FRAMES):
            cv2.imwrite(str(root / f"franck_{i:05d}.jpg"), gradient(i))
    for i in annotated:
        (root / f"franck_{i:05d}.pts").write_text(text)
    return root


def truth(angles: Array | None = None) -> Truth:
    """Exact rotations of angles (n, 3) in degrees."""
    angles = angles_deg() if angles is None else angles
    return Truth(len(angles), rotations=FACING @ head_rotations(angles))


def estimate(frame: Frame, rotation: Array | None = None, shift_px: float = 0.0) -> Estimate:
    """A tracked face that looks into the camera, give or take a degree, its twelve points those of `face68` moved to
    the right."""
    rows = (36, 39, 42, 45, 30, 33, 31, 35, 48, 54, 51, 57)
    points = face68()[list(rows)] + [shift_px, 0.0]
    status = Status.INITIALIZED if frame.index == 0 else Status.TRACKED
    return Estimate(
        frame.index,
        frame.time,
        status,
        rotation=FACING if rotation is None else rotation,
        animation=np.zeros(6),
        covariance=np.radians(1.0) ** 2 * np.eye(12),
        landmarks=TrackedLandmarks(POINT_NAMES, points),
        confidence=0.75,
    )


class Still:
    """Says that the face looks into the camera and does not move."""

    shift_px = 0.0

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        return estimate(frame, shift_px=self.shift_px)

    def track(self, frame: Frame) -> Estimate:
        return estimate(frame, shift_px=self.shift_px)


class Shifted(Still):
    """Puts every landmark three pixels to the right."""

    shift_px = 3.0


class Known(Still):
    """Gives these rotations (n, 3, 3) head -> camera; a NaN is a lost frame."""

    def __init__(self, rotations: Array) -> None:
        self.rotations = rotations

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        return self.track(frame)

    def track(self, frame: Frame) -> Estimate:
        R = self.rotations[frame.index]
        return estimate(frame, R) if np.isfinite(R).all() else Estimate.lost(frame, "behind a hand")


class Warns(Still):
    """Is not sure of what it says."""

    def track(self, frame: Frame) -> Estimate:
        warn("the light is poor")
        return estimate(frame)


class Raises(Still):
    """Fails in the third frame."""

    def track(self, frame: Frame) -> Estimate:
        if frame.index == 2:
            raise RuntimeError("the third frame is too much")
        return estimate(frame)


class Exits(Still):
    """Ends its process in good order."""

    def track(self, frame: Frame) -> Estimate:
        sys.exit(0)


class Vanishes(Still):
    """Ends its process as if all was well."""

    def track(self, frame: Frame) -> Estimate:
        os._exit(0)


class Crashes(Still):
    """Takes its process down."""

    def track(self, frame: Frame) -> Estimate:
        os.kill(os.getpid(), signal.SIGSEGV)
        return estimate(frame)


class Hangs(Still):
    """Never answers."""

    def track(self, frame: Frame) -> Estimate:
        time.sleep(600)
        return estimate(frame)
