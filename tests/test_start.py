"""Where tracking begins: a face that is turned at first is learned where it looks into the camera."""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest

import mien
from long_motion import NOISE_SD
from mien import start
from mien.errors import MienWarning
from mien.geometry.rotation import FACING, Array, angle_between, matrix_from_euler
from mien.initialization.landmarks import Landmarks
from mien.synthetic import SyntheticSequence, make_sequence, moved
from mien.video import Frame, open_video
from small_motion import face
from videos import write_video

PANS_DEG = np.concatenate([np.linspace(30, 0, 16), np.linspace(0, -15, 8)])


@pytest.fixture(scope="module")
def turning() -> SyntheticSequence:
    """A face that is turned by 30 degrees, looks into the camera, and turns to the other side."""
    angles = np.outer(PANS_DEG, [0, 1, 0])
    return make_sequence(face(), moved(face(), angles, 0 * angles, np.zeros((len(angles), 6))), noise_sd=NOISE_SD)


@pytest.fixture
def video(turning: SyntheticSequence, tmp_path: Path) -> Path:
    return write_video(tmp_path / "turning.mkv", [frame.pixels for frame in turning.frames])


@pytest.fixture
def detector(monkeypatch: pytest.MonkeyPatch, turning: SyntheticSequence) -> set[int]:
    """One that finds the true landmarks, but not in the frames of this set, which a test fills."""
    hidden: set[int] = set()

    def seen(frame: Frame) -> Landmarks:
        points = turning.landmarks[frame.index]
        return Landmarks(points, "candide26", None, frame.index, frame.time, "detected face")

    def first_with_a_face(frames: Iterable[Frame]) -> tuple[Frame, list[Landmarks]]:
        return next((frame, [seen(frame)]) for frame in frames)

    def follow(face: Landmarks, frames: Iterable[Frame]) -> Iterator[tuple[Frame, Landmarks]]:
        yield from ((frame, seen(frame)) for frame in frames if frame.index not in hidden)

    monkeypatch.setattr("mien.initialization.detector.first_with_a_face", first_with_a_face)
    monkeypatch.setattr("mien.initialization.detector.follow", follow)
    monkeypatch.setattr("mien.initialization.detector.refine", lambda frame, face: face)
    return hidden


def _errors_deg(track: mien.Track, truth: SyntheticSequence) -> Array:
    """(n,) angle in degrees between a track's rotations and the true ones, head axes aligned to these."""
    R = np.stack([matrix_from_euler(angles) for angles in np.radians(track.euler_deg)])
    D = np.swapaxes(truth.R @ FACING, 1, 2) @ R
    U, _, Vt = np.linalg.svd(D.mean(axis=0))
    return np.asarray(np.degrees(angle_between(D, U @ Vt)))


def test_a_face_that_is_turned_is_learned_where_it_looks_into_the_camera(detector: set[int], video: Path) -> None:
    with pytest.warns(MienWarning, match=r"turned by \d\d degrees at 0\.00 s; tracking begins at 0\.60 s"):
        begin = start.prepare(open_video(video), camera=face().camera)
    assert begin.first.index == begin.landmarks.frame_index == 15
    assert begin.since == 0
    assert [frame.index for frame in begin.frames] == list(range(len(PANS_DEG)))


def test_the_best_look_is_taken_where_none_is_good(detector: set[int], video: Path) -> None:
    detector.update(range(11, 24))
    with pytest.warns(MienWarning, match=r"begins at 0\.40 s"):
        assert start.prepare(open_video(video), camera=face().camera).first.index == 10


def test_a_look_that_is_hardly_better_is_not_worth_it(detector: set[int], video: Path) -> None:
    detector.update(range(4, 24))
    assert start.prepare(open_video(video), camera=face().camera).first.index == 0


def test_what_is_behind_the_end_is_not_looked_at(detector: set[int], video: Path) -> None:
    with pytest.warns(MienWarning, match=r"begins at 0\.40 s"):
        assert start.prepare(open_video(video), camera=face().camera, end=0.5).first.index == 10


def test_a_face_that_is_hardly_turned_is_learned_at_once(
    detector: set[int], video: Path, monkeypatch: pytest.MonkeyPatch, recwarn: pytest.WarningsRecorder
) -> None:
    monkeypatch.setattr("mien.initialization.detector.follow", None)
    assert start.prepare(open_video(video), camera=face().camera, start=0.4).first.index == 10
    assert not recwarn


def test_landmarks_that_are_given_are_those_of_the_beginning(
    detector: set[int], turning: SyntheticSequence, video: Path
) -> None:
    marks = Landmarks(turning.landmarks[0], "candide26")
    assert start.prepare(open_video(video), marks, face().camera).first.index == 0


def test_begun_in_front_a_turned_head_is_tracked_better(turning: SyntheticSequence, video: Path) -> None:
    """With the real detector, from the first frame to the last."""
    detector = pytest.importorskip("mediapipe") and importlib.import_module("mien.initialization.detector")
    (there,) = detector.detect(turning.frames[0])
    with pytest.warns(MienWarning, match="where tracking begins, and all angles will be less certain"):
        turned = _errors_deg(mien.track(video, camera=face().camera, landmarks=there), turning)
    with pytest.warns(MienWarning, match="and goes back from there"):
        frontal = _errors_deg(mien.track(video, camera=face().camera), turning)
    assert len(frontal) == len(turned) == len(PANS_DEG)
    assert frontal.mean() < 0.8 * turned.mean()
    assert frontal.max() < 2
