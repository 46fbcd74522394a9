"""The real-time tracker begun with a head that is turned: tables of `mien report` by the turn in the first frame.

`OMP_NUM_THREADS=1 python benchmarks/turned_start.py PATH`, with PATH a folder of rendered sequences. Each is begun at
every 25th frame, played from there to its end, and from there backwards. Protocol `rebased`, landmarks from the
detector.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from ablation import Run, prepare, print_tables, score

from mien.evaluation.datasets import load_dataset
from mien.evaluation.scores import Score
from mien.evaluation.tables import angles_by_kind, calibration
from mien.initialization.detector import detect
from mien.tracking.realtime import RealtimeTracker

STEP = 25
TURNS_DEG = (0, 5, 10, 15, 20, 30, 90)
KINDS = tuple(f"{low} to {high} degrees" for low, high in pairwise(TURNS_DEG))


def begun_at(run: Run, first: int) -> Run | None:
    """A run from one of its frames to the end, and from there backwards; None where no face is found in that frame."""
    landmarks, end = detect(run.frames[first]), len(run.frames)
    if not landmarks or run.truth.rotations is None:
        return None
    order = [*range(first, end), *reversed(range(end - 1))]
    truth = replace(run.truth, frames=len(order), rotations=run.truth.rotations[order], expression=None, landmarks=None)
    return replace(run, frames=[run.frames[k] for k in order], truth=truth, landmarks=landmarks[0])


def starts(run: Run) -> Iterator[Score]:
    """What the tracker makes of a run from each of its beginnings; the kind is the turn there."""
    for first in range(0, len(run.frames), STEP):
        begun = begun_at(run, first)
        if begun is not None and begun.truth.rotations is not None:
            turn = np.degrees(np.arccos(np.clip(-begun.truth.rotations[0, 2, 2], -1, 1)))
            kind = KINDS[int(np.searchsorted(TURNS_DEG, turn, side="right")) - 1]
            made = score(RealtimeTracker, begun)
            yield replace(made, result=replace(made.result, tracker="realtime", kind=kind))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("path", type=Path)
    sequences = load_dataset("rendered", parser.parse_args().path)
    every = (made for sequence in sequences for made in starts(prepare(sequence)))
    print_tables(sorted(every, key=lambda made: KINDS.index(made.result.kind)), (angles_by_kind, calibration))


if __name__ == "__main__":
    main()
