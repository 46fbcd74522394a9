"""A view holds the head, at a size that the surface can sample."""

from __future__ import annotations

import numpy as np
import pytest

from mien.baselines.surface import Pose
from mien.baselines.view import look
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING
from small_motion import face


def test_no_view_of_a_head_outside_the_image() -> None:
    for t in ([60.0, 0, 10], [0, 0, -5], [0, 0, 0.01]):
        assert look(face().frame, Pose(FACING, np.array(t)), face().camera) is None


def test_a_large_head_is_shrunk_and_projects_to_the_same_place() -> None:
    ramp = np.tile(np.arange(640, dtype=float) * 255 / 640, (480, 1))
    frame = Frame(np.repeat(ramp[..., None], 3, axis=2).astype(np.uint8))
    camera = Camera.centred(900, 640, 480)
    X = np.array([[0.1, 0.05, 4.0]])
    view = look(frame, Pose(FACING, np.array([0.0, 0, 4])), camera)
    assert view is not None
    assert view.levels[0].shape[0] < 480
    values, inside = view.read(1, view.camera.project(X)[0])
    assert inside.all()
    assert values[0, 0] == pytest.approx(camera.project(X)[0][0, 0] * 255 / 640, abs=1.0)


def test_the_pixels_of_a_shrunk_view_are_in_the_middle_of_those_that_they_hold() -> None:
    ramp = np.tile(np.arange(250, dtype=np.uint8), (250, 1))
    camera = Camera.centred(960, 250, 250)
    pose = Pose(FACING, np.array([0.0, 0, 4]))
    X = np.array([[0.1, 0.05, 4.0]])
    for grey, axis in ((ramp, 0), (ramp.T.copy(), 1)):
        view = look(Frame(grey), pose, camera)
        assert view is not None
        assert view.levels[0].shape[0] == 83
        values, _ = view.read(1, view.camera.project(X)[0])
        assert values[0, 0] == pytest.approx(camera.project(X)[0][0, axis], abs=0.1)
