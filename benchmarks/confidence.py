"""The confidence of the real-time tracker: with boards of all sizes that pass before the face or stay there, and begun
with a head that is turned.

`OMP_NUM_THREADS=1 python benchmarks/confidence.py PATH`, with PATH the folder of the rendered sequences. Prints, as
Markdown, how often the rotation is right to 5 degrees by confidence and by the share of the landmarks that is seen,
and the bias and the weight of `mien.tracking.realtime.uncertainty` that fit these frames best, a wrong rotation
counting twice.
`-o FIGURE` draws the reliability diagram.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from scipy.optimize import minimize
from shared.boards import boards
from shared.command_line import carry_out, parser_of, print_heads
from shared.runs import Run, begun_at, prepare, score

from mien.arrays import Array
from mien.evaluation.datasets import load_dataset
from mien.evaluation.figures import reliability_diagram
from mien.evaluation.metrics import RIGHT_DEG, reliability
from mien.tracking.realtime import RealtimeTracker, tracker, uncertainty

RUNS = 5
"""Runs of every sequence with boards, after one without."""
STARTS = (50, 100, 150)
"""Frames with which every sequence is begun, too: heads that are turned then."""
WRONG_COUNTS = 2.0
SHARES = (0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.01)


@dataclass(frozen=True)
class Frames:
    """What is known of n frames in which the face was not lost: logarithm of the spread, share that is seen,
    confidence, error of the rotation in degrees."""

    spread: Array
    seen: Array
    confidence: Array
    error_deg: Array
    lost: int


def track(run: Run) -> Frames:
    """Track a run, and note what its confidence is made of."""
    noted: list[tuple[float, float, float]] = []

    def confidence(covariance: Array, seen: float, *others: Any) -> float:
        value = uncertainty.confidence(covariance, seen, *others)
        noted.append((float(np.log(np.trace(covariance[:3, :3]))), seen, value))
        return value

    with patch.object(tracker, "confidence", confidence):
        compared = score(RealtimeTracker, run).compared
    return Frames(*np.array(noted).T, compared.rotation_error_deg[~compared.lost], int(compared.lost.sum()))


def best_fit(frames: Frames) -> Array:
    """Bias and weight (2,) of the logistic regression that makes these frames most probable."""
    bias, weight = uncertainty.CONFIDENCE
    right = frames.error_deg < RIGHT_DEG
    # What else the confidence is a product of stays as it is.
    others = np.clip(frames.confidence * (1 + np.exp(-(bias + weight * frames.spread))), 0, 1)

    def surprise(w: Array) -> float:
        p = np.clip(others / (1 + np.exp(-np.clip(w[0] + w[1] * frames.spread, -30, 30))), 1e-9, 1 - 1e-9)
        return float(-np.where(right, np.log(p), WRONG_COUNTS * np.log(1 - p)).mean())

    return np.asarray(minimize(surprise, [bias, weight], method="Nelder-Mead").x)


def main() -> None:
    parser = parser_of(__doc__, "path")
    parser.add_argument("-o", "--figure", type=Path)
    arguments = parser.parse_args()
    rng = np.random.default_rng(0)
    runs = []
    for sequence in load_dataset("rendered", arguments.path):
        run = prepare(sequence)
        assert run.truth.landmarks is not None
        runs.append(track(run))
        for _ in range(RUNS):
            hidden = list(run.frames)
            for board in boards(run.truth.landmarks, rng):
                for k in range(board.begin, board.end):
                    hidden[k] = board.paint(run.frames[k])
            runs.append(track(replace(run, frames=hidden)))
        runs += [track(begun) for first in STARTS if (begun := begun_at(run, first)) is not None]
    columns = zip(*((r.spread, r.seen, r.confidence, r.error_deg) for r in runs), strict=True)
    every = Frames(*(np.concatenate(column) for column in columns), sum(r.lost for r in runs))
    diagram = reliability(every.confidence, every.error_deg)
    print_heads("confidence", "frames", "mean confidence", "right to 5 degrees")
    for k, count in enumerate(diagram.count):
        edges = f"{diagram.edges[k]:.1f} to {diagram.edges[k + 1]:.1f}"
        print(f"| {edges} | {count:.0f} | {diagram.confidence[k]:.2f} | {diagram.right[k]:.2f} |")
    print()
    print_heads("seen", "frames", "mean confidence", "right to 5 degrees", "median error")
    for low, high in zip((0.0, *SHARES), SHARES, strict=False):
        of = (every.seen >= low) & (every.seen < high)
        if of.any():
            right, error = (every.error_deg[of] < RIGHT_DEG).mean(), np.median(every.error_deg[of])
            print(f"| from {low:.1f} | {of.sum()} | {every.confidence[of].mean():.2f} | {right:.2f} | {error:.1f} |")
    bias, weight = best_fit(every)
    print(f"\n{len(every.seen)} frames, {every.lost} more lost; gap {100 * diagram.gap:.1f} per cent")
    print(f"best fit: bias {bias:.2f}, weight {weight:.2f}")
    if arguments.figure is not None:
        reliability_diagram({"realtime": diagram}).savefig(arguments.figure, dpi=110)


if __name__ == "__main__":
    carry_out(main)
