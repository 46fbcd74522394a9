"""The metrics of a result, one tracker on one sequence, and of many results together."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mien.arrays import Array, Mask
from mien.errors import MienError, warn
from mien.evaluation import metrics
from mien.evaluation.plan import Evaluation, result_path, timing_path
from mien.evaluation.points12 import outer_eye_distance, points_of_names, points_of_scheme
from mien.evaluation.protocols import Comparison, Protocol, compare, protocol_named
from mien.evaluation.results import SequenceResult, Timing
from mien.files import printable
from mien.tracking.state import EXPRESSION_NAMES

_SHARED = {
    "version": "versions of mien",
    "code": "states of mien's code",
    "source": "kinds of first landmarks",
    "focal_px": "focal lengths",
}
"""Settings that all results of one run have alike, and what several of them are."""


@dataclass(frozen=True)
class Score:
    """The metrics of one result under one protocol. `failure` says why there are none."""

    result: SequenceResult
    protocol: Protocol
    lost_deg: float

    @cached_property
    def failure(self) -> str:
        """Why this sequence has no metrics; "" if it has."""
        if self.result.failure or self.result.track is None:
            return self.result.failure or "not run yet"
        if self.result.truth is not None and not self.result.truth.known.any():
            return "the truth gives neither a pose nor a landmark for any frame"
        try:
            compared = self.comparison is not None or self.points is not None
        except MienError as e:
            return str(e)
        compared |= self.result.truth is not None and self.result.truth.expression is not None
        return "" if compared else "truth and track have neither a pose nor the twelve landmarks in common"

    @cached_property
    def comparison(self) -> Comparison | None:
        """Truth and estimate in the protocol's angles; None if there is no true pose, or the tracker gives landmarks
        only."""
        track, truth = self.result.track, self.result.truth
        if track is None or truth is None or not truth.has_pose or track.landmarks_alone:
            return None
        return compare(self.protocol, truth, track.rotation, track.rotation_covariance)

    @property
    def has_pose(self) -> bool:
        """Whether a true pose is known, and the tracker gives one."""
        return self.comparison is not None

    @property
    def frames(self) -> int:
        """Number of frames that have truth."""
        return 0 if self.result.truth is None else int(self.result.truth.known.sum())

    @property
    def lost(self) -> int:
        """Number of those in which the tracker gave no face; where there is no truth, there may be none."""
        track, truth = self.result.track, self.result.truth
        return 0 if track is None or truth is None else int((track.lost & truth.known).sum())

    @property
    def counted(self) -> Mask:
        """(n,) frames whose errors are averaged."""
        return self.compared.counted(self.lost_deg)

    @property
    def error_deg(self) -> Array:
        """(n, 3) errors of tilt, pan and roll."""
        return self.compared.error_deg

    @property
    def mean_errors(self) -> Array:
        """(3,) E_tilt, E_pan, E_roll in degrees."""
        return metrics.mean_absolute_error(self.error_deg, self.counted)

    @cached_property
    def points(self) -> tuple[Array, Array] | None:
        """(n, 12, 2) points of the estimate and of the truth; None if either lacks them."""
        track, truth = self.result.track, self.result.truth
        if track is None or truth is None or truth.landmarks is None:
            return None
        estimate = points_of_names(track.landmarks, track.landmark_names)
        return None if estimate is None else (estimate, points_of_scheme(truth.landmarks, truth.landmark_scheme))

    @property
    def frame_rms_px(self) -> Array | None:
        """(n,) RMS of the twelve points of each frame in pixels."""
        return None if self.points is None else metrics.landmark_rms(*self.points)

    @property
    def frame_rms_without_offset_px(self) -> Array | None:
        """(n,) the same after subtracting each point's offset in the first frame."""
        if self.points is None:
            return None
        return metrics.landmark_rms(metrics.without_offset(*self.points), self.points[1])

    @property
    def eye_distance_px(self) -> float:
        """Distance between the outer corners of the eyes in the first frame that has both, so that it does not change
        as the head turns; NaN if none has."""
        assert self.points is not None
        distance = outer_eye_distance(self.points[1])
        return next((float(d) for d in distance if np.isfinite(d)), math.nan)

    @property
    def expression_moves(self) -> bool | None:
        """Whether the truth contains movements of the tracked expressions; None if it has no expressions."""
        truth = self.result.truth
        if truth is None or truth.expression is None:
            return None
        moves = [metrics.counterpart(u, truth.expression, truth.expression_names) for u in EXPRESSION_NAMES]
        known = (m[np.isfinite(m)] for m in moves if m is not None)
        return any(m.size > 0 and float(np.ptp(m)) > 0.05 for m in known)

    @property
    def unit_correlations(self) -> Array:
        """(7,) correlation of each unit with its counterpart in the truth; NaN if either is constant."""
        track, truth = self.result.track, self.result.truth
        out = np.full(len(EXPRESSION_NAMES), np.nan)
        if track is None or truth is None or truth.expression is None:
            return out
        for i, unit in enumerate(EXPRESSION_NAMES):
            expected = metrics.counterpart(unit, truth.expression, truth.expression_names)
            if expected is not None:
                out[i] = metrics.correlation(track.expression[:, i], expected)
        return out

    @property
    def false_movement(self) -> Array:
        """(7,) largest movement of each unit."""
        assert self.result.track is not None
        return metrics.false_movement(self.result.track.expression)

    @property
    def jitter_deg(self) -> float:
        """Standard deviation of the second difference of the error, mean over the angles."""
        lost = self.compared.lost | ~self.compared.known
        return float(metrics.jitter_deg(self.error_deg, lost).mean())

    @property
    def calibrated(self) -> Mask:
        """(n,) frames for which calibration is evaluated: tracked ones after the first, whose error is zero by
        definition."""
        c = self.compared
        return c.known & ~c.lost & (np.cumsum(c.known) > 1)

    @property
    def confidence(self) -> Array:
        """(n,) probability that the rotation error is below `RIGHT_DEG`; NaN of a tracker that estimates none, and says
        the same 1, or 0, of every frame with a face."""
        track = self.result.track
        assert track is not None
        stated = np.unique(track.confidence[~track.lost])
        return np.full(track.frames, np.nan) if stated.tolist() in ([0.0], [1.0]) else track.confidence

    @property
    def compared(self) -> Comparison:
        assert self.comparison is not None
        return self.comparison


@dataclass(frozen=True)
class Scores:
    """All scores and timings of a results folder."""

    evaluation: Evaluation
    protocol: Protocol
    scores: tuple[Score, ...]
    timings: tuple[Timing, ...]

    @property
    def trackers(self) -> tuple[str, ...]:
        return self.evaluation.trackers

    @property
    def kinds(self) -> tuple[str, ...]:
        return self.evaluation.kinds

    @property
    def warnings(self) -> dict[str, list[SequenceResult]]:
        """What was warned of while the trackers ran, each with the results that it concerns."""
        out: dict[str, list[SequenceResult]] = {}
        for result in (s.result for s in self.scores):
            for warning in result.warnings:
                out.setdefault(warning, []).append(result)
        return out

    def for_tracker(self, tracker: str, kind: str | None = None) -> tuple[Score, ...]:
        """The scores of a tracker that have metrics, for one kind of sequence or all."""
        return tuple(
            s for s in self.scores if s.result.tracker == tracker and kind in (None, s.result.kind) and not s.failure
        )

    def with_pose(self, tracker: str, kind: str | None = None) -> tuple[Score, ...]:
        """Those of them that have a true pose."""
        return tuple(s for s in self.for_tracker(tracker, kind) if s.has_pose)


def load_scores(out: Path, protocol: str | None = None) -> Scores:
    """Load a results folder and score it, by default under the protocol of its evaluation. A damaged file causes a
    warning, and its result has no metrics; results of a run that was stopped beside those of an earlier one cause one
    as well. Figures cannot show names that are not valid UTF-8: they are `printable`.

    Raises MienError if the folder contains no evaluation.
    """
    evaluation = Evaluation.load(out)
    chosen = protocol_named(protocol or evaluation.protocol)
    scores: list[Score] = []
    timings: list[Timing] = []
    for tracker in evaluation.trackers:
        for sequence, kind in zip(evaluation.sequences, evaluation.kinds_of_sequences, strict=True):
            missing = SequenceResult(tracker, evaluation.dataset, sequence, kind, failure="not run yet")
            result = _result(result_path(out, tracker, sequence), missing)
            # A result is kept when the folder that tells the kind has another name.
            result = replace(result, tracker=printable(tracker), sequence=printable(sequence), kind=kind)
            scores.append(Score(result, chosen, evaluation.lost_deg))
            timing = _timing_of(result, timing_path(out, tracker, sequence))
            timings += [] if timing is None else [timing]
    _warn_of_mixture(out, [score.result for score in scores])
    trackers, sequences = (tuple(map(printable, names)) for names in (evaluation.trackers, evaluation.sequences))
    return Scores(replace(evaluation, trackers=trackers, sequences=sequences), chosen, tuple(scores), tuple(timings))


def _warn_of_mixture(out: Path, results: Sequence[SequenceResult]) -> None:
    """Warn of results that were made with different settings, as where a run with others was stopped."""
    for key, several in _SHARED.items():
        if len({r.settings[key] for r in results if key in r.settings and not r.failure}) > 1:
            warn(f"{out} has results of different {several}; run mien evaluate again, which makes the older ones anew")


def _result(path: Path, missing: SequenceResult) -> SequenceResult:
    """Load a result; returns the placeholder `missing` if there is no file, or a damaged one."""
    try:
        return SequenceResult.load(path) if path.exists() else missing
    except MienError as error:
        warn(str(error))
        return replace(missing, failure=str(error))


def _timing_of(result: SequenceResult, path: Path) -> Timing | None:
    """Load the timing of a result, if there is one with the same settings."""
    try:
        timing = Timing.load(path) if path.exists() else None
    except MienError as error:
        warn(str(error))
        return None
    same = timing is not None and dict(timing.settings) == dict(result.settings)
    return timing if same else None


def pooled(scores: Sequence[Score], values: Callable[[Score], NDArray[Any]]) -> NDArray[Any]:
    """Concatenate values over the frames of all sequences."""
    parts = [values(s) for s in scores]
    return np.concatenate(parts) if parts else np.empty(0)


def pooled_errors(scores: Sequence[Score]) -> Array:
    """(3,) E_tilt, E_pan, E_roll over the counted frames of all sequences; NaN if there are none."""
    if not scores:
        return np.full(3, np.nan)
    return metrics.mean_absolute_error(pooled(scores, lambda s: s.error_deg), pooled(scores, lambda s: s.counted))


def aligned_errors(scores: Sequence[Score]) -> Array:
    """(3,) the same after aligning the head axes of each sequence to the true ones."""
    if not scores:
        return np.full(3, np.nan)
    errors = pooled(scores, lambda s: s.compared.aligned_error_deg)
    return metrics.mean_absolute_error(errors, pooled(scores, lambda s: s.counted))


def spread_of_errors(scores: Sequence[Score]) -> Array:
    """(3,) standard deviation of E_tilt, E_pan, E_roll over the sequences with frames that count; NaN if there is only
    one."""
    errors = np.array([e for s in scores if np.isfinite(e := s.mean_errors).all()])
    return errors.std(axis=0, ddof=1) if len(errors) > 1 else np.full(3, np.nan)


def reliability(scores: Sequence[Score]) -> metrics.Reliability:
    """How often the frames of all sequences are right, by their confidence, where that is evaluated."""
    confidence = pooled(scores, lambda s: s.confidence[s.calibrated])
    return metrics.reliability(confidence, pooled(scores, lambda s: s.compared.rotation_error_deg[s.calibrated]))


def success_rate(scores: Sequence[Score], threshold_deg: float) -> float:
    """P_s over the frames of all sequences."""
    if not scores:
        return float("nan")
    squared = pooled(scores, lambda s: s.compared.squared_error)
    return metrics.success_rate(squared, pooled(scores, lambda s: s.compared.known), threshold_deg)
