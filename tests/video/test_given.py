"""Frames of a camera, and of a program."""

from __future__ import annotations

import warnings
from typing import Any

import cv2
import numpy as np
import pytest

from mien.errors import MienError, MienWarning
from mien.frame import Frame
from mien.video import backwards, decode_frame, open_video
from videos import Device, gradient


def test_frames_of_a_program_are_a_video_that_is_shown_once() -> None:
    given = [Frame(gradient(i), 2 * i, i / 30) for i in range(3)]
    video = open_video(iter(given))
    assert (video.path, video.frame_count) == (None, None)
    assert list(video) == given
    assert not list(video)


def test_a_list_of_frames_is_read_again_like_a_file() -> None:
    images = [np.full((4, 6, 3), value, np.uint8) for value in (10, 20, 30)]
    video = open_video([Frame(image, index, 0.5 + 0.04 * index) for index, image in enumerate(images)])
    assert video.repeatable
    assert (video.frame_count, video.fps) == (3, pytest.approx(25))
    assert [frame.index for frame in (*video, *video)] == [0, 1, 2] * 2
    assert [frame.index for frame in backwards(video, 0.53, 2)] == [1]
    found = decode_frame(video, next(iter(video)), 1, 0.54)
    assert found.pixels.max() == 20


def test_a_list_without_times_has_the_usual_frame_rate() -> None:
    assert open_video([Frame(np.zeros((4, 6, 3), np.uint8))] * 3).fps == 30
    assert open_video([]).fps == 30


def test_frames_of_a_program_are_of_one_size() -> None:
    large = np.zeros((480, 640, 3), np.uint8)
    with pytest.warns(MienWarning, match="the frames: frame 1 has 640x480 pixels"):
        frames = list(open_video([Frame(gradient(0), 0, 0.0), Frame(large, 1, 0.1)]))
    assert [f.pixels.shape for f in frames] == [gradient(0).shape] * 2


def test_frames_of_a_program_are_numbered_from_zero() -> None:
    with pytest.raises(MienError, match="index -5; count them from 0"):
        list(open_video([Frame(np.zeros((8, 8, 3), np.uint8), -5, 0.0)]))


@pytest.mark.parametrize("time", [float("nan"), float("inf")])
def test_the_first_frame_of_a_program_has_a_time(time: float) -> None:
    with pytest.raises(MienError, match=rf"the first frame has the time {time} s; give each frame its time"):
        next(iter(open_video([Frame(gradient(0), 0, time)])))


def test_frames_of_a_program_are_frames_and_numbered() -> None:
    with pytest.raises(MienError, match=r"is no frame; give each as mien\.Frame"):
        next(iter(open_video([gradient(0)])))  # type: ignore[list-item]


def test_a_program_goes_on_where_its_indices_and_times_do_not() -> None:
    """As where a camera repeats a time stamp, or begins anew after a failure: what was learned must not be lost."""
    stated = [(0, 5.0), (1, 5.1), (2, 5.1), (3, 5.2), (3, float("nan")), (0, 0.0), (1, 0.1)]
    given = [Frame(gradient(k), *stamp) for k, stamp in enumerate(stated)]
    with pytest.warns(MienWarning) as warned:
        frames = list(open_video(given))
    assert [frame.index for frame in frames] == [0, 1, 2, 3, 4, 5, 6]
    times = np.array([frame.time for frame in frames])
    np.testing.assert_allclose(times, [5.0, 5.1, 5.1 + 1 / 30, 5.2, 5.2 + 1 / 30, 5.2 + 2 / 30, 5.3 + 2 / 30])
    for frame, known in zip(frames, given, strict=True):
        np.testing.assert_array_equal(frame.pixels, known.pixels)
    texts = [str(warning.message) for warning in warned]
    assert len(texts) == 2  # one of the times that do not increase, one of the clock that was set back
    assert "frame 2 at 5.1 s comes after frame 1 at 5.1 s" in texts[0]
    assert "time jumps back" in texts[1]


def test_a_time_that_stands_still_jumps_nowhere() -> None:
    with pytest.warns(MienWarning) as warned:
        frames = list(open_video([Frame(gradient(0), k, 0.0) for k in range(60)]))
    np.testing.assert_allclose([frame.time for frame in frames], np.arange(60) / 30)
    (text,) = (str(warning.message) for warning in warned)
    assert "frame 1 at 0 s comes after frame 0 at 0 s" in text


@pytest.mark.parametrize("rate", [60, 240])
def test_a_fast_camera_that_repeats_a_time_does_not_run_ahead(rate: int) -> None:
    times = np.arange(3 * rate) / rate
    times[rate] = times[rate - 1]
    with pytest.warns(MienWarning) as warned:
        frames = list(open_video(iter([Frame(gradient(0), k, time) for k, time in enumerate(times)])))
    assert len(warned) == 1
    np.testing.assert_allclose([frame.time for frame in frames], times, atol=1 / rate)


def test_a_clock_that_is_coarser_than_the_intervals_of_a_camera_does_not_run_ahead() -> None:
    """Of a hundred frames a second, timed in ticks of a sixtieth."""
    times = np.arange(1000) // (100 / 60) / 60
    with pytest.warns(MienWarning) as warned:
        frames = list(open_video(iter([Frame(gradient(0), k, time) for k, time in enumerate(times)])))
    assert len(warned) == 1
    np.testing.assert_allclose([frame.time for frame in frames], times, atol=0.1)


@pytest.mark.parametrize("in_a_list", [False, True])
def test_times_in_milliseconds_are_warned_of_once(in_a_list: bool) -> None:
    frames = [Frame(gradient(i % 9), i, 1000 * i / 30) for i in range(30)]
    with pytest.warns(MienWarning, match=r"the frames: 33\.3 s lie between .* divide them by 1000") as warned:
        assert list(open_video(frames if in_a_list else iter(frames))) == frames
    assert len(warned) == 1


@pytest.mark.parametrize("step", [0.001, 1 / 30, 2.0])
def test_times_in_seconds_are_not_warned_of_even_after_a_pause(step: float) -> None:
    times = step * np.arange(30)
    times[3:] += 60
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        list(open_video(iter([Frame(gradient(0), i, time) for i, time in enumerate(times)])))


@pytest.mark.parametrize("number", [97, 10**20])
def test_camera_that_is_not_there(number: int) -> None:
    with pytest.raises(MienError, match=f"camera {number} cannot be opened"):
        next(iter(open_video(number)))


def test_a_camera_is_named_by_its_number() -> None:
    assert open_video("97").name == open_video(np.int64(97)).name == "camera 97"  # type: ignore[arg-type]


def test_a_camera_that_gives_no_image_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """As one that another program uses: a stream would end at once, without a word."""
    device = Device([])
    monkeypatch.setattr(cv2, "VideoCapture", lambda number: device)
    with pytest.raises(MienError, match="camera 0 gives no image"):
        next(iter(open_video(0)))
    assert device.released


def test_a_camera_that_is_stopped_while_it_is_opened_leaves_the_log_of_opencv_as_it_was(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def stop(number: int) -> None:
        raise KeyboardInterrupt

    log: Any = getattr(cv2.utils, "logging", cv2)  # OpenCV 5, else OpenCV 4
    before = log.getLogLevel()
    log.setLogLevel(3)
    try:
        monkeypatch.setattr(cv2, "VideoCapture", stop)
        with pytest.raises(KeyboardInterrupt):
            next(iter(open_video(0)))
        assert log.getLogLevel() == 3
    finally:
        log.setLogLevel(before)


def test_a_camera_is_read_until_it_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which it does not by itself: the end is told of."""
    device = Device(gradient(index) for index in range(3))
    monkeypatch.setattr(cv2, "VideoCapture", lambda number: device)
    video = open_video(0)
    with pytest.warns(MienWarning, match=r"^camera 0 gives no more images after \d\.\d\d s, which .* check its cable"):
        frames = list(video)
    assert video.stopped is not None
    assert device.released
    assert [frame.index for frame in frames] == [0, 1, 2]
    assert frames[0].time == 0 < frames[1].time < frames[2].time
    for index, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.pixels, gradient(index))


def test_images_of_a_camera_that_change_their_size_are_scaled_to_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """As those of a program: what was learned would end with an error."""
    device = Device([gradient(0), gradient(1, width=128, height=96), gradient(2)])
    monkeypatch.setattr(cv2, "VideoCapture", lambda number: device)
    with pytest.warns(MienWarning) as warned:
        frames = list(open_video(0))
    assert "camera 0: frame 1 has 128x96 pixels and the first 64x48" in str(warned[0].message)
    assert [frame.pixels.shape for frame in frames] == [gradient(0).shape] * 3
    assert device.released


@pytest.mark.parametrize("last", [None, np.zeros((0, 0, 3), np.uint8), cv2.error("the driver failed")])
def test_a_camera_that_fails_gives_no_more_images(last: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Some drivers say that they have an image which is none, or raise, when their camera is unplugged."""
    device = Device([gradient(0)])
    image = device.images[0]
    read = iter([(True, image), last if isinstance(last, Exception) else (True, last)])

    def answer() -> tuple[bool, Any]:
        answered = next(read)
        if isinstance(answered, Exception):
            raise answered
        return answered

    monkeypatch.setattr(device, "read", answer)
    monkeypatch.setattr(cv2, "VideoCapture", lambda number: device)
    video = open_video(0)
    with pytest.warns(MienWarning, match="^camera 0 gives no more images"):
        assert len(list(video)) == 1
    assert video.stopped is not None
    assert device.released


def test_images_of_a_camera_that_are_not_of_8_bits_are_not_misread(monkeypatch: pytest.MonkeyPatch) -> None:
    device = Device([])
    monkeypatch.setattr(device, "read", lambda: (True, np.full((48, 64, 3), 4000, np.uint16)))
    monkeypatch.setattr(cv2, "VideoCapture", lambda number: device)
    with pytest.raises(MienError, match="uint16"):
        next(iter(open_video(0)))
    assert device.released
