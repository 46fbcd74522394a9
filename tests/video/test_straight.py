"""Videos through a lens that bends straight lines."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from mien.frame import Frame
from mien.lens import Lens
from mien.video import StraightVideo, backwards, decode_frame, open_video, select
from videos import gradient, write_video

LENS = Lens(((80.0, 0.0, 31.5), (0.0, 80.0, 23.5), (0.0, 0.0, 1.0)), (-0.4, 0.1, 0.0, 0.0))


@pytest.fixture(params=["bgr0", "yuv420p"])
def path(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    codec = "ffv1" if request.param == "bgr0" else "libx264"
    return write_video(tmp_path / "x.mkv", [gradient(k) for k in range(10)], codec=codec, pix_fmt=request.param)


def test_frames_are_those_of_the_video_straightened(path: Path) -> None:
    video = open_video(path)
    straight = StraightVideo(video, LENS)
    for seen, frame in zip(video, straight, strict=True):
        assert (frame.index, frame.time, frame.width, frame.height) == (seen.index, seen.time, 64, 48)
        np.testing.assert_array_equal(frame.pixels, LENS.straighten(seen.pixels))
        np.testing.assert_allclose(frame.gray.astype(int), LENS.straighten(seen.gray), atol=1)
        assert frame.quantizer_step == seen.quantizer_step
        assert frame.interlaced is False


def test_luma_needs_no_conversion(path: Path) -> None:
    """Of a video that has it; of others there is none."""
    (seen, *_), (frame, *_) = open_video(path), StraightVideo(open_video(path), LENS)
    assert (frame.luma is None) is (seen.luma is None)
    _ = frame.gray
    assert ("pixels" in vars(frame)) is (seen.luma is None)


def test_everything_else_is_the_videos_own(path: Path) -> None:
    video = open_video(path)
    straight = StraightVideo(video, LENS)
    for name in ("name", "path", "repeatable", "fps", "begin", "frame_count", "stopped"):
        assert getattr(straight, name) == getattr(video, name)


def test_frames_are_straight_wherever_they_are_read(path: Path) -> None:
    straight = StraightVideo(open_video(path), LENS)
    frames = list(straight)
    for again in (decode_frame(straight, frames[0], 7, frames[7].time), next(backwards(straight, 0.0, 8))):
        assert again.index == 7
        np.testing.assert_array_equal(again.pixels, frames[7].pixels)
    assert [frame.index for frame in select(straight, start=0.2)] == [5, 6, 7, 8, 9]


def test_a_straight_frame_can_be_pickled(path: Path) -> None:
    frame = next(iter(StraightVideo(open_video(path), LENS)))
    again: Frame = pickle.loads(pickle.dumps(frame))
    np.testing.assert_array_equal(again.pixels, frame.pixels)
