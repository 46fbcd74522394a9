"""Landmarks: their schemes, which vertices they are, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mien.arrays import Array
from mien.candide.model import Candide
from mien.errors import MienError
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING, exp
from mien.initialization.landmarks import LANDMARK_NAMES, LANDMARK_VERTICES, SCHEMES, VERTICES, Landmarks

COUNTS = {"candide26": 26, "ibug68": 68, "mediapipe478": 478, "mediapipe468": 468}


def _spread(size: float = 100.0, corner: tuple[float, float] = (50, 60)) -> Landmarks:
    """26 points that fill a square."""
    points = np.random.default_rng(0).uniform(0, size, (26, 2))
    points[:2] = [[0, 0], [size, size]]
    return Landmarks(points + corner, "candide26", source="face.json")


def test_landmarks_stay_as_they_are_where_a_program_goes_on_in_its_array() -> None:
    points = _spread().points.copy()
    landmarks = Landmarks(points, "candide26")
    points += 1
    np.testing.assert_array_equal(landmarks.points, _spread().points)


def test_landmarks_of_several_faces_are_told_apart() -> None:
    faces = [_spread(), _spread(), _spread()]
    assert faces.index(faces[2]) == 2
    assert len(set(faces)) == 3


@pytest.mark.parametrize("scheme", SCHEMES)
def test_correspondences_pick_rows(scheme: str) -> None:
    """Each point stands for its own row, so that it is seen which were picked; roots, so that no middle of two of
    them is a third."""
    own = np.sqrt(np.arange(COUNTS[scheme]))
    vertices, picked, depths = Landmarks(own[:, None] * np.array([1.0, -1]), scheme, 10.0 * own).correspondences()
    assert depths is not None
    np.testing.assert_allclose(picked[:, 1], -picked[:, 0])
    np.testing.assert_allclose(depths, 10 * picked[:, 0])
    assert len(set(vertices)) == len(vertices)
    assert len(set(picked[:, 0])) == len(picked)


@pytest.mark.parametrize("scheme", ["ibug68", "mediapipe478"])
def test_correspondences_are_as_symmetric_as_the_face(scheme: str) -> None:
    vertices, _, _ = Landmarks(np.zeros((COUNTS[scheme], 2)), scheme).correspondences()
    points = Candide.default().mean[vertices]
    to_mirrored = np.linalg.norm(points[:, None] * [-1, 1, 1] - points[None], axis=2)
    np.testing.assert_allclose(to_mirrored.min(axis=1), 0, atol=1e-9)


def test_ibug_corners_of_the_eyes_and_the_mouth() -> None:
    """36, 39, 42, 45, 48 and 54 from the left of the image to its right, as annotated."""
    vertices, picked, _ = Landmarks(np.arange(68)[:, None] * np.ones(2), "ibug68").correspondences()
    by_row = {int(row): int(vertex) for row, vertex in zip(picked[:, 0], vertices, strict=True)}
    names = Candide.default().vertex_names
    assert [names[by_row[k]] for k in (36, 39, 42, 45, 48, 54)] == [
        "right_eye_outer_corner", "right_eye_inner_corner", "left_eye_inner_corner", "left_eye_outer_corner",
        "right_mouth_corner_outer", "left_mouth_corner_outer",
    ]  # fmt: skip


def test_the_landmarks_are_called_as_their_vertices() -> None:
    names = Candide.default().vertex_names
    assert len(LANDMARK_NAMES) == 26
    assert [names[v] for v in LANDMARK_VERTICES.values()] == list(LANDMARK_NAMES)


def test_right_is_left_in_the_image() -> None:
    model: Array = Candide.default().mean
    points, _ = Camera(280, 160, 120).project(model @ FACING.T + [0, 0, 5])
    assert points[LANDMARK_VERTICES["right_eye_outer_corner"], 0] < points[LANDMARK_VERTICES["nose_tip"], 0]


def test_points_may_be_lists() -> None:
    landmarks = Landmarks([[float(k), 2.0] for k in range(68)], "ibug68")  # type: ignore[arg-type]
    assert landmarks.correspondences()[1].shape[1] == 2


def test_bad_values_are_refused() -> None:
    with pytest.raises(MienError, match="unknown scheme 'dlib'"):
        Landmarks(np.zeros((68, 2)), "dlib")
    with pytest.raises(MienError, match="ibug68 needs 68 points"):
        Landmarks(np.zeros((26, 2)), "ibug68")
    points = np.zeros((26, 2))
    points[3, 1] = np.nan
    with pytest.raises(MienError, match=r"face\.json: .*finite"):
        Landmarks(points, "candide26", source="face.json")
    with pytest.raises(MienError, match=r"face\.json: its frame has the time -inf s"):
        Landmarks(np.zeros((26, 2)), "candide26", time=-np.inf, source="face.json")
    for wrong in ({"frame_index": None}, {"time": "soon"}, {"disagreement": "little"}, {"frame_index": np.inf}):
        with pytest.raises(
            MienError, match=r"face\.json: the frame's index, its time or the disagreement is no number"
        ):
            Landmarks(np.zeros((26, 2)), "candide26", source="face.json", **wrong)  # type: ignore[arg-type]
    with pytest.raises(MienError, match=r"face\.json: the `graphics` are <class 'str'>; remove them"):
        Landmarks(np.zeros((26, 2)), "candide26", source="face.json", graphics="a logo")  # type: ignore[arg-type]


@pytest.mark.parametrize("depths", [[1.0, 2.0], [float("nan")] * 26, ["deep"] * 26])
def test_bad_depths_are_refused(depths: list[Any]) -> None:
    with pytest.raises(MienError, match="depths"):
        Landmarks(np.zeros((26, 2)), "candide26", depths)  # type: ignore[arg-type]


def test_what_lies_in_the_image_is_accepted() -> None:
    _spread().check(320, 240)
    _spread(corner=(-20, 60)).check(320, 240)  # a face that the edge cuts


@pytest.mark.parametrize("corner", [(-30, 60), (50, -30), (250, 60), (50, 170)])
def test_points_outside_the_image_are_refused(corner: tuple[float, float]) -> None:
    with pytest.raises(MienError, match=r"face\.json: landmarks lie outside the image of 320x240"):
        _spread(corner=corner).check(320, 240)


@pytest.mark.parametrize(("scheme", "row", "name"), [("mediapipe478", 61, "61"), ("mediapipe478", 133, "133/155")])
def test_a_point_far_outside_is_named(scheme: str, row: int, name: str) -> None:
    landmarks = Landmarks(np.random.default_rng(0).uniform(100, 200, (478, 2)), scheme)
    landmarks.points[row, 1] = 9999
    with pytest.raises(MienError, match=rf"lie outside the image of 320x240 pixels, point {name} farthest"):
        landmarks.check(320, 240)


def test_mirrored_landmarks_are_refused() -> None:
    model: Array = Candide.default().mean[VERTICES]
    for pan in np.radians([-80, -40, 0, 40, 80]):
        turned = model @ (FACING @ exp(np.array([0, pan, 0]))).T + [0, 0, 5]
        points, _ = Camera(280, 160, 120).project(turned)
        Landmarks(points, "candide26").check(320, 240)
    points, _ = Camera(280, 160, 120).project(model @ FACING.T + [0, 0, 5])
    for wrong in (points * [-1, 1] + [320, 0], points * [1, -1] + [0, 240]):
        with pytest.raises(MienError, match=r"face\.json: the landmarks are mirrored"):
            Landmarks(wrong, "candide26", source="face.json").check(320, 240)


def test_depths_in_another_unit_are_refused() -> None:
    landmarks = _spread(size=100)
    across = landmarks.points[:, 0]
    replace(landmarks, depths=across).check(320, 240)
    with pytest.raises(MienError, match=r"the depths span .* give depths in pixels"):
        replace(landmarks, depths=100 * across).check(320, 240)


def test_small_faces_are_refused() -> None:
    _spread(size=41).check(320, 240)
    with pytest.raises(MienError, match="measures 39"):
        _spread(size=39).check(320, 240)


@pytest.mark.parametrize("row", [0, 1])
def test_points_on_one_line_are_refused(row: int) -> None:
    """As where a column of a table is empty: a line of a face in full profile is not one."""
    points = _spread().points.copy()
    points[:, row] = 60
    with pytest.raises(MienError, match=r"face\.json: the landmarks lie on one line"):
        replace(_spread(), points=points).check(320, 240)
    points[:, row] += 0.1 * (_spread().points[:, row] - 60)
    replace(_spread(), points=points).check(320, 240)


def test_a_landmark_that_is_marked_outside_the_image_is_named() -> None:
    replace(_spread(), marked={"nose_tip": [330, 100]}).check(320, 240)
    with pytest.raises(MienError, match=r"face\.json: `marked` has nose_tip at 1000, 100, outside the image"):
        replace(_spread(), marked={"nose_tip": [1000, 100]}).check(320, 240)
