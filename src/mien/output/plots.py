"""Plot of a track over time: angles and expression with their 90 % intervals, confidence."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mien.arrays import Array, Mask
from mien.candide.model import MOVES_MOUTH, TRACKED_UNITS
from mien.files import whole_file
from mien.tracking.state import Status

if TYPE_CHECKING:
    from mien.output.track import Track

NORMAL_90 = 1.6449
"""Half width of the central 90 % interval of a normal distribution, in standard deviations."""
ANGLE_NAMES = ("pitch", "yaw", "roll")
COLOURS = ("#c1443c", "#2f7d4f", "#2c62a8", "#c98a1b")
LOST_COLOUR = "#d9d4cf"
_DOTTED = 1000
"""Most frames that are drawn as dots, too."""


def plot_track(track: Track, path: Path) -> None:
    """Plot the track to a PNG (or PDF, SVG, by the suffix), with lost frames shaded."""
    series = [_Series("angle (degrees)", ANGLE_NAMES, track.euler_deg, track.euler_sd_deg), *_expression(track)]
    figure = Figure(figsize=(10, 2.5 * len(series) + 1.5), layout="constrained")
    FigureCanvasAgg(figure)
    heights = [*[2.5] * len(series), 1.2]
    axes = list(figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0])
    for axis, of in zip(axes, series, strict=False):
        _plot_series(axis, track.time, of.values, of.sd, of.names)
        axis.set_ylabel(of.label)
    _plot_confidence(axes[-1], track.time, track.confidence)
    lost = np.array([status == Status.LOST.value for status in track.status], dtype=bool)
    for axis in axes:
        _shade(axis, track.time, lost)
        axis.grid(alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)
        axis.margins(x=0.01)
    axes[-1].set_xlabel("time (seconds)")
    axes[-1].ticklabel_format(axis="x", useOffset=False, style="plain")
    figure.align_ylabels(axes)
    if lost.any():
        axes[0].set_title(f"{lost.sum()} of {len(lost)} frames lost (shaded)", loc="left", fontsize=10)
    with whole_file(path) as file:
        figure.savefig(file, dpi=120)


class _Series(NamedTuple):
    """What one panel shows. values, sd: (n, k), sd None where there are none; names: (k,)."""

    label: str
    names: Sequence[str]
    values: Array
    sd: Array | None


def _expression(track: Track) -> Iterator[_Series]:
    """The panels of the mouth and of brows and eyes, of a track that has an expression."""
    if track.animation is None:
        return
    names, values, sd = [name.replace("_", " ") for name in TRACKED_UNITS], track.animation, track.animation_sd
    if track.eyes_closed is not None:
        names.append("eyes closed")
        values = np.column_stack([values, track.eyes_closed])
        if sd is not None:
            unknown = np.full(len(values), np.nan)
            sd = np.column_stack([sd, unknown if track.eyes_closed_sd is None else track.eyes_closed_sd])
    mouth = np.flatnonzero(MOVES_MOUTH)
    for label, shown in (("mouth", mouth), ("brows and eyes", np.setdiff1d(np.arange(len(names)), mouth))):
        of_these = None if sd is None else sd[:, shown]
        yield _Series(f"{label}\n(0 neutral, 1 full)", [names[k] for k in shown], values[:, shown], of_these)


def _plot_series(axis: Axes, time: Array, values: Array, sd: Array | None, names: Sequence[str]) -> None:
    """One line per column of values (n, k), interrupted at lost frames, with a 90 % band if sd is known."""
    for k, (name, colour) in enumerate(zip(names, COLOURS, strict=False)):
        axis.plot(time, values[:, k], color=colour, label=name, **_line(time))
        if sd is None:
            continue
        half = NORMAL_90 * sd[:, k]
        if len(time) > 1:
            low, high = values[:, k] - half, values[:, k] + half
            axis.fill_between(time, low, high, color=colour, alpha=0.18, linewidth=0)
        else:  # with a single frame the band would have no extent in time
            axis.errorbar(time, values[:, k], half, color=colour, alpha=0.5, capsize=6)
    if sd is not None:
        axis.fill_between([], [], [], color="#888888", alpha=0.3, linewidth=0, label="90 % band")
    axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=9)


def _line(time: Array) -> dict[str, Any]:
    """Style of a line through these times: in a long video a dot for each frame would cover the line."""
    return {"linewidth": 0.6} if len(time) > _DOTTED else {"linewidth": 1.4, "marker": ".", "markersize": 3}


def _plot_confidence(axis: Axes, time: Array, confidence: Array) -> None:
    axis.plot(time, confidence, color="#333333", **_line(time))
    axis.fill_between(time, 0, confidence, color="#333333", alpha=0.12, linewidth=0)
    axis.set_ylim(0, 1.05)
    axis.set_ylabel("confidence")


def _shade(axis: Axes, time: Array, lost: Mask) -> None:
    """Shade each run of lost frames, from halfway before its first frame to halfway after its last."""
    if not lost.any():
        return
    midpoints = 0.5 * (time[1:] + time[:-1])
    borders = np.concatenate([time[:1], midpoints, time[-1:]])
    steps = np.flatnonzero(np.diff(np.concatenate([[False], lost, [False]]).astype(int)))
    for first, stop in steps.reshape(-1, 2):
        axis.axvspan(borders[first], borders[stop], color=LOST_COLOUR, linewidth=0, zorder=0)
