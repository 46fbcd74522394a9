"""Real recordings: how far the real-time tracker is from MediaPipe, learned in the first frame and in the best one.

`OMP_NUM_THREADS=1 python benchmarks/recordings.py PATH`, with PATH a folder of videos. There is no truth: two trackers
that share nothing but the first landmarks are the nearer to each other the less each errs. Angles between their
rotations in degrees, the head's axes of one aligned to those of the other.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Iterator
from itertools import chain, takewhile
from pathlib import Path

import numpy as np
from inputs import carry_out, videos_of
from scipy.spatial.transform import Rotation

import mien
from mien.arrays import Array, Mask
from mien.errors import MienWarning
from mien.geometry.rotation import angle_between, matrix_from_euler
from mien.initialization.detector import first_with_a_face, follow
from mien.initialization.landmarks import Landmarks
from mien.video import open_video


def asked(description: str | None) -> tuple[list[Path], float]:
    """The videos that the command line names, and how many seconds of each."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("path", type=Path)
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


def row(path: Path, seconds: float) -> str:
    """What the two beginnings make of one recording."""
    peer = rotations(mien.track(path, preset="mediapipe", at_once=True, end=seconds))
    cells = [path.stem, str(len(peer))]
    for at_once in (True, False):
        track = mien.track(path, at_once=at_once, end=seconds)
        apart = apart_deg(peer, rotations(track))
        begun = track.time[track.status.index("initialized")]
        figures = (begun, np.nanmean(apart), np.nanpercentile(apart, 95))
        cells += [*(f"{value:.2f}" for value in figures), str(track.lost), str(int((track.confidence < 0.5).sum()))]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    paths, seconds = asked(__doc__)
    warnings.simplefilter("ignore", MienWarning)
    of_each = ("begun at (s)", "mean", "95 %", "lost", "confidence below a half")
    columns = ("recording", "frames", *(f"{name}, {which}" for which in ("at once", "best") for name in of_each))
    print(f"| {' | '.join(columns)} |", "|---" * len(columns) + "|", sep="\n")
    for path in paths:
        print(row(path, seconds), flush=True)


if __name__ == "__main__":
    carry_out(main)
