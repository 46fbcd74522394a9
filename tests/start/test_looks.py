"""From which of several looks a face is best learned."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from mien.arrays import Array
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING, exp
from mien.initialization.landmarks import LANDMARK_VERTICES, Landmarks, rows_by_name, rows_of_scheme
from mien.start.looks import (
    LEAST_DETAIL,
    PER_DEGREE,
    PER_DETAIL,
    PER_UPPER,
    detail,
    expected_errors,
    eye_opening,
    turn_of,
)
from small_motion import face, small_motion

AHEAD = -FACING[:, 2]
EYES = np.array([LANDMARK_VERTICES[f"{side}_eye_outer_corner"] for side in ("left", "right")])


def look(
    turn_deg: tuple[float, float, float] = (0, 0, 0), scale: float = 1.0, moved: dict[str, float] | None = None
) -> Landmarks:
    """The face of the portrait from far away, turned about its axes, larger, its landmarks moved up by distances of the
    eyes."""
    vertices = face().fit.shape.copy()
    eyes = float(np.linalg.norm(np.diff(vertices[EYES], axis=0)))
    for name, up in (moved or {}).items():
        vertices[LANDMARK_VERTICES[name], 1] += up * eyes
    posed = 100 * scale * vertices @ (FACING @ exp(np.radians(turn_deg))).T
    ids, rows = rows_of_scheme("mediapipe478")
    points = np.zeros((478, 3))
    points[rows] = posed[ids][:, None]
    return Landmarks(points[:, :2] + 200, "mediapipe478", points[:, 2])


def rotation_y(deg: float) -> Array:
    return exp(np.radians([0, deg, 0]))


def errors(*looks: Landmarks, details: tuple[float, ...] = ()) -> Array:
    return expected_errors(looks, details or (1.0,) * len(looks), Camera(1e9, 200, 200), FACING, AHEAD)


def test_a_face_at_rest_that_looks_into_the_camera() -> None:
    """However large it is, and wherever its roll."""
    np.testing.assert_allclose(errors(look(), look(scale=2), look((0, 0, 30))), 1, atol=1e-6)


def test_the_opening_of_the_eyes_by_hand() -> None:
    seen = replace(look(), points=look().points.copy())
    rows = {name: rows_by_name("mediapipe478")[name] for name in LANDMARK_VERTICES if "eye" in name}
    for side, opening in (("right", 3.0), ("left", 5.0)):
        for name, point in {
            "eye_outer_corner": (0.0, 0.0), "eye_inner_corner": (16.0, 12.0),
            "eyelid_upper_mid": (8.0, 4.0), "eyelid_lower_mid": (8.0, 4.0 + opening),
        }.items():  # fmt: skip
            seen.points[rows[f"{side}_{name}"]] = point
    assert eye_opening(seen) == pytest.approx((3 / 20 + 5 / 20) / 2)


def test_a_grin_costs_even_where_it_is_usual() -> None:
    """Units count from what is learned. A mouth is as wide as it is where it never is narrower."""
    wide = replace(look(), points=look().points.copy())
    corners, (right, left) = [61, 291], wide.points[[61, 291]]
    wide.points[corners] += 0.3 * np.array([right - left, left - right])
    grins, rests = errors(wide, wide, wide, look())[[0, 3]]
    assert grins > rests + 1
    np.testing.assert_allclose(errors(wide, wide), 1, atol=1e-6)


def test_shut_eyes_cost_even_where_they_are_usual() -> None:
    """Somebody may weep for most of the looks."""
    opening = np.ptp(face().fit.shape[[LANDMARK_VERTICES[f"left_eyelid_{lid}_mid"] for lid in ("upper", "lower")], 1])
    eyes = float(np.linalg.norm(np.diff(face().fit.shape[EYES], axis=0)))
    lids = [f"{side}_eyelid_upper_mid" for side in ("right", "left")]
    shut = look(moved={lid: -0.9 * opening / eyes for lid in lids})
    narrow = look(moved={lid: -0.3 * opening / eyes for lid in lids})
    weeping, awake = errors(shut, shut, shut, look())[[0, 3]]
    assert weeping > awake + 1
    assert errors(narrow, narrow, narrow, look())[0] == pytest.approx(1, abs=1e-6)


def test_the_turn_of_a_look_is_measured_from_the_first() -> None:
    lips = {name: -0.3 for name in LANDMARK_VERTICES if "lip" in name}
    turned = turn_of(look((0, -20, 0), 2.0, lips), look((0, 10, 0)), Camera(1e9, 200, 200), FACING, AHEAD)
    assert turned == pytest.approx(30, abs=1e-3)


@pytest.mark.parametrize("aside_deg", [-30.0, 20.0])
def test_a_face_is_turned_from_where_it_is_seen_itself(aside_deg: float) -> None:
    """One that enters at the side of the image, and looks into the camera from its middle."""
    camera = Camera(500, 160, 120)

    def seen(at_deg: float, turned_deg: float) -> Landmarks:
        R, ray = rotation_y(turned_deg) @ FACING, rotation_y(at_deg)[:, 2]
        ids, rows = rows_of_scheme("mediapipe478")
        X = face().fit.shape[ids] @ R.T
        points, depths = np.tile(camera.project(9 * ray)[0], (478, 1)), np.zeros(478)
        points[rows] = camera.project(X + 9 * ray)[0][:, None]
        depths[rows] = (X @ ray * 500 / (9 * ray[2]))[:, None]
        return Landmarks(points, "mediapipe478", depths)

    first, R, t = seen(aside_deg, aside_deg), rotation_y(aside_deg) @ FACING, rotation_y(aside_deg)[:, 2]
    assert turn_of(seen(0, 0), first, camera, R, t) == pytest.approx(0, abs=1)
    assert turn_of(seen(0, aside_deg), first, camera, R, t) == pytest.approx(abs(aside_deg), abs=1)


def test_a_frame_with_less_detail_costs_beyond_what_always_differs() -> None:
    found = errors(look(), look(), look(), look(), details=(0.7, 1.0, 0.95, 1.3))
    typical = 0.5 * (0.95 + 1.0)
    np.testing.assert_allclose(found, [1 + PER_DETAIL * (LEAST_DETAIL - 0.7 / typical), 1, 1, 1], atol=1e-6)


def test_detail_is_lost_to_blur_and_not_to_size_and_light() -> None:
    frame, landmarks = small_motion().frames[0], face().landmarks
    pixels, as_it_is = frame.pixels, detail(frame, landmarks)
    blurred = Frame(np.asarray(cv2.GaussianBlur(pixels, (0, 0), 2), np.uint8))
    darker = Frame((0.6 * pixels).astype(np.uint8))
    larger = Frame(np.asarray(cv2.resize(pixels, None, fx=2, fy=2), np.uint8))
    assert detail(blurred, landmarks) < 0.8 * as_it_is
    assert detail(darker, landmarks) == pytest.approx(as_it_is, rel=0.03)
    assert detail(larger, replace(landmarks, points=2 * landmarks.points + 0.5)) == pytest.approx(as_it_is, rel=0.15)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_turn_costs_by_degree(axis: int) -> None:
    turn = [0.0, 0.0, 0.0]
    turn[axis] = 14
    found = errors(look(), look(), look((turn[0], turn[1], turn[2])))
    np.testing.assert_allclose(found, [1, 1, 1 + 14 * PER_DEGREE], atol=1e-6)


def test_who_is_mostly_seen_from_the_side_is_learned_from_the_front() -> None:
    """Whatever a detector makes of the side: it has no say in how the face mostly is."""
    lips = {name: -0.3 for name in LANDMARK_VERTICES if "lip" in name}
    aside, front = look((0, 40, 0), moved=lips), look((0, 5, 0))
    found = errors(look(), aside, front, aside, aside)
    np.testing.assert_allclose(found, [1, np.inf, 1 + 5 * PER_DEGREE, np.inf, np.inf])


def test_raised_brows_cost_where_they_are_mostly_not() -> None:
    brows = {name: 0.1 for name in LANDMARK_VERTICES if "brow" in name}
    raised, rest = look(moved=brows), look()
    found = errors(raised, rest, rest, rest)
    np.testing.assert_allclose(found[1:], 1, atol=1e-6)
    assert found[0] == pytest.approx(1 + PER_UPPER * 0.1 * np.sqrt(6 / 10))  # six of the brows, four of the lids
    assert errors(raised, raised, raised, rest).argmax() == 3


@pytest.mark.parametrize("closed", [("eyelid_upper_mid", -0.06), ("eyelid_lower_mid", 0.06)])
def test_a_blink_and_an_open_mouth_cost(closed: tuple[str, float]) -> None:
    lids = {f"{side}_{closed[0]}": closed[1] for side in ("left", "right")}
    mouth = {name: -0.3 for name in LANDMARK_VERTICES if name.startswith("lower_lip")}
    found = errors(look(), look(moved=lids), look(), look(moved=mouth), look())
    np.testing.assert_allclose(found[[0, 2, 4]], 1, atol=1e-6)
    assert (found[[1, 3]] > 1.2).all()


def test_one_look_is_at_rest() -> None:
    np.testing.assert_allclose(errors(look()), 1, atol=1e-6)
