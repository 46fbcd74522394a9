"""The landmarks of a face at the side of the image are those of the same face in the middle, moved there."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from mien.arrays import Array
from mien.frame import Frame
from mien.geometry.camera import Camera, back_project
from mien.geometry.rotation import matrix_from_euler, similarity
from mien.initialization.detector import detect
from mien.initialization.landmarks import Landmarks, place_of
from mien.initialization.straight import straightened
from mien.initialization.upright import Upright
from small_motion import face, seen_by_turned, with_border

BORDER = (300, 100)


@cache
def _middle() -> tuple[Frame, Landmarks, Camera]:
    """A portrait in the middle of a wide image, what is detected in it, and its camera."""
    frame = with_border(face().frame, *BORDER)
    return frame, detect(frame)[0], Camera.centred(500.0, frame.width, frame.height)


def _beside(tilt: float, pan: float) -> tuple[Frame, Array]:
    """The image of the camera once it has turned by these degrees, and the homography (3, 3) to it."""
    frame, _, camera = _middle()
    pixels, homography = seen_by_turned(frame, camera, matrix_from_euler(np.radians([tilt, pan, 0])))
    return Frame(pixels, 7, 0.25), homography


@pytest.mark.parametrize(("tilt", "pan"), [(0, 24), (6, -24), (-5, 18)])
def test_a_face_at_the_side_is_found_as_in_the_middle(tilt: float, pan: float) -> None:
    _, middle, camera = _middle()
    frame, homography = _beside(tilt, pan)
    (seen,) = detect(frame)
    straight = straightened(frame, seen, camera)
    expected = cv2.perspectiveTransform(middle.points[None], homography)[0]

    def apart(landmarks: Landmarks) -> float:
        return float(np.linalg.norm(landmarks.points - expected, axis=1).mean() / place_of(expected)[1])

    assert apart(straight) < 0.006
    assert apart(straight) < 0.6 * apart(seen)
    assert straight.depths is not None
    assert middle.depths is not None
    shape = back_project(np.column_stack([straight.points, straight.depths]), camera)
    shape_middle = back_project(np.column_stack([middle.points, middle.depths]), camera)
    scale, R, t = similarity(shape_middle, shape)
    assert np.abs(shape - (scale * shape_middle @ R.T + t)).mean() < 0.006 * np.ptp(shape, axis=0).max()
    np.testing.assert_allclose(R, matrix_from_euler(np.radians([tilt, pan, 0])), atol=0.02)
    assert (straight.frame_index, straight.time, straight.scheme) == (7, 0.25, seen.scheme)


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_face_at_the_side_of_a_turned_image_is_found_as_in_an_upright_one(quarters: int) -> None:
    _, _, camera = _middle()
    frame, _ = _beside(8, 10)
    (seen,) = detect(frame)
    upright = straightened(frame, seen, camera)
    turned = Upright(Frame(np.ascontiguousarray(np.rot90(frame.pixels, -quarters))), quarters)
    camera = Camera.centred(camera.focal_px, turned.seen.width, turned.seen.height)
    straight = turned.turned_upright(straightened(turned.seen, turned.seen_by_camera(seen), camera))
    np.testing.assert_allclose(straight.points, upright.points, atol=0.05)


def test_a_face_in_the_middle_is_left_as_it_was_found() -> None:
    frame, middle, camera = _middle()
    assert straightened(frame, middle, camera) is middle


def test_what_is_not_found_again_is_left_as_it_was_found() -> None:
    frame, middle, camera = _middle()
    beside = replace(middle, points=middle.points + np.array([250.0, 0.0]))
    assert straightened(Frame(np.full_like(frame.pixels, 90)), beside, camera) is beside
