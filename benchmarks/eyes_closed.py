"""How far the eyes have closed: the error, and how much of it the tracker's own intervals hold, as a Markdown table.

`OMP_NUM_THREADS=1 python benchmarks/eyes_closed.py PATH`, with PATH a folder of rendered sequences; landmarks from the
detector. The truth is the mean of eyeBlink of both eyes, which are open below 0.1 and closed beyond 0.6. For each kind:
frames with open eyes, of which the mean and the largest `eyes_closed`, and the share beyond 0.5; frames with closing
eyes, of which the mean absolute error and the share inside the 90 per cent interval; frames with closed eyes, of which
the share beyond 0.5; and the correlation over all of these.
"""

from __future__ import annotations

import numpy as np
from shared.command_line import carry_out, parser_of, print_heads
from shared.runs import Run, prepare, track

from mien.arrays import Array
from mien.evaluation.datasets import load_dataset
from mien.evaluation.metrics import ANGLE_LEVEL, correlation, counterpart, coverage
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.state import EYES_CLOSED

OPEN, CLOSED, HALF = 0.1, 0.6, 0.5
COLUMNS = ("", "open", "mean", "largest", "beyond 0.5 (%)", "closing", "error", "in 90 % (%)", "closed")
COLUMNS += ("beyond 0.5 (%)", "correlation")


def told(run: Run) -> Array:
    """(n, 3): truth, estimate, and its standard deviation, in the frames that have them."""
    truth = None
    if run.truth.expression is not None:
        truth = counterpart(EYES_CLOSED, run.truth.expression, run.truth.expression_names)
    if truth is None:  # a data set without expression
        truth = np.zeros(len(run.frames))
    estimates = (estimate.closing for estimate in track(RealtimeTracker(), run))
    figures = [(t, e.share, e.sd) for t, e in zip(truth, estimates, strict=True) if e is not None]
    return np.array(figures).reshape(-1, 3)  # none where the eyes were closed to begin with


def row(kind: str, figures: Array) -> str:
    """One kind's figures (n, 3) in the table."""
    truth, estimate, sd = figures.T
    open_, closing, closed = truth < OPEN, truth >= OPEN, truth > CLOSED
    error = estimate - truth
    cells: list[object] = [open_.sum(), f"{estimate[open_].mean():.2f}", f"{estimate[open_].max():.2f}"]
    cells += [f"{100 * (estimate[open_] > HALF).mean():.1f}", closing.sum()]
    if closing.any():
        inside = coverage(error[closing], sd[closing], ANGLE_LEVEL)
        cells += [f"{np.abs(error[closing]).mean():.2f}", f"{100 * inside:.0f}", closed.sum()]
        cells += [f"{100 * (estimate[closed] > HALF).mean():.0f}", f"{correlation(truth, estimate):.2f}"]
    cells += [""] * (len(COLUMNS) - 1 - len(cells))
    return f"| {kind} | {' | '.join(map(str, cells))} |"


def main() -> None:
    parser = parser_of(__doc__, "path")
    every: dict[str, list[Array]] = {}
    for sequence in load_dataset("rendered", parser.parse_args().path):
        every.setdefault(sequence.kind, []).append(told(prepare(sequence)))
    print_heads(*COLUMNS)
    for kind, of_kind in every.items():
        print(row(kind, np.concatenate(of_kind)))


if __name__ == "__main__":
    carry_out(main)
