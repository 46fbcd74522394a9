"""Overlay videos keep the frames' own times."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import av
import numpy as np
import pytest

from mien.errors import MienError, MienWarning
from mien.output.overlay_video import OverlayWriter


def test_a_video_keeps_times_colours_and_an_even_size(tmp_path: Path) -> None:
    times = [2.0, 2.04, 2.5, 2.5, 3.25]
    colour = np.array([200, 60, 40], dtype=np.uint8)
    with OverlayWriter(tmp_path / "overlay.mp4") as writer:
        for time in times:
            writer.write(np.full((91, 121, 3), colour), time)
        assert not (tmp_path / "overlay.mp4").exists()
    assert [p.name for p in tmp_path.iterdir()] == ["overlay.mp4"]
    with av.open(str(tmp_path / "overlay.mp4")) as container:
        frames = list(container.decode(video=0))
        assert container.streams.video[0].codec_context.name == "h264"
    shown = [f.time for f in frames]
    np.testing.assert_allclose(shown, np.array(times) - 2, atol=1e-4)
    assert (np.diff(shown) > 0).all()  # players skip a frame that comes at the time of another
    assert {(f.width, f.height, f.format.name) for f in frames} == {(120, 90, "yuv420p")}
    assert np.abs(frames[2].to_ndarray(format="rgb24").astype(int) - colour).max() < 12


def test_a_gap_that_players_may_not_show_is_shown_as_a_second(tmp_path: Path) -> None:
    """As where the clock of a computer is set, or a transport stream begins anew."""
    times = [0.0, 0.04, 1.7e9, 1.7e9 + 0.04, 1.7e9 + 480]
    with pytest.warns(MienWarning) as warned, OverlayWriter(tmp_path / "overlay.mp4") as writer:  # noqa: PT031
        for time in times:
            writer.write(np.zeros((90, 120, 3), np.uint8), time)
    (message,) = (str(warning.message) for warning in warned)
    assert "overlay.mp4: 1700000000 s lie between two frames" in message
    with av.open(str(tmp_path / "overlay.mp4")) as container:
        shown = [frame.time for frame in container.decode(video=0)]
    np.testing.assert_allclose(shown, [0, 0.04, 1.04, 1.08, 481.04], atol=1e-4)


@pytest.mark.parametrize("size", [(120, 16386), (32770, 200)])
def test_what_is_too_large_for_the_encoder_is_scaled_down(size: tuple[int, int], tmp_path: Path) -> None:
    colour = np.array([200, 60, 40], dtype=np.uint8)
    with OverlayWriter(tmp_path / "overlay.mp4") as writer:
        writer.write(np.full((*size, 3), colour), 0.0)
    with av.open(str(tmp_path / "overlay.mp4")) as container:
        frame = next(container.decode(video=0))
    assert max(frame.width, frame.height) == 16384
    assert frame.width / frame.height == pytest.approx(size[1] / size[0], rel=0.02)
    assert np.abs(frame.to_ndarray(format="rgb24").astype(int) - colour).max() < 12


def test_what_the_encoder_refuses_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mien.output.overlay_video._LARGEST_SIDE", 1 << 20)
    with (
        pytest.raises(MienError, match=r"overlay\.mp4 cannot be encoded \(.*external library\); scale"),
        OverlayWriter(tmp_path / "overlay.mp4") as writer,
    ):
        writer.write(np.zeros((120, 16386, 3), dtype=np.uint8), 0.0)
    assert not list(tmp_path.iterdir())


def test_a_video_without_frames_leaves_nothing(tmp_path: Path) -> None:
    with OverlayWriter(tmp_path / "overlay.mp4"):
        pass
    assert not list(tmp_path.iterdir())


def test_an_interrupted_video_holds_what_was_written(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), OverlayWriter(tmp_path / "overlay.mp4") as writer:  # noqa: PT012
        writer.write(np.zeros((90, 120, 3), dtype=np.uint8), 0.0)
        raise KeyboardInterrupt
    with av.open(str(tmp_path / "overlay.mp4")) as container:
        assert len(list(container.decode(video=0))) == 1


def test_a_video_that_fails_leaves_the_one_that_is_there(tmp_path: Path) -> None:
    path = tmp_path / "overlay.mp4"
    path.write_bytes(b"of yesterday")
    with pytest.raises(ZeroDivisionError), OverlayWriter(path) as writer:  # noqa: PT012
        writer.write(np.zeros((48, 64, 3), np.uint8), 0.0)
        raise ZeroDivisionError
    assert path.read_bytes() == b"of yesterday"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no device that is always full")
@pytest.mark.parametrize("frames", [1, 80])
def test_a_full_disk_is_named(frames: int, tmp_path: Path) -> None:
    """In a process of its own, which FFmpeg would end if it were asked to go on."""
    (tmp_path / "full.mp4").symlink_to("/dev/full")
    program = f"""
import numpy as np
from pathlib import Path
from mien.output import overlay_video
overlay_video.create_temporary = lambda path: Path("full.mp4")
try:
    with overlay_video.OverlayWriter(Path("overlay.mp4")) as writer:
        for k in range({frames}):
            writer.write(np.zeros((48, 64, 3), np.uint8), 0.04 * k)
except overlay_video.MienError as error:
    print(error)
"""
    ended = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert "overlay.mp4 cannot be written (no space left on device)" in ended.stdout
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_created_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(MienError, match=r"file/overlay.*cannot be written"):
        OverlayWriter(tmp_path / "file" / "overlay.mp4")
