"""Which frames are read, and in which order."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mien.errors import MienError, MienWarning
from mien.frame import Decoded, Frame
from mien.video import backwards, decode_frame, expected_count, open_video, select
from videos import frames_of, gradient, write_images, write_video


@pytest.mark.filterwarnings("ignore::mien.errors.MienWarning")
def test_where_time_jumps_back_frames_are_found_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A time may be that of a frame in each of the files that were joined; only the first jump is warned of."""
    images = [gradient(i) for i in range(80)]
    write_video(tmp_path / "long.mpg", images, codec="mpeg2video", pix_fmt="yuv420p")
    write_video(tmp_path / "short.mpg", [255 - image for image in images[:40]], codec="mpeg2video", pix_fmt="yuv420p")
    parts = [(tmp_path / name).read_bytes() for name in ("short.mpg", "long.mpg", "short.mpg")]
    (tmp_path / "joined.mpg").write_bytes(b"".join(parts))
    video = open_video(tmp_path / "joined.mpg")
    with pytest.warns(MienWarning, match="time jumps back") as told:
        frames = list(video)
    assert len(frames) == 160
    assert len(told) == 1
    monkeypatch.setattr("mien.video.selection.BUFFER_BYTES", 50 * frames[0].pixels.nbytes)
    once_more = {f.index: decode_frame(video, f, f.index, f.time) for f in frames[::20]}
    played = list(backwards(video, begin=0.0, end=160))
    for again in (once_more, {f.index: f for f in played}):
        for index, frame in again.items():
            assert frame.time == frames[index].time
            np.testing.assert_array_equal(frame.pixels, frames[index].pixels)
    assert [f.index for f in played] == [*range(159, -1, -1)]


@pytest.mark.parametrize("held", [1, 3, 100])
def test_a_video_is_played_backwards_in_parts(held: int, video: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """However little may be held in memory, at least a frame."""
    frames = frames_of(video)
    monkeypatch.setattr("mien.video.selection.BUFFER_BYTES", held * frames[0].pixels.nbytes)
    played = list(backwards(open_video(video), begin=0.06, end=8))
    assert [f.index for f in played] == [7, 6, 5, 4, 3, 2]
    for f in played:
        np.testing.assert_array_equal(f.pixels, frames[f.index].pixels)
    assert not list(backwards(open_video(video), begin=0.06, end=2))


def test_a_frame_is_decoded_again(video: Path) -> None:
    frames = list(open_video(video))
    for frame in (frames[5], frames[0]):
        again = decode_frame(open_video(video), frames[2], frame.index, frame.time)
        assert (again.index, again.time) == (frame.index, frame.time)
        np.testing.assert_array_equal(again.pixels, frame.pixels)


def test_where_no_key_frame_is_found_a_video_is_played_backwards_all_the_same(
    video: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = frames_of(video)
    monkeypatch.setattr("mien.video.selection.BUFFER_BYTES", 3 * frames[0].pixels.nbytes)
    monkeypatch.setattr("mien.video.file.VideoFile.between", lambda video, begin, until: iter(frames[:1]))
    played = list(backwards(open_video(video), begin=0.0, end=8))
    assert [f.index for f in played] == [7, 6, 5, 4, 3, 2, 1, 0]
    for f in played:
        np.testing.assert_array_equal(f.pixels, frames[f.index].pixels)


def test_frames_that_are_passed_over_are_not_converted(video: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(Decoded, "rgb")
    assert [f.index for f in select(open_video(video), 0.1, 0.3)] == [3, 4, 5, 6, 7]
    assert [f.index for f in backwards(open_video(video), begin=0.06, end=8)] == [7, 6, 5, 4, 3, 2]


def test_selection_keeps_indices_and_ends_before_the_end(video: Path) -> None:
    chosen = list(select(open_video(video), start=0.08, end=0.2))
    assert [f.index for f in chosen] == [2, 3, 4]
    assert expected_count(open_video(video), 0.08, 0.2) == 3
    assert expected_count(open_video(video)) == 10
    assert expected_count(open_video(video), 9.0) == 1  # as a header may state too few


@pytest.mark.parametrize(
    ("start", "end"),
    [(None, None), (-3, None), (0.1, None), (None, 0.2), (0.1, 0.2), (-1, 9), (None, 1e308), (-1e308, 0.2)],
)
@pytest.mark.parametrize("begin", [0.0, 10.0])
def test_how_many_frames_there_will_be_is_known_wherever_the_time_begins(
    begin: float, start: float | None, end: float | None, tmp_path: Path
) -> None:
    file = open_video(write_video(tmp_path / "x.mkv", [gradient(k) for k in range(10)], times_ms=range(0, 400, 40)))
    for video in (file, open_video([Frame(frame.image, frame.index, begin + frame.time) for frame in file])):
        interval = [None if time is None else video.begin + time for time in (start, end)]
        assert expected_count(video, *interval) == len(list(select(video, *interval)))


@pytest.mark.filterwarnings("ignore::mien.errors.MienWarning")
def test_a_frame_that_is_gone_is_told_of(tmp_path: Path) -> None:
    video = open_video(write_images(tmp_path / "images", [gradient(k) for k in range(3)]))
    frame = list(video)[1]
    (tmp_path / "images" / "1.png").unlink()
    with pytest.raises(MienError, match=r"images: its frame at 0\.04 s can no longer be read"):
        decode_frame(video, frame, frame.index, frame.time)


def test_a_frame_is_at_its_time_as_tables_round_it(tmp_path: Path) -> None:
    video = open_video(write_video(tmp_path / "thirds.avi", [gradient(k) for k in range(10)], fps=30))
    for frame in list(video)[1:]:
        time = round(frame.time, 6)
        assert [f.index for f in select(video, start=time)] == list(range(frame.index, 10))
        assert expected_count(video, time) == 10 - frame.index
        assert [f.index for f in select(video, end=time)] == list(range(frame.index))
        assert [f.index for f in backwards(video, begin=time, end=10)] == list(range(9, frame.index - 1, -1))


def test_selection_without_a_frame_says_how_long_the_video_is(video: Path) -> None:
    with pytest.raises(MienError, match=r"no frame from 5 s .*last is at 0.36 s"):
        list(select(open_video(video), start=5))
    with pytest.raises(MienError, match="must come before the end"):
        list(select(open_video(video), start=2, end=1))
