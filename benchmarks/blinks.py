"""Real recordings: how far a blink nods the head, for the real-time tracker, noticing it or not, and for MediaPipe;
and how `eyes_closed` compares with the opening of the eyes in MediaPipe's landmarks.

`OMP_NUM_THREADS=1 python benchmarks/blinks.py PATH`, with PATH a folder of videos. Blinks are found by the opening of
the eyes over their width in MediaPipe's landmarks (T. Soukupova and J. Cech, Real-time eye blink detection using facial
landmarks, CVWW 2016): both eyes together below 0.6 of what is usual, for ten frames at most. A head hardly moves in
that time, so the rotation in a blink is compared with that between four frames before it and three after.
"""

from __future__ import annotations

import warnings
from itertools import groupby
from pathlib import Path

import numpy as np
from shared.command_line import carry_out, print_heads
from shared.recordings import asked, rotations, seen_by_mediapipe

import mien
from mien.arrays import Array
from mien.config import RealtimeSettings
from mien.config.realtime import VisibilitySettings
from mien.errors import MienWarning
from mien.evaluation.metrics import correlation
from mien.geometry.rotation import exp, log
from mien.tracking.realtime import RealtimeTracker

LIDS, CORNERS = ((159, 145), (386, 374)), ((33, 133), (362, 263))
"""MediaPipe's points in the middle of the lids, and at the corners, of the right and of the left eye."""
USUAL_FRAMES, CLOSED, LONGEST = 20, 0.6, 10
BEFORE, AFTER = 4, 3
SHUT, OPEN = 0.4, 0.9
TRACKERS = {"realtime": "realtime", "without noticing": "__main__:Unaware", "MediaPipe": "mediapipe"}


class Unaware(RealtimeTracker):
    """The real-time tracker, to which no eye is closed enough."""

    def __init__(self) -> None:
        super().__init__(RealtimeSettings(visibility=VisibilitySettings(closing_share=1e6)))


def openings(path: Path, seconds: float) -> dict[int, float]:
    """By frame: the mean opening of both eyes over their width, where there is a face."""

    def apart(points: Array, pairs: tuple[tuple[int, int], ...]) -> Array:
        return np.array([np.linalg.norm(points[a] - points[b]) for a, b in pairs])

    seen = seen_by_mediapipe(path, seconds)
    return {k: float((apart(face.points, LIDS) / apart(face.points, CORNERS)).mean()) for k, face in seen}


def blinks(opening: dict[int, float]) -> list[tuple[int, int]]:
    """First and last frame of each blink."""
    frames, values = np.array(list(opening)), np.array(list(opening.values()))
    usual = [np.percentile(values[max(i - USUAL_FRAMES, 0) : i + USUAL_FRAMES + 1], 80) for i in range(len(values))]
    runs = (list(run) for shut, run in groupby(range(len(frames)), lambda i: values[i] < CLOSED * usual[i]) if shut)
    return [(int(frames[run[0]]), int(frames[run[-1]])) for run in runs if len(run) <= LONGEST]


def nods_deg(R: Array, blinks: list[tuple[int, int]]) -> Array:
    """Rotation vectors (k, 3) in degrees, about the head's axes, between R (n, 3, 3) in frames of blinks and the
    rotation that goes evenly from before each to after it."""
    out = []
    for first, last in blinks:
        begin, end = first - BEFORE, last + AFTER
        if begin >= 0 and end < len(R) and np.isfinite(R[begin : end + 1]).all():
            turn = log(R[begin].T @ R[end])
            evenly = (R[begin] @ exp(turn * (i - begin) / (end - begin)) for i in range(first, last + 1))
            out += [log(there.T @ here) for there, here in zip(evenly, R[first : last + 1], strict=True)]
    return np.degrees(np.reshape(out, (-1, 3)))


def compared(track: mien.Track, opening: dict[int, float]) -> list[str]:
    """Of `eyes_closed`: correlation with how much is gone of the opening with which tracking began; median where less
    than 0.4 of that is left, and 95th percentile where more than 0.9 is, with the frames."""
    frames = [i for i in opening if i < len(track)]
    begun = opening.get(track.status.index("initialized"), np.nan)
    if track.eyes_closed is None or not np.isfinite(begun):
        return ["", "", ""]
    told, seen = track.eyes_closed[frames], np.array([opening[i] for i in frames]) / begun
    known = np.isfinite(told)
    told, seen = told[known], seen[known]
    shut, wide = told[seen < SHUT], told[seen > OPEN]
    cells = [f"{correlation(told, np.maximum(1 - seen, 0)):.2f}"]
    cells += [f"{np.median(shut):.2f} ({len(shut)})" if len(shut) else ""]
    return [*cells, f"{np.percentile(wide, 95):.2f} ({len(wide)})" if len(wide) else ""]


def main() -> None:
    paths, seconds = asked(__doc__)
    warnings.simplefilter("ignore", MienWarning)
    of_nods = [f"{name}: {what}" for name in TRACKERS for what in ("tilt", "RMS")]
    print_heads("recording", "blinks", "frames", *of_nods, "correlation", "shut", "open")
    for path in paths:
        opening = openings(path, seconds)
        found = blinks(opening)
        tracks = [mien.track(path, preset=preset, end=seconds) for preset in TRACKERS.values()]
        nods = [nods_deg(rotations(track), found) for track in tracks]
        figures = [""] * len(of_nods)
        if len(nods[0]):
            both = ((nod[:, 0].mean(), np.sqrt((nod**2).sum(axis=1).mean())) for nod in nods)
            figures = [f"{value:.2f}" for pair in both for value in pair]
        cells = [path.stem, str(len(found)), str(len(nods[0])), *figures, *compared(tracks[0], opening)]
        print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    carry_out(main)
