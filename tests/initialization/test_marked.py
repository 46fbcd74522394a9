"""Marks without depths are completed by a detector; landmarks stay where they were marked."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mien
from mien.errors import MienError, MienWarning
from mien.frame import Frame
from mien.initialization.landmark_files import read_landmarks, write_landmarks
from mien.initialization.landmarks import LANDMARK_NAMES, Landmarks, count_of_scheme, rows_of_scheme
from mien.initialization.marked import completed
from small_motion import face, small_motion

VERTICES, ROWS = rows_of_scheme("candide26")


def _marks(noise: float = 0.0) -> Landmarks:
    """The portrait's 26 landmarks as somebody would mark them."""
    rng, known = np.random.default_rng(0), face().landmarks.reported()
    missing = face().camera.project(face().fit.in_camera())[0]
    points = np.zeros((count_of_scheme("candide26"), 2))
    for (row, _), vertex, name in zip(ROWS, VERTICES, LANDMARK_NAMES, strict=True):
        points[row] = known.get(name, missing[vertex])
    return Landmarks(points + rng.normal(0, noise, points.shape), "candide26", source="marks")


def test_a_marked_face_has_the_detectors_depths_and_its_own_landmarks() -> None:
    frame, marks = face().frame, _marks(noise=1.0)
    found = completed(frame, marks, face().camera)
    assert found.depths is not None
    assert found.scheme.startswith("mediapipe")
    whole = face().landmarks.points
    assert np.linalg.norm(found.points[: len(whole)] - whole[: len(found.points)], axis=1).mean() < 1.5
    for name, point in marks.reported().items():
        np.testing.assert_array_equal(found.reported()[name], point)
    assert completed(frame, found, face().camera) is found


def test_marks_stay_marks_where_no_face_is_found() -> None:
    blank = Frame(np.full_like(face().frame.pixels, 128))
    with pytest.warns(MienWarning, match="marks: no face is detected where it was marked"):
        assert completed(blank, _marks(), face().camera).depths is None


def test_marks_of_another_face_are_not_completed() -> None:
    marks = _marks()
    wrong = replace(marks, points=marks.points + np.random.default_rng(0).normal(0, 0.1 * marks.size, (26, 2)))
    with pytest.warns(MienWarning, match="no face is detected"):
        assert completed(face().frame, wrong, face().camera) is wrong


@pytest.mark.parametrize(("scale", "right"), [(1.25, 0.0), (0.8, 0.0), (1.0, 0.2)])
def test_marks_of_another_frame_or_size_of_image_are_not_completed(scale: float, right: float) -> None:
    """The face that is detected fits them when it is moved, but it is not there."""
    marks = _marks()
    wrong = replace(marks, points=scale * marks.points + [right * marks.size, 0.0])
    with pytest.warns(MienWarning, match="no face is detected where it was marked.*this frame at its size"):
        assert completed(face().frame, wrong, face().camera) is wrong


def test_a_track_from_marks_reports_them_and_is_repeated_from_its_json(tmp_path: Path) -> None:
    frames, marks = small_motion().frames, _marks(noise=0.5)
    write_landmarks(tmp_path / "marks.json", marks)
    track = mien.track(frames, landmarks=tmp_path / "marks.json", camera=face().camera, save=tmp_path / "t.csv")
    first = next(iter(track.estimates()))
    assert first.landmarks is not None
    assert first.landmarks.image is not None
    # Lids follow the closing that is found in the first frame.
    still = [name for name in LANDMARK_NAMES if "eyelid" not in name]
    rows = [LANDMARK_NAMES.index(name) for name in still]
    np.testing.assert_allclose(first.landmarks.image[rows], marks.points[rows], atol=0.01)
    saved = read_landmarks(tmp_path / "t.json")
    assert saved.marked is not None
    assert set(saved.marked) == set(LANDMARK_NAMES)
    again = mien.track(frames, landmarks=tmp_path / "t.json", camera=face().camera)
    np.testing.assert_array_equal(again.euler_deg, track.euler_deg)


@pytest.mark.parametrize(
    "marked", [{"nose": [1.0, 2.0]}, {"nose_tip": [1.0]}, {"nose_tip": [1.0, float("nan")]}, {"nose_tip": [1, "a"]}]
)
def test_marks_that_are_none_are_refused(marked: Any) -> None:
    with pytest.raises(MienError, match=f"`marked` has no point for a landmark at {next(iter(marked))!r}"):
        replace(_marks(), marked=marked)
    with pytest.raises(MienError, match="`marked` needs points by name"):
        replace(_marks(), marked=list(marked.values()))  # type: ignore[arg-type]
