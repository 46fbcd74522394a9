"""What a second pass over a sequence gains on the first, and what both say of their errors, as a Markdown table.

`OMP_NUM_THREADS=1 python benchmarks/second_pass.py PATH`, with PATH a folder of rendered sequences. Protocol `rebased`,
landmarks from the detector. The 90 per cent intervals, of all angles and of each, and the gap of the confidence are as
in `mien report`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from ablation import prepare, score

from mien.evaluation.datasets import load_dataset
from mien.evaluation.datasets.sequence import Sequence
from mien.evaluation.metrics import ANGLE_LEVEL, coverage, reliability
from mien.evaluation.scores import Score, pooled, pooled_errors
from mien.tracking.realtime import RealtimeTracker


def twice(sequence: Sequence) -> tuple[Score, Score]:
    """What the first and the second pass over a sequence make of it."""
    run, tracker = prepare(sequence), RealtimeTracker()
    return score(lambda: tracker, run), score(tracker.again, run)


def row(kind: str, turn: int, scores: list[Score]) -> str:
    """A row of the table: one pass over the sequences of a kind."""
    error = pooled(scores, lambda s: s.error_deg[s.calibrated])
    sd = pooled(scores, lambda s: s.compared.sd_deg[s.calibrated])
    confidence = pooled(scores, lambda s: s.confidence[s.calibrated])
    turned = pooled(scores, lambda s: s.compared.rotation_error_deg[s.calibrated])
    inside = [100 * coverage(error[:, k], sd[:, k], ANGLE_LEVEL) for k in range(3)]
    cells = (
        kind,
        str(turn),
        f"{pooled_errors(scores).mean():.2f}",
        f"{np.mean([s.jitter_deg for s in scores]):.2f}",
        f"{np.mean(inside):.0f}",
        ", ".join(f"{share:.0f}" for share in inside),
        f"{100 * reliability(confidence, turned).gap:.1f}",
        str(sum(s.lost for s in scores)),
    )
    return f"| {' | '.join(cells)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("path", type=Path)
    scores: dict[str, list[tuple[Score, Score]]] = {}
    for sequence in load_dataset("rendered", parser.parse_args().path):
        scores.setdefault(sequence.kind, []).append(twice(sequence))
    columns = ("", "pass", "error", "jitter", "in 90 %", "of tilt, pan, roll", "gap", "lost")
    print(f"| {' | '.join(columns)} |", "|---" * len(columns) + "|", sep="\n")
    for kind, both in scores.items():
        for turn, of_pass in enumerate(zip(*both, strict=True), start=1):
            print(row(kind, turn, list(of_pass)))


if __name__ == "__main__":
    main()
