"""Plots: they come out for every kind of track, and lost frames are shaded."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure

from mien.candide.model import TRACKED_UNITS
from mien.output.plots import COLOURS, LOST_COLOUR, _expression, _plot_series, _shade, plot_track


def _track(
    n: int, lost: slice = slice(0, 0), with_sd: bool = True, with_animation: bool = True, with_eyes: bool = True
) -> Any:
    time = np.arange(n) / 25
    euler, animation = np.sin(time[:, None] * [1, 2, 3]), np.cos(time[:, None] * np.arange(6))
    status = np.full(n, "tracked", dtype=object)
    confidence = np.full(n, 0.9)
    status[lost], euler[lost], animation[lost], confidence[lost] = "lost", np.nan, np.nan, 0
    return SimpleNamespace(
        time=time,
        euler_deg=euler,
        euler_sd_deg=np.full((n, 3), 0.5) if with_sd else None,
        animation=animation if with_animation else None,
        animation_sd=np.full((n, 6), 0.1) if with_sd and with_animation else None,
        eyes_closed=np.linspace(0, 1, n) if with_eyes else None,
        eyes_closed_sd=np.full(n, 0.1) if with_sd and with_eyes else None,
        confidence=confidence,
        status=list(status),
    )


def _shaded(path: Path) -> float:
    """Share of the picture in the colour of lost frames."""
    colour = [int(LOST_COLOUR[i : i + 2], 16) for i in (5, 3, 1)]
    return float((np.abs(cv2.imread(str(path)).astype(int) - colour).max(axis=2) < 3).mean())


@pytest.mark.parametrize(
    "track",
    [
        _track(50),
        _track(1),
        _track(1, slice(0, 1)),
        _track(2),
        _track(30, slice(0, 30)),
        _track(30, with_sd=False),
        _track(30, with_animation=False),
        _track(30, with_eyes=False),
    ],
    ids=["whole", "one frame", "one lost frame", "two frames", "all lost", "no sd", "no animation", "no eyes"],
)
@pytest.mark.filterwarnings("error")
def test_every_kind_of_track_is_plotted(tmp_path: Path, track: Any) -> None:
    plot_track(track, tmp_path / "plot.png")
    assert cv2.imread(str(tmp_path / "plot.png")).std() > 1
    assert [p.name for p in tmp_path.iterdir()] == ["plot.png"]


def test_each_unit_is_in_one_panel_with_its_own_values_and_a_colour() -> None:
    track = _track(20)
    panels = list(_expression(track))
    columns = dict(zip((*TRACKED_UNITS, "eyes_closed"), [*track.animation.T, track.eyes_closed], strict=True))
    shown = [(name, of.values[:, k]) for of in panels for k, name in enumerate(of.names)]
    assert sorted(name for name, _ in shown) == sorted(name.replace("_", " ") for name in columns)
    for name, values in shown:
        np.testing.assert_array_equal(values, columns[name.replace(" ", "_")])
    assert max(len(of.names) for of in panels) <= len(COLOURS)


def test_lost_frames_are_shaded_in_proportion(tmp_path: Path) -> None:
    for name, lost in {"none": slice(0, 0), "half": slice(20, 60), "all": slice(0, 80)}.items():
        plot_track(_track(80, lost), tmp_path / f"{name}.png")
    none, half, every = (_shaded(tmp_path / f"{name}.png") for name in ("none", "half", "all"))
    assert none < 0.01
    assert half / every == pytest.approx(0.5, abs=0.08)


def test_the_band_holds_nine_tenths_of_a_normal_distribution() -> None:
    axis = Figure().subplots()
    _plot_series(axis, np.arange(3.0), np.full((3, 1), 10.0), np.full((3, 1), 2.0), ["yaw"])
    band = axis.collections[0].get_paths()[0].vertices[:, 1] - 10
    assert math.erf(band.max() / 2 / math.sqrt(2)) == pytest.approx(0.9, abs=1e-4)
    assert band.min() == pytest.approx(-band.max())


def test_lost_frames_are_shaded_up_to_halfway_to_those_beside_them() -> None:
    axis = Figure().subplots()
    axis.set_xlim(0, 10)
    _shade(axis, np.array([0.0, 1.0, 3.0, 4.0, 8.0]), np.array([False, True, True, False, True]))
    extents = [patch.get_extents().transformed(axis.transData.inverted()) for patch in axis.patches]
    np.testing.assert_allclose([(of.x0, of.x1) for of in extents], [(0.5, 3.5), (6, 8)])
