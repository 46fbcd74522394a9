"""Mouths that move further within a frame than what is measured from the last one reaches, and show what was hidden."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from mien.arrays import Array
from mien.candide.model import TRACKED_UNITS
from mien.config import RealtimeSettings
from mien.frame import Frame
from mien.synthetic import SyntheticSequence
from mien.tracking.prior import JAW_DROP
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.realtime.mouth import _JAWS as JAWS
from moved_mouth import moved_unit, with_mouth
from small_motion import begun

OPENED = 0.5
DARK = 40
STRETCHER = TRACKED_UNITS.index("lip_stretcher")


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


def _stretched(tolerance: float) -> RealtimeTracker:
    """A tracker that has followed a mouth which widens, and shows something else between its corners."""
    sequence = moved_unit(STRETCHER, 0.5)
    tracker = begun(sequence.frames[0], RealtimeSettings(mouth={"corner_tolerance": tolerance}))
    tracker.track(with_mouth(sequence.frames[1], sequence.landmarks[1], DARK, 2))
    return tracker


def test_corners_of_the_mouth_that_look_strange_are_followed_without_the_head() -> None:
    hardly, further = _stretched(1.0), _stretched(8.0)
    widened = [float((t.pose.animation - t.first_animation)[STRETCHER]) for t in (hardly, further)]
    assert 1.5 * widened[0] < widened[1] < 0.5
    assert pytest.approx(hardly.pose.R, abs=1e-3) == further.pose.R


def test_skin_stretches_around_the_corners_of_the_mouth() -> None:
    """They follow themselves, the cells of their descriptors the less, the further away they are; where all cells are
    taken to follow, less of a motion is found."""
    stretched, rigid = (begun(opening().frames[0]) for _ in range(2))
    follows, corners = stretched.mouth.follows, stretched.person.corners
    assert (follows[~corners] == 1).all()
    right, left = follows[corners].reshape(2, 4, 4)
    np.testing.assert_allclose(right, left[:, ::-1], atol=0.02)
    np.testing.assert_allclose(right, right[::-1], atol=1e-12)
    assert 0.4 < right.min() < 0.6 < right[1:3].max() < 1
    rigid.mouth.follows = np.ones_like(follows)
    widened = []
    for tracker in (rigid, stretched):
        tracker.track(moved_unit(STRETCHER, 0.5).frames[1])
        widened.append(float((tracker.pose.animation - tracker.first_animation)[STRETCHER]))
    assert widened[0] < widened[1] < 0.55


def test_a_mouth_that_hardly_stretches_is_reported_as_at_rest() -> None:
    """A half of what is as far from rest as the setting says; and it does not come nearer to rest from frame to
    frame."""
    sequence, reported = moved_unit(STRETCHER, 0.3), []
    for rest in (0.0, 0.1, 1.0):
        tracker = begun(sequence.frames[0], RealtimeSettings(mouth={"corner_rest": rest}))
        for _ in range(2):
            tracker.track(sequence.frames[1])
        reported.append(float((tracker.pose.animation - tracker.prior.rest)[STRETCHER]))
        for _ in range(3):
            tracker.track(sequence.frames[1])
        again = float((tracker.pose.animation - tracker.prior.rest)[STRETCHER])
        assert again == pytest.approx(reported[-1], rel=0.2)
    found = reported[0]
    assert reported[1] == pytest.approx(found / (1 + (0.1 / found) ** 2), rel=0.15)
    assert abs(reported[2]) < 0.2 * found


@pytest.mark.parametrize("is_visible", [False, True])
def test_only_corners_that_were_visible_are_found_again(is_visible: bool) -> None:
    tracker, frame = begun(opening().frames[0]), moved_unit(STRETCHER, 0.5).frames[1]
    predicted = tracker.prior.prediction(tracker.pose, tracker.pose)
    view, best = tracker.solver.refine(frame, predicted)
    found = tracker.mouth.search(view, best, predicted, np.full(len(view.facing), float(is_visible)))
    assert np.array_equal(found.pose.animation, best.pose.animation) is not is_visible


@pytest.mark.parametrize("tolerance", [1.0, 8.0])
def test_some_landmarks_alone_are_found_as_in_a_view_of_these(tolerance: float) -> None:
    """And with the wider tolerance as if that were expected of them."""
    tracker, frame = begun(opening().frames[0]), opening().frames[1]
    solver, mouth = tracker.solver, tracker.person.mouth
    predicted = tracker.prior.prediction(tracker.pose, tracker.pose)
    view, best = solver.refine(frame, predicted)
    alone = solver.alone(mouth, best, predicted, tolerance, solver.rigid)
    tracker.person.tolerance = tolerance * tracker.person.tolerance
    expected = solver.solve(view.of_landmarks(mouth), best.pose, predicted).pose
    for name in ("R", "t", "animation"):
        np.testing.assert_allclose(getattr(alone, name), getattr(expected, name), atol=1e-9)
    assert not np.allclose(alone.animation, best.pose.animation, atol=1e-3)
