"""Frames of files, folders and cameras."""

from __future__ import annotations

import gc
import os
import pickle
import struct
import tracemalloc
import warnings
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from av.stream import Disposition

from mien.arrays import Pixels
from mien.errors import MienError, MienWarning
from mien.files import checksum
from mien.frame import Decoded, Frame
from mien.video import FOLDER_FPS, backwards, decode_frame, expected_count, open_video, select
from videos import gradient, turn_by_metadata, write_video


@pytest.fixture
def video(tmp_path: Path) -> Path:
    return write_video(tmp_path / "plain.mkv", [gradient(i) for i in range(10)])


def frames_of(path: Path) -> list[Frame]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return list(open_video(path))


def test_frames_come_in_order_with_the_containers_times(video: Path) -> None:
    frames = frames_of(video)
    assert [f.index for f in frames] == list(range(10))
    np.testing.assert_allclose([f.time for f in frames], np.arange(10) / 25, atol=1e-3)
    for f in frames:
        np.testing.assert_array_equal(f.pixels, gradient(f.index))


def test_gray_is_luminance() -> None:
    frame = Frame(np.full((2, 3, 3), (255, 0, 0), np.uint8))
    assert frame.gray.shape == (2, 3)
    assert np.all(frame.gray == 76)  # 0.299 of 255
    assert (frame.width, frame.height) == (3, 2)


@pytest.mark.parametrize(
    ("pixels", "told"),
    [
        (np.zeros((4, 4), np.uint8), "an array (4, 4) of uint8"),
        (np.zeros((4, 4, 4), np.uint8), "an array (4, 4, 4) of uint8"),
        (np.zeros((4, 4, 3), np.uint16), "an array (4, 4, 3) of uint16"),
        (np.zeros((4, 4, 3)), "an array (4, 4, 3) of float64"),
        (np.zeros((0, 4, 3), np.uint8), "an array (0, 4, 3) of uint8"),
        ([[[0, 0, 0]]], "<class 'list'>"),
        (None, "<class 'NoneType'>"),
    ],
)
def test_pixels_that_are_no_rgb_of_8_bits_are_refused(pixels: Any, told: str) -> None:
    with pytest.raises(MienError, match="in RGB, as cv2") as raised:
        Frame(pixels)
    assert told in str(raised.value)


def test_frames_of_a_program_are_a_video_that_is_shown_once() -> None:
    given = [Frame(gradient(i), 2 * i, i / 30) for i in range(3)]
    video = open_video(iter(given))
    assert (video.path, video.frame_count) == (None, None)
    assert list(video) == given
    assert not list(video)


def test_frames_of_a_program_are_of_one_size() -> None:
    large = np.zeros((480, 640, 3), np.uint8)
    with pytest.warns(MienWarning, match="the frames: frame 1 has 640x480 pixels"):
        frames = list(open_video([Frame(gradient(0), 0, 0.0), Frame(large, 1, 0.1)]))
    assert [f.pixels.shape for f in frames] == [gradient(0).shape] * 2


def test_frames_of_a_program_are_numbered_from_zero() -> None:
    with pytest.raises(MienError, match="index -5; count them from 0"):
        list(open_video([Frame(np.zeros((8, 8, 3), np.uint8), -5, 0.0)]))


def test_frames_of_a_program_are_frames_and_numbered() -> None:
    with pytest.raises(MienError, match=r"is no frame; give each as mien\.Frame"):
        next(iter(open_video([gradient(0)])))  # type: ignore[list-item]
    with pytest.raises(MienError, match="frame 0 comes after frame 0; number them"):
        list(open_video([Frame(gradient(0)), Frame(gradient(1))]))
    with pytest.raises(MienError, match=r"frame 1 has the time 0 s after 0 s; give increasing seconds, .*perf_counter"):
        list(open_video([Frame(gradient(0), 0), Frame(gradient(1), 1)]))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with a name")
def test_what_is_neither_file_nor_folder_is_refused(video: Path, tmp_path: Path) -> None:
    """Nothing waits for what may never come through a pipe; a link to a file is that file."""
    os.mkfifo(tmp_path / "pipe.mp4")
    with pytest.raises(MienError, match=r"pipe.mp4 is a pipe or a device, .* save it as a file"):
        open_video(tmp_path / "pipe.mp4")
    (tmp_path / "link.mp4").symlink_to(video)
    assert len(list(open_video(tmp_path / "link.mp4"))) == 10


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
    monkeypatch.setattr("mien.video.BUFFER_BYTES", 50 * frames[0].pixels.nbytes)
    once_more = {f.index: decode_frame(video, f, f.index, f.time) for f in frames[::20]}
    played = list(backwards(video, begin=0.0, end=160))
    for again in (once_more, {f.index: f for f in played}):
        for index, frame in again.items():
            assert frame.time == frames[index].time
            np.testing.assert_array_equal(frame.pixels, frames[index].pixels)
    assert [f.index for f in played] == [*range(159, -1, -1)]


def test_a_video_can_be_read_twice(video: Path) -> None:
    opened = open_video(video)
    assert len(list(opened)) == len(list(opened)) == 10


@pytest.mark.parametrize("held", [1, 3, 100])
def test_a_video_is_played_backwards_in_parts(held: int, video: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """However little may be held in memory, at least a frame."""
    frames = frames_of(video)
    monkeypatch.setattr("mien.video.BUFFER_BYTES", held * frames[0].pixels.nbytes)
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
    monkeypatch.setattr("mien.video.BUFFER_BYTES", 3 * frames[0].pixels.nbytes)
    monkeypatch.setattr("mien.video.VideoFile.between", lambda video, begin, until: iter(frames[:1]))
    played = list(backwards(open_video(video), begin=0.0, end=8))
    assert [f.index for f in played] == [7, 6, 5, 4, 3, 2, 1, 0]
    for f in played:
        np.testing.assert_array_equal(f.pixels, frames[f.index].pixels)


def test_variable_frame_rate_keeps_the_true_times(tmp_path: Path) -> None:
    times = [0, 40, 50, 200, 1000, 1033]
    path = write_video(tmp_path / "vfr.mkv", [gradient(i) for i in range(6)], times_ms=times)
    np.testing.assert_allclose([f.time for f in frames_of(path)], np.array(times) / 1000, atol=1e-9)


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


PART = slice(5, 30), slice(7, 40)


@pytest.mark.parametrize(
    ("codec", "pix_fmt", "has_luma"),
    [("libx264", "yuv420p", True), ("libx264", "nv12", True), ("mjpeg", "yuvj422p", True), ("ffv1", "gray", True),
     ("ffv1", "yuv420p10le", False), ("ffv1", "gray16le", False), ("ffv1", "bgr0", False),
     ("libx264rgb", "rgb24", False)],
)  # fmt: skip
def test_grey_is_there_without_a_conversion_where_luma_is(
    codec: str, pix_fmt: str, has_luma: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_video(tmp_path / "video.mkv", [gradient(i) for i in range(4)], codec=codec, pix_fmt=pix_fmt)
    plain = [cv2.cvtColor(frame.pixels, cv2.COLOR_RGB2GRAY) for frame in frames_of(path)]
    asked: list[Decoded] = []
    convert = Decoded.rgb
    monkeypatch.setattr(Decoded, "rgb", lambda image: asked.append(image) or convert(image))
    for frame, expected in zip(frames_of(path), plain, strict=True):
        part = frame.gray_part(*PART)
        assert part.flags.c_contiguous
        np.testing.assert_array_equal(frame.gray[PART], part)
        assert frame.brightness.shape == (48, 64)
        # Luma may have a range of its own, from 16 to 235; what is told of it by gain and offset is the same.
        gain, offset = np.polyfit(frame.gray.ravel().astype(float), expected.ravel().astype(float), 1)
        np.testing.assert_allclose(gain * frame.gray + offset, expected, atol=4)
    assert len(asked) == (0 if has_luma else 4)


def test_frames_that_are_passed_over_are_not_converted(video: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(Decoded, "rgb")
    assert [f.index for f in select(open_video(video), 0.1, 0.3)] == [3, 4, 5, 6, 7]
    assert [f.index for f in backwards(open_video(video), begin=0.06, end=8)] == [7, 6, 5, 4, 3, 2]


def test_a_frame_goes_to_another_process(video: Path) -> None:
    frame = pickle.loads(pickle.dumps(frames_of(video)[3]))
    assert (frame.index, frame.time) == (3, pytest.approx(0.12, abs=1e-3))
    np.testing.assert_array_equal(frame.pixels, gradient(3))
    np.testing.assert_array_equal(frame.gray, cv2.cvtColor(gradient(3), cv2.COLOR_RGB2GRAY))


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


def test_frames_of_changing_size_are_fitted_into_the_first_with_a_warning(tmp_path: Path) -> None:
    """A wider frame keeps its proportions: black above and below, and only there."""
    images = [np.full((48, 64, 3), 200, np.uint8)] * 2 + [np.full((48, 128, 3), 200, np.uint8)] * 2
    path = tmp_path / "sizes.mjpeg"
    path.write_bytes(b"".join(cv2.imencode(".jpg", i)[1].tobytes() for i in images))
    with pytest.warns(MienWarning, match=r"sizes.mjpeg: frame 2 has 128x48 pixels and the first 64x48") as caught:
        frames = list(open_video(path))
    assert len(caught) == 1
    assert [f.pixels.shape for f in frames] == [(48, 64, 3)] * 4
    fitted = frames[2].pixels
    assert fitted[:12].max() == fitted[36:].max() == 0
    assert fitted[12:36].min() > 190


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


def test_damage_in_the_middle_does_not_end_the_video(tmp_path: Path) -> None:
    images = [gradient(i) for i in range(20)]
    path = write_video(tmp_path / "hole.avi", images, codec="mjpeg", pix_fmt="yuvj420p")
    content = bytearray(path.read_bytes())
    starts = [i for i in range(len(content)) if content.startswith(b"00dc", i)]
    content[starts[10] + 8 : starts[11]] = bytes(starts[11] - starts[10] - 8)
    path.write_bytes(content)
    with pytest.warns(MienWarning, match="truncated or damaged: 19 of 20"):
        frames = list(open_video(path))
    np.testing.assert_allclose([f.time for f in frames[-2:]], [18 / 25, 19 / 25])


def test_nothing_decodes(tmp_path: Path) -> None:
    path = write_video(tmp_path / "header.avi", [gradient(i) for i in range(5)])
    content = path.read_bytes()
    path.write_bytes(content[: content.index(b"movi") + 4])
    with pytest.raises(MienError, match=r"header.avi: no frame .* empty, damaged, or of a kind .*; convert it"):
        list(open_video(path))


@pytest.mark.parametrize("content", [b"", b"hello\n" * 100, bytes(range(256)) * 40])
@pytest.mark.parametrize("name", ["x.mp4", "x.txt", "x"])
def test_not_a_video(tmp_path: Path, content: bytes, name: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(MienError, match=r"/x.* (is not a video|cannot be read as a video)"):
        open_video(tmp_path / name)


def test_missing_file_and_empty_folder(tmp_path: Path) -> None:
    with pytest.raises(MienError, match=r"none.mp4: no such file"):
        open_video(tmp_path / "none.mp4")
    with pytest.raises(MienError, match="holds no image"):
        open_video(tmp_path)


def test_camera_that_is_not_there() -> None:
    with pytest.raises(MienError, match="camera 97 cannot be opened"):
        next(iter(open_video(97)))
    assert open_video("97").name == open_video(np.int64(97)).name == "camera 97"  # type: ignore[arg-type]


@pytest.mark.parametrize("source", [True, None, 1.0, b"x.mp4"])
def test_what_is_no_source_of_frames(source: Any) -> None:
    with pytest.raises(MienError, match=r"a video is a file, .*, not <class"):
        open_video(source)


def test_the_address_of_a_stream_is_no_file() -> None:
    with pytest.raises(MienError, match=r"rtsp://host/x is not a file; read the stream yourself"):
        open_video("rtsp://host/x")


class Device:
    """A camera that shows three images, and that somebody then unplugs."""

    def __init__(self, number: int) -> None:
        self.images, self.released = [gradient(index)[..., ::-1] for index in range(3)], False

    def isOpened(self) -> bool:
        return True

    def read(self) -> tuple[bool, Pixels | None]:
        return (True, self.images.pop(0)) if self.images else (False, None)

    def release(self) -> None:
        self.released = True


def test_a_camera_is_read_until_it_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    device = Device(0)
    monkeypatch.setattr(cv2, "VideoCapture", lambda number: device)
    frames = list(open_video(0))
    assert device.released
    assert [frame.index for frame in frames] == [0, 1, 2]
    assert frames[0].time == 0 < frames[1].time < frames[2].time
    for index, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.pixels, gradient(index))


def test_folder_is_read_by_name_whatever_the_images_depth(tmp_path: Path) -> None:
    image = gradient(5)
    gray16 = np.full((48, 64), 128 * 257, np.uint16)
    cv2.imwrite(str(tmp_path / "b.png"), image[..., ::-1])
    cv2.imwrite(str(tmp_path / "a.png"), gray16)
    cv2.imwrite(str(tmp_path / "c.png"), np.dstack([image[..., ::-1], np.full((48, 64), 9, np.uint8)]))
    (tmp_path / "notes.txt").write_text("not an image")
    frames = frames_of(tmp_path)
    assert np.all(frames[0].pixels == 128)
    np.testing.assert_array_equal(frames[1].pixels, image)
    np.testing.assert_array_equal(frames[2].pixels, image)
    np.testing.assert_allclose([f.time for f in frames], np.arange(3) / FOLDER_FPS)


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
def test_images_of_16_bits_may_use_fewer(bits: int, tmp_path: Path) -> None:
    """Cameras store 10 or 12 bits so; the first image may be a dark one."""
    for name, image in (("a", gradient(0) // 8), ("b", gradient(9))):
        cv2.imwrite(str(tmp_path / f"{name}.png"), image[..., ::-1].astype(np.uint16) << (bits - 8))
    np.testing.assert_array_equal(frames_of(tmp_path)[1].pixels, gradient(9))


def _exif(orientation: int) -> bytes:
    """A TIFF header with a single entry, the orientation."""
    entry = struct.pack("<HHIHH", 274, 3, 1, orientation, 0)
    return b"II*\0" + struct.pack("<IH", 8, 1) + entry + bytes(4)


@pytest.mark.parametrize(("orientation", "quarters"), [(1, 0), (3, 2), (6, 3), (8, 1)])
def test_a_photo_is_upright_as_a_file_and_in_a_folder(orientation: int, quarters: int, tmp_path: Path) -> None:
    jpeg = cv2.imencode(".jpg", gradient(3)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()
    exif = b"Exif\0\0" + _exif(orientation)
    path = tmp_path / "photo.jpg"
    path.write_bytes(jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + jpeg[2:])
    upright = np.rot90(gradient(3), quarters)
    for source in (path, tmp_path):
        pixels = frames_of(source)[0].pixels
        assert pixels.shape == upright.shape
        assert np.abs(pixels.astype(int) - upright).mean() < 5


def test_a_tiff_is_upright(tmp_path: Path) -> None:
    image = np.arange(6, dtype=np.uint8).reshape(2, 3) * 40
    tags = {256: 3, 257: 2, 258: 8, 259: 1, 262: 1, 273: 8, 274: 6, 277: 1, 278: 2, 279: 6}
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags.items())
    content = b"II*\0" + struct.pack("<I", 14) + image.tobytes() + struct.pack("<H", len(tags)) + entries + bytes(4)
    (tmp_path / "a.tif").write_bytes(content)
    np.testing.assert_array_equal(frames_of(tmp_path)[0].pixels[..., 0], np.rot90(image, -1))


def test_of_several_streams_the_one_is_read_that_players_show(tmp_path: Path) -> None:
    path = tmp_path / "two.mkv"
    with av.open(str(path), "w") as container:
        streams = [container.add_stream("ffv1", 25) for _ in range(2)]
        for stream, image in zip(streams, (gradient(0, 32, 24), gradient(0)), strict=True):
            stream.height, stream.width, stream.pix_fmt = *image.shape[:2], "bgr0"
        streams[0].disposition, streams[1].disposition = Disposition(0), Disposition.default
        for stream, image in zip(streams, (gradient(0, 32, 24), gradient(0)), strict=True):
            for picture in (av.VideoFrame.from_ndarray(image, format="rgb24"), None):
                container.mux(stream.encode(picture))
    np.testing.assert_array_equal(frames_of(path)[0].pixels, gradient(0))


def test_the_cover_of_a_sound_file_is_no_video(video: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = av.open

    def with_cover(*args: Any, **options: Any) -> Any:
        container = opened(*args, **options)
        container.streams.video[0].disposition = Disposition.attached_pic
        return container

    monkeypatch.setattr(av, "open", with_cover)
    with pytest.raises(MienError, match=r"plain\.mkv is not a video"):
        open_video(video)


def test_a_name_with_a_colon_is_no_protocol(video: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    video.rename(tmp_path / "2024-05-01T12:30:00.mkv")
    assert len(frames_of(Path("2024-05-01T12:30:00.mkv"))) == 10


def test_decoded_images_are_freed_at_once(video: Path) -> None:
    """And not when garbage is collected, which the command line does rarely."""
    gc.collect()
    gc.disable()
    try:
        for frame in open_video(video):
            assert frame.brightness.any() or frame.index == 0
        assert sum(type(each) is av.VideoFrame for each in gc.get_objects()) < 5
    finally:
        gc.enable()


def test_numbers_of_numpy_become_plain() -> None:
    frame = Frame(gradient(0), np.int64(3), np.float32(0.5))  # type: ignore[arg-type]
    assert (type(frame.index), type(frame.time)) == (int, float)


def test_broken_image_of_a_folder_is_left_out_and_keeps_its_place(tmp_path: Path) -> None:
    for name in "ac":
        cv2.imwrite(str(tmp_path / f"{name}.png"), gradient(1))
    (tmp_path / "b.png").write_bytes(b"broken")
    with pytest.warns(MienWarning, match=r"b.png is not a readable image"):
        frames = list(open_video(tmp_path))
    assert [f.index for f in frames] == [0, 2]


def test_selection_keeps_indices_and_ends_before_the_end(video: Path) -> None:
    chosen = list(select(open_video(video), start=0.08, end=0.2))
    assert [f.index for f in chosen] == [2, 3, 4]
    assert expected_count(open_video(video), 0.08, 0.2) == 3
    assert expected_count(open_video(video)) == 10


def test_images_come_by_their_numbers(tmp_path: Path) -> None:
    for k, name in enumerate(("b1.png", "frame2.png", "frame09.png", "frame10.png", "frame010a.png", "z.png")):
        cv2.imwrite(str(tmp_path / name), gradient(k)[..., ::-1])
    blue = [int(frame.pixels[0, 0, 2]) for frame in frames_of(tmp_path)]
    assert blue == [10 * k for k in range(6)]


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


def test_a_video_whose_time_begins_late_is_whole(tmp_path: Path) -> None:
    path = write_video(tmp_path / "late.mkv", [gradient(k) for k in range(10)], times_ms=range(3600000, 3600400, 40))
    opened = open_video(path)
    assert [frame.time for frame in frames_of(path)][::9] == [3600, 3600.36]
    assert opened.frame_count == 10
    with pytest.raises(MienError, match=r"no frame before 1 s; the next is at 3600 s"):
        list(select(opened, end=1))


def test_selection_without_a_frame_says_how_long_the_video_is(video: Path) -> None:
    with pytest.raises(MienError, match=r"no frame from 5 s .*last is at 0.36 s"):
        list(select(open_video(video), start=5))
    with pytest.raises(MienError, match="must come before the end"):
        list(select(open_video(video), start=2, end=1))


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


def test_checksum_depends_on_contents_and_names(tmp_path: Path) -> None:
    a, b = tmp_path / "a", tmp_path / "b"
    a.write_bytes(b"abc")
    assert checksum(a) == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    before = checksum(tmp_path)
    a.rename(b)
    assert checksum(tmp_path) != before
