"""Frames of a file, with its times."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from mien.arrays import Pixels
from mien.errors import MienError, MienWarning
from mien.video import decode_frame, open_video, select
from mien.video.file import VideoFile
from videos import frames_of, gradient, turn_by_metadata, write_video


def test_frames_come_in_order_with_the_containers_times(video: Path) -> None:
    frames = frames_of(video)
    assert [f.index for f in frames] == list(range(10))
    np.testing.assert_allclose([f.time for f in frames], np.arange(10) / 25, atol=1e-3)
    for f in frames:
        np.testing.assert_array_equal(f.pixels, gradient(f.index))


def test_time_that_jumps_back_goes_on(tmp_path: Path) -> None:
    """As where two recordings were joined; a single wrong time stamp is put right alone."""
    joined, part = tmp_path / "joined.ts", tmp_path / "part.ts"
    write_video(part, [gradient(i) for i in range(40)], codec="mpeg2video", pix_fmt="yuv420p")
    joined.write_bytes(2 * part.read_bytes())
    alone = [f.time for f in frames_of(part)]
    with pytest.warns(MienWarning, match=r"joined.ts: time jumps back from .* s; later times are shifted"):
        times = np.array([f.time for f in open_video(joined)])
    assert len(times) == 80
    np.testing.assert_allclose(times[:40], alone)
    np.testing.assert_allclose(np.diff(times), 0.04, atol=1e-3)


def test_a_video_can_be_read_twice(video: Path) -> None:
    opened = open_video(video)
    assert len(list(opened)) == len(list(opened)) == 10


def test_variable_frame_rate_keeps_the_true_times(tmp_path: Path) -> None:
    times = [0, 40, 50, 200, 1000, 1033]
    path = write_video(tmp_path / "vfr.mkv", [gradient(i) for i in range(6)], times_ms=times)
    np.testing.assert_allclose([f.time for f in frames_of(path)], np.array(times) / 1000, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "codec", "how"),
    [
        ("x.avi", "libx264", {"bf": "3", "b_strategy": "0"}),
        ("x.avi", "libx264", {"x264-params": "bframes=8:b-pyramid=0"}),
        ("x.avi", "mpeg4", {"bf": "2", "g": "300", "qmax": "2"}),
        ("x.asf", "libx264", {"bf": "3", "b_strategy": "0"}),
    ],
)
def test_images_come_regularly_where_only_decoding_has_time_stamps(
    name: str, codec: str, how: dict[str, str], tmp_path: Path
) -> None:
    """They are not shown in the order in which they are decoded; without a warning that some are missing."""
    images = [gradient(k) for k in range(40)]
    path = write_video(tmp_path / name, images, codec=codec, pix_fmt="yuv420p", options=how)
    frames, video = frames_of(path), open_video(path)
    assert isinstance(video, VideoFile)
    np.testing.assert_allclose(np.diff([f.time for f in frames]), 1 / 25, atol=1.1e-3)
    assert frames[0].time <= 0.08
    np.testing.assert_allclose([f.pixels[..., 2].mean() for f in frames], [10 * k % 256 for k in range(40)], atol=9)
    for first, last in ((0, 4), (20, 22), (35, 39)):
        again = list(video.between(frames[first].time, frames[last].time))
        assert [f.time for f in again] == [f.time for f in frames[first : last + 1]]
        for frame, known in zip(again, frames[first:], strict=False):
            np.testing.assert_array_equal(frame.pixels, known.pixels)


def test_rotation_metadata_is_honoured(tmp_path: Path) -> None:
    path = write_video(tmp_path / "phone.mp4", [gradient(i) for i in range(3)], codec="libx264", pix_fmt="yuv420p")
    before = frames_of(path)[0].pixels
    turn_by_metadata(path)
    after = frames_of(path)[0]
    assert (after.width, after.height) == (48, 64)
    np.testing.assert_array_equal(after.pixels, np.rot90(before, -1))
    assert np.corrcoef(after.brightness.ravel(), cv2.cvtColor(after.pixels, cv2.COLOR_RGB2GRAY).ravel())[0, 1] > 0.99


@pytest.mark.parametrize(
    ("shown", "as_shown"),
    [((0, 1, -1, 0), lambda image: np.rot90(image, -1)), ((-1, 0, 0, -1), lambda image: image[::-1, ::-1]),
     ((-1, 0, 0, 1), lambda image: image[:, ::-1]), ((1, 0, 0, -1), lambda image: image[::-1]),
     ((0, 1, 1, 0), lambda image: image.swapaxes(0, 1)),
     ((0, -1, -1, 0), lambda image: image[::-1, ::-1].swapaxes(0, 1))],
)  # fmt: skip
def test_a_picture_is_turned_and_mirrored_as_players_show_it(
    shown: tuple[int, int, int, int], as_shown: Callable[[Pixels], Pixels], tmp_path: Path
) -> None:
    path = write_video(tmp_path / "phone.mp4", [gradient(i) for i in range(3)], codec="libx264", pix_fmt="yuv420p")
    before = frames_of(path)[0]
    turn_by_metadata(path, shown)
    after = frames_of(path)[0]
    assert (after.height, after.width) == as_shown(before.gray).shape
    np.testing.assert_array_equal(after.pixels, as_shown(before.pixels))
    np.testing.assert_array_equal(after.gray, as_shown(before.gray))


@pytest.mark.parametrize(
    ("pix_fmt", "image"),
    [
        ("gray", np.arange(48 * 64, dtype=np.uint8).reshape(48, 64) // 2 * 2),
        ("gray16le", np.arange(48 * 64, dtype=np.uint16).reshape(48, 64) * 16),
    ],
)
def test_one_channel_and_16_bits_become_rgb(tmp_path: Path, pix_fmt: str, image: np.ndarray) -> None:
    frame = frames_of(write_video(tmp_path / "gray.mkv", [image], pix_fmt=pix_fmt, of=pix_fmt))[0]
    assert frame.pixels.dtype == np.uint8
    expected = image if image.dtype == np.uint8 else image / 257
    for channel in range(3):
        np.testing.assert_allclose(frame.pixels[..., channel], expected, atol=1.5)


def test_four_channels_become_rgb(tmp_path: Path) -> None:
    image = np.dstack([gradient(3), np.full((48, 64), 200, np.uint8)])
    frame = frames_of(write_video(tmp_path / "alpha.mkv", [image], pix_fmt="bgra", of="rgba"))[0]
    np.testing.assert_array_equal(frame.pixels, gradient(3))


def test_one_frame_is_a_video(tmp_path: Path) -> None:
    assert len(frames_of(write_video(tmp_path / "one.mkv", [gradient(0)]))) == 1


@pytest.mark.parametrize("ending", [".avi", ".mkv"])
def test_a_truncated_file_gives_what_decodes_and_a_warning(tmp_path: Path, ending: str) -> None:
    rng = np.random.default_rng(0)
    images = [rng.integers(0, 255, (48, 64, 3), np.uint8) for _ in range(100)]
    path = write_video(tmp_path / f"whole{ending}", images)
    cut = tmp_path / f"cut{ending}"
    cut.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.warns(MienWarning, match=r"cut.* is truncated or damaged: \d+ .*decoded"):
        frames = list(open_video(cut))
    assert 30 < len(frames) < 70
    np.testing.assert_array_equal(frames[20].pixels, images[20])


def test_a_file_that_lacks_half_a_second_at_its_end_is_said_to_be_truncated(tmp_path: Path) -> None:
    """A Matroska file whose last packets are gone, as one cut between two of them; that and no error tells it."""
    rng = np.random.default_rng(0)
    path = write_video(tmp_path / "whole.mkv", [rng.integers(0, 255, (48, 64, 3), np.uint8) for _ in range(100)])
    assert len(frames_of(path)) == 100
    with av.open(str(path)) as container:
        place = [packet.pos for packet in container.demux(video=0) if packet.size][87]
    cut = tmp_path / "cut.mkv"
    cut.write_bytes(path.read_bytes()[:place])
    with pytest.warns(MienWarning, match=r"cut\.mkv is truncated or damaged: 8\d frames"):
        assert 85 < len(list(open_video(cut))) < 89


def _with_sound(path: Path, first: int, last: int, seconds: int) -> Path:
    """A file with sound for so many seconds, and images, 25 a second, from the first to before the last of these."""
    rng = np.random.default_rng(0)
    with av.open(str(path), "w") as container:
        stream, sound = container.add_stream("ffv1", 25), container.add_stream("pcm_s16le", 8000, layout="mono")
        stream.height, stream.width, stream.pix_fmt = 48, 64, "bgr0"
        for k in range(seconds):
            for index in range(25 * k, 25 * (k + 1) if first <= k < last else 0):
                image = av.VideoFrame.from_ndarray(rng.integers(0, 255, (48, 64, 3), np.uint8), format="rgb24")
                image.pts, image.time_base = index, Fraction(1, 25)
                container.mux(stream.encode(image))
            samples = av.AudioFrame.from_ndarray(np.zeros((1, 8000), np.int16), layout="mono")
            samples.sample_rate = 8000
            container.mux(sound.encode(samples))
        for one in (stream, sound):
            container.mux(one.encode())
    return path


def test_a_file_is_whole_where_its_sound_is_longer(tmp_path: Path) -> None:
    whole, cut = _with_sound(tmp_path / "whole.mkv", 0, 4, 8), tmp_path / "cut.mkv"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    assert open_video(whole).frame_count == len(frames_of(whole)) == 100
    with pytest.warns(MienWarning, match=r"cut\.mkv is truncated or damaged"):
        assert 30 < len(list(open_video(cut))) < 70


def test_a_video_whose_sound_starts_earlier_keeps_its_place_in_it(tmp_path: Path) -> None:
    path = _with_sound(tmp_path / "late.mkv", 2, 4, 4)
    assert [frame.time for frame in frames_of(path)] == pytest.approx(np.arange(50, 100) / 25)
    assert open_video(path).begin == 2
    assert open_video(path).frame_count == 50
    with pytest.raises(MienError, match=r"no frame before 1 s; the next is at 2 s"):
        list(select(open_video(path), end=1))


@pytest.mark.parametrize(
    ("name", "codec", "late_ms"),
    [("x.mts", "libx264", 1400), ("x.mp4", "libx264", 2000), ("x.mkv", "ffv1", 3_600_000)],
)
def test_times_count_from_where_a_file_starts(name: str, codec: str, late_ms: int, tmp_path: Path) -> None:
    """Its time stamps begin later."""
    pix_fmt, times = "bgr0" if codec == "ffv1" else "yuv420p", range(late_ms, late_ms + 2000, 40)
    path = write_video(tmp_path / name, [gradient(k) for k in range(50)], codec=codec, pix_fmt=pix_fmt, times_ms=times)
    with av.open(str(path)) as container:
        assert container.start_time >= 1_000_000
    frames, video = frames_of(path), open_video(path)
    assert frames[0].time == video.begin == 0
    assert [frame.time for frame in frames] == pytest.approx(np.arange(50) / 25)
    assert video.frame_count == 50
    assert [frame.index for frame in select(video, start=0.4, end=1)] == list(range(10, 25))
    again = decode_frame(video, frames[0], 30, frames[30].time)
    np.testing.assert_array_equal(again.pixels, frames[30].pixels)


@pytest.mark.parametrize(("aspect", "size"), [("2/1", (128, 48)), ("1/2", (64, 96)), ("1/100", (64, 48))])
def test_pixels_become_square(tmp_path: Path, aspect: str, size: tuple[int, int]) -> None:
    """Unless the header says what cannot be."""
    path = tmp_path / "narrow.mp4"
    images = [gradient(k) for k in range(3)]
    write_video(path, images, codec="libx264", pix_fmt="yuv420p", aspect=Fraction(aspect))
    for frame in frames_of(path):
        assert (frame.width, frame.height) == size
        assert frame.pixels.shape == (size[1], size[0], 3)
        assert frame.gray.shape == (size[1], size[0])
        np.testing.assert_allclose(frame.pixels[0, :, 0], np.linspace(0, 250, size[0]), atol=16)
        np.testing.assert_allclose(frame.pixels[:, 0, 1], np.linspace(0, 250, size[1]), atol=16)


def test_memory_does_not_grow_with_the_length(tmp_path: Path) -> None:
    def peak(count: int) -> int:
        path = write_video(tmp_path / f"{count}.mkv", (gradient(i, 160, 120) for i in range(count)))
        tracemalloc.start()
        for _ in open_video(path):
            pass
        _, highest = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return highest

    assert peak(200) < peak(20) + 2 * 160 * 120 * 3


@pytest.mark.parametrize(("step_ms", "fps"), [(40, 25.0), (2, 500.0)])
def test_the_rate_of_a_clock_is_no_frame_rate(tmp_path: Path, step_ms: int, fps: float) -> None:
    """Browsers record so; cameras for slow motion may be as fast as they say."""
    times = [step_ms * k for k in range(30)]
    file = write_video(tmp_path / "recorded.mkv", [gradient(k) for k in range(30)], times_ms=times, fps=1000)
    video = open_video(file)
    assert video.fps == pytest.approx(fps)
    assert [frame.time for frame in frames_of(file)] == pytest.approx([t / 1000 for t in times])


@pytest.mark.parametrize("codec", ["ffv1", "libx264"])
def test_a_clock_whose_ticks_are_counted_as_frames_leaves_none_out(codec: str, tmp_path: Path) -> None:
    """As in an AVI into which another file was copied: most of its frames are empty."""
    times, pix_fmt = [0, 120, 160, *range(200, 1360, 40), 2000], "bgr0" if codec == "ffv1" else "yuv420p"
    how = {} if codec == "ffv1" else {"bf": "0"}
    images = [gradient(k) for k in range(len(times))]
    path = write_video(tmp_path / "x.avi", images, codec=codec, pix_fmt=pix_fmt, options=how, times_ms=times, fps=1000)
    assert [frame.time for frame in frames_of(path)] == pytest.approx([t / 1000 for t in times])
    video = open_video(path)
    assert video.fps == pytest.approx(25)
    assert video.frame_count == pytest.approx(2.0 * 25, abs=1)  # by its duration


def test_frames_missing_from_the_middle_are_told_where_nothing_else_tells(tmp_path: Path) -> None:
    whole, cut = tmp_path / "whole.ts", tmp_path / "cut.ts"
    write_video(whole, [gradient(i) for i in range(60)], codec="mpeg2video", pix_fmt="yuv420p")
    packets = whole.read_bytes()
    third = len(packets) // 188 // 3 * 188
    cut.write_bytes(packets[:third] + packets[2 * third :])
    assert len(frames_of(whole)) == 60
    with pytest.warns(MienWarning, match=r"cut\.ts: 0\.\d+ s of it have no frames, the first after 0\.\d+ s"):
        assert len(list(open_video(cut))) < 50
