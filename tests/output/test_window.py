"""The window, with a screen that is not there."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

import mien
from mien.arrays import Pixels
from mien.errors import MienError, MienWarning
from mien.output.window import Window
from small_motion import face
from videos import portrait_images, write_video

ESCAPE = 27


class Screen:
    """What OpenCV does with a window; `key` is pressed in the frame `pressed_in`."""

    def __init__(self) -> None:
        self.shown: list[Pixels] = []
        self.sizes: list[tuple[int, int]] = []
        self.key, self.pressed_in, self.open = -1, 0, True

    def close(self, *_: object) -> None:
        self.open = False

    def wait(self, _: int) -> int:
        return self.key if len(self.shown) > self.pressed_in else -1


@pytest.fixture
def screen(monkeypatch: pytest.MonkeyPatch) -> Screen:
    screen = Screen()
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(cv2, "namedWindow", lambda *_: None)
    monkeypatch.setattr(cv2, "imshow", lambda _, pixels: screen.shown.append(pixels))
    monkeypatch.setattr(cv2, "resizeWindow", lambda _, width, height: screen.sizes.append((width, height)))
    monkeypatch.setattr(cv2, "waitKey", screen.wait)
    monkeypatch.setattr(cv2, "getWindowProperty", lambda *_: float(screen.open))
    monkeypatch.setattr(cv2, "destroyWindow", screen.close)
    return screen


def test_a_video_whose_name_is_not_valid_utf_8_is_shown(screen: Screen, monkeypatch: pytest.MonkeyPatch) -> None:
    titles: list[str] = []
    monkeypatch.setattr(cv2, "namedWindow", lambda title, _: titles.append(title))
    with Window(os.fsdecode(b"lat\xe9in.mp4")):
        (title,) = titles
    assert title.encode().startswith(b"lat")  # else OpenCV crashes


def test_a_picture_is_shown_in_its_colours_and_its_size(screen: Screen) -> None:
    red = np.zeros((90, 160, 3), np.uint8)
    red[..., 0] = 255
    with Window("face") as window:
        window.show(red)
        window.show(red)
        window.show(np.zeros((1440, 2560, 3), np.uint8))
    assert screen.shown[0][0, 0].tolist() == [0, 0, 255]  # OpenCV counts blue first
    assert screen.sizes == [(160, 90), (1280, 720)]
    assert not screen.open


@pytest.mark.parametrize("key", [ESCAPE, ord("q"), -1])
def test_a_key_or_a_closed_window_interrupts(key: int, screen: Screen) -> None:
    screen.key, screen.open = key, key >= 0
    with pytest.raises(KeyboardInterrupt), Window("face") as window:
        window.show(np.zeros((90, 160, 3), np.uint8))


def test_what_was_tracked_until_then_is_written(screen: Screen, tmp_path: Path) -> None:
    video, table = write_video(tmp_path / "face.mkv", portrait_images()), tmp_path / "out.csv"
    screen.key, screen.pressed_in = ESCAPE, 2
    with pytest.warns(MienWarning, match="stopped after 3 frames"), pytest.raises(KeyboardInterrupt):
        mien.track(video, landmarks=face().landmarks, save=table, show=True)
    assert len(screen.shown) == len(mien.Track.read(table)) == 3


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there is always a screen")
def test_without_a_screen_nothing_is_begun(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    video = write_video(tmp_path / "face.mkv", portrait_images())
    with pytest.raises(MienError, match="no screen"):
        mien.track(video, landmarks=face().landmarks, save=tmp_path / "out.csv", show=True)
    assert not (tmp_path / "out.csv").exists()


def test_an_opencv_without_windows_is_told(screen: Screen, monkeypatch: pytest.MonkeyPatch) -> None:
    def not_built(*_: object) -> None:
        raise cv2.error("The function is not implemented")

    monkeypatch.setattr(cv2, "namedWindow", not_built)
    with pytest.raises(MienError, match="cannot show a video"):
        Window("face")
