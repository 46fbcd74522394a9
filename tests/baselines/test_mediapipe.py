"""MediaPipe as a tracker, where it is installed: its PnP, and the portrait in known motion."""

from __future__ import annotations

import importlib.util
from dataclasses import replace

import numpy as np
import pytest

from mien.candide.model import Candide
from mien.errors import MienError
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING, exp, log
from mien.initialization.landmarks import LANDMARK_NAMES, Landmarks

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("mediapipe") is None, reason="the extra `auto` is not installed"
)
CAMERA = Camera(500, 160, 120)


def test_pnp_recovers_a_projected_pose() -> None:
    from mien.baselines.mediapipe import solve_pnp

    shape = Candide.default().vertices()
    R, t = exp(np.array([0.2, -0.3, 0.1])) @ FACING, np.array([0.3, -0.2, 9.0])
    pixels, _ = CAMERA.project(shape @ R.T + t)
    found, shift = solve_pnp(shape, pixels, CAMERA, FACING, np.array([0.0, 0.0, 8.0]))
    np.testing.assert_allclose(log(found @ R.T), 0, atol=1e-5)
    np.testing.assert_allclose(shift, t, atol=1e-3)


def test_it_follows_the_portrait() -> None:
    from mien.baselines.mediapipe import MediaPipeTracker
    from mien.evaluation.datasets.sequence import Truth
    from mien.evaluation.protocols import Protocol, compare
    from mien.frame import Frame
    from mien.synthetic import make_sequence, moved, portrait
    from mien.tracking.state import Status

    face = portrait()
    turn = np.linspace(0, 1, 8)[:, None] * np.array([[4.0, 12.0, 6.0]])
    sequence = make_sequence(face, moved(face, turn, np.zeros((8, 3)), np.zeros((8, 6))))
    tracker = MediaPipeTracker()
    first, *rest = sequence.frames
    estimates = [tracker.initialize(first, face.landmarks, face.camera), *map(tracker.track, rest)]
    assert [e.status for e in estimates] == [Status.INITIALIZED] + [Status.TRACKED] * 7
    R = np.array([e.rotation for e in estimates])
    error = compare(Protocol.REBASED, Truth(8, rotations=sequence.R), R).error_deg
    assert np.abs(error).max() < 5
    seen = estimates[0].landmarks
    assert seen is not None
    assert np.abs(np.degrees(estimates[0].euler)).max() < 20
    assert {"nose_tip", "right_eye_outer_corner"} <= set(seen.names)
    black = tracker.track(Frame(np.zeros_like(first.pixels), 8, 0.3))
    assert black.status is Status.LOST
    assert "sees no face" in black.reason
    assert tracker.track(first).status is Status.RECOVERED
    for late in (MediaPipeTracker(), tracker):  # one that has a mesh of an earlier face forgets it
        late.initialize(Frame(np.zeros_like(first.pixels)), face.landmarks, face.camera)
        assert "saw no face in the first frame" in late.track(first).reason


def test_it_finds_the_face_of_another_video_wherever_the_last_one_was() -> None:
    from mien.baselines.mediapipe import MediaPipeTracker
    from mien.frame import Frame
    from mien.synthetic import portrait

    face, new, used = portrait(), MediaPipeTracker(), MediaPipeTracker()
    aside = Frame(np.roll(face.frame.pixels, 75, axis=1))
    there = replace(face.landmarks, points=face.landmarks.points + np.array([75, 0]))
    assert used.initialize(aside, there, face.camera).rotation is not None
    once, again = (tracker.initialize(face.frame, face.landmarks, face.camera) for tracker in (new, used))
    assert once.rotation is not None
    np.testing.assert_array_equal(once.rotation, again.rotation)
    np.testing.assert_array_equal(once.translation, again.translation)


def test_a_face_that_it_does_not_choose_is_lost() -> None:
    from mien.baselines.mediapipe import MediaPipeTracker
    from mien.synthetic import portrait

    face, tracker = portrait(), MediaPipeTracker()
    other = replace(face.landmarks, points=face.landmarks.points + np.array([2 * face.landmarks.size, 0]))
    begun, later = tracker.initialize(face.frame, other, face.camera), tracker.track(face.frame)
    assert (begun.rotation, later.rotation) == (None, None)
    assert "another face in the first frame" in begun.reason == later.reason


def test_landmarks_of_any_scheme_are_those_of_the_face_that_it_sees() -> None:
    """Also of one with a landmark that it has not."""
    from mien.baselines.mediapipe import MediaPipeTracker
    from mien.synthetic import portrait

    face, tracker = portrait(), MediaPipeTracker()
    names = [name for name in LANDMARK_NAMES if name != "chin_boss"]
    known = face.landmarks.reported()
    points = np.array([known.get(name, known["lower_lip_outer"]) for name in LANDMARK_NAMES])
    assert set(names) <= known.keys()
    own = Landmarks(points, "candide26")
    assert "chin_boss" in own.reported()
    assert tracker.initialize(face.frame, own, face.camera).rotation is not None


def test_frames_that_the_camera_cannot_have_taken_are_refused() -> None:
    from mien.baselines.mediapipe import MediaPipeTracker
    from mien.frame import Frame
    from mien.synthetic import portrait

    face, tracker = portrait(), MediaPipeTracker()
    with pytest.raises(MienError, match="call initialize first"):
        tracker.track(face.frame)
    tracker.initialize(face.frame, face.landmarks, face.camera)
    wide = Frame(np.repeat(face.frame.pixels, 2, axis=1), 1)  # its face would be tracked 25 degrees off
    with pytest.raises(MienError, match=r"has the size \(640, 240\), the first had \(320, 240\)"):
        tracker.track(wide)
