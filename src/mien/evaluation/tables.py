"""The tables of a report: each one protocol, published rows marked as such."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mien.evaluation import metrics
from mien.evaluation.datasets import buft
from mien.evaluation.protocols import Protocol
from mien.evaluation.published import REBASED_REFERENCES, TABLE_1
from mien.evaluation.scores import (
    Score,
    Scores,
    aligned_errors,
    pooled,
    pooled_errors,
    spread_of_errors,
    success_rate,
)
from mien.geometry.rotation import Array
from mien.tracking.state import EXPRESSION_NAMES

NONE = "—"


@dataclass(frozen=True)
class Table:
    """Cells as text under their heads; note: what one must know to read them; protocol: the one of all of
    them.
    """

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


def all_tables(scores: Scores) -> tuple[Table, ...]:
    """Every table that these results fill, in the order of a report."""
    tables = [
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


def published_and_measured(scores: Scores) -> Table | None:
    """Table 1 of the paper, or the figures published for `rebased`, and what was measured here."""
    if not any(scores.posed(t) for t in scores.trackers):
        return None
    rows: list[tuple[str, ...]] = []
    if scores.protocol is Protocol.PAPER:
        rows += [(name, "published: BUFT uniform-light, 45 sequences", *cells) for name, *cells in TABLE_1]
    if scores.protocol is Protocol.REBASED:
        rows += [(name, "published: BUFT, 45 sequences", NONE, *cells) for name, *cells in REBASED_REFERENCES]
    rows += [
        (t, f"measured here: {scores.evaluation.dataset} {k}, {_sequences(chosen)}", *_table_1_cells(scores, chosen))
        for t in scores.trackers
        for k in scores.kinds
        if (chosen := scores.posed(t, k))
    ]
    threshold = f"P_s counts frames whose e_i is at most ({scores.evaluation.lost_deg:g} degrees)². "
    of_paper = "E is over these frames. " if scores.protocol is Protocol.PAPER else "E is over all frames. "
    return Table(
        "table1",
        "Published and measured",
        f"{threshold}{of_paper}± is the standard deviation over sequences. "
        f"Rows of different data sets do not compare. {coverage_of_buft(scores)}".strip(),
        ("approach", "source", "P_s (%)", "E_pan (°)", "E_tilt (°)", "E_roll (°)", "E_m (°)"),
        tuple(rows),
    )


def by_kind(scores: Scores) -> Table:
    """Mean of the three mean absolute errors of each kind of sequence."""
    rows = [
        (t, *(_number(float(pooled_errors(scores.posed(t, k)).mean())) for k in scores.kinds), _done(scores, t))
        for t in scores.trackers
        if scores.posed(t)
    ]
    return Table(
        "kinds",
        "Rotation error by kind of sequence",
        "Mean of the mean absolute errors of tilt, pan and roll, degrees.",
        ("tracker", *scores.kinds, "sequences"),
        tuple(rows),
    )


def angles_by_kind(scores: Scores) -> Table:
    """Errors of each angle, lost frames and P_s, for each kind."""
    rows = []
    for tracker in scores.trackers:
        for kind in scores.kinds:
            chosen = scores.posed(tracker, kind)
            if chosen:
                tilt, pan, roll = pooled_errors(chosen)
                lost, frames = sum(s.lost for s in chosen), sum(s.frames for s in chosen)
                p_s = success_rate(chosen, scores.evaluation.lost_deg)
                aligned = float(aligned_errors(chosen).mean()) if scores.protocol.in_head_axes else math.nan
                cells = [_number(v) for v in (tilt, pan, roll, (tilt + pan + roll) / 3, aligned)]
                rows.append((tracker, kind, str(len(chosen)), f"{lost} of {frames}", _percent(p_s), *cells))
    angles = ("tilt (°)", "pan (°)", "roll (°)", "mean (°)", "axes aligned (°)")
    return Table(
        "angles",
        "Errors of each angle",
        "A lost frame is one in which the tracker gave no face. Which way a head looks no tracker can know exactly: "
        "`axes aligned` is the mean with the head's axes of every sequence turned as near to the true ones as the "
        "rotations show them.",
        ("tracker", "kind", "sequences", "lost frames", "P_s (%)", *angles),
        tuple(rows),
    )


def landmarks(scores: Scores) -> Table:
    """RMS of the twelve points."""
    rows = []
    for tracker in scores.trackers:
        for kind in scores.kinds:
            chosen = [s for s in scores.of(tracker, kind) if s.points is not None]
            if chosen:
                raw = metrics.root_mean_square(pooled(chosen, lambda s: _array(s.frame_rms_px)))
                free = metrics.root_mean_square(pooled(chosen, lambda s: _array(s.frame_rms_without_offset_px)))
                share = pooled(chosen, lambda s: _array(s.frame_rms_px) / s.eye_distance_px)
                rows.append((tracker, kind, _number(raw), _number(free), _percent(metrics.root_mean_square(share))))
    return Table(
        "landmarks",
        "Landmarks: RMS of the twelve points of Fig. 3",
        "`raw` compares the points as they are. `without offset` takes off the distance that each point has from the "
        "annotation in the first frame, because a tracker's points and the annotator's are not defined alike. "
        "`normalised` is the raw RMS over the distance of the outer corners of the eyes in the first frame.",
        ("tracker", "kind", "raw (px)", "without offset (px)", "normalised (%)"),
        tuple(rows),
    )


def animation(scores: Scores) -> Table:
    """Correlation of each unit with its counterpart, by kind."""
    rows = []
    for tracker in scores.trackers:
        for kind in scores.kinds:
            chosen = [s for s in scores.of(tracker, kind) if s.expression_moves]
            values = np.array([s.unit_correlations for s in chosen])
            if len(chosen) and np.isfinite(values).any():
                cells = [_number(_mean(values[:, i])) for i in range(len(EXPRESSION_NAMES))]
                rows.append((tracker, kind, *cells))
    return Table(
        "animation",
        "Animation: correlation with the truth",
        "Mean over sequences. The counterparts in ARKit's shapes, left and right averaged: "
        + "; ".join(f"{unit} = {_sum(shapes)}" for unit, shapes in metrics.UNIT_COUNTERPARTS.items())
        + ".",
        ("tracker", "kind", *EXPRESSION_NAMES),
        tuple(rows),
    )


def false_movements(scores: Scores) -> Table:
    """Largest movement of each unit in sequences of pose alone."""
    rows = []
    for tracker in scores.trackers:
        for kind in scores.kinds:
            chosen = [s for s in scores.of(tracker, kind) if s.expression_moves is False]
            values = np.array([s.false_movement for s in chosen])
            if len(chosen) and np.isfinite(values).any():
                largest = np.where(np.isnan(values), -np.inf, values).max(axis=0)
                rows.append((tracker, kind, *(_number(v) for v in largest)))
    return Table(
        "false-movement",
        "Animation: false movement under pose alone",
        "Largest distance of a unit from its value in the first frame, over all sequences without expression.",
        ("tracker", "kind", *EXPRESSION_NAMES),
        tuple(rows),
    )


def calibration(scores: Scores) -> Table:
    """Coverage of the intervals, normalised error squared, and the gap of the confidence."""
    rows = []
    for tracker in scores.trackers:
        for kind in scores.kinds:
            chosen = scores.posed(tracker, kind)
            if chosen:
                rows.append((tracker, kind, *_calibration_cells(chosen)))
    levels = tuple(f"{level:.0%} interval (%)" for level in metrics.COVERAGE_LEVELS)
    angles = tuple(f"{metrics.ANGLE_LEVEL:.0%} of {angle} (%)" for angle in ("tilt", "pan", "roll"))
    return Table(
        "calibration",
        "Calibration",
        "Share of the errors of the three angles inside the tracker's own intervals. "
        "The normalised error squared is 1 where the covariance is right and more where it is too small. "
        "The gap is the mean distance of the confidence from the share of frames with an error below "
        f"{metrics.RIGHT_DEG:g} degrees. Tracked frames after the first.",
        ("tracker", "kind", *levels, *angles, "error² / variance", "gap of confidence (%)"),
        tuple(rows),
    )


def jitter(scores: Scores) -> Table:
    """Deviation of the second difference of the error."""
    rows = [
        (t, *(_number(_mean(np.array([s.jitter_deg for s in scores.posed(t, k)])), 3) for k in scores.kinds))
        for t in scores.trackers
        if scores.posed(t)
    ]
    return Table(
        "jitter",
        "Jitter",
        "Standard deviation of the second difference of the error, degrees, mean of the angles and sequences.",
        ("tracker", *scores.kinds),
        tuple(rows),
    )


def cost(scores: Scores) -> Table:
    """Time and memory, from runs of their own."""
    rows = []
    for t in scores.timings:
        ms = 1000 * np.array(t.frame_seconds)
        cells = [f"{t.frames_per_second:.1f}", f"{np.median(ms):.2f}", f"{np.percentile(ms, 99):.2f}"]
        rows.append((t.tracker, t.sequence, *cells, f"{t.training_seconds:.2f}", f"{t.peak_mb:.0f}", t.threads))
    return Table(
        "cost",
        "Cost",
        "Without decoding, after a warm-up, nothing beside it from this evaluation. Training is the first "
        "frame. "
        "Memory is the peak of the whole process, interpreter and libraries included.",
        (
            "tracker",
            "sequence",
            "frames/s",
            "median (ms)",
            "99th percentile (ms)",
            "training (s)",
            "memory (MB)",
            "threads",
        ),
        tuple(rows),
    )


def sequences(scores: Scores) -> Table:
    """Every sequence on its own."""
    rows = []
    for s in scores.scores:
        if not s.failure:
            pose = [_number(v) for v in (*s.mean_errors, s.mean_errors.mean())] if s.comparison else [NONE] * 4
            rms = s.frame_rms_px
            points = NONE if rms is None else _number(metrics.root_mean_square(rms))
            r = s.result
            rows.append((r.tracker, r.sequence, r.kind, str(s.frames), str(s.lost), *pose, points))
    return Table(
        "sequences",
        "Every sequence",
        "The errors are degrees, the RMS of the twelve points pixels.",
        ("tracker", "sequence", "kind", "frames", "lost", "tilt", "pan", "roll", "mean", "RMS"),
        tuple(rows),
    )


def failures(scores: Scores) -> Table:
    """The sequences that have no figures, and why."""
    rows = [(s.result.tracker, s.result.sequence, s.result.kind, s.failure) for s in scores.scores if s.failure]
    return Table(
        "failures",
        "Sequences without figures",
        "They are in no mean above.",
        ("tracker", "sequence", "kind", "reason"),
        tuple(rows),
    )


def _sequences(chosen: Sequence[Score]) -> str:
    return f"{len(chosen)} sequence{'s' if len(chosen) != 1 else ''}"


def _table_1_cells(scores: Scores, chosen: Sequence[Score]) -> tuple[str, ...]:
    tilt, pan, roll = pooled_errors(chosen)
    sd_tilt, sd_pan, sd_roll = spread_of_errors(chosen)
    angles = [_with_spread(v, sd) for v, sd in ((pan, sd_pan), (tilt, sd_tilt), (roll, sd_roll))]
    p_s = _percent(success_rate(chosen, scores.evaluation.lost_deg))
    return p_s, *angles, _number((pan + tilt + roll) / 3)


def _calibration_cells(chosen: Sequence[Score]) -> tuple[str, ...]:
    error = pooled(chosen, lambda s: s.error_deg[s.calibrated])
    sd = pooled(chosen, lambda s: s.compared.sd_deg[s.calibrated])
    covariance = pooled(chosen, lambda s: s.compared.covariance_deg2[s.calibrated])
    confidence = pooled(chosen, lambda s: s.confidence[s.calibrated])
    rotation_error = pooled(chosen, lambda s: s.compared.rotation_error_deg[s.calibrated])
    nees = metrics.normalised_error_squared(error, covariance)
    return (
        *(_percent(metrics.coverage(error, sd, level)) for level in metrics.COVERAGE_LEVELS),
        *(_percent(metrics.coverage(error[:, k], sd[:, k], metrics.ANGLE_LEVEL)) for k in range(3)),
        _number(_mean(nees)),
        _percent(metrics.reliability(confidence, rotation_error).gap),
    )


def coverage_of_buft(scores: Scores) -> str:
    """Which of the 45 sequences are there."""
    if scores.evaluation.dataset != "buft":
        return ""
    e = scores.evaluation
    named = zip(e.sequences, e.kinds_of_sequences, strict=True)
    names = tuple(name for name, kind in named if kind == buft.UNIFORM)
    absent = buft.missing(names)
    present = [n for n in buft.COMPLETE if n in names]
    if not absent:
        return "All 45 sequences of the uniform-light set are there."
    return f"Of the 45 sequences of the uniform-light set {len(present)} are there: {', '.join(present) or 'none'}."


def _done(scores: Scores, tracker: str) -> str:
    return f"{len(scores.posed(tracker))} of {len(scores.evaluation.sequences)}"


def _array(values: Array | None) -> Array:
    assert values is not None
    return values


def _mean(values: Array) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if len(finite) else float("nan")


def _number(value: float, digits: int = 2) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else NONE


def _percent(share: float) -> str:
    return f"{100 * share:.1f}" if np.isfinite(share) else NONE


def _with_spread(value: float, sd: float) -> str:
    return f"{_number(value)} ± {_number(sd)}" if np.isfinite(sd) else _number(value)


def _sum(shapes: Mapping[str, float]) -> str:
    text = " ".join(f"{'+' if sign > 0 else '-'} {name}" for name, sign in shapes.items())
    return text.removeprefix("+ ")
