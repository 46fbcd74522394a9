"""What a source of frames is, and what is none."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from mien.errors import MienError
from mien.video import open_video


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with a name")
def test_what_is_neither_file_nor_folder_is_refused(video: Path, tmp_path: Path) -> None:
    """Nothing waits for what may never come through a pipe; a link to a file is that file."""
    os.mkfifo(tmp_path / "pipe.mp4")
    with pytest.raises(MienError, match=r"pipe.mp4 is a pipe or a device, .* save it as a file"):
        open_video(tmp_path / "pipe.mp4")
    (tmp_path / "link.mp4").symlink_to(video)
    assert len(list(open_video(tmp_path / "link.mp4"))) == 10


def test_a_camera_that_is_named_by_its_device_is_given_by_its_number(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also by a link to it, which stays where numbers change."""
    link = "/dev/v4l/by-id/usb-camera-index0"
    monkeypatch.setattr(os.path, "realpath", lambda path: "/dev/video7" if str(path) == link else str(path))
    for name in ("/dev/video7", link):
        with pytest.raises(MienError, match=rf"^{name} is a camera, which has a number; give 7$"):
            open_video(name)
    with pytest.raises(MienError, match="no such file"):
        open_video("/dev/video7.mp4")


def test_missing_file_and_empty_folder(tmp_path: Path) -> None:
    with pytest.raises(MienError, match=r"none.mp4: no such file"):
        open_video(tmp_path / "none.mp4")
    with pytest.raises(MienError, match="holds no image"):
        open_video(tmp_path)


@pytest.mark.parametrize("source", [True, None, 1.0, b"x.mp4"])
def test_what_is_no_source_of_frames(source: Any) -> None:
    with pytest.raises(MienError, match=r"a video is a file, .*, not <class"):
        open_video(source)


@pytest.mark.parametrize("fps", [0, -5, float("nan"), float("inf"), "25", 1e-308, 1e308])
def test_what_is_no_frame_rate(fps: Any, tmp_path: Path) -> None:
    with pytest.raises(MienError, match=r"fps is .*; give a positive number of frames per second"):
        open_video(tmp_path, fps)


def test_what_has_its_own_times_is_given_no_frame_rate(video: Path) -> None:
    for source, name in ((video, r"plain\.mkv"), (0, "camera 0"), ([], "the frames")):
        with pytest.raises(MienError, match=f"{name} has times of its own; omit fps"):
            open_video(source, 25)


def test_the_address_of_a_stream_is_no_file() -> None:
    with pytest.raises(MienError, match=r"rtsp://host/x is not a file; read the stream yourself"):
        open_video("rtsp://host/x")
