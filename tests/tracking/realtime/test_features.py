"""Corners of the mouth and brows that move and look strange: found again with the head held."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from mien.arrays import Array
from mien.candide.model import TRACKED_UNITS
from mien.config import RealtimeSettings
from mien.synthetic import SyntheticSequence
from mien.tracking.realtime import RealtimeTracker
from moved_mouth import moved_unit, with_mouth
from small_motion import begun

DARK = 40
STRETCHER = TRACKED_UNITS.index("lip_stretcher")
BROWS = [k for k, name in enumerate(TRACKED_UNITS) if "brow" in name]


@cache
def widening() -> SyntheticSequence:
    return moved_unit(STRETCHER, 0.5)


def _stretched(tolerance: float) -> RealtimeTracker:
    """A tracker that has followed a mouth which widens, and shows something else between its corners."""
    sequence = widening()
    tracker = begun(sequence.frames[0], RealtimeSettings(features={"tolerance": tolerance}))
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
    stretched, rigid = (begun(widening().frames[0]) for _ in range(2))
    follows, corners = stretched.features.follows, stretched.person.corners
    assert (follows[~(corners | stretched.person.brows)] == 1).all()
    right, left = follows[corners].reshape(2, 4, 4)
    np.testing.assert_allclose(right, left[:, ::-1], atol=0.02)
    np.testing.assert_allclose(right, right[::-1], atol=1e-12)
    assert 0.4 < right.min() < 0.6 < right[1:3].max() < 1
    rigid.features.follows = np.ones_like(follows)
    widened = []
    for tracker in (rigid, stretched):
        tracker.track(widening().frames[1])
        widened.append(float((tracker.pose.animation - tracker.first_animation)[STRETCHER]))
    assert widened[0] < widened[1] < 0.55


def test_a_mouth_that_hardly_stretches_is_reported_as_at_rest() -> None:
    """A half of what is as far from rest as the setting says; and it does not come nearer to rest from frame to
    frame."""
    sequence, reported = moved_unit(STRETCHER, 0.3), []
    for rest in (0.0, 0.1, 1.0):
        tracker = begun(sequence.frames[0], RealtimeSettings(features={"rest": rest}))
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


def _found_again(visible: bool, corners: bool) -> Array:
    """How a search changes the animation (6,) that was found in a frame in which a mouth has widened."""
    tracker = begun(widening().frames[0])
    predicted = tracker.prior.prediction(tracker.pose, tracker.pose)
    view, best = tracker.solver.refine(widening().frames[1], predicted)
    found = tracker.features.search(view, best, predicted, np.full(len(view.facing), float(visible)), corners)
    return found.pose.animation - best.pose.animation


@pytest.mark.parametrize("is_visible", [False, True])
def test_only_corners_that_were_visible_are_found_again(is_visible: bool) -> None:
    assert np.array_equal(_found_again(is_visible, True), np.zeros(6)) is not is_visible


@pytest.mark.parametrize("is_put_back", [False, True])
def test_corners_of_a_mouth_that_was_put_back_to_rest_are_left(is_put_back: bool) -> None:
    change = _found_again(True, not is_put_back)
    assert bool(abs(change[STRETCHER]) < 1e-6) is is_put_back


@pytest.mark.parametrize("unit", BROWS)
def test_brows_that_move_are_found_again_without_the_head(unit: int) -> None:
    """More of what they move by, and nothing else."""
    sequence, settings = moved_unit(unit, 0.4), ({"tolerance": 1.0}, {})
    hardly, further = (begun(sequence.frames[0], RealtimeSettings(features=s)) for s in settings)  # type: ignore[arg-type]
    moved = []
    for tracker in (hardly, further):
        tracker.track(sequence.frames[1])
        moved.append(float((tracker.pose.animation - tracker.first_animation)[unit]))
    assert moved[0] < moved[1] < 0.5
    assert pytest.approx(hardly.pose.R, abs=1e-3) == further.pose.R
