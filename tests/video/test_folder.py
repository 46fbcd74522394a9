"""Images of a folder."""

from __future__ import annotations

import os
import re
import struct
import sys
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from mien.errors import MienError, MienWarning
from mien.video import FOLDER_FPS, open_video
from videos import frames_of, gradient


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


def test_what_is_probably_not_meant_as_one_video_is_warned_of(tmp_path: Path) -> None:
    (tmp_path / "film.mp4").write_bytes(b"0")
    with pytest.raises(MienError, match=r"holds no images; mien batch .* tracks its videos"):
        open_video(tmp_path)
    cv2.imwrite(str(tmp_path / "0.png"), gradient(0))
    assert len(list(open_video(tmp_path))) == 1  # beside its overlay
    (tmp_path / "other.mp4").write_bytes(b"0")
    with pytest.warns(MienWarning, match="holds 2 videos beside the images that are read as one, 1 of them"):
        open_video(tmp_path)
    for film in tmp_path.glob("*.mp4"):
        film.unlink()
    cv2.imwrite(str(tmp_path / "0.jpg"), gradient(0))
    with pytest.warns(MienWarning, match="same names in several formats"):
        open_video(tmp_path)
    for file in tmp_path.iterdir():
        file.unlink()
    cv2.imwritemulti(str(tmp_path / "0.tif"), [gradient(0), gradient(1)])
    with pytest.warns(MienWarning, match=r"0\.tif holds several images"):
        assert len(list(open_video(tmp_path))) == 1


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
def test_images_of_16_bits_may_use_fewer(bits: int, tmp_path: Path) -> None:
    """Cameras store 10 or 12 bits so; the first image may be a dark one."""
    for name, image in (("a", gradient(0) // 8), ("b", gradient(9))):
        cv2.imwrite(str(tmp_path / f"{name}.png"), image[..., ::-1].astype(np.uint16) << (bits - 8))
    np.testing.assert_array_equal(frames_of(tmp_path)[1].pixels, gradient(9))


def test_images_of_16_bits_stay_alike(tmp_path: Path) -> None:
    """Where a later one is brighter, by a spot or as a whole."""
    for k in range(40):
        image = np.full((48, 64), 1000, np.uint16)
        image[:12] = 1000 if k < 20 else 1100
        cv2.imwrite(str(tmp_path / f"{k}.png"), image)
    assert {int(frame.pixels[-1, 0, 0]) for frame in frames_of(tmp_path)} == {1000 >> 4}
    cv2.imwrite(str(tmp_path / "1.png"), np.full((48, 64), 60000, np.uint16))  # not among those looked at
    values = [int(frame.pixels[-1, 0, 0]) for frame in frames_of(tmp_path)]
    assert values == [1000 >> 4, 255, *[1000 >> 4] * 38]


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


def test_broken_image_of_a_folder_is_left_out_and_keeps_its_place(tmp_path: Path) -> None:
    for name in "ac":
        cv2.imwrite(str(tmp_path / f"{name}.png"), gradient(1))
    (tmp_path / "b.png").write_bytes(b"broken")
    with pytest.warns(MienWarning, match=r"b.png is not a readable image"):
        frames = list(open_video(tmp_path))
    assert [f.index for f in frames] == [0, 2]


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("kind", [np.int32, np.float32, np.float64])
def test_an_image_of_32_bits_or_more_is_to_be_converted(
    kind: type, channels: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    cv2.imwrite(str(tmp_path / "b.png"), gradient(1))
    cv2.imwrite(str(tmp_path / "a.tif"), np.ones((48, 64, channels), kind))
    with pytest.warns(MienWarning, match=r"a\.tif has (32|64) bits per channel, .*; convert it to 8 or 16 bits"):
        assert [f.index for f in open_video(tmp_path)] == [1]
    assert not re.search(r"\[ *(WARN|ERROR)", capfd.readouterr().err)


def test_opencv_logs_nothing_of_a_broken_image(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), gradient(1))
    (tmp_path / "b.png").write_bytes((tmp_path / "a.png").read_bytes()[:60])
    with pytest.warns(MienWarning, match=r"b\.png is not a readable image and was skipped"):
        assert [f.index for f in open_video(tmp_path)] == [0]
    assert not re.search(r"\[ *(WARN|ERROR)", capfd.readouterr().err)


def test_an_image_that_states_an_impossible_size_is_left_out(tmp_path: Path) -> None:
    for name in "ab":
        cv2.imwrite(str(tmp_path / f"{name}.png"), gradient(1))
    content = bytearray((tmp_path / "b.png").read_bytes())
    content[16:24] = struct.pack(">II", 100_000, 100_000)
    content[29:33] = struct.pack(">I", zlib.crc32(content[12:29]))
    (tmp_path / "b.png").write_bytes(content)
    with pytest.warns(MienWarning, match=r"b.png is not a readable image"):
        assert [f.index for f in open_video(tmp_path)] == [0]


@pytest.mark.skipif(sys.platform != "linux", reason="names of other systems are text")
def test_a_tiff_may_have_a_name_that_is_not_valid_utf_8(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "0.tif"), gradient(1)[..., ::-1])
    (tmp_path / "0.tif").rename(tmp_path / os.fsdecode(b"\xff.tif"))
    (frame,) = frames_of(tmp_path)
    np.testing.assert_array_equal(frame.pixels, gradient(1))


@pytest.mark.parametrize("fps", [10, 59.94])
def test_a_folder_has_the_frame_rate_that_is_given(fps: float, tmp_path: Path) -> None:
    for k in range(3):
        cv2.imwrite(str(tmp_path / f"{k}.png"), gradient(k))
    video = open_video(tmp_path, fps)
    assert video.fps == fps
    np.testing.assert_allclose([frame.time for frame in video], np.arange(3) / fps)


@pytest.mark.parametrize(
    ("names", "gap"),
    [
        (["img_28", "img_29", "img_33", "img_40"], "img_33.png comes after img_29.png"),
        (["0000", "0005", "0010", "0020"], "0020.png comes after 0010.png"),  # each fifth frame
        (["0000", "0005", "0010", "0015"], None),
        (["1403.58", "1403.61", "1403.65"], None),  # times
        (["a_1", "a_2", "b_7", "b_8", "cover"], None),
        (["take2_009", "take2_010", "take3_001"], None),
        (["29", "33"], None),
    ],
)
def test_a_gap_in_the_numbers_is_told(names: list[str], gap: str | None, tmp_path: Path) -> None:
    for name in names:
        cv2.imwrite(str(tmp_path / f"{name}.png"), gradient(0))
    if gap is None:
        assert len(frames_of(tmp_path)) == len(names)
    else:
        with pytest.warns(MienWarning, match=f"{gap}; gaps in the numbers have no frames and take no time") as told:
            assert [frame.index for frame in open_video(tmp_path)] == list(range(len(names)))
        assert len(told) == 1


def test_images_come_by_their_numbers(tmp_path: Path) -> None:
    for k, name in enumerate(("b1.png", "frame8.png", "frame09.png", "frame10.png", "frame010a.png", "z.png")):
        cv2.imwrite(str(tmp_path / name), gradient(k)[..., ::-1])
    blue = [int(frame.pixels[0, 0, 2]) for frame in frames_of(tmp_path)]
    assert blue == [10 * k for k in range(6)]
