"""The files of a track as they are written together."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mien.frame import Frame
from mien.output.destination import Destination
from mien.output.track import Track
from mien.tracking.state import Estimate

LOST = Track.from_estimates([Estimate.lost(Frame(np.zeros((4, 4, 3), np.uint8)), "gone")])


def test_a_plot_is_written_where_a_link_leads(tmp_path: Path) -> None:
    (tmp_path / "kept").mkdir()
    plot, target = tmp_path / "plot.png", tmp_path / "kept" / "plot.png"
    plot.symlink_to(target)
    for _ in range(2):
        Destination(plot=plot).write(LOST)
        assert plot.is_symlink()
        assert target.stat().st_size > 0


def test_files_of_further_faces_are_named_where_the_table_is_named_without_its_ending(tmp_path: Path) -> None:
    """`mien track -o take.2 --faces 2` prints their names."""
    for name in ("take.2", "take.2.csv", "take.2.parquet"):
        written = Destination.checked(tmp_path / name, None, None, None).of_face(1)
        assert Destination(tmp_path / name).of_face(1).paths() == written.paths()
        assert written.table == tmp_path / "take.2.face1.csv"


def test_nothing_of_an_earlier_track_is_left_with_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = Destination(tmp_path / "out.csv", None, tmp_path / "plot.png", tmp_path / "head.glb")
    earlier = [path for path in (files.plot, files.gltf) if path is not None]
    for path in earlier:
        path.write_bytes(b"of an earlier track")

    def stop(track: Track, path: Path) -> Path:
        raise KeyboardInterrupt

    monkeypatch.setattr(Track, "plot", stop)
    with pytest.raises(KeyboardInterrupt):
        files.write(LOST)
    assert Track.read(tmp_path / "out.csv").lost == 1
    assert not any(path.exists() for path in earlier)
