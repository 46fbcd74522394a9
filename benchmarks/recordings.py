"""Real recordings: how far the real-time tracker is from MediaPipe, learned in the first frame and in the best one.

`OMP_NUM_THREADS=1 python benchmarks/recordings.py PATH`, with PATH a folder of videos. There is no truth: two trackers
that share nothing but the first landmarks are the nearer to each other the less each errs. Angles between their
rotations in degrees, the head's axes of one aligned to those of the other.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from shared.command_line import carry_out, print_heads
from shared.recordings import apart_deg, asked, rotations

import mien
from mien.errors import MienWarning


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
    print_heads(*columns)
    for path in paths:
        print(row(path, seconds), flush=True)


if __name__ == "__main__":
    carry_out(main)
