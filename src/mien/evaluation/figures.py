"""The figures of a report, drawn from result files only."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import cycle
from pathlib import Path

import cv2
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from numpy.typing import NDArray

from mien.arrays import Array
from mien.evaluation import metrics
from mien.evaluation.contact_sheet import contact_sheet
from mien.evaluation.plan import file_name
from mien.evaluation.protocols import ANGLE_NAMES, rotation_of
from mien.evaluation.scores import Score, Scores, pooled, reliability
from mien.files import whole_file
from mien.output.plots import NORMAL_90

_FEW = 5
"""Largest number of trackers for which a figure has room for more than one line each."""
COLOURS = (
    "#2b62ad", "#c44536", "#2e7d4f", "#c9861a", "#7b4fa3", "#3a9bb0",
    "#8a5a44", "#555555", "#d36fa8", "#8c9a2b", "#1b1b1b", "#7fb2e5",
)  # fmt: skip
TRUTH_COLOUR = "#222222"
_ENTRY_INCHES, _LETTER_INCHES, _ROW_INCHES = 0.72, 0.08, 0.22
"""Space in a legend for an entry without its text, for a letter, and for a row of entries."""
_GAP = 3
"""How many times the usual distance of frames with truth is a gap in a line."""
_RARE = 20
"""Number of frames of a confidence below which a share of them says little."""
_BIN_DEG = 5.0
"""Width of the bins of the angle of the head."""
PANELS = 24
"""Number of sequences per page in figures with a panel for each."""


def save_figures(scores: Scores, folder: Path) -> dict[str, Path]:
    """Draw all figures for which there are results; returns title -> file."""
    angles, points = _pages(scores, _with_pose), _pages(scores, _with_points)
    makers: list[tuple[str, str, list[Figure]]] = [
        (
            "angles",
            "Angles against truth, with the 90 per cent interval",
            [angles_over_time(scores, p) for p in angles],
        ),
        (
            "landmarks",
            "RMS of the twelve points against the frame (Fig. 4)",
            [landmark_rms_over_time(scores, p) for p in points],
        ),
    ]
    if angles:
        diagrams = {tracker: reliability(scores.with_pose(tracker)) for tracker in scores.trackers}
        makers += [
            ("head-angle", "Rotation error against the angle of the head", [error_against_head_angle(scores)]),
            ("success", "P_s against the threshold", [success_against_threshold(scores)]),
        ]
        if any(diagram.count.any() for diagram in diagrams.values()):
            makers.append(("reliability", "Reliability of the confidence", [reliability_diagram(diagrams)]))
    out = {}
    for name, title, figures in makers:
        for page, figure in enumerate(figures, 1):
            ending = f" ({page} of {len(figures)})" if len(figures) > 1 else ""
            number = f"-{page}" if len(figures) > 1 else ""
            out[title + ending] = _save(figure, folder / f"{name}{number}.png")
    for tracker in scores.trackers:
        sheet = contact_sheet(scores.for_tracker(tracker))
        if sheet is not None:
            file = folder / f"worst-{file_name(tracker)}.jpg"
            with whole_file(file) as temporary:
                temporary.write_bytes(cv2.imencode(".jpg", sheet, [cv2.IMWRITE_JPEG_QUALITY, 88])[1].tobytes())
            out[f"The worst frames of {tracker}: its landmarks in green, the truth in red"] = file
    return out


def angles_over_time(scores: Scores, names: Sequence[str]) -> Figure:
    """For each of these sequences, the angles of truth and trackers, with the interval if there is one."""
    figure = _figure(11, 1.9 * len(names))
    axes, colours = figure.subplots(len(names), 3, squeeze=False, sharex="row"), _colours(scores)
    for row, name in zip(axes, names, strict=True):
        for k, axis in enumerate(row):
            for i, score in enumerate(_with_pose(scores, name)):
                _plot_angle(axis, score, k, colours[score.result.tracker])
                if i == 0:
                    known = np.flatnonzero(score.compared.known)
                    frames, truth = with_gaps(known, score.compared.truth_deg[known, k])
                    axis.plot(frames, truth, color=TRUTH_COLOUR, linewidth=1.2, linestyle="--")
            _tidy(axis)
        row[0].set_ylabel(f"{name}\ndegrees", fontsize=8)
    for k, name in enumerate(ANGLE_NAMES):
        axes[0, k].set_title(name, fontsize=10)
        axes[-1, k].set_xlabel("frame")
    entries = _entries(scores, [score for name in names for score in _with_pose(scores, name)])
    _legend(figure, [*entries, Line2D([], [], color=TRUTH_COLOUR, linestyle="--", label="truth")])
    return figure


def landmark_rms_over_time(scores: Scores, names: Sequence[str]) -> Figure:
    """Fig. 4 of the paper: a panel for each of these sequences."""
    columns = 3 if len(names) > 2 else 1
    figure = _figure(11, 2.0 * -(-len(names) // columns) + 0.6)
    axes = figure.subplots(-(-len(names) // columns), columns, squeeze=False).ravel()
    for axis, name in zip(axes, names, strict=False):
        for score in _with_points(scores, name):
            annotated, rms = with_gaps(*_annotated_rms(score))
            axis.plot(annotated, rms, color=_colours(scores)[score.result.tracker], linewidth=1.0)
        axis.set_title(name, fontsize=9)
        axis.set_ylim(bottom=0)
        _tidy(axis)
    for axis in axes[len(names) :]:
        axis.set_visible(False)
    for axis in axes[max(0, len(names) - columns) : len(names)]:
        axis.set_xlabel("frame")
    for axis in axes[: len(names) : columns]:
        axis.set_ylabel("RMS (px)")
    _legend(figure, _entries(scores, [score for name in names for score in _with_points(scores, name)]))
    return figure


def error_against_head_angle(scores: Scores) -> Figure:
    """Median rotation error, binned by the true rotation of the head; with few trackers, also the 90th percentile."""
    figure = _figure(7, 4)
    axis = figure.subplots()
    few = len(scores.trackers) <= _FEW
    for tracker, colour in _colours(scores).items():
        chosen = scores.with_pose(tracker)
        if chosen:
            turned = pooled(chosen, lambda s: _head_angle_deg(s)[s.compared.known])
            error = pooled(chosen, lambda s: s.compared.rotation_error_deg[s.compared.known])
            centres, median, high = _binned(turned, error)
            axis.plot(centres, median, color=colour, marker="o", markersize=4, label=tracker)
            if few:
                axis.plot(centres, high, color=colour, marker=".", linewidth=0.9, linestyle=":")
    axis.set_xlabel("rotation of the head since the first frame (degrees)")
    axis.set_ylabel("rotation error (degrees)\n" + ("median; dotted: 90th percentile" if few else "median"))
    if few:
        axis.set_ylim(bottom=0)
    else:
        axis.set_yscale("log", subs=(2, 5))
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter("{x:g}")
        axis.tick_params(axis="y", which="minor", labelsize=8)
    _tidy(axis)
    _legend(figure, axis.get_legend_handles_labels()[0])
    return figure


def success_against_threshold(scores: Scores) -> Figure:
    """Fraction of frames in which the root of e_i is at most the threshold."""
    figure = _figure(7, 4)
    axis = figure.subplots()
    thresholds = np.linspace(0.5, 60, 120)
    for tracker, colour in _colours(scores).items():
        chosen = scores.with_pose(tracker)
        if chosen:
            squared = pooled(chosen, lambda s: s.compared.squared_error)
            known = pooled(chosen, lambda s: s.compared.known)
            rates = [100 * metrics.success_rate(squared, known, t) for t in thresholds]
            axis.plot(thresholds, rates, color=colour, label=tracker)
    axis.axvline(scores.evaluation.lost_deg, color="#999999", linestyle=":", label="threshold of the tables")
    axis.set_xlabel("threshold on the root of e_i (degrees)")
    axis.set_ylabel("P_s (per cent)")
    axis.set_ylim(0, 102)
    _tidy(axis)
    _legend(figure, axis.get_legend_handles_labels()[0])
    return figure


def reliability_diagram(diagrams: dict[str, metrics.Reliability]) -> Figure:
    """Fraction of frames with an error below 5 degrees, hollow where it is of few frames, and number of frames, against
    confidence, by tracker; without those that estimate none."""
    figure = _figure(6, 5)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    above.plot((0, 1), (0, 1), color="#999999", linestyle=":", linewidth=1)
    for (tracker, r), colour in zip(diagrams.items(), cycle(COLOURS), strict=False):
        if r.count.any():
            many, few = (np.where(chosen, r.right, np.nan) for chosen in (r.count >= _RARE, r.count < _RARE))
            above.plot(r.confidence, many, color=colour, marker="o", label=tracker)
            above.plot(r.confidence, few, color=colour, marker="o", markerfacecolor="none", linestyle="none", alpha=0.5)
            below.stairs(r.count, r.edges, color=colour, fill=True, alpha=0.2)
            below.stairs(r.count, r.edges, color=colour, linewidth=1.5)
    above.set_ylabel(
        f"share with an error\nbelow {metrics.RIGHT_DEG:g} degrees\n(hollow: of fewer than {_RARE} frames)"
    )
    above.set_ylim(0, 1.05)
    below.set_ylabel("frames")
    below.set_xlabel("confidence")
    for axis in (above, below):
        _tidy(axis)
    _legend(figure, above.get_legend_handles_labels()[0])
    return figure


def _plot_angle(axis: Axes, score: Score, k: int, colour: str) -> None:
    """Draw one angle in the frames that have truth, as a line also where only every other one has."""
    c = score.compared
    known = np.flatnonzero(c.known)
    shown = np.where(c.lost[known], np.nan, c.estimate_deg[known, k])
    frames, shown, estimate, sd = with_gaps(known, shown, c.estimate_deg[known, k], c.sd_deg[known, k])
    axis.plot(frames, shown, color=colour, linewidth=1.0)
    if np.isfinite(sd).any():
        low, high = estimate - NORMAL_90 * sd, estimate + NORMAL_90 * sd
        axis.fill_between(frames, low, high, color=colour, alpha=0.2, linewidth=0)


def with_gaps(frames: NDArray[np.intp], *values: Array) -> list[Array]:
    """Frames (n,) and values (n,) with a NaN where a line would cross a stretch without frames.

    That is a step much longer than most, between two that are not: no frame stands alone, where it would not be seen.
    """
    steps = np.diff(frames)
    near = steps <= _GAP * np.median(steps) if len(steps) else np.zeros(0, bool)
    gaps = 2 + np.flatnonzero(near[:-2] & ~near[1:-1] & near[2:])
    return [np.insert(np.asarray(v, float), gaps, np.nan) for v in (frames, *values)]


def _pages(scores: Scores, chosen: Callable[[Scores, str], list[Score]]) -> list[list[str]]:
    """The names of the sequences with anything to show, split into pages."""
    names = [n for n in scores.evaluation.sequences if chosen(scores, n)]
    return [names[i : i + PANELS] for i in range(0, len(names), PANELS)]


def _with_pose(scores: Scores, sequence: str) -> list[Score]:
    """The scores of a sequence that have poses."""
    return [s for s in scores.scores if s.result.sequence == sequence and not s.failure and s.has_pose]


def _with_points(scores: Scores, sequence: str) -> list[Score]:
    """The scores of a sequence that have the twelve points."""
    return [s for s in scores.scores if s.result.sequence == sequence and not s.failure and s.points is not None]


def _annotated_rms(score: Score) -> tuple[NDArray[np.intp], Array]:
    """The annotated frames, and their RMS; NaN if the face was lost."""
    rms = score.frame_rms_px
    assert rms is not None
    assert score.points is not None
    annotated = np.flatnonzero(np.isfinite(score.points[1]).all(axis=(1, 2)))
    return annotated, rms[annotated]


def _head_angle_deg(score: Score) -> Array:
    """Angle (n,) of the true rotation since the first frame."""
    truth, known = score.compared.truth_deg, score.compared.known
    out = np.full(len(truth), np.nan)
    out[known] = np.degrees(rotation_of(truth[known], score.protocol.order).magnitude())
    return out


def _binned(x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Centres of the bins with at least ten values, and the median and 90th percentile in each."""
    which = (x // _BIN_DEG).astype(int)
    filled = [b for b in np.unique(which) if (which == b).sum() >= 10]
    quantiles = np.array([np.percentile(y[which == b], (50, 90)) for b in filled]).reshape(-1, 2)
    return (np.array(filled) + 0.5) * _BIN_DEG, quantiles[:, 0], quantiles[:, 1]


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _save(figure: Figure, path: Path) -> Path:
    for text in figure.findobj(Text):
        text.set_parse_math(False)  # names of files may have dollar signs
    with whole_file(path) as temporary:
        figure.savefig(temporary, dpi=110)
    return path


def _tidy(axis: Axes) -> None:
    axis.grid(alpha=0.25)
    axis.spines[["top", "right"]].set_visible(False)
    axis.margins(x=0.01)
    axis.tick_params(labelsize=8)


def _entries(scores: Scores, shown: Sequence[Score]) -> list[Artist]:
    """The entries of a legend: the trackers that have one of these scores."""
    drawn = {score.result.tracker for score in shown}
    return [Line2D([], [], color=c, label=t) for t, c in _colours(scores).items() if t in drawn]


def _legend(figure: Figure, entries: Sequence[Artist]) -> None:
    """Add a legend above the figure, where it hides no line, in as many rows as its width requires."""
    longest = max((len(str(entry.get_label())) for entry in entries), default=0)
    columns = int(figure.get_figwidth() / (_ENTRY_INCHES + _LETTER_INCHES * longest))
    columns = max(1, min(columns, len(entries)))
    figure.set_figheight(figure.get_figheight() + _ROW_INCHES * ((len(entries) - 1) // columns))
    figure.legend(handles=entries, loc="outside upper left", ncols=columns, frameon=False)


def _colours(scores: Scores) -> dict[str, str]:
    """The colour of each tracker; more trackers than there are colours share them."""
    return dict(zip(scores.trackers, cycle(COLOURS), strict=False))
