"""Animation units: how much of their movement is reported, and how much of the error their intervals hold, as Markdown
tables.

`OMP_NUM_THREADS=1 python benchmarks/animation_units.py PATH`, with PATH a folder of rendered sequences, or of videos.
None of these faces is moved by CANDIDE's units. Their true units are those that bring the fitted face nearest to the
true landmarks, at the true rotation; of these, the part that the shapes explain which move the head, by least squares,
with little weight for turned heads, where the fitted face is wrong in depth. Heads without expression have true units
of zero. For videos, what MediaPipe finds in each frame takes the place of the truth, and its noise counts as error; the
rotation is nearly the tracker's own. All count from the first frame; landmarks from the detector.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from itertools import takewhile
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from shared.command_line import carry_out, parser_of, print_heads
from shared.inputs import videos_of
from shared.recordings import seen_by_mediapipe
from shared.runs import Run, prepare

from mien.arrays import Array
from mien.candide.model import TRACKED_UNITS
from mien.errors import MienWarning
from mien.evaluation.datasets import load_dataset
from mien.evaluation.metrics import ANGLE_LEVEL, coverage
from mien.geometry.camera import Camera
from mien.geometry.rotation import angle_between, exp
from mien.initialization.landmarks import LANDMARK_NAMES, rows_reported
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.state import Estimate
from mien.video import open_video

POINT_SD = 0.01
"""Error of a point in CANDIDE units, beside a standard deviation of 1 of the animation units."""
ROTATION_SD = 0.03
"""Radians by which the tracker's rotation may be off in a video."""
SECONDS = 15.0
"""Of each video."""
FRONTAL_DEG = 12.0
"""Turn at which a frame has a weight of 1/e in the regression on shapes."""
RIDGE = 0.3

Moved = tuple[Array, Array, Array]
"""Reported and true units (m, 6) since the first frame, and the standard deviations as reported."""


class FirstFace:
    """A tracker's face in the first frame, and where the given points (k, 2) of some landmarks lie beside its own."""

    def __init__(self, tracker: RealtimeTracker, scheme: str, points: Array) -> None:
        """points: (n, 2) of an annotation of this scheme."""
        self.tracker = tracker
        self.rows = np.array(list(rows_reported(scheme).values()))
        self.which = [LANDMARK_NAMES.index(name) for name in rows_reported(scheme)]
        pose = tracker.pose
        self.R, self.t, self.animation = pose.R, pose.t, pose.animation
        self.offset = self._chosen(points) - self._projected(self.R, self.t, self.animation)
        self.last = np.concatenate([np.zeros(3), self.t, self.animation])

    def nearest_units(self, points: Array, R: Array, rotation_sd: float = 0.0) -> Array:
        """Units (6,) since the first frame by which the face that is known by now comes nearest to points (n, 2), at a
        rotation R (3, 3), which may be off by rotation_sd (radians)."""
        size = self.tracker.camera.focal_px / self.t[2]
        wanted = self._chosen(points) - self.offset

        def residual(x: Array) -> Array:
            off = self._projected(exp(rotation_sd * x[:3]) @ R, x[3:6], x[6:]) - wanted
            return np.concatenate([off.ravel() / (size * POINT_SD), x[:3], x[6:] - self.animation])

        self.last = least_squares(residual, self.last).x
        return np.asarray(self.last[6:] - self.animation)

    def _chosen(self, points: Array) -> Array:
        return np.asarray(points[self.rows].mean(axis=1))

    def _projected(self, R: Array, t: Array, animation: Array) -> Array:
        person = self.tracker.person
        X = person.neutral[self.which] + np.tensordot(animation, person.units[:, self.which], axes=1)
        return self.tracker.camera.project(X @ R.T + t)[0]


def rendered(run: Run) -> Moved:
    """The units of a rendered head."""
    tracker, frame, truth = RealtimeTracker(), run.frames[0], run.truth
    estimates = [tracker.initialize(frame, run.landmarks, run.sequence.camera_for(frame.width, frame.height))]
    assert truth.landmarks is not None
    assert truth.rotations is not None
    face = FirstFace(tracker, "ibug68", truth.landmarks[0])
    estimates += [tracker.track(frame) for frame in run.frames[1:]]
    rotations = truth.rotations @ truth.rotations[0].T @ face.R
    nearest = np.array([face.nearest_units(p, R) for p, R in zip(truth.landmarks, rotations, strict=True)])
    return beside(estimates, explained(run, nearest), face)


def explained(run: Run, nearest: Array) -> Array:
    """The part of the nearest units (frames, 6) that the head's shapes explain."""
    truth = run.truth
    assert truth.expression is not None
    assert truth.rotations is not None
    shapes = truth.expression - truth.expression[0]
    shapes = shapes[:, shapes.std(axis=0) > 0.01]
    turned_deg = np.degrees(angle_between(truth.rotations[0], truth.rotations))
    weighted = shapes * np.exp(-((turned_deg[:, None] / FRONTAL_DEG) ** 2))
    ridge = RIDGE * np.eye(shapes.shape[1])
    return np.asarray(shapes @ np.linalg.solve(weighted.T @ shapes + ridge, weighted.T @ nearest))


def filmed(video: Path) -> Moved | None:
    """The units of a face in a video beside those in MediaPipe's landmarks; None if there is no face."""
    seen = dict(seen_by_mediapipe(video, SECONDS))
    tracker, face = RealtimeTracker(), None
    estimates, nearest = list[Estimate](), list[Array]()
    for frame in takewhile(lambda frame: frame.time <= SECONDS, open_video(video)):
        if frame.index not in seen and face is None:
            continue
        if face is None:
            landmarks = seen[frame.index]
            tracker.initialize(frame, landmarks, Camera.unknown(frame.width, frame.height))
            face = FirstFace(tracker, landmarks.scheme, landmarks.points)
            continue
        estimate = tracker.track(frame)
        if estimate.status.success and frame.index in seen:
            estimates.append(estimate)
            nearest.append(face.nearest_units(seen[frame.index].points, tracker.pose.R, ROTATION_SD))
    return beside(estimates, np.array(nearest), face) if face and estimates else None


def beside(estimates: list[Estimate], true: Array, face: FirstFace) -> Moved:
    """What is reported beside what is true, in the frames that are not lost."""
    rows = [
        (estimate.animation - face.animation, of_truth, np.sqrt(np.diag(estimate.covariance)[6:]))
        for estimate, of_truth in zip(estimates, true, strict=True)
        if estimate.animation is not None and estimate.covariance is not None
    ]
    reported, true, sd = (np.array(column) for column in zip(*rows, strict=True))
    return reported, true, sd


def measured(path: Path) -> Iterator[tuple[str, list[Moved]]]:
    """The kinds of sequences, or the videos one by one and all together."""
    if any(path.glob("*_truth.npz")):
        of_kind: dict[str, list[Moved]] = {}
        for sequence in load_dataset("rendered", path):
            of_kind.setdefault(sequence.kind, []).append(rendered(prepare(sequence)))
        yield from of_kind.items()
        return
    every = []
    for video in videos_of(path):
        moved = filmed(video)
        if moved is not None:
            every.append(moved)
            yield video.stem, [moved]
    yield "all", every


def main() -> None:
    arguments = parser_of(__doc__, "path").parse_args()
    warnings.simplefilter("ignore", MienWarning)
    print_heads("", "", *TRACKED_UNITS)
    for name, moved in measured(arguments.path):
        reported, true, sd = (np.concatenate(column) for column in zip(*moved, strict=True))
        error = reported - true
        if true.any():
            share = (reported * true).sum(axis=0) / (true**2).sum(axis=0)
            _print(name, "movement reported", [f"{value:.2f}" for value in share])
        _print(name, "root mean square error", [f"{value:.3f}" for value in np.sqrt((error**2).mean(axis=0))])
        inside = [coverage(e, s, ANGLE_LEVEL) for e, s in zip(error.T, sd.T, strict=True)]
        _print(name, f"in the {ANGLE_LEVEL:.0%} interval", [f"{100 * value:.0f}" for value in inside])


def _print(name: str, what: str, cells: list[str]) -> None:
    print(f"| {name} | {what} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    carry_out(main)
