"""Finding a face again by keyframes: where it is, and not where there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from long_motion import sequence
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING, angle_between, exp
from mien.initialization.landmarks import Landmarks
from mien.tracking.realtime import recovery
from mien.tracking.realtime.pose import Pose
from mien.tracking.realtime.recovery import Keyframes, _pnp, turned_aside
from small_motion import face

NECK = np.array([0.0, 0.0, -0.7])
"""In head axes: eight centimetres behind the middle of the face."""
CLOSE = np.array([0.0, 0.0, 3.0])


@pytest.fixture(scope="module")
def keyframes() -> Keyframes:
    """Of the first frame alone."""
    found = Keyframes(face().fit, face().camera)
    found.add(sequence().frames[0], face().fit.R, face().fit.t, face().fit.animation)
    return found


@pytest.mark.parametrize("index", [0, 3, 6, 36])
def test_a_face_is_found_from_nothing(keyframes: Keyframes, index: int) -> None:
    found = keyframes.find(sequence().frames[index], face().fit.t)
    assert found is not None
    R, t = found
    assert np.degrees(angle_between(R, sequence().R[index])) < 10
    np.testing.assert_allclose(t, sequence().t[index], atol=0.3)


def test_a_head_turns_aside_about_its_neck() -> None:
    fit = face().fit
    before = Pose(exp(np.array([0.0, 0.3, 0.0])) @ fit.R, fit.t + np.array([0.5, 0.2, 1.0]), fit.animation)
    poses = list(turned_aside(before, fit.R))
    turns = [np.degrees(angle_between(pose.R, fit.R)) for pose in poses]
    np.testing.assert_allclose(turns, [50, 25, 0, 25, 50], atol=1e-6)
    for pose in poses:
        np.testing.assert_allclose(pose.R @ NECK + pose.t, before.R @ NECK + before.t, atol=1e-9)


def test_a_detected_face_is_placed_alike_wherever_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """A point that is wrong is left out near the image's corner as elsewhere."""
    landmarks, camera = face().landmarks, face().camera
    points = landmarks.points.copy()
    points[[61, 291]] += [0, 12]
    placed = []
    for shift in (0, 1500):
        seen = replace(landmarks, points=points + np.array([shift, 0]))
        monkeypatch.setattr(recovery, "detect_once", lambda frame, distant, seen=seen: [seen])
        there = replace(camera, cx=camera.cx + shift)
        placed += list(recovery.find_by_detector(sequence().frames[0], face().fit, there, 0.0, True))
    (R, t), (R_shifted, t_shifted) = placed
    np.testing.assert_allclose(R_shifted, R, atol=1e-6)
    np.testing.assert_allclose(t_shifted, t, atol=1e-5)


@pytest.mark.parametrize("quarters", [0, 1, 2, 3])
def test_a_detected_face_is_placed_as_it_lies(quarters: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The detector is shown an upright face, of a frame that is rotated clockwise by quarter turns."""
    frame, landmarks, camera, fit = sequence().frames[0], face().landmarks, face().camera, face().fit

    def detect_once(seen: Frame, distant: bool) -> list[Landmarks]:
        np.testing.assert_array_equal(seen.pixels, frame.pixels)
        return [landmarks]

    monkeypatch.setattr(recovery, "detect_once", detect_once)
    rotated = Frame(np.ascontiguousarray(np.rot90(frame.pixels, -quarters)))
    middle = Camera.centred(camera.focal_px, rotated.width, rotated.height)
    roll = 0.5 * np.pi * quarters + 0.6
    ((R, t),) = recovery.find_by_detector(rotated, fit, middle, roll, True)
    ((upright, at),) = recovery.find_by_detector(frame, fit, camera, 0.0, True)
    turn = exp(np.array([0, 0, 0.5 * np.pi * quarters]))
    np.testing.assert_allclose(R, turn @ upright, atol=1e-6)
    np.testing.assert_allclose(t, turn @ at, atol=1e-5)


def test_a_face_is_found_at_another_place_and_size(keyframes: Keyframes) -> None:
    """The picture shifted by 60 pixels to the right and 20 down."""
    pixels = np.roll(sequence().frames[0].pixels, (20, 60), axis=(0, 1))
    found = keyframes.find(Frame(pixels), 1.2 * face().fit.t)
    assert found is not None
    before, after = (face().camera.project(t)[0] for t in (face().fit.t, found[1]))
    np.testing.assert_allclose(after - before, [60, 20], atol=4)


def test_a_face_is_found_anywhere_in_a_large_picture_at_the_cost_of_a_small_one() -> None:
    height, width = 1500, 2000
    pixels = np.full((height, width, 3), 128, np.uint8)
    pixels[-240:, -320:] = sequence().frames[0].pixels
    fit, portrait = face().fit, face().camera
    keyframes = Keyframes(fit, Camera(portrait.focal_px, width - 320 + portrait.cx, height - 240 + portrait.cy))
    keyframes.add(Frame(pixels), fit.R, fit.t, fit.animation)
    last = fit.t - [1700 / portrait.focal_px * fit.t[2], 0, 0]
    found = [place for _ in range(50) if (place := keyframes.find(Frame(pixels), last)) is not None]
    assert len(found) >= 2
    np.testing.assert_allclose(found[0][1], fit.t, atol=0.3)
    windows = [keyframes._window(Frame(pixels), last, scale=1.0) for _ in range(50)]
    assert {window.shape for window, _ in windows} == {(440, 440)}
    corners = {tuple(corner) for _, corner in windows}
    assert {(0, 0), (width - 440, 0), (0, height - 440), (width - 440, height - 440)} <= corners


@pytest.mark.parametrize("value", [0, 128, 255])
def test_nothing_is_found_in_a_flat_picture(keyframes: Keyframes, value: int) -> None:
    pixels = np.full((240, 320, 3), value, np.uint8)
    assert keyframes.find(Frame(pixels), CLOSE) is None


def test_nothing_is_found_in_noise(keyframes: Keyframes) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (240, 320, 3)).astype(np.uint8)
    assert keyframes.find(Frame(pixels), CLOSE) is None


def test_without_keypoints_nothing_is_found() -> None:
    empty = Keyframes(face().fit, face().camera)
    empty.add(Frame(np.zeros((240, 320, 3), np.uint8)), face().fit.R, face().fit.t, face().fit.animation)
    assert len(empty.keyframes[0].features[0]) == 0
    assert empty.find(sequence().frames[0], CLOSE) is None


def test_a_view_is_new_where_no_other_is_near(keyframes: Keyframes) -> None:
    assert not keyframes.is_new(face().fit.R)
    assert keyframes.is_new(sequence().R[10])


def test_points_that_coincide_give_no_pose() -> None:
    X = np.random.default_rng(0).normal(size=(10, 3))
    assert _pnp(X, np.full((10, 2), 50.0), face().camera, 5.0) is None


@pytest.mark.parametrize("roll_deg", [0.0, 90.0, 180.0, -40.0])
def test_a_head_that_lies_on_its_side_turns_aside_about_its_own_axis(roll_deg: float) -> None:
    first = Pose(exp(np.radians([0.0, 0.0, roll_deg])) @ FACING, np.array([0.0, 0.0, 9.0]), np.zeros(6))
    for pose in turned_aside(first, first.R):
        np.testing.assert_allclose(pose.R[:, 1], first.R[:, 1], atol=1e-9)
