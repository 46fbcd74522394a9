"""Recordings, of which there is no truth: two trackers beside each other."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, takewhile
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from shared.command_line import parser_of
from shared.inputs import videos_of

import mien
from mien.arrays import Array, Mask
from mien.geometry.rotation import angle_between, matrix_from_euler
from mien.initialization.detector import first_with_a_face, follow
from mien.initialization.landmarks import Landmarks
from mien.video import open_video


def asked(description: str | None) -> tuple[list[Path], float]:
    """The videos that the command line names, and how many seconds of each."""
    parser = parser_of(description, "path")
    parser.add_argument("--seconds", type=float, default=30.0, help="of each recording")
    arguments = parser.parse_args()
    return videos_of(arguments.path), arguments.seconds


def seen_by_mediapipe(path: Path, seconds: float) -> Iterator[tuple[int, Landmarks]]:
    """Index and landmarks of every frame of a recording with a face."""
    frames = takewhile(lambda frame: frame.time <= seconds, open_video(path))
    found = first_with_a_face(frames)
    if found is not None:
        first, faces = found
        for frame, face in chain([(first, faces[0])], follow(faces[0], frames)):
            yield frame.index, face


def rotations(track: mien.Track) -> Array:
    """(n, 3, 3), NaN where the face is lost."""
    return np.stack([matrix_from_euler(angles) for angles in np.radians(track.euler_deg)])


def apart_deg(a: Array, b: Array, known: Mask | None = None) -> Array:
    """(n,) angles in degrees between two tracks (n, 3, 3) of one head with axes of its own each; NaN where one has
    lost it. known: (n,) the frames over which the axes are aligned, all unless given."""
    D = np.swapaxes(a, 1, 2) @ b
    there = np.isfinite(D).all(axis=(1, 2))
    between = Rotation.from_matrix(D[there if known is None else there & known]).mean().as_matrix()
    apart = np.full(len(D), np.nan)
    apart[there] = np.degrees(angle_between(D[there], between))
    return apart
