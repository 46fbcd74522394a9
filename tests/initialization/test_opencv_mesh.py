"""Faces found by OpenCV, with the networks that come with mien."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mien.arrays import Pixels
from mien.initialization.landmarks import Landmarks, place_of
from mien.initialization.opencv_mesh import OpenCVMesh
from small_motion import face, small_motion, turned_portrait


def _portrait() -> Pixels:
    return small_motion().frames[0].pixels


def test_the_points_are_those_of_the_portrait() -> None:
    (found,) = OpenCVMesh(4).faces(_portrait())
    _, points, depths = Landmarks(found[:, :2], "mediapipe468", found[:, 2]).correspondences()
    _, known, known_depths = face().landmarks.correspondences()
    assert np.linalg.norm(points - known, axis=1).mean() < 0.02 * place_of(known)[1]
    assert depths is not None
    assert known_depths is not None
    assert np.corrcoef(depths, known_depths)[0, 1] > 0.98


@pytest.mark.parametrize("deg", [-30.0, -15.0, 20.0, 30.0])
def test_a_face_that_leans_is_seen_upright(deg: float) -> None:
    """The same points, turned along, wherever the picture turns to."""
    (known,), (picture, A) = OpenCVMesh(1).faces(_portrait()), turned_portrait(deg)
    (found,) = OpenCVMesh(1).faces(picture)
    apart = np.linalg.norm(known[:, :2] @ A[:, :2].T + A[:, 2] - found[:, :2], axis=1)
    assert apart.mean() < 0.02 * place_of(known)[1]


def test_places_are_where_a_face_is_in_a_large_picture() -> None:
    room, (centre, size) = np.full((700, 1200, 3), 90, np.uint8), place_of(face().landmarks.points)
    small, at = cv2.resize(_portrait(), None, fx=0.4, fy=0.4, interpolation=cv2.INTER_AREA), (900, 350)
    room[at[1] : at[1] + small.shape[0], at[0] : at[0] + small.shape[1]] = small
    mesh = OpenCVMesh(4)
    assert mesh.places(room)
    for place, side in mesh.places(room):
        assert np.abs(place - 0.4 * centre - at).max() < 0.25 * 0.4 * size
        assert side == pytest.approx(0.4 * size, rel=0.5)


@pytest.mark.parametrize("shape", [(1, 1), (3, 900), (900, 2), (240, 320)])
def test_where_there_is_no_face_none_is_seen(shape: tuple[int, int]) -> None:
    mesh = OpenCVMesh(4)
    for pixels in (np.zeros((*shape, 3), np.uint8), np.full((*shape, 3), 255, np.uint8)):
        assert mesh.faces(pixels) == []
        assert mesh.places(pixels) == []


def test_no_more_faces_are_told_of_than_asked_for() -> None:
    pair = np.hstack([_portrait(), _portrait()])
    assert len(OpenCVMesh(4).faces(pair)) == 2
    assert len(OpenCVMesh(1).faces(pair)) == 1
