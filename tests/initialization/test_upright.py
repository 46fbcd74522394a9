"""Frames turned so that a face is upright."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mien.frame import Frame
from mien.initialization.upright import Upright, quarters_of, roll_of
from small_motion import face


@pytest.mark.parametrize("quarters", [0, 1, 2, 3])
def test_pixels_and_points_are_turned_alike(quarters: int) -> None:
    pixels = np.zeros((4, 7, 3), np.uint8)
    pixels[1, 5] = 255
    view = Upright(Frame(pixels, 3, 0.5), quarters)
    assert (view.frame.index, view.frame.time) == (3, 0.5)
    at = view.point((5.0, 1.0))
    assert at is not None
    assert view.frame.pixels[round(at[1]), round(at[0])].tolist() == [255, 255, 255]
    np.testing.assert_allclose(view.points_seen(np.array([at])), [[5, 1]], atol=1e-9)
    assert view.point(None) is None


@pytest.mark.parametrize("quarters", [0, 1, 2, 3])
def test_a_face_that_has_rolled_is_upright_there(quarters: int) -> None:
    seen = Frame(np.zeros((240, 320, 3), np.uint8))
    known = face().landmarks
    upright = Upright(seen, quarters)
    rolled = upright.seen_by_camera(known)
    assert abs(roll_of(known)) < np.radians(10)
    assert quarters_of(roll_of(rolled)) == quarters
    np.testing.assert_allclose(upright.turned_upright(rolled).points, known.points, atol=1e-9)


@pytest.mark.parametrize("deg", [-170, -30, 20, 130])
def test_roll_is_clockwise_in_the_image(deg: float) -> None:
    c, s = np.cos(np.radians(deg)), np.sin(np.radians(deg))
    known = face().landmarks
    rolled = replace(known, points=known.points @ np.array([[c, s], [-s, c]]))
    assert np.degrees((roll_of(rolled) - roll_of(known)) % (2 * np.pi)) == pytest.approx(deg % 360)
