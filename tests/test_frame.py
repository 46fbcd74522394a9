"""Images and their grey values, converted only where they are asked for."""

from __future__ import annotations

import gc
import pickle
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest

from mien.arrays import Pixels
from mien.errors import MienError
from mien.frame import Decoded, Frame
from mien.graphics import Graphics
from mien.video import open_video
from videos import frames_of, gradient, turn_by_metadata, write_video


def test_gray_is_luminance() -> None:
    frame = Frame(np.full((2, 3, 3), (255, 0, 0), np.uint8))
    assert frame.gray.shape == (2, 3)
    assert np.all(frame.gray == 76)  # 0.299 of 255
    assert (frame.width, frame.height) == (3, 2)


def test_one_line_tells_of_a_frame() -> None:
    assert repr(Frame(gradient(0), 12, 0.5)) == "<Frame 12 at 0.50 s, 64x48 pixels>"


@pytest.mark.parametrize(
    ("pixels", "told"),
    [
        (np.zeros(4, np.uint8), "an array (4,) of uint8"),
        (np.zeros((4, 4, 1), np.uint8), "an array (4, 4, 1) of uint8"),
        (np.zeros((4, 4), np.uint16), "an array (4, 4) of uint16"),
        (np.zeros((4, 4, 4), np.uint8), "an array (4, 4, 4) of uint8"),
        (np.zeros((4, 4, 3), np.uint16), "an array (4, 4, 3) of uint16"),
        (np.zeros((4, 4, 3)), "an array (4, 4, 3) of float64"),
        (np.zeros((0, 4, 3), np.uint8), "an array (0, 4, 3) of uint8"),
        ([[[0, 0, 0]]], "<class 'list'>"),
        (None, "<class 'NoneType'>"),
    ],
)
def test_pixels_that_are_no_rgb_or_grey_of_8_bits_are_refused(pixels: Any, told: str) -> None:
    with pytest.raises(MienError, match=r"in RGB, as cv2.*or \(height, width\) of uint8 of a grey") as raised:
        Frame(pixels)
    assert told in str(raised.value)
    assert ("the upper 8 of 12 bits are (image >> 4)" in str(raised.value)) is ("uint16" in told)


PART = slice(5, 30), slice(7, 40)


@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize("graphics", [None, Graphics(64, 48, 10, 6, np.ones((4, 9), np.bool_))])
def test_a_grey_image_is_its_own_luminance(
    graphics: Graphics | None, order: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    grey = gradient(0)[:, ::order, 0]
    pixels = np.repeat(grey[..., None], 3, axis=2)
    expected = Frame(pixels).behind(graphics).gray
    monkeypatch.setattr(cv2, "cvtColor", None)
    frame = Frame(grey, 4, 0.2).behind(graphics)
    for seen in (frame, pickle.loads(pickle.dumps(frame))):
        np.testing.assert_array_equal(seen.gray, expected)
        np.testing.assert_array_equal(seen.gray_part(*PART), expected[PART])
        np.testing.assert_array_equal(seen.brightness, grey)
        np.testing.assert_array_equal(seen.pixels, pixels)
        assert (seen.index, seen.time, seen.width, seen.height) == (4, 0.2, 64, 48)


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


def _spot(x: float, y: float) -> Pixels:
    """(64, 96, 3) a bright round spot around a point."""
    rows, columns = np.mgrid[:64, :96]
    spot = 40 + 200 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * 5**2))
    return np.repeat(np.round(spot).astype(np.uint8)[..., None], 3, axis=2)


def _centre(gray: Pixels) -> tuple[float, float]:
    """The column and the row of the centre of what is brighter than the border."""
    weights = np.clip(gray.astype(float) - gray[0, 0] - 5, 0, None)
    rows, columns = np.mgrid[: gray.shape[0], : gray.shape[1]]
    return float((weights * columns).sum() / weights.sum()), float((weights * rows).sum() / weights.sum())


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("aspect", [Fraction(1), Fraction(8, 9), Fraction(4, 3)])
@pytest.mark.parametrize("first", ["tff", "bff"])
def test_of_an_interlaced_picture_the_upper_field_is_seen_where_it_is(
    first: str, aspect: Fraction, turned: bool, tmp_path: Path
) -> None:
    upper, lower = _spot(40.3, 30.6), _spot(52.0, 41.0)
    woven = upper.copy()
    woven[1::2] = lower[1::2]
    shown = []
    for name, image, how in (("plain", upper, "progressive"), ("woven", woven, f"interlaced=1:{first}=1")):
        options = {"qp": "0"} | ({"x264-params": how} if name == "woven" else {})
        path = tmp_path / f"{name}.mp4"
        write_video(path, [image] * 3, codec="libx264", pix_fmt="yuv420p", options=options, aspect=aspect)
        if turned:
            turn_by_metadata(path)
        shown.append(frames_of(path)[1])
    plain, seen = shown
    assert (plain.interlaced, seen.interlaced) == (False, True)
    for picture, expected in ((seen.gray, plain.gray), (seen.pixels[..., 1], plain.pixels[..., 1])):
        assert picture.shape == expected.shape
        np.testing.assert_allclose(_centre(picture), _centre(expected), atol=0.05)
        np.testing.assert_allclose(picture.astype(int), expected.astype(int), atol=5)


@pytest.mark.parametrize("space", ["bt2020c", "ycgco", "ictcp"])
def test_a_colour_space_that_ffmpeg_does_not_convert_is_read_as_the_usual_one(space: str, tmp_path: Path) -> None:
    pixels = []
    for colormatrix in ("undef", space):
        how = {"x264-params": f"colormatrix={colormatrix}"}
        path = write_video(
            tmp_path / "x.mp4", [gradient(0)], codec="libx264", pix_fmt="yuv420p", options=how, aspect=Fraction(2)
        )
        pixels.append(frames_of(path)[0].pixels)
    np.testing.assert_array_equal(*pixels)


def test_a_frame_goes_to_another_process(video: Path) -> None:
    frame = pickle.loads(pickle.dumps(frames_of(video)[3]))
    assert (frame.index, frame.time) == (3, pytest.approx(0.12, abs=1e-3))
    np.testing.assert_array_equal(frame.pixels, gradient(3))
    np.testing.assert_array_equal(frame.gray, cv2.cvtColor(gradient(3), cv2.COLOR_RGB2GRAY))


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


@pytest.mark.parametrize(("index", "time"), [(None, 0.0), (0, None), (0.5, 0.0), (0, "1")])
def test_index_and_time_are_numbers(index: Any, time: Any) -> None:
    with pytest.raises(MienError, match="a frame has the index"):
        Frame(np.zeros((4, 4, 3), np.uint8), index, time)
