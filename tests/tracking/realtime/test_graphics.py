"""A face behind graphics, which stand still while it moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from long_motion import sequence, shown
from mien.arrays import Array
from mien.errors import MienError, MienWarning
from mien.frame import Frame
from mien.graphics import Graphics
from mien.initialization.landmarks import LANDMARK_NAMES, Landmarks, place_of
from mien.synthetic import SyntheticSequence, make_sequence, moved
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.state import Estimate
from small_motion import errors_deg, face

BROWS = [k for k, name in enumerate(LANDMARK_NAMES) if "brow" in name]


def _behind_bar() -> tuple[SyntheticSequence, Graphics]:
    """The sequence with a black bar before the brows and the eyes, and the bar."""
    (x, y), size = place_of(sequence().landmarks[0])
    top, left, h, w = int(y - 0.55 * size), int(x - 0.6 * size), int(0.35 * size), int(1.2 * size)
    frames = []
    for frame in sequence().frames:
        pixels = frame.pixels.copy()
        pixels[top : top + h, left : left + w] = 10
        frames.append(Frame(pixels))
    return shown(frames), Graphics(pixels.shape[1], pixels.shape[0], left, top, np.ones((h, w), dtype=bool))


def _track(truth: SyntheticSequence, graphics: Graphics | None) -> tuple[list[Estimate], Array]:
    tracker, landmarks = RealtimeTracker(), replace(face().landmarks, graphics=graphics)
    first = tracker.initialize(truth.frames[0], landmarks, face().camera)
    estimates = [first, *(tracker.track(frame) for frame in truth.frames[1:])]
    return estimates, errors_deg(estimates, truth)


def test_a_face_is_followed_behind_graphics_that_are_known() -> None:
    truth, bar = _behind_bar()
    with pytest.warns(MienWarning, match="the eyes are shut, covered or too small"):
        (_, held), (estimates, errors) = _track(truth, None), _track(truth, bar)
    assert errors.mean() < 0.5 * held.mean()
    assert errors.max() < 4.5
    visible = [e.landmarks.visibility for e in estimates if e.landmarks is not None]
    assert len(visible) == len(estimates)
    assert visible[0][BROWS].max() == 0
    assert visible[0][LANDMARK_NAMES.index("nose_tip")] > 0.5
    free, _ = _track(sequence(), None)
    turned = int(np.argmax([np.linalg.norm(e.euler) for e in free if e.euler is not None]))
    behind, seen = estimates[turned].euler_sd, free[turned].euler_sd
    assert behind is not None
    assert seen is not None
    assert (behind[:2] > 1.5 * seen[:2]).all()  # tilt and pan


def test_graphics_of_another_video_are_refused() -> None:
    graphics = Graphics(640, 480, 0, 0, np.ones((4, 4), dtype=bool))
    with pytest.raises(MienError, match="another size"):
        _track(sequence(), graphics)


def test_what_faces_away_in_the_first_frame_is_not_behind_graphics() -> None:
    """Graphics in the corner of the image cover nothing of a face, however it is turned."""
    truth = make_sequence(face(), moved(face(), np.array([[0.0, -45.0, 0.0]]), np.zeros((1, 3)), np.zeros((1, 6))))
    frame, tracker = truth.frames[0], RealtimeTracker()
    corner = Graphics(frame.width, frame.height, 0, 0, np.ones((4, 4), dtype=bool))
    tracker.initialize(frame, Landmarks(truth.landmarks[0], "candide26", graphics=corner), face().camera)
    assert tracker.axes.first.covered == 0
