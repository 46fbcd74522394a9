"""Mouths that move further within a frame than what is measured from the last one reaches, and show what was hidden."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from mien.arrays import Array
from mien.candide.model import Candide
from mien.frame import Frame
from mien.geometry.rotation import matrix_from_euler
from mien.initialization.landmarks import LANDMARK_NAMES, Landmarks
from mien.synthetic import SyntheticSequence, make_sequence, moved
from mien.tracking.prior import JAW_DROP
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.realtime.mouth import _JAWS as JAWS
from mien.tracking.realtime.skin import CORNERS, UPPER_LIP
from small_motion import begun, face

STRETCHER = CORNERS[0].unit
OPENED, RAISED, STRETCHED = 0.5, 0.8, 0.8
DARK, TEETH = 40, 230


def _sequence(unit: int, amount: float, roll_deg: float = 0.0) -> SyntheticSequence:
    """A mouth that is moved from one frame to the next, and stays so, of a head that is held aslant."""
    animation = np.zeros((4, 6))
    animation[1:, unit] = amount
    return make_sequence(face(), moved(face(), np.tile([0, 0, roll_deg], (4, 1)), np.zeros((4, 3)), animation))


@cache
def opening() -> SyntheticSequence:
    return _sequence(JAW_DROP, OPENED)


@cache
def still() -> SyntheticSequence:
    return _sequence(STRETCHER, 0.0)


@cache
def raising() -> SyntheticSequence:
    return _sequence(UPPER_LIP.unit, RAISED)


def _with_mouth(frame: Frame, landmarks: Array, grey: int, below: int) -> Frame:
    """The frame with something between the lips, and on them, that the first one did not show, from some pixels below
    the upper one's border on."""
    corners = [name for name in LANDMARK_NAMES if "mouth_corner" in name]
    left, right = sorted(int(landmarks[LANDMARK_NAMES.index(name), 0]) for name in corners)
    top, bottom = (int(landmarks[LANDMARK_NAMES.index(f"{lip}_lip_outer"), 1]) for lip in ("upper", "lower"))
    pixels = frame.pixels.copy()
    pixels[top + below : bottom + 1, left:right] = grey
    return Frame(pixels, frame.index, frame.time)


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
        tracker.track(_with_mouth(frame, landmarks, DARK, 2))
        assert tracker.pose.animation[JAW_DROP] - tracker.first_animation[JAW_DROP] == pytest.approx(OPENED, abs=0.2)


def test_the_chin_shows_that_a_mouth_has_opened_until_it_closes() -> None:
    """While it is open it is not taken for a covered one."""
    tracker = begun(opening().frames[0])
    for frame, is_open in ((0, False), (1, True), (2, True), (0, False)):
        tracker.track(opening().frames[frame])
        assert tracker.mouth.is_open == is_open


def test_teeth_do_not_hide_a_raised_upper_lip() -> None:
    tracker, sequence = begun(raising().frames[0]), raising()
    for frame, landmarks in zip(sequence.frames[1:], sequence.landmarks[1:], strict=True):
        tracker.track(_with_mouth(frame, landmarks, TEETH, 4))
    raised = tracker.pose.animation[UPPER_LIP.unit] - tracker.first_animation[UPPER_LIP.unit]
    assert raised == pytest.approx(RAISED, abs=0.2)


def _stretched(tracker: RealtimeTracker, frame: Frame, landmarks: Array, stretched: float) -> Frame:
    """The frame with the skin around the corners of the mouth moved outwards by a value of lip_stretcher, as of real
    faces: CANDIDE moves the corner alone."""
    pixels_per_unit = tracker.camera.focal_px / tracker.pose.t[2]
    v, u = np.indices((frame.height, frame.width)).astype(np.float32)
    moved_by = np.zeros_like(u)
    for side in CORNERS:
        x, y = landmarks[side.carrier]
        away = np.hypot(u - x, v - y) / (0.25 * pixels_per_unit)
        moved_by += np.sign(side.offsets[-1, 0]) * np.exp(-(away**2) / 2)
    moved_by *= stretched * tracker.mouth.widening * pixels_per_unit
    pixels = cv2.remap(frame.pixels, (u - moved_by).astype(np.float32), v, cv2.INTER_LINEAR)
    return Frame(np.asarray(pixels, np.uint8), frame.index, frame.time)


def _corners(tracker: RealtimeTracker, frame: Frame) -> tuple[Array, float]:
    """The likeness of the corners of the mouth in a frame, and how far outwards it is greatest."""
    view = tracker.solver.view(tracker.face.fine, frame, tracker.pose)
    corners = tracker.mouth.corners
    likeness = corners.likeness(view.image, tracker.person.arrays, tracker.pose.arrays, view.geometry)
    return likeness, corners.shifts[np.unravel_index(likeness.argmax(), likeness.shape)[1]]


@pytest.mark.parametrize("stretched", [-STRETCHED, 0.0, STRETCHED])
def test_the_corners_of_the_mouth_are_found_by_the_skin_around_them(stretched: float) -> None:
    sequence, tracker = still(), begun(still().frames[0])
    frame = _stretched(tracker, sequence.frames[1], sequence.landmarks[1], stretched)
    likeness, out = _corners(tracker, frame)
    assert likeness.max() > 0.8
    assert likeness.argmax() // likeness.shape[1] == len(likeness) // 2  # no lower, no higher
    assert out == pytest.approx(stretched * tracker.mouth.widening, abs=0.025)


def test_teeth_do_not_hide_a_grin() -> None:
    sequence, tracker = still(), begun(still().frames[0])
    for frame, landmarks in zip(sequence.frames[1:], sequence.landmarks[1:], strict=True):
        grin = _stretched(tracker, frame, landmarks, STRETCHED)
        tracker.track(_with_mouth(grin, landmarks, TEETH, 4))
    stretched = tracker.pose.animation[STRETCHER] - tracker.first_animation[STRETCHER]
    assert stretched == pytest.approx(STRETCHED, abs=0.2)


@pytest.mark.parametrize("factor", [0.01, -1.0])
def test_the_skin_says_nothing_of_a_unit_that_does_not_move_the_corners_outwards(factor: float) -> None:
    """A face model of one's own may have another lip_stretcher: what the skin shows would be a hundred of it."""
    model = Candide.default()
    units = model.animation_units.copy()
    units[model.animation_unit_names.index("lip_stretcher")] *= factor
    tracker = RealtimeTracker(model=replace(model, animation_units=units))
    first, landmarks = still().frames[0], Landmarks(still().landmarks[0], "candide26")
    tracker.initialize(first, landmarks, face().camera)
    grin = _stretched(begun(first), still().frames[1], still().landmarks[1], STRETCHED)
    view = tracker.solver.view(tracker.face.fine, grin, tracker.pose)
    predicted = tracker.prior.prediction(tracker.pose, tracker.pose)
    found = tracker.mouth.with_skin(view, predicted)
    assert found.pose.animation[STRETCHER] == pytest.approx(predicted.pose.animation[STRETCHER], abs=0.01)


@pytest.mark.parametrize("roll_deg", [-25.0, 90.0])
def test_the_skin_beside_the_lips_is_where_it_is_however_the_head_is_held(roll_deg: float) -> None:
    """What it looks like is what it looks like upright, so that it is found as it is there."""
    upright, aslant = begun(still().frames[0]), RealtimeTracker()
    sequence = _sequence(STRETCHER, 0.0, roll_deg)
    aslant.initialize(sequence.frames[0], Landmarks(sequence.landmarks[0], "candide26"), face().camera)
    for name in ("chin", "upper_lip"):
        looks = [getattr(tracker.mouth, name).values for tracker in (upright, aslant)]
        assert np.corrcoef(*looks)[0, 1] > 0.9
    for looks in zip(upright.mouth.corners.templates, aslant.mouth.corners.templates, strict=True):
        assert np.corrcoef(*(look.ravel() for look in looks))[0, 1] > 0.9


def test_the_further_a_head_turns_the_less_the_skin_says_of_the_upper_lip() -> None:
    tracker, frame = begun(raising().frames[0]), raising().frames[1]
    view = tracker.solver.view(tracker.face.fine, frame, tracker.pose)
    predicted = tracker.prior.prediction(tracker.pose, tracker.pose)
    entry, ahead = 6 + UPPER_LIP.unit, tracker.prior.seen_from
    added = []
    for degrees in (0, 3, 30):
        tracker.prior.seen_from = matrix_from_euler(np.radians([0, degrees, 0])) @ ahead
        found = tracker.mouth.with_skin(view, predicted)
        added.append(found.information[entry, entry] - predicted.information[entry, entry])
        assert found.pose.animation[UPPER_LIP.unit] > tracker.pose.animation[UPPER_LIP.unit]
    assert added[0] == pytest.approx(2 * added[1], rel=0.01)
    assert added[2] < added[0] / 50


def test_skin_that_is_hidden_says_nothing_of_the_upper_lip() -> None:
    tracker, pixels = begun(raising().frames[0]), raising().frames[1].pixels.copy()
    pixels[:] = np.random.default_rng(0).integers(0, 256, pixels.shape)
    view = tracker.solver.view(tracker.face.fine, Frame(pixels, 1, 0.04), tracker.pose)
    predicted = tracker.prior.prediction(tracker.pose, tracker.pose)
    assert tracker.mouth.with_skin(view, predicted) is predicted
