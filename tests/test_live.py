"""Estimates while they are made, with a detector and a tracker that do what they are told."""

from __future__ import annotations

import sys
from collections.abc import Generator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import get_origin, get_type_hints

import cv2
import numpy as np
import pytest

import mien
from mien import live
from mien.errors import MienError, require
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING
from mien.initialization import detector
from mien.initialization.landmarks import Landmarks, Point
from mien.start import live_search
from mien.tracking.state import Estimate, Status
from mien.video import FOLDER_FPS
from small_motion import face
from videos import Device, gradient

FRAMES = 30
SEEN = range(3, 10)
"""Frames in which the tracker sees its face; the detector sees one from the first of them on."""


class Told:
    """A tracker that sees its face in `SEEN`, and for five frames after it has learned one; `doubt` is its confidence
    in others, which are lost if it has none."""

    doubt = 0.0

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        self.learned, self.camera = frame.index, camera
        return self._estimate(frame, Status.INITIALIZED, 1.0)

    def track(self, frame: Frame) -> Estimate:
        if frame.index in SEEN or frame.index < self.learned + 5:
            return self._estimate(frame, Status.TRACKED, 1.0)
        return self._estimate(frame, Status.TRACKED, self.doubt) if self.doubt else Estimate.lost(frame, "told so")

    def _estimate(self, frame: Frame, status: Status, confidence: float) -> Estimate:
        R, t = FACING, np.array([0.0, 0.0, 9.0])
        return Estimate(frame.index, frame.time, status, R, t, confidence=confidence)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for index in range(FRAMES):
        cv2.imwrite(str(tmp_path / f"{index:03}.png"), np.full((240, 320, 3), 128, np.uint8))
    monkeypatch.setattr(live, "create_tracker", lambda name: Told())
    known = face().landmarks
    monkeypatch.setattr(detector, "detect_once", lambda frame, at, distant: [known] * (frame.index >= SEEN.start))
    monkeypatch.setattr(detector, "detect", lambda frame, at: [known])
    return tmp_path


def begun(folder: Path, anew_after: float) -> list[int]:
    """Frames in which a face was learned."""
    estimates = [estimate for _, estimate in mien.stream(folder, anew_after=anew_after)]
    return [e.index for e in estimates if e.status is Status.INITIALIZED]


def test_every_frame_has_its_estimate(folder: Path) -> None:
    pairs = list(mien.stream(folder, focal_px=500))
    assert [frame.index for frame, _ in pairs] == [estimate.index for _, estimate in pairs] == list(range(FRAMES))
    assert [estimate.reason for _, estimate in pairs[:3]] == ["no face was seen yet"] * 3
    assert [estimate.status.success for _, estimate in pairs] == [index in SEEN for index in range(FRAMES)]


def test_a_folder_has_the_frame_rate_that_is_given(folder: Path) -> None:
    times = [estimate.time for _, estimate in mien.stream(folder, fps=10)]
    assert times == pytest.approx(np.arange(FRAMES) / 10)
    with pytest.raises(MienError, match="fps is 0"):
        mien.stream(folder, fps=0)


def test_a_face_at_the_side_is_learned_as_a_camera_sees_it_that_looks_at_it(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a file; with the camera of the stream."""
    asked: list[tuple[int, float]] = []

    def straightened(frame: Frame, face: Landmarks, camera: Camera) -> Landmarks:
        asked.append((frame.index, camera.focal_px))
        return replace(face, source="straight")

    learned: list[str] = []

    class Learning(Told):
        def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
            learned.append(landmarks.source)
            return super().initialize(frame, landmarks, camera)

    monkeypatch.setattr(live, "straightened", straightened)
    monkeypatch.setattr(live, "create_tracker", lambda name: Learning())
    list(mien.stream(folder, focal_px=500))
    assert asked == [(SEEN.start, 500.0)]
    assert learned == ["straight"]


def test_a_tracker_is_created_for_every_face_that_is_learned(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first of them when the stream is asked for, so that an unknown preset is told at once."""
    created: list[str] = []

    def create(name: str) -> Told:
        created.append(name)
        return Told()

    monkeypatch.setattr(live, "create_tracker", create)
    stream = mien.stream(folder, anew_after=0.1)
    assert created == ["realtime"]
    learned = sum(estimate.status is Status.INITIALIZED for _, estimate in stream)
    assert len(created) == learned > 1


def test_estimates_come_before_the_next_frame_is_asked_for(folder: Path) -> None:
    estimates = mien.stream(folder)
    for path in sorted(folder.iterdir())[5:]:
        path.unlink()
    assert next(estimates)[1].index == 0


def test_a_stream_can_be_closed_which_frees_the_camera(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And type checkers know that, as of `contextlib.closing`."""
    device = Device([gradient(0)] * 9)
    monkeypatch.setattr(cv2, "VideoCapture", lambda number: device)
    with closing(mien.stream(0)) as estimates:
        assert next(estimates)[1].index == 0
        assert not device.released
    assert device.released
    assert get_origin(get_type_hints(mien.stream)["return"]) is Generator


def test_a_lost_face_is_not_given_up_unless_asked(folder: Path) -> None:
    assert begun(folder, anew_after=np.inf) == [SEEN.start]


def test_after_a_while_another_face_is_learned(folder: Path) -> None:
    last, later = SEEN[-1], round(0.18 * FOLDER_FPS) + 1
    assert begun(folder, anew_after=0.18) == [SEEN.start, last + later, last + later + 4 + later]


def test_a_face_that_cannot_be_learned_does_not_end_the_stream(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Except the first: then the camera is to be corrected."""

    class Nearsighted(Told):
        def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
            require(frame.index in self.sees, "the face would be too near")
            return super().initialize(frame, landmarks, camera)

        sees = SEEN

    monkeypatch.setattr(live, "create_tracker", lambda name: Nearsighted())
    estimates = [estimate for _, estimate in mien.stream(folder, anew_after=0.2)]
    assert len(estimates) == FRAMES
    refused = [e for e in estimates if e.reason == "the face in view cannot be learned: the face would be too near"]
    assert refused
    assert all(e.status is Status.LOST for e in refused)
    learned = iter([Nearsighted(), SimpleNamespace(initialize=lambda *_: None, track=lambda _: None)])
    monkeypatch.setattr(live, "create_tracker", lambda name: next(learned))
    with pytest.raises(MienError, match="returned NoneType"):  # a fault of the tracker, not of the face
        list(mien.stream(folder, anew_after=0.2))
    learned = iter([Nearsighted(), SimpleNamespace(initialize=lambda *_: sys.exit(), track=lambda _: None)])
    with pytest.raises(MienError, match=r"called sys\.exit\(None\)"):
        list(mien.stream(folder, anew_after=0.2))
    monkeypatch.setattr(live, "create_tracker", lambda name: Nearsighted())
    monkeypatch.setattr(Nearsighted, "sees", ())
    with pytest.raises(MienError, match="too near"):
        list(mien.stream(folder))


@pytest.mark.parametrize(("doubt", "again"), [(0.05, True), (0.3, False)])
def test_a_face_that_looks_like_somebody_elses_is_given_up_too(
    doubt: float, again: bool, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Told, "doubt", doubt)
    assert (len(begun(folder, anew_after=0.18)) > 1) is again


def test_a_face_that_is_there_is_not_given_up(folder: Path) -> None:
    assert begun(folder, anew_after=0.0)[0] == SEEN.start
    assert begun(folder, anew_after=0.0)[1] > SEEN[-1]


def test_a_turned_face_is_waited_for_in_every_doubt(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also if it was looked for in one before, at the end of which it was the known one."""
    monkeypatch.setattr(live_search, "turn_of", lambda *args: 90.0)
    monkeypatch.setattr(live_search, "_PATIENCE", 0.11)
    known = face().landmarks
    look = lambda frame, at, distant: [replace(known, time=frame.time)] * (frame.index >= SEEN.start)  # noqa: E731
    monkeypatch.setattr(detector, "detect_once", look)
    sure = {*range(6, 15), *range(18, 24)}
    monkeypatch.setattr(
        Told, "track", lambda told, frame: told._estimate(frame, Status.TRACKED, float(frame.index in sure))
    )
    assert begun(folder, anew_after=0.05) == [SEEN.start + 3, 25 + 3]


@pytest.mark.parametrize("method", ["initialize", "track"])
def test_a_tracker_that_returns_no_estimate_is_named(
    method: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Told, method, lambda *_: None)
    with pytest.raises(MienError, match=":Told returned NoneType for frame"):
        list(mien.stream(folder))


@pytest.mark.parametrize("method", ["initialize", "track"])
def test_a_tracker_does_not_end_the_program(method: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Told, method, lambda *_: sys.exit(0))
    with pytest.raises(MienError, match=r":Told called sys\.exit\(0\)"):
        list(mien.stream(folder))


def test_an_interruption_of_a_compiled_function_is_one(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    within = KeyboardInterrupt()

    def stopped(tracker: Told, frame: Frame) -> Estimate:
        raise SystemError from within

    monkeypatch.setattr(Told, "track", stopped)
    with pytest.raises(KeyboardInterrupt) as raised:
        list(mien.stream(folder))
    assert raised.value is not within  # which would be its own cause


def test_the_face_at_a_point_is_learned(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also anew, after it was lost."""
    asked: list[Point | None] = []

    def detect(frame: Frame, at: Point | None, distant: bool) -> list[Landmarks]:
        if frame.index >= SEEN.start:  # before, turned frames are searched, too, in which the point is elsewhere
            asked.append(at)
        return [face().landmarks] * (frame.index >= SEEN.start)

    monkeypatch.setattr(detector, "detect_once", detect)
    monkeypatch.setattr(detector, "refine", lambda frame, seen: seen)
    learned = [
        e.index for _, e in mien.stream(folder, face=(200, 100), anew_after=0.18) if e.status is Status.INITIALIZED
    ]
    assert len(learned) > 1
    assert set(asked) == {(200.0, 100.0)}
    with pytest.raises(MienError, match=r"^the face at 320, 100 lies outside the image of 320x"):
        next(mien.stream(folder, face=(320, 100)))


def test_bad_input_is_told_at_once(tmp_path: Path) -> None:
    for wrong in (np.nan, -1.0, "2", None):
        with pytest.raises(MienError, match="anew_after is"):
            mien.stream(tmp_path, anew_after=wrong)  # type: ignore[arg-type]
    for nowhere in (7, (None, None), ([1.0], 2.0)):
        with pytest.raises(MienError, match="give a point"):
            mien.stream(tmp_path, face=nowhere)  # type: ignore[arg-type]
    with pytest.raises(MienError, match="no such file"):
        mien.stream(tmp_path / "missing.mp4")
    with pytest.raises(MienError, match="unknown tracker"):
        mien.stream(tmp_path, preset="none")
    cv2.imwrite(str(tmp_path / "1.png"), np.zeros((24, 32, 3), np.uint8))
    with pytest.raises(MienError, match="more than one way"):
        mien.stream(tmp_path, focal_px=500, fov_deg=60)
    with pytest.raises(MienError, match=r"none\.json"):
        mien.stream(tmp_path, camera=tmp_path / "none.json")


def test_a_face_that_enters_from_the_border_is_waited_for(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of it is detected beyond the border: nothing could be learned there."""
    known = face().landmarks
    half = replace(known, points=known.points - [known.points[:, 0].mean(), 0])
    seen = lambda frame, at, distant: [half if frame.index < SEEN.start + 2 else known]  # noqa: E731
    monkeypatch.setattr(detector, "detect_once", seen)
    statuses = [estimate.status for _, estimate in mien.stream(folder)]
    assert statuses[: SEEN.start + 2] == [Status.LOST] * (SEEN.start + 2)
    assert statuses[SEEN.start + 2] is Status.INITIALIZED
