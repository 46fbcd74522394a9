"""The real-time tracker begun with a head that is turned: tables of `mien report` by the turn in the first frame.

`OMP_NUM_THREADS=1 python benchmarks/turned_start.py PATH`, with PATH a folder of rendered sequences. Each is begun at
every 25th frame, played from there to its end, and from there backwards. Protocol `rebased`, landmarks from the
detector. Last, by turn and by kind of sequence: the same beside `mien track`, which begins in the frame that shows the
face best and goes both ways.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from shared.command_line import carry_out, parser_of, print_heads
from shared.recordings import apart_deg
from shared.runs import KINDS as SEQUENCE_KINDS
from shared.runs import Run, begun_at, prepare, print_tables, score, scored

from mien.arrays import Array
from mien.evaluation.datasets import load_dataset
from mien.evaluation.scores import Score, pooled_errors
from mien.evaluation.tables import angles_by_kind, calibration
from mien.frame import Frame
from mien.pipeline import run as both_ways
from mien.start import first_frame
from mien.start.footage import Footage
from mien.tracking.realtime import RealtimeTracker
from mien.video import open_video

STEP, FPS = 25, 30
TURNS_DEG = (0, 5, 10, 15, 20, 30, 90)
KINDS = tuple(f"{low} to {high} degrees" for low, high in pairwise(TURNS_DEG))


def as_tracked(run: Run) -> Score:
    """What `mien track` makes of a run: begun in the frame that shows the face best, and played both ways."""
    played = [Frame(frame.pixels, k, k / FPS) for k, frame in enumerate(run.frames)]
    begin = first_frame.prepare(Footage(open_video(played), camera=run.sequence.camera))
    tracker = RealtimeTracker()
    earlier = {estimate.index: estimate for estimate in both_ways.run_back(tracker, begin)}
    onwards = tracker.again() if earlier else tracker
    return scored([estimate for _, estimate in both_ways.run(onwards, begin, earlier)], run)


def starts(run: Run) -> Iterator[tuple[Score, Score]]:
    """What the tracker makes of a run from each of its beginnings, and what `mien track` does; the kind is the turn
    there."""
    for first in range(0, len(run.frames), STEP):
        begun = begun_at(run, first)
        if begun is not None and begun.truth.rotations is not None:
            turn = np.degrees(np.arccos(np.clip(-begun.truth.rotations[0, 2, 2], -1, 1)))
            kind = KINDS[int(np.searchsorted(TURNS_DEG, turn, side="right")) - 1]
            made = score(RealtimeTracker, begun, "realtime")
            yield replace(made, result=replace(made.result, kind=kind)), as_tracked(begun)


def aligned_deg(score: Score) -> Array:
    """(n,) angles in degrees between a track's rotations and the true ones, head axes aligned to these."""
    truth, track = score.result.truth, score.result.track
    assert truth is not None
    assert truth.rotations is not None
    assert track is not None
    apart = apart_deg(truth.rotations, track.rotation)
    return apart[np.isfinite(apart)]


def errors(scores: Sequence[Score]) -> Iterator[str]:
    """Error since the first frame, with the head's axes aligned, and frames without a face."""
    yield f"{pooled_errors(scores).mean():.2f}"
    yield f"{np.concatenate([aligned_deg(s) for s in scores]).mean():.2f}"
    yield str(sum(s.lost for s in scores))


def main() -> None:
    parser = parser_of(__doc__, "path")
    sequences = load_dataset("rendered", parser.parse_args().path)
    pairs = [pair for sequence in sequences for pair in starts(prepare(sequence))]
    pairs.sort(key=lambda pair: KINDS.index(pair[0].result.kind))
    print_tables([there for there, _ in pairs], (angles_by_kind, calibration))
    heads = ("", "starts", "begun there", "aligned", "lost", "as tracked", "aligned", "lost")
    print_heads(*heads)
    for name in (*KINDS, *SEQUENCE_KINDS):
        begun = [pair for pair in pairs if name in (score.result.kind for score in pair)]
        if begun:
            cells = (cell for scores in zip(*begun, strict=True) for cell in errors(scores))
            print(f"| {name} | {len(begun)} | {' | '.join(cells)} |")


if __name__ == "__main__":
    carry_out(main)
