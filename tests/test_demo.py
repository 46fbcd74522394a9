"""The demo: it writes what it says, and its errors are those of the files."""

from __future__ import annotations

import shutil
from io import StringIO
from pathlib import Path

import av
import numpy as np
import pytest
from rich.console import Console

from mien.batch import find_videos
from mien.demo import DemoErrors, compare, demo_states, run_demo
from mien.errors import MienError
from mien.output.destination import Destination
from mien.output.track import Track
from mien.synthetic import make_sequence
from mien.tracking.state import Estimate, Status, TrackedLandmarks
from small_motion import face

SECONDS = 0.6


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, DemoErrors, str]:
    out, console = tmp_path_factory.mktemp("demo") / "new" / "folder", Console(file=StringIO(), width=100)
    errors = run_demo(out, seconds=SECONDS, console=console)
    assert isinstance(console.file, StringIO)
    return out, errors, console.file.getvalue()


def test_it_writes_what_it_says(demo: tuple[Path, DemoErrors, str]) -> None:
    out, _, said = demo
    written = {Path(line.removeprefix("wrote ")).name for line in said.splitlines() if line.startswith("wrote ")}
    assert written == {p.name for p in out.iterdir()}
    assert {"track.csv", "track.json", "track.parquet", "overlay.mp4", "plot.png", "truth.npz", "head.glb"} <= written


def test_video_overlay_track_and_truth_have_the_same_frames(demo: tuple[Path, DemoErrors, str]) -> None:
    out, *_ = demo
    n = round(SECONDS * 25)
    for name in ("video.mp4", "overlay.mp4"):
        with av.open(str(out / name)) as container:
            assert len(list(container.decode(video=0))) == n
    assert len(Track.read(out / "track.csv")) == n
    with np.load(out / "truth.npz") as truth:
        assert truth["R"].shape == (n, 3, 3)
        assert truth["landmarks"].shape == (n, 26, 2)


def test_the_face_is_followed(demo: tuple[Path, DemoErrors, str]) -> None:
    _, errors, said = demo
    assert errors.lost == 0
    assert errors.euler_deg.max() < 8
    assert errors.landmarks_px < 8
    assert f"{errors.euler_deg[1]:.2f} degrees" in said


@pytest.mark.parametrize("name", ["video.mp4", "plot.png"])
def test_what_it_has_not_written_is_not_overwritten(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text("mine")
    with pytest.raises(MienError, match=rf"{name} exists and is not of mien demo; choose another folder with --out"):
        run_demo(tmp_path)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [(name, "mine")]


def test_an_earlier_demo_is_overwritten(demo: tuple[Path, DemoErrors, str], tmp_path: Path) -> None:
    out, *_ = demo
    shutil.copytree(out, tmp_path / "demo")
    run_demo(tmp_path / "demo", seconds=0.2, console=Console(file=StringIO()))
    assert len(Track.read(tmp_path / "demo" / "track.csv")) == 5


def test_its_video_is_no_overlay(demo: tuple[Path, DemoErrors, str], tmp_path: Path) -> None:
    """A batch tracks it, and no overlay takes its place."""
    out, *_ = demo
    assert [video.name for video, _ in find_videos([out], tmp_path)] == ["video.mp4"]
    with pytest.raises(MienError, match=r"video\.mp4 exists and is not an overlay by mien"):
        Destination(overlay=out / "video.mp4").check([])
    Destination(overlay=out / "overlay.mp4").check([])


def test_errors_by_hand() -> None:
    """A track of the true pose, its landmarks off by (3, 4) pixels, its animation by 0.1, its last frame lost."""
    known = face()
    sequence = make_sequence(known, np.tile(known.state, (3, 1)))
    estimates = [
        Estimate(
            k,
            k / 25,
            Status.TRACKED,
            known.fit.R,
            known.fit.t,
            known.fit.animation + 0.1,
            landmarks=TrackedLandmarks(("p",) * 26, sequence.landmarks[k] + [3, 4]),
        )
        for k in range(2)
    ]
    lost = Estimate.lost(sequence.frames[2], "hidden")
    errors = compare(Track.from_estimates([*estimates, lost]), sequence)
    np.testing.assert_allclose(errors.euler_deg, 0, atol=1e-3)
    np.testing.assert_allclose(errors.animation, 0.1, atol=1e-4)
    assert errors.landmarks_px == pytest.approx(5, abs=1e-3)
    assert errors.lost == 1


def test_states_begin_at_the_portrait_and_are_smooth() -> None:
    states = demo_states(face(), 100)
    np.testing.assert_allclose(states[0], face().state, atol=1e-9)
    assert np.degrees(np.abs(np.diff(states[:, :3], axis=0))).max() < 4
    assert np.abs(np.diff(states[:, 6:], axis=0)).max() < 0.15
