"""Faces of recordings that turn aside: how many frames are lost, by how far MediaPipe says they have turned.

`OMP_NUM_THREADS=1 python benchmarks/turned_faces.py PATH`, with PATH a folder of videos. There is no truth: angles are
between the two trackers' rotations, in degrees, the head's axes of one aligned to those of the other where both see the
face from the front and ours is sure, so that what one of them adds or loses on the way to the side counts.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
from shared.command_line import carry_out, print_heads
from shared.recordings import apart_deg, asked, rotations

import mien
from mien.arrays import Array
from mien.errors import MienWarning

TURNS_DEG = (0, 15, 25, 35, 45, 60, 90)
FRONT_DEG = TURNS_DEG[1]
COLUMNS = ("recording", "turn", "frames", "lost", "apart, median", "95 %", "apart < 5", "mean confidence")


def turns_deg(R: Array) -> Array:
    """(n,) angles between the camera's axis and the faces of rotations (n, 3, 3), NaN where there is none."""
    return np.asarray(np.degrees(np.arccos(np.clip(R[:, 2, 2], -1, 1))))


def rows(path: Path, seconds: float) -> Iterator[str]:
    """What came of the frames of one recording, by turn."""
    peer = rotations(mien.track(path, preset="mediapipe", end=seconds))
    track = mien.track(path, end=seconds)
    turn, ours = turns_deg(peer), rotations(track)
    from_the_front = (turn < FRONT_DEG) & (turns_deg(ours) < 2 * FRONT_DEG) & (track.confidence > 0.5)
    apart = apart_deg(peer, ours, from_the_front)
    for low, high in pairwise(TURNS_DEG):
        of = (turn >= low) & (turn < high)
        there = of & np.isfinite(apart)
        if there.any():
            median, most = np.percentile(apart[there], [50, 95])
            right, sure = (apart[there] < 5).mean(), track.confidence[there].mean()
            figures = f"{of.sum()} | {of.sum() - there.sum()} | {median:.1f} | {most:.1f} | {right:.2f} | {sure:.2f}"
            yield f"| {path.stem} | {low} to {high} | {figures} |"


def main() -> None:
    paths, seconds = asked(__doc__)
    warnings.simplefilter("ignore", MienWarning)
    print_heads(*COLUMNS)
    for path in paths:
        for row in rows(path, seconds):
            print(row, flush=True)


if __name__ == "__main__":
    carry_out(main)
