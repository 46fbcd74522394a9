"""Another face in the place of the one that is tracked: is it believed?

`OMP_NUM_THREADS=1 python benchmarks/strangers.py RECORDINGS PATH`, with RECORDINGS a folder of videos and PATH that of
the rendered sequences, of which the first of every person is taken. All faces are brought to one size and place;
every one is tracked for 20 frames, and then the picture is another one's for 30: at once, or dissolving into it for
10 frames more. Prints of how many of those 30 frames the confidence is above a half, by pair; whether a pair is the
same person twice the reader has to know.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice, permutations
from pathlib import Path

import cv2
import numpy as np
from shared.command_line import carry_out, parser_of
from shared.inputs import videos_of

from mien.arrays import Pixels
from mien.evaluation.datasets import load_dataset
from mien.frame import Frame
from mien.geometry.camera import DEFAULT_FOV_DEG, Camera
from mien.initialization.detector import detect, detect_once
from mien.tracking.realtime import RealtimeTracker
from mien.video import open_video

SIZE, FACE_PX = (320, 240), 110
BEFORE, BETWEEN, AFTER = 20, 10, 30
BELIEVED = 0.5


def faces(recordings: Path, rendered: Path) -> Iterator[tuple[str, list[Pixels]]]:
    """The first frames of each recording and each rendered person, the face of the first in the middle and as large as
    all others."""
    persons: dict[str, Path] = {}
    for sequence in load_dataset("rendered", rendered):
        persons.setdefault(sequence.name.split("_")[0], sequence.video)
    videos = {path.stem: path for path in videos_of(recordings)}
    for name, path in (videos | persons).items():
        frames = list(islice(open_video(path), BEFORE + BETWEEN + AFTER))
        found = detect_once(frames[0])
        if found and len(frames) == BEFORE + BETWEEN + AFTER:
            scale = FACE_PX / float(np.ptp(found[0].points, axis=0).max())
            shift = 0.5 * np.array(SIZE) - scale * found[0].points.mean(axis=0)
            A = np.column_stack([scale * np.eye(2), shift])
            yield name, [np.asarray(cv2.warpAffine(f.pixels, A, SIZE, flags=cv2.INTER_AREA), np.uint8) for f in frames]


def cut(one: list[Pixels], other: list[Pixels], between: int) -> list[Pixels]:
    """One face, in `between` frames something between it and the other, and the other face."""
    mixed = []
    for k in range(BEFORE, BEFORE + between):
        share = (k - BEFORE + 1) / (between + 1)
        mixed.append(np.asarray(cv2.addWeighted(one[k], 1 - share, other[k], share, 0), np.uint8))
    return [*one[:BEFORE], *mixed, *other[BEFORE + between :][:AFTER]]


@dataclass(frozen=True)
class Outcome:
    """Of a number of frames after a cut, how many are lost and how many believed."""

    frames: int
    lost: int
    believed: int


def outcome(pixels: list[Pixels]) -> Outcome | None:
    """Track a face that becomes another; None where it is not found in its first frame."""
    frames = [Frame(p, k, k / 30) for k, p in enumerate(pixels)]
    found = detect(frames[0])
    if not found:
        return None
    tracker = RealtimeTracker()
    tracker.initialize(frames[0], found[0], Camera.from_fov(*SIZE, DEFAULT_FOV_DEG))
    after = [tracker.track(frame) for frame in frames[1:]][-AFTER:]
    lost = sum(not estimate.status.success for estimate in after)
    return Outcome(len(after), lost, sum(estimate.confidence > BELIEVED for estimate in after))


def show(name: str, outcomes: Mapping[tuple[str, str], Outcome]) -> None:
    """Print what came of all pairs, and of those that are believed."""
    total = (sum(values) for values in zip(*((o.frames, o.lost, o.believed) for o in outcomes.values()), strict=True))
    print(f"{name}: {len(outcomes)} pairs; frames, lost, believed:", *total)
    for (one, other), o in outcomes.items():
        if o.believed:
            print(f"  {one} to {other}: {o.believed} of {o.frames}")


def main() -> None:
    parser = parser_of(__doc__, "recordings", "rendered")
    arguments = parser.parse_args()
    known = dict(faces(arguments.recordings, arguments.rendered))
    for name, between in (("cut", 0), ("dissolve", BETWEEN)):
        made = {pair: outcome(cut(known[pair[0]], known[pair[1]], between)) for pair in permutations(known, 2)}
        show(name, {pair: o for pair, o in made.items() if o is not None})


if __name__ == "__main__":
    carry_out(main)
