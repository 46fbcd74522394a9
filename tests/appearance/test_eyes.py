"""Closed eyes, and eyes that look aside, are drawn where the eyes are, and nowhere else."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from mien.appearance.eyes import close_eye, turn_eye
from mien.arrays import Array, Pixels

CORNERS, LIDS = np.array([[40.0, 50.0], [80.0, 50.0]]), np.array([[60.0, 42.0], [60.0, 58.0]])
SKIN, EYE = 200, 40


def _open_eye() -> Pixels:
    """Skin with a dark opening between two parabolas."""
    y, x = np.mgrid[0:100, 0:120]
    arch = np.maximum(1 - ((x - 60) / 20) ** 2, 0)
    return np.where(np.abs(y - 50) < 8 * arch, EYE, SKIN).astype(np.uint8)


def test_skin_covers_a_closed_eye() -> None:
    image = _open_eye()
    before = image.copy()
    closed = close_eye(image, CORNERS, LIDS, 1.0)
    assert closed[46:54, 55:66].min() > 0.9 * SKIN
    np.testing.assert_array_equal(image, before)
    outside = np.ones(image.shape, bool)
    outside[30:70, 36:84] = False
    np.testing.assert_array_equal(closed[outside], image[outside])


def test_half_closed_shows_the_lower_half() -> None:
    column = close_eye(_open_eye(), CORNERS, LIDS, 0.5)[:, 60].astype(int)
    assert column[44:48].min() > 0.9 * SKIN
    assert column[53:56].max() < 1.1 * EYE


def test_an_iris_moves_with_the_eye_and_leaves_white_behind() -> None:
    """White 190 and a dark iris of five pixels in the middle, moved by a quarter of the eye's 40 to either side."""
    image = np.where(_open_eye() == EYE, 190, SKIN).astype(np.uint8)
    image[46:55, 58:63] = EYE
    for share, x in ((0.25, 70), (-0.25, 50)):
        turned = turn_eye(image, CORNERS, LIDS, share)
        assert turned[50, x - 1 : x + 2].max() < 1.1 * EYE
        assert turned[48:53, 58:63].min() > 180
        np.testing.assert_array_equal(turned[turned == SKIN], SKIN)
        np.testing.assert_array_equal((turned == SKIN)[:40], (image == SKIN)[:40])


@pytest.mark.parametrize("draw", [close_eye, turn_eye])
@pytest.mark.parametrize("turns", [1, 2])
def test_a_turned_picture_is_drawn_alike(turns: int, draw: Callable[..., Pixels]) -> None:
    image = _open_eye()[:100, 10:110]
    corners, lids = CORNERS - [10, 0], LIDS - [10, 0]

    def turned(points: Array) -> Array:
        for _ in range(turns):
            points = np.column_stack([points[:, 1], 99 - points[:, 0]])
        return points

    expected = np.rot90(draw(image, corners, lids, 0.3), turns)
    found = draw(np.ascontiguousarray(np.rot90(image, turns)), turned(corners), turned(lids), 0.3)
    assert np.abs(found.astype(int) - expected).mean() < 1


def test_an_eye_outside_the_picture_or_without_size_changes_nothing() -> None:
    image = _open_eye()
    for corners, lids in ((CORNERS + 500, LIDS + 500), (np.full((2, 2), 50.0), np.full((2, 2), 50.0))):
        for draw in (close_eye, turn_eye):
            np.testing.assert_array_equal(draw(image, corners, lids, 1.0), image)
