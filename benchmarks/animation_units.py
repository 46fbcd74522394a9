"""Animation units on rendered heads: how much of their movement is reported, and how much of the error their intervals
hold, as Markdown tables.

`OMP_NUM_THREADS=1 python benchmarks/animation_units.py PATH`, with PATH a folder of rendered sequences; landmarks from
the detector. These heads are not moved by CANDIDE's units. Their true units are those that move the fitted face so that
its points come nearest to the true landmarks, at the true rotation; of these, what follows the shapes that move the
head, by least squares, with little weight for turned heads, where the fitted face is wrong in depth. Heads that show no
expression have true units of zero. All count from the first frame.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from ablation import Run, prepare
from inputs import carry_out
from scipy.optimize import least_squares

from mien.arrays import Array
from mien.candide.model import TRACKED_UNITS
from mien.evaluation.datasets import load_dataset
from mien.evaluation.metrics import ANGLE_LEVEL, coverage
from mien.geometry.rotation import angle_between
from mien.initialization.landmarks import LANDMARK_NAMES, rows_reported
from mien.tracking.realtime import RealtimeTracker

REGULARIZER_PX = 0.05
"""Pixels by which the points may miss if a unit then moves by 1 less."""
FRONTAL_DEG = 12.0
"""Turn at which a frame has a weight of 1/e in the regression on shapes."""
RIDGE = 0.3


def nearest_units(tracker: RealtimeTracker, first: tuple[Array, Array, Array], run: Run) -> Array:
    """Units (frames, 6) of the face that a tracker has learned, by which it comes nearest to the true landmarks. first:
    R, t and animation of the model in the first frame."""
    assert run.truth.landmarks is not None
    assert run.truth.rotations is not None
    rows = rows_reported("ibug68")
    which = [LANDMARK_NAMES.index(name) for name in rows]
    neutral, units = tracker.person.neutral[which], tracker.person.units[:, which]
    points = np.stack([run.truth.landmarks[:, pair].mean(axis=1) for pair in rows.values()], axis=1)

    def projected(R: Array, t: Array, animation: Array) -> Array:
        X = (neutral + np.tensordot(animation, units, axes=1)) @ R.T + t
        return tracker.camera.project(X)[0]

    R_first, t, animation = first
    points -= points[0] - projected(*first)
    state, found = np.concatenate([t, animation]), []
    for R, p in zip(run.truth.rotations @ run.truth.rotations[0].T @ R_first, points, strict=True):

        def residual(x: Array, R: Array = R, p: Array = p) -> Array:
            return np.append(projected(R, x[:3], x[3:]) - p, REGULARIZER_PX * (x[3:] - animation))

        state = least_squares(residual, state).x
        found.append(state[3:])
    return np.array(found)


def moved(run: Run, nearest: Array) -> Array:
    """True units (frames, 6) since the first frame: the part of the nearest ones that the head's shapes explain."""
    truth = run.truth
    assert truth.expression is not None
    assert truth.rotations is not None
    shapes = truth.expression - truth.expression[0]
    shapes = shapes[:, shapes.std(axis=0) > 0.01]
    turned_deg = np.degrees(angle_between(truth.rotations[0], truth.rotations))
    weighted = shapes * np.exp(-((turned_deg[:, None] / FRONTAL_DEG) ** 2))
    ridge = RIDGE * np.eye(shapes.shape[1])
    return np.asarray(shapes @ np.linalg.solve(weighted.T @ shapes + ridge, weighted.T @ (nearest - nearest[0])))


def measured(run: Run) -> tuple[Array, Array, Array]:
    """Reported and true units (m, 6) since the first frame, and the standard deviations as reported, in the frames that
    are not lost."""
    tracker, frame = RealtimeTracker(), run.frames[0]
    estimates = [tracker.initialize(frame, run.landmarks, run.sequence.camera_for(frame.width, frame.height))]
    first = tracker.pose.R, tracker.pose.t, tracker.pose.animation
    estimates += [tracker.track(frame) for frame in run.frames[1:]]
    true = moved(run, nearest_units(tracker, first, run))
    rows = [
        (estimate.animation - first[2], np.sqrt(np.diag(estimate.covariance)[6:]), of_truth)
        for estimate, of_truth in zip(estimates, true, strict=True)
        if estimate.animation is not None and estimate.covariance is not None
    ]
    reported, sd, true = (np.array(column) for column in zip(*rows, strict=True))
    return reported, true, sd


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("path", type=Path)
    every: dict[str, list[tuple[Array, Array, Array]]] = {}
    for sequence in load_dataset("rendered", parser.parse_args().path):
        every.setdefault(sequence.kind, []).append(measured(prepare(sequence)))
    print(f"| kind | | {' | '.join(TRACKED_UNITS)} |", "|---" * (2 + len(TRACKED_UNITS)) + "|", sep="\n")
    for kind, of_kind in every.items():
        reported, true, sd = (np.concatenate(column) for column in zip(*of_kind, strict=True))
        error = reported - true
        if true.any():
            share = (reported * true).sum(axis=0) / (true**2).sum(axis=0)
            _print(kind, "movement reported", [f"{value:.2f}" for value in share])
        _print(kind, "root mean square error", [f"{value:.3f}" for value in np.sqrt((error**2).mean(axis=0))])
        inside = [coverage(e, s, ANGLE_LEVEL) for e, s in zip(error.T, sd.T, strict=True)]
        _print(kind, f"in {ANGLE_LEVEL:.0%}", [f"{100 * value:.0f}" for value in inside])


def _print(kind: str, what: str, cells: list[str]) -> None:
    print(f"| {kind} | {what} | {' | '.join(cells)} |")


if __name__ == "__main__":
    carry_out(main)
