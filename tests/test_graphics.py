"""Graphics before a face: what replaces them, and their way into a file and back."""

from __future__ import annotations

import base64
import pickle
import struct
import zlib

import numpy as np
import pytest

from mien.arrays import Mask, Pixels
from mien.errors import MienError
from mien.frame import Frame
from mien.graphics import Graphics

HEIGHT, WIDTH = 40, 60
RING = np.ones((12, 16), dtype=bool)
RING[4:8, 5:11] = False


def _slope() -> Pixels:
    """Grey values that grow evenly to the right and downwards."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    return np.asarray(20 + 2 * x + y, np.uint8)


def _with_ring(x: int, y: int) -> tuple[Pixels, Graphics, Mask]:
    """The slope behind a white ring; the ring, and where it is in the image."""
    graphics, covered = Graphics(WIDTH, HEIGHT, x, y, RING), np.zeros((HEIGHT, WIDTH), dtype=bool)
    covered[y : y + RING.shape[0], x : x + RING.shape[1]] = RING
    gray = _slope()
    gray[covered] = 255
    return gray, graphics, covered


def _seen_behind(gray: Pixels, graphics: Graphics) -> Frame:
    return Frame(np.repeat(gray[:, :, None], 3, axis=2)).behind(graphics)


def test_an_even_slope_is_restored_behind_graphics() -> None:
    gray, graphics, covered = _with_ring(20, 15)
    frame = _seen_behind(gray, graphics)
    assert np.abs(frame.gray.astype(int) - _slope())[covered].max() <= 1
    np.testing.assert_array_equal(frame.gray[~covered], gray[~covered])
    assert (frame.pixels[covered] == 255).all()


@pytest.mark.parametrize(("x", "y"), [(0, 0), (WIDTH - 16, HEIGHT - 12), (0, 15)])
def test_at_the_border_the_nearest_pixels_inside_replace_graphics(x: int, y: int) -> None:
    gray, graphics, covered = _with_ring(x, y)
    assert np.abs(_seen_behind(gray, graphics).gray.astype(int) - _slope())[covered].max() <= 32


@pytest.mark.parametrize(
    ("rows", "columns"),
    [
        (slice(10, 30), slice(15, 40)),  # all of it
        (slice(18, 22), slice(23, 25)),  # within it
        (slice(0, 20), slice(30, WIDTH)),  # a corner of it
        (slice(0, 10), slice(0, 10)),  # elsewhere
    ],
)
def test_a_part_is_as_it_is_in_the_whole(rows: slice, columns: slice) -> None:
    gray, graphics, _ = _with_ring(20, 15)
    frame = _seen_behind(gray, graphics)
    np.testing.assert_array_equal(frame.gray_part(rows, columns), frame.gray[rows, columns])


def test_the_frame_itself_stays_as_it_is() -> None:
    gray, graphics, _ = _with_ring(20, 15)
    frame = Frame(np.repeat(gray[:, :, None], 3, axis=2))
    assert (frame.behind(graphics).gray != gray).any()
    np.testing.assert_array_equal(frame.gray, gray)
    assert frame.behind(None) is frame


def test_graphics_take_the_place_of_others_and_are_pickled() -> None:
    gray, graphics, covered = _with_ring(20, 15)
    frame = _seen_behind(gray, Graphics(WIDTH, HEIGHT, 3, 3, RING[:5, :7]))
    assert (frame.gray[covered] == 255).all()
    again = frame.behind(graphics)
    assert (again.gray[covered] < 255).all()
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(again)).gray, again.gray)
    np.testing.assert_array_equal(again.behind(None).gray, gray)


def test_where_graphics_fill_the_image_nothing_is_known() -> None:
    everything = Graphics(8, 6, 0, 0, np.ones((6, 8), dtype=bool))
    assert (_seen_behind(np.full((6, 8), 200, np.uint8), everything).gray == 0).all()


def test_the_share_of_graphics_around_points() -> None:
    graphics = Graphics(WIDTH, HEIGHT, 20, 10, np.ones((10, 10), dtype=bool))
    points = np.array([[25.0, 15.0], [20.0, 15.0], [20.0, 10.0], [50.0, 15.0], [-9.0, -9.0]])
    np.testing.assert_allclose(graphics.share_around(points, 4), [1, 0.5, 0.25, 0, 0])
    assert graphics.share_around(np.array([[-np.inf, -np.inf]]), 4) == 0  # behind the camera


def test_graphics_come_back_from_plain_values() -> None:
    _, graphics, _ = _with_ring(20, 15)
    again = Graphics.from_dict(graphics.to_dict())
    assert (again.width, again.height, again.x, again.y) == (WIDTH, HEIGHT, 20, 15)
    np.testing.assert_array_equal(again.mask, RING)


def test_graphics_outside_the_image_are_refused() -> None:
    with pytest.raises(MienError, match="lie outside 60x40"):
        Graphics(WIDTH, HEIGHT, 50, 15, RING)
    values = Graphics(WIDTH, HEIGHT, 20, 15, RING).to_dict()
    huge = bytearray(base64.b64decode(values["mask_png"]))
    huge[16:24] = struct.pack(">II", 100_000, 100_000)
    huge[29:33] = struct.pack(">I", zlib.crc32(huge[12:29]))
    for png in (b"", b"text", bytes(huge)):
        with pytest.raises(MienError, match="no PNG"):
            Graphics.from_dict(values | {"mask_png": base64.b64encode(png).decode()})
