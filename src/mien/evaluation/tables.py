"""The tables of a report: one protocol each, with published rows marked as such."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from mien.arrays import Array
from mien.evaluation import metrics
from mien.evaluation.cells import (
    NONE,
    calibration_cells,
    coverage_of_buft,
    done_of,
    listed,
    lost_of,
    mean,
    number,
    percent,
    sequences_of,
    sum_of,
    table_1_cells,
)
from mien.evaluation.protocols import ANGLE_NAMES, Protocol
from mien.evaluation.published import AS_PRINTED, REBASED_REFERENCES, TABLE_1
from mien.evaluation.scores import (
    Score,
    Scores,
    aligned_errors,
    pooled,
    pooled_errors,
    success_rate,
)
from mien.tracking.state import EXPRESSION_NAMES


@dataclass(frozen=True)
class Table:
    """Column names and rows of text cells; note: explains how to read them; protocol: that of all cells."""

    name: str
    title: str
    note: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    protocol: str = ""

    @property
    def caption(self) -> str:
        """The protocol and the note."""
        return f"Protocol: {self.protocol}. {self.note}" if self.protocol else self.note

    @property
    def transposed(self) -> Table:
        """The same table with a row for each column."""
        columns, *rows = zip(self.columns, *self.rows, strict=True)
        return replace(self, columns=columns, rows=tuple(rows))


def all_tables(scores: Scores) -> tuple[Table, ...]:
    """All tables for which there are results, in the order of a report."""
    tables = [
        warnings(scores),
        published_and_measured(scores),
        by_kind(scores),
        angles_by_kind(scores),
        landmarks(scores),
        animation(scores),
        false_movements(scores),
        calibration(scores),
        jitter(scores),
        cost(scores),
        sequences(scores),
        failures(scores),
    ]
    return tuple(replace(t, protocol=scores.protocol.value) for t in tables if t is not None and t.rows)


def warnings(scores: Scores) -> Table:
    """What was warned of while the trackers ran."""
    rows = [
        (listed(r.tracker for r in concerned), listed(r.sequence for r in concerned), warning)
        for warning, concerned in scores.warnings.items()
    ]
    return Table(
        "warnings",
        "Warnings",
        "The numbers below include these sequences.",
        ("trackers", "sequences", "warning"),
        tuple(rows),
    )


def published_and_measured(scores: Scores) -> Table | None:
    """Table 1 of the paper, or the numbers published for `rebased`, and those measured here."""
    if not any(scores.with_pose(t) for t in scores.trackers):
        return None
    rows: list[tuple[str, ...]] = []
    if scores.protocol is Protocol.PAPER:
        rows += [(name, "published: BUFT uniform-light, 45 sequences", *cells) for name, *cells in TABLE_1]
    if scores.protocol is Protocol.REBASED:
        rows += [(name, "published: BUFT, 45 sequences", NONE, *cells) for name, *cells in REBASED_REFERENCES]
    rows += [
        (
            tracker,
            f"measured here: {' '.join(dict.fromkeys((scores.evaluation.dataset, kind)))}, {sequences_of(chosen)}",
            *table_1_cells(chosen, scores.evaluation.lost_deg),
        )
        for tracker, kind, chosen in _by_kind(scores, lambda s: s.has_pose)
    ]
    threshold = f"P_s counts frames whose e_i is at most ({scores.evaluation.lost_deg:g} degrees)². "
    of_paper, remark = "E is over all frames. ", ""
    if scores.protocol is Protocol.PAPER:
        of_paper, remark = "E is over these frames. ", AS_PRINTED
    return Table(
        "table1",
        "Published and measured",
        f"{threshold}{of_paper}± is the standard deviation over sequences. "
        f"Rows of different data sets are not comparable. {remark}{coverage_of_buft(scores)}".strip(),
        ("approach", "source", "P_s (%)", "E_pan (°)", "E_tilt (°)", "E_roll (°)", "E_m (°)"),
        tuple(rows),
    )


def by_kind(scores: Scores) -> Table:
    """Mean of the three mean absolute errors, for each kind of sequence, and the lost frames of all."""
    rows = []
    for tracker in scores.trackers:
        if chosen := scores.with_pose(tracker):
            errors = (number(float(pooled_errors(scores.with_pose(tracker, kind)).mean())) for kind in scores.kinds)
            rows.append((tracker, *errors, lost_of(chosen), done_of(scores, tracker)))
    return Table(
        "kinds",
        "Rotation error in degrees by kind of sequence",
        "Mean of the mean absolute errors of tilt, pan and roll. Lost frames are counted among those with truth.",
        ("tracker", *scores.kinds, "lost frames", "sequences"),
        tuple(rows),
    )


def angles_by_kind(scores: Scores) -> Table:
    """Errors of each angle, lost frames and P_s, for each kind."""
    rows = []
    for tracker, kind, chosen in _by_kind(scores, lambda s: s.has_pose):
        tilt, pan, roll = pooled_errors(chosen)
        p_s = success_rate(chosen, scores.evaluation.lost_deg)
        aligned = float(aligned_errors(chosen).mean()) if scores.protocol.in_head_axes else math.nan
        cells = [number(v) for v in (tilt, pan, roll, (tilt + pan + roll) / 3, aligned)]
        rows.append((tracker, kind, str(len(chosen)), lost_of(chosen), percent(p_s), *cells))
    angles = ("tilt (°)", "pan (°)", "roll (°)", "mean (°)", "axes aligned (°)")
    return Table(
        "angles",
        "Errors of each angle",
        "A lost frame is one with truth in which the tracker gave no face. No tracker can know the axes of a head "
        "exactly: `axes aligned` is the mean after aligning the head axes of each sequence to the true ones as well as "
        "its rotations allow.",
        ("tracker", "kind", "sequences", "lost frames", "P_s (%)", *angles),
        tuple(rows),
    )


def landmarks(scores: Scores) -> Table:
    """RMS error of the twelve points."""
    rows = []
    for tracker, kind, chosen in _by_kind(scores, lambda s: s.points is not None):
        raw = metrics.root_mean_square(pooled(chosen, lambda s: _array(s.frame_rms_px)))
        free = metrics.root_mean_square(pooled(chosen, lambda s: _array(s.frame_rms_without_offset_px)))
        share = pooled(chosen, lambda s: _array(s.frame_rms_px) / s.eye_distance_px)
        rows.append((tracker, kind, number(raw), number(free), percent(metrics.root_mean_square(share))))
    return Table(
        "landmarks",
        "Landmarks: RMS of the twelve points of Fig. 3",
        "Over the frames in which the tracker has a face; the angles hold the last rotation in the others. "
        "`raw` compares the points as they are. `without offset` subtracts each point's offset from the annotation in "
        "the first frame, because a tracker's points and the annotator's are not defined identically. "
        "`normalised` is the raw RMS over the distance between the outer corners of the eyes in the first frame.",
        ("tracker", "kind", "raw (px)", "without offset (px)", "normalised (%)"),
        tuple(rows),
    )


def animation(scores: Scores) -> Table:
    """Correlation of each animation unit with its counterpart, for each kind of sequence."""
    rows = []
    for tracker, kind, chosen in _by_kind(scores, lambda s: bool(s.expression_moves)):
        values = np.array([s.unit_correlations for s in chosen])
        if np.isfinite(values).any():
            rows.append((tracker, kind, *(number(mean(unit)) for unit in values.T)))
    return Table(
        "animation",
        "Animation: correlation with the truth",
        "Mean over sequences. The counterparts in ARKit's shapes, left and right averaged: "
        + "; ".join(f"{unit} = {sum_of(shapes)}" for unit, shapes in metrics.UNIT_COUNTERPARTS.items())
        + ".",
        ("tracker", "kind", *EXPRESSION_NAMES),
        tuple(rows),
    )


def false_movements(scores: Scores) -> Table:
    """Largest movement of each animation unit in sequences without expression."""
    rows = []
    for tracker, kind, chosen in _by_kind(scores, lambda s: s.expression_moves is False):
        values = np.array([s.false_movement for s in chosen])
        if np.isfinite(values).any():
            largest = np.where(np.isnan(values), -np.inf, values).max(axis=0)
            rows.append((tracker, kind, *(number(v) for v in largest)))
    return Table(
        "false-movement",
        "Animation: false movement under pose alone",
        "Largest deviation of a unit from its value in the first frame, over all sequences without expression.",
        ("tracker", "kind", *EXPRESSION_NAMES),
        tuple(rows),
    )


def calibration(scores: Scores) -> Table:
    """Coverage of the intervals, normalised squared error, and calibration error of the confidence."""
    by_kind = _by_kind(scores, lambda s: s.has_pose)
    rows = [(tracker, kind, *calibration_cells(chosen)) for tracker, kind, chosen in by_kind]
    levels = tuple(f"{level:.0%} interval (%)" for level in metrics.COVERAGE_LEVELS)
    angles = tuple(f"{metrics.ANGLE_LEVEL:.0%} of {angle} (%)" for angle in ANGLE_NAMES)
    return Table(
        "calibration",
        "Calibration",
        "Fraction of the errors of the three angles inside the tracker's own intervals. "
        "The normalised squared error is 1 if the covariance is right, and more if it is too small. "
        "The gap is the mean difference between the confidence and the fraction of frames with an error below "
        f"{metrics.RIGHT_DEG:g} degrees; a tracker whose confidence is 1 in every frame with a face estimates none. "
        "Over tracked frames after the first.",
        ("tracker", "kind", *levels, *angles, "error² / variance", "gap of confidence (%)"),
        tuple(rows),
    )


def jitter(scores: Scores) -> Table:
    """Standard deviation of the second difference of the error."""
    rows = []
    for tracker in scores.trackers:
        if scores.with_pose(tracker):
            jitters = (np.array([s.jitter_deg for s in scores.with_pose(tracker, kind)]) for kind in scores.kinds)
            rows.append((tracker, *(number(mean(of_kind), 3) for of_kind in jitters)))
    return Table(
        "jitter",
        "Jitter",
        "Standard deviation of the second difference of the error in degrees, mean over angles and sequences.",
        ("tracker", *scores.kinds),
        tuple(rows),
    )


def cost(scores: Scores) -> Table:
    """Time and memory, from separate runs."""
    rows = []
    for t in scores.timings:
        ms = 1000 * np.array(t.frame_seconds)
        cells = [f"{t.frames_per_second:.1f}", f"{np.median(ms):.2f}", f"{np.percentile(ms, 99):.2f}"]
        cells += [f"{t.training_seconds:.2f}", number(t.peak_mb, 0), f"{t.busy_cores:.1f}"]
        rows.append((t.tracker, t.sequence, *cells))
    return Table(
        "cost",
        "Cost",
        "Without decoding, after a warm-up, with nothing else of this evaluation running. Training is the first "
        "frame. "
        "Memory is the peak of the whole process, including interpreter and libraries. "
        "`cores busy` is the processor time of all its threads over the time that the other frames took.",
        (
            "tracker",
            "sequence",
            "frames/s",
            "median (ms)",
            "99th percentile (ms)",
            "training (s)",
            "memory (MB)",
            "cores busy",
        ),
        tuple(rows),
    )


def sequences(scores: Scores) -> Table:
    """The results of each sequence."""
    rows = []
    for s in scores.scores:
        if not s.failure:
            pose = [number(v) for v in (*s.mean_errors, s.mean_errors.mean())] if s.comparison else [NONE] * 4
            rms = s.frame_rms_px
            points = NONE if rms is None else number(metrics.root_mean_square(rms))
            r = s.result
            rows.append((r.tracker, r.sequence, r.kind, str(s.frames), str(s.lost), *pose, points))
    return Table(
        "sequences",
        "Every sequence",
        "Frames are those with truth. Errors are in degrees, the RMS of the twelve points in pixels.",
        ("tracker", "sequence", "kind", "frames", "lost", *ANGLE_NAMES, "mean", "RMS"),
        tuple(rows),
    )


def failures(scores: Scores) -> Table:
    """The sequences without results, and why; once where trackers share the reason, as a truth that cannot be read."""
    trackers: dict[tuple[str, str, str], list[str]] = {}
    for score in scores.scores:
        if score.failure:
            cause = score.result.sequence, score.result.kind, score.failure
            trackers.setdefault(cause, []).append(score.result.tracker)
    rows = [(", ".join(names), *cause) for cause, names in trackers.items()]
    return Table(
        "failures",
        "Sequences without results",
        "They are excluded from all means above.",
        ("tracker", "sequence", "kind", "reason"),
        tuple(rows),
    )


def _by_kind(scores: Scores, wanted: Callable[[Score], bool]) -> Iterator[tuple[str, str, list[Score]]]:
    """Each tracker with each kind of sequence, and the scores that are wanted of these, where there are any."""
    for tracker in scores.trackers:
        for kind in scores.kinds:
            chosen = [s for s in scores.for_tracker(tracker, kind) if wanted(s)]
            if chosen:
                yield tracker, kind, chosen


def _array(values: Array | None) -> Array:
    assert values is not None
    return values
