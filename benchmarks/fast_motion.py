"""Faces that move faster: what the tracker makes of every frame, and of every second, third and fifth alone. Tables of
`mien report`.

`OMP_NUM_THREADS=1 python benchmarks/fast_motion.py PATH`, with PATH a folder of rendered sequences. Protocol `rebased`,
landmarks from the detector.
"""

from __future__ import annotations

from collections.abc import Iterator

from shared.command_line import carry_out, parser_of
from shared.runs import prepare, print_tables, score, thinned

from mien.evaluation.datasets import load_dataset
from mien.evaluation.datasets.sequence import Sequence
from mien.evaluation.scores import Score
from mien.evaluation.tables import angles_by_kind, by_kind, calibration
from mien.tracking.realtime import RealtimeTracker

STEPS = {"every frame": 1, "every second": 2, "every third": 3, "every fifth": 5}


def at_each_rate(sequence: Sequence) -> Iterator[Score]:
    """What a new tracker makes of a sequence at each rate."""
    run = prepare(sequence)
    for name, step in STEPS.items():
        yield score(RealtimeTracker, thinned(run, step), name)


def main() -> None:
    parser = parser_of(__doc__, "path")
    sequences = load_dataset("rendered", parser.parse_args().path)
    print_tables((made for s in sequences for made in at_each_rate(s)), (by_kind, angles_by_kind, calibration))


if __name__ == "__main__":
    carry_out(main)
