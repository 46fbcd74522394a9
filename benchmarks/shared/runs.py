"""Rendered sequences as a tracker sees them, and what it makes of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from shared.command_line import print_heads

from mien.arrays import Array
from mien.baselines.mediapipe import MediaPipeTracker
from mien.errors import require
from mien.evaluation.cells import calibration_cells
from mien.evaluation.datasets.sequence import Sequence, Truth
from mien.evaluation.formats import to_markdown
from mien.evaluation.metrics import ANGLE_LEVEL, COVERAGE_LEVELS
from mien.evaluation.plan import Evaluation
from mien.evaluation.protocols import DEFAULT_LOST_DEG, Protocol
from mien.evaluation.results import SequenceResult, TrackTable
from mien.evaluation.scores import Score, Scores, pooled_errors
from mien.evaluation.tables import Table
from mien.frame import Frame
from mien.geometry.rotation import angle_between
from mien.initialization.detector import detect
from mien.initialization.landmarks import Landmarks
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.state import Estimate, Tracker
from mien.video import open_video

BELIEVED, WRONG_DEG = 0.5, 5.0
KINDS = ("uniform", "expression", "light", "occluded", "wide")


@dataclass(frozen=True)
class Run:
    """A sequence as a tracker sees it: some of its frames, their truth, landmarks of the first."""

    sequence: Sequence
    frames: list[Frame]
    truth: Truth
    landmarks: Landmarks


def prepare(sequence: Sequence) -> Run:
    """Decode a sequence and find its face. Raises MienError where there is none."""
    frames = list(open_video(sequence.video))
    faces = detect(frames[0])
    require(bool(faces), f"{sequence.video}: no face was found in the first frame; leave the sequence out")
    return Run(sequence, frames, sequence.read_truth(len(frames)), faces[0])


def thinned(run: Run, step: int) -> Run:
    """Every step-th frame of a run."""
    frames = run.frames[::step]
    rotations, expression = (None if a is None else a[::step] for a in (run.truth.rotations, run.truth.expression))
    truth = replace(run.truth, frames=len(frames), rotations=rotations, expression=expression, landmarks=None)
    return replace(run, frames=frames, truth=truth)


def track(tracker: Tracker, run: Run) -> list[Estimate]:
    """A new tracker's estimates of every frame."""
    first = run.frames[0]
    begun = tracker.initialize(first, run.landmarks, run.sequence.camera_for(first.width, first.height))
    return [begun, *(tracker.track(frame) for frame in run.frames[1:])]


def rotations_of(estimates: list[Estimate]) -> Array:
    """Rotations (n, 3, 3) of estimates, NaN where the face is lost."""
    return np.array([np.full((3, 3), np.nan) if e.rotation is None else e.rotation for e in estimates])


def score(make: Callable[[], RealtimeTracker], run: Run, name: str = "") -> Score:
    """What a tracker, by this name in the tables, makes of a run."""
    return scored(track(make(), run), run, name)


def scored(estimates: list[Estimate], run: Run, name: str = "") -> Score:
    """Estimates of every frame of a run beside its truth."""
    sequence, table = run.sequence, TrackTable.from_estimates(estimates)
    result = SequenceResult(name, "rendered", sequence.name, sequence.kind, track=table, truth=run.truth)
    return Score(result, Protocol.REBASED, DEFAULT_LOST_DEG)


def wrong_share(estimates: list[Estimate], run: Run) -> float:
    """Share of the estimates that are believed, at a confidence above `BELIEVED`, and off by more than `WRONG_DEG`."""
    R, true = rotations_of(estimates), run.truth.rotations
    assert true is not None, "a rendered sequence has rotations"
    wrong = np.degrees(angle_between(R[0].T @ R, true[0].T @ true)) > WRONG_DEG  # never of NaN, where it is lost
    return float(np.mean(wrong & (np.array([e.confidence for e in estimates]) > BELIEVED)))


def landmarks_of(run: Run) -> Array:
    """True landmarks (n, k, 2) of a run. Raises MienError where there are none."""
    landmarks = run.truth.landmarks
    require(landmarks is not None, f"{run.sequence.video}: no landmarks are known; leave the sequence out")
    return np.asarray(landmarks)


def cells_of(scores: tuple[Score, ...], wrong: tuple[float, ...], intervals: bool) -> str:
    """Cells of a Markdown row on a tracker: mean error, share of the errors in the 90 per cent intervals, empty unless
    it has `intervals`, lost frames, and the mean of `wrong`, see `wrong_share`, in thousandths."""
    error, lost = pooled_errors(scores).mean(), sum(score.lost for score in scores)
    held = calibration_cells(scores)[COVERAGE_LEVELS.index(ANGLE_LEVEL)] if intervals else ""
    return f"{error:.2f} | {held} | {lost} | {1000 * np.mean(wrong):.0f}"


def judged(run: Run) -> Iterator[tuple[str, Score, float]]:
    """The name of each of TRACKERS, the score of what it makes of a run, and the share of believed wrong frames."""
    for name, new in TRACKERS.items():
        estimates = track(new(), run)
        yield name, scored(estimates, run, name), wrong_share(estimates, run)


def print_judged(labels: tuple[str, ...], made: list[tuple[tuple[str, ...], Score, float]]) -> None:
    """A Markdown table with a row for all that has the same labels, of which the last is the tracker. made: labels,
    score and share of believed wrong frames of each run."""
    print_heads(*labels, "error", "90 %", "lost", "believed and wrong")
    for same in dict.fromkeys(row[0] for row in made):
        scores, wrong = zip(*[row[1:] for row in made if row[0] == same], strict=True)
        print(f"| {' | '.join(same)} | {cells_of(scores, wrong, same[-1] == 'realtime')} |")


def print_tables(scores: Iterable[Score], tables: Iterable[Callable[[Scores], Table]]) -> None:
    """Tables of `mien report` for what trackers made of runs, as Markdown."""
    scores = tuple(scores)
    trackers = tuple(dict.fromkeys(s.result.tracker for s in scores))
    names, kinds = zip(*dict.fromkeys((s.result.sequence, s.result.kind) for s in scores), strict=True)
    protocol = Protocol.REBASED
    evaluation = Evaluation("rendered", protocol.value, "detected", DEFAULT_LOST_DEG, trackers, names, kinds, "")
    for table in tables:
        print(to_markdown(replace(table(Scores(evaluation, protocol, scores, ())), protocol=protocol.value)))


def begun_at(run: Run, first: int) -> Run | None:
    """A run from one of its frames to the end, and from there backwards; None where there is no such frame, or no face
    is found in it."""
    end = len(run.frames)
    landmarks = detect(run.frames[first]) if first < end else []
    if not landmarks or run.truth.rotations is None:
        return None
    order = [*range(first, end), *reversed(range(end - 1))]
    truth = replace(run.truth, frames=len(order), rotations=run.truth.rotations[order], expression=None, landmarks=None)
    return replace(run, frames=[run.frames[k] for k in order], truth=truth, landmarks=landmarks[0])


TRACKERS: dict[str, type[Tracker]] = {"realtime": RealtimeTracker, "MediaPipe": MediaPipeTracker}
