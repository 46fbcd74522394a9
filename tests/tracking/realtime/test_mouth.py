"""Mouths that move further within a frame than what is measured from the last one reaches, and show what was hidden."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from mien.arrays import Array
from mien.frame import Frame
from mien.synthetic import SyntheticSequence
from mien.tracking.prior import JAW_DROP
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.realtime.mouth import _JAWS as JAWS
from moved_mouth import moved_unit, with_mouth
from small_motion import begun

OPENED = 0.5
DARK = 40


@cache
def opening() -> SyntheticSequence:
    return moved_unit(JAW_DROP, OPENED)


def _likeness(tracker: RealtimeTracker, frame: Frame) -> Array:
    """The chin's likeness at `JAWS`, counted from the jaw of the first frame."""
    view = tracker.solver.view(tracker.face.fine, frame, tracker.pose)
    jaws = tracker.first_animation[JAW_DROP] + JAWS
    return tracker.mouth.chin.likeness(view.image, tracker.person.arrays, tracker.pose.arrays, view.geometry, jaws)


@pytest.mark.parametrize(("frame", "least", "most"), [(0, -0.05, 0.05), (1, 0.1, 0.6)])
def test_the_chin_shows_how_far_the_jaw_has_dropped(frame: int, least: float, most: float) -> None:
    """The model moves the tip of the chin by half as much as the lower lip: an open jaw seems less open there."""
    likeness = _likeness(begun(opening().frames[0]), opening().frames[frame])
    assert likeness.max() > 0.9
    assert least <= JAWS[likeness.argmax()] <= most
    assert likeness[JAWS > 1.2].max() < 0.5


def test_lips_that_look_strange_do_not_hide_an_open_mouth() -> None:
    tracker, sequence = begun(opening().frames[0]), opening()
    for frame, landmarks in zip(sequence.frames[1:], sequence.landmarks[1:], strict=True):
        tracker.track(with_mouth(frame, landmarks, DARK, 2))
        assert tracker.pose.animation[JAW_DROP] - tracker.first_animation[JAW_DROP] == pytest.approx(OPENED, abs=0.2)


def test_the_chin_shows_that_a_mouth_has_opened_until_it_closes() -> None:
    """While it is open it is not taken for a covered one."""
    tracker = begun(opening().frames[0])
    for frame, is_open in ((0, False), (1, True), (2, True), (0, False)):
        tracker.track(opening().frames[frame])
        assert tracker.mouth.is_open == is_open


@pytest.mark.parametrize("tolerance", [1.0, 8.0])
def test_some_landmarks_alone_are_found_as_in_a_view_of_these(tolerance: float) -> None:
    """And with the wider tolerance as if that were expected of them."""
    tracker, frame = begun(opening().frames[0]), opening().frames[1]
    solver, mouth = tracker.solver, tracker.person.mouth
    predicted = tracker.prior.prediction(tracker.pose, tracker.pose)
    view, best = solver.refine(frame, predicted)
    alone = solver.alone(mouth, best, predicted, np.full(len(mouth), tolerance), solver.rigid)
    tracker.person.tolerance = tolerance * tracker.person.tolerance
    expected = solver.solve(view.of_landmarks(mouth), best.pose, predicted).pose
    for name in ("R", "t", "animation"):
        np.testing.assert_allclose(getattr(alone, name), getattr(expected, name), atol=1e-9)
    assert not np.allclose(alone.animation, best.pose.animation, atol=1e-3)
