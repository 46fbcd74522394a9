"""The search for graphics: what stands still before a face that moves."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from long_motion import sequence
from mien.arrays import Array, Pixels
from mien.frame import Frame
from mien.graphics import Graphics
from mien.initialization.landmarks import Landmarks, place_of
from mien.start.still import StillSearch

LOOKS = range(0, 40, 3)


def _middle() -> tuple[int, int, int]:
    """Position and size of the face in the first frame."""
    (x, y), size = place_of(sequence().landmarks[0])
    return int(x), int(y), int(size)


def _mark(pixels: Pixels) -> Pixels:
    """Half-transparent letters across the face."""
    x, y, size = _middle()
    over = pixels.copy()
    cv2.putText(over, "AB", (x - size // 3, y + size // 5), cv2.FONT_HERSHEY_SIMPLEX, size / 50, (255, 255, 255), 4)
    return np.asarray(cv2.addWeighted(over, 0.7, pixels, 0.3, 0), np.uint8)


def _bar(pixels: Pixels) -> Pixels:
    """A plain bar before the eyes."""
    x, y, size = _middle()
    over = pixels.copy()
    over[y - size // 3 : y - size // 8, x - size // 2 : x + size // 2] = 15
    return over


def _found(change: Callable[[Pixels], Pixels], looks: range = LOOKS) -> Graphics | None:
    """The graphics in these looks at the face that looks about."""
    search = None
    for k in looks:
        frame = Frame(change(sequence().frames[k].pixels), k)
        look = Landmarks(sequence().landmarks[k], "candide26")
        if search is None:
            search = StillSearch(frame, look)
        else:
            search.add(frame, look)
    assert search is not None
    return search.graphics()


def _in_image(graphics: Graphics) -> Array:
    mask = np.zeros((graphics.height, graphics.width), dtype=bool)
    (h, w), y, x = graphics.mask.shape, graphics.y, graphics.x
    mask[y : y + h, x : x + w] = graphics.mask
    return mask


@pytest.mark.parametrize(("change", "share"), [(_mark, 0.5), (_bar, 0.7)])
def test_graphics_are_found_and_nothing_else(change: Callable[[Pixels], Pixels], share: float) -> None:
    found = _found(change)
    assert found is not None
    mask, pixels = _in_image(found), sequence().frames[0].pixels
    changed = (change(pixels) != pixels).any(axis=2)
    x, _, size = _middle()
    searched = np.zeros_like(mask)  # what lies beside the face in half of the looks does not matter
    searched[:, x - size // 3 : x + size // 3] = True
    assert (mask & changed & searched).sum() > share * (changed & searched).sum()
    near = cv2.dilate(changed.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    assert (mask & ~near).sum() < 0.15 * mask.sum()


def test_a_face_alone_has_no_graphics() -> None:
    assert _found(lambda pixels: pixels) is None


def test_before_a_face_that_keeps_still_nothing_is_told_from_it() -> None:
    first = sequence().frames[0].pixels
    assert _found(lambda pixels: _mark(first)) is not None  # the landmarks say that it moves
    assert _found(_mark, range(4)) is None


def test_a_single_look_tells_nothing() -> None:
    assert _found(_mark, range(1)) is None
