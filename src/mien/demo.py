"""`mien demo`: render a face in known motion, track it, write all that mien can, and compare it with the truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from mien.arrays import Array
from mien.candide.model import TRACKED_UNITS
from mien.errors import require
from mien.files import require_writable, whole_file
from mien.geometry.rotation import FACING, euler_from_matrix
from mien.initialization.landmark_files import write_landmarks
from mien.output.overlay_video import OverlayWriter, comment_of
from mien.output.track import Track
from mien.output.track_files import track_paths
from mien.pipeline.track import track
from mien.synthetic import FPS, Portrait, SyntheticSequence, make_sequence, moved, portrait

SECONDS = 4.0
NOISE_SD = 2.0
"""Standard deviation of the simulated sensor noise, in grey values."""

VIDEO, TRUTH, LANDMARKS = "video.mp4", "truth.npz", "landmarks.json"
TABLE, OVERLAY, PLOT, HEAD = "track.csv", "overlay.mp4", "plot.png", "head.glb"
_COMMENT = "made by mien demo"
"""What the video states of itself: that it may be replaced, and that it is no overlay."""


@dataclass(frozen=True)
class DemoErrors:
    """Errors over the tracked frames: mean absolute error (3,) of pitch, yaw and roll in degrees, root mean square
    error of the landmarks in pixels, mean absolute error (6,) of the animation units; and the number of lost frames."""

    euler_deg: Array
    landmarks_px: float
    animation: Array
    lost: int


def run_demo(
    out: Path,
    *,
    seconds: float = SECONDS,
    console: Console | None = None,
) -> DemoErrors:
    """Write video, truth, track, overlay, plot and head to the folder `out`; print and return the errors. Raises
    MienError if a file of these names is there that is not of an earlier demo."""
    console = console or Console()
    _require_own(out)
    require_writable(out / VIDEO)
    with console.status("making a face in known motion, and tracking it"):
        face = portrait()
        sequence = make_sequence(face, demo_states(face, round(seconds * FPS)), noise_sd=NOISE_SD)
        write_sequence(out, face, sequence)
        result = track(
            out / VIDEO,
            landmarks=out / LANDMARKS,
            camera=face.camera,
            save=out / TABLE,
            overlay=out / OVERLAY,
            plot=out / PLOT,
            gltf=out / HEAD,
        )
    errors = compare(result, sequence)
    console.print(_table(errors, len(result)))
    for path in _paths(out):
        console.print(f"wrote {path}", soft_wrap=True, highlight=False, markup=False)
    return errors


def _paths(out: Path) -> list[Path]:
    """Every file that is written, in this order."""
    return [out / VIDEO, out / TRUTH, out / LANDMARKS, *track_paths(out / TABLE), out / OVERLAY, out / PLOT, out / HEAD]


def _require_own(out: Path) -> None:
    """Raise MienError if a file would be overwritten in a folder without the video of an earlier demo, which is the
    first that it writes."""
    taken = next((path for path in _paths(out) if path.exists()), None)
    require(
        taken is None or comment_of(out / VIDEO) == _COMMENT,
        f"{taken} exists and is not of mien demo; choose another folder with --out, or move it away",
    )


def demo_states(face: Portrait, n: int) -> Array:
    """States (n, 12) of the portrait: it looks around and nods, then opens its mouth and raises its brows."""
    s = np.arange(n) / (SECONDS * FPS) % 1
    wave = np.sin(2 * np.pi * s)
    pitch, yaw, roll = 9 * np.sin(4 * np.pi * s), 22 * wave, 8 * np.sin(3 * np.pi * s)
    shift = np.stack([0.12 * wave, 0.05 * np.sin(4 * np.pi * s), 0.15 * (1 - np.cos(2 * np.pi * s))], axis=1)
    animation = np.zeros((n, len(TRACKED_UNITS)))
    for unit, size, begin, end in (
        ("jaw_drop", 0.45, 0.10, 0.35),
        ("outer_brow_raiser", 0.7, 0.30, 0.55),
        ("lip_stretcher", -0.5, 0.50, 0.75),
        ("brow_lowerer", 0.4, 0.70, 0.95),
    ):
        animation[:, TRACKED_UNITS.index(unit)] = size * _bump(s, begin, end)
    return moved(face, np.stack([pitch, yaw, roll], axis=1), shift, animation)


def write_sequence(out: Path, face: Portrait, sequence: SyntheticSequence) -> None:
    """Write the frames as a video, the ground truth, and the landmarks of the first frame."""
    with OverlayWriter(out / VIDEO, comment=_COMMENT) as video:
        for frame in sequence.frames:
            video.write(frame.pixels, frame.time)
    write_landmarks(out / LANDMARKS, face.landmarks)
    with whole_file(out / TRUTH) as file:
        np.savez(file, R=sequence.R, t=sequence.t, animation=sequence.animation, landmarks=sequence.landmarks)


def compare(result: Track, sequence: SyntheticSequence) -> DemoErrors:
    """Errors of a track against the ground truth of its sequence."""
    found = np.isfinite(result.euler_deg).all(axis=1)
    truth_deg = np.degrees(euler_from_matrix(sequence.R @ FACING))
    landmarks, animation = result.landmarks, result.animation
    nothing = np.full(len(found), np.nan)
    distance = nothing if landmarks is None else np.linalg.norm(landmarks - sequence.landmarks, axis=2)
    difference = nothing[:, None] if animation is None else np.abs(animation - sequence.animation)
    return DemoErrors(
        euler_deg=np.abs(result.euler_deg - truth_deg)[found].mean(axis=0),
        landmarks_px=float(np.sqrt(np.mean(distance[found] ** 2))),
        animation=difference[found].mean(axis=0),
        lost=result.lost,
    )


def _bump(s: Array, begin: float, end: float) -> Array:
    """A smooth rise from 0 to 1 and back between begin and end."""
    phase = np.clip((s - begin) / (end - begin), 0, 1)
    return np.asarray(np.sin(np.pi * phase) ** 2)


def _table(errors: DemoErrors, frames: int) -> Table:
    table = Table(title=f"Error against the truth, {frames} frames, {errors.lost} lost")
    table.add_column("quantity")
    table.add_column("error", justify="right")
    for name, value in zip(("pitch", "yaw", "roll"), errors.euler_deg, strict=True):
        table.add_row(f"{name}, mean absolute", f"{value:.2f} degrees")
    table.add_row("26 landmarks, root mean square", f"{errors.landmarks_px:.2f} pixels")
    for name, value in zip(TRACKED_UNITS, errors.animation, strict=False):
        table.add_row(f"{name.replace('_', ' ')}, mean absolute", f"{value:.3f}")
    return table
