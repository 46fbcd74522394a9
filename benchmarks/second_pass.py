"""What a second pass over a sequence gains on the first, and what both say of their errors: tables of `mien report`.

`OMP_NUM_THREADS=1 python benchmarks/second_pass.py PATH`, with PATH a folder of rendered sequences. Protocol `rebased`,
landmarks from the detector.
"""

from __future__ import annotations

from collections.abc import Iterator

from shared.command_line import carry_out, parser_of
from shared.runs import prepare, print_tables, score

from mien.evaluation.datasets import load_dataset
from mien.evaluation.datasets.sequence import Sequence
from mien.evaluation.scores import Score
from mien.evaluation.tables import angles_by_kind, by_kind, calibration, jitter
from mien.tracking.realtime import RealtimeTracker

PASSES = ("first pass", "second pass")


def twice(sequence: Sequence) -> Iterator[Score]:
    """What the first and the second pass over a sequence make of it."""
    run, tracker = prepare(sequence), RealtimeTracker()
    for name, make in zip(PASSES, (lambda: tracker, tracker.again), strict=True):
        yield score(make, run, name)


def main() -> None:
    parser = parser_of(__doc__, "path")
    sequences = load_dataset("rendered", parser.parse_args().path)
    print_tables((made for s in sequences for made in twice(s)), (by_kind, angles_by_kind, calibration, jitter))


if __name__ == "__main__":
    carry_out(main)
