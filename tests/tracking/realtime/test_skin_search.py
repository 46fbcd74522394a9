"""Lips and brows that the skin shows where they are, although they look strange there."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from mien.arrays import Array
from mien.candide.model import TRACKED_UNITS, Candide
from mien.frame import Frame
from mien.geometry.rotation import matrix_from_euler
from mien.initialization.landmarks import LANDMARK_NAMES, Landmarks
from mien.synthetic import SyntheticSequence
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.realtime.pose import Prediction
from mien.tracking.realtime.skin import BROWS, CORNERS, UPPER_LIP, Skin
from mien.tracking.realtime.solution import View
from moved_mouth import moved_unit, with_mouth
from small_motion import begun, face

STRETCHER, RAISER = (TRACKED_UNITS.index(name) for name in ("lip_stretcher", "outer_brow_raiser"))
RAISED, STRETCHED = 0.8, 0.8
BROWS_UP = 0.08
"""CANDIDE units."""
TEETH = 230
KNOWN, UNKNOWN = 1e8, 1.0
"""Information of a predicted pose that is known well, and hardly."""


@cache
def still() -> SyntheticSequence:
    return moved_unit(STRETCHER, 0.0)


@cache
def raising() -> SyntheticSequence:
    return moved_unit(UPPER_LIP.unit, RAISED)


def _view(tracker: RealtimeTracker, frame: Frame) -> View:
    return tracker.solver.view(tracker.face.fine, frame, tracker.pose)


def _of_model(units: str, factor: float) -> RealtimeTracker:
    """A tracker, begun, whose face model has these animation units smaller or the other way round."""
    model = Candide.default()
    changed = model.animation_units.copy()
    changed[[units in name for name in model.animation_unit_names]] *= factor
    tracker = RealtimeTracker(model=replace(model, animation_units=changed))
    tracker.initialize(still().frames[0], Landmarks(still().landmarks[0], "candide26"), face().camera)
    return tracker


def test_teeth_do_not_hide_a_raised_upper_lip() -> None:
    tracker, sequence = begun(raising().frames[0]), raising()
    for frame, landmarks in zip(sequence.frames[1:], sequence.landmarks[1:], strict=True):
        tracker.track(with_mouth(frame, landmarks, TEETH, 4))
    raised = tracker.pose.animation[UPPER_LIP.unit] - tracker.first_animation[UPPER_LIP.unit]
    assert raised == pytest.approx(RAISED, abs=0.2)


def _stretched(tracker: RealtimeTracker, frame: Frame, landmarks: Array, stretched: float) -> Frame:
    """The frame with the skin around the corners of the mouth moved outwards by a value of lip_stretcher, as of real
    faces: CANDIDE moves the corner alone."""
    pixels_per_unit = tracker.camera.focal_px / tracker.pose.t[2]
    v, u = np.indices((frame.height, frame.width)).astype(np.float32)
    moved_by = np.zeros_like(u)
    for side in CORNERS.sides:
        x, y = landmarks[side.carrier]
        away = np.hypot(u - x, v - y) / (0.25 * pixels_per_unit)
        moved_by += np.sign(side.offsets[-1, 0]) * np.exp(-(away**2) / 2)
    moved_by *= stretched * tracker.skin.widening[STRETCHER] * pixels_per_unit
    pixels = cv2.remap(frame.pixels, (u - moved_by).astype(np.float32), v, cv2.INTER_LINEAR)
    return Frame(np.asarray(pixels, np.uint8), frame.index, frame.time)


def _corners(tracker: RealtimeTracker, frame: Frame) -> tuple[Array, float]:
    """The likeness of the corners of the mouth in a frame, and how far outwards it is greatest."""
    view = _view(tracker, frame)
    corners = tracker.skin.corners
    likeness = corners.likeness(view.image, tracker.person.arrays, tracker.pose.arrays, view.geometry)
    return likeness, corners.outwards[np.unravel_index(likeness.argmax(), likeness.shape)[1]]


@pytest.mark.parametrize("stretched", [-STRETCHED, 0.0, STRETCHED])
def test_the_corners_of_the_mouth_are_found_by_the_skin_around_them(stretched: float) -> None:
    sequence, tracker = still(), begun(still().frames[0])
    frame = _stretched(tracker, sequence.frames[1], sequence.landmarks[1], stretched)
    likeness, out = _corners(tracker, frame)
    assert likeness.max() > 0.8
    assert likeness.argmax() // likeness.shape[1] == len(likeness) // 2  # no lower, no higher
    assert out == pytest.approx(stretched * tracker.skin.widening[STRETCHER], abs=0.025)


def test_the_likeness_of_skin_is_its_normalised_cross_correlation() -> None:
    """As OpenCV finds it, in a frame whose first animation is not at rest."""
    tracker, frame = begun(raising().frames[2]), raising().frames[0]
    person, pose, view = tracker.person.arrays, tracker.pose.arrays, _view(tracker, frame)
    first = _view(tracker, raising().frames[2])
    for region, points, skin in (
        (CORNERS, tracker.face.corners, tracker.skin.corners),
        (BROWS, tracker.face.brows, tracker.skin.brows),
    ):
        sides = [
            Skin(side, at, first.image, person, pose, first.geometry)
            for side, at in zip(region.sides, points, strict=True)
        ]
        by_side = [
            cv2.matchTemplate(
                side.look(view.image, person, pose, view.geometry).reshape(region.shape),
                side.look(first.image, person, pose, first.geometry).reshape(region.shape)[region.skin].copy(),
                cv2.TM_CCOEFF_NORMED,
            )
            for side in sides
        ]
        found = skin.likeness(view.image, person, pose, view.geometry)
        np.testing.assert_allclose(found, np.mean(by_side, axis=0), atol=1e-4)


def test_teeth_do_not_hide_a_grin() -> None:
    sequence, tracker = still(), begun(still().frames[0])
    for frame, landmarks in zip(sequence.frames[1:], sequence.landmarks[1:], strict=True):
        grin = _stretched(tracker, frame, landmarks, STRETCHED)
        tracker.track(with_mouth(grin, landmarks, TEETH, 4))
    stretched = tracker.pose.animation[STRETCHER] - tracker.first_animation[STRETCHER]
    assert stretched == pytest.approx(STRETCHED, abs=0.2)


@pytest.mark.parametrize("factor", [0.01, -1.0])
def test_the_skin_says_nothing_of_a_unit_that_does_not_move_the_corners_outwards(factor: float) -> None:
    """A face model of one's own may have another lip_stretcher: what the skin shows would be a hundred of it."""
    tracker = _of_model("lip_stretcher", factor)
    grin = _stretched(begun(still().frames[0]), still().frames[1], still().landmarks[1], STRETCHED)
    predicted = tracker.prior.prediction(tracker.pose, tracker.pose)
    found = tracker.skin.with_skin(_view(tracker, grin), predicted)
    assert found.pose.animation[STRETCHER] == pytest.approx(predicted.pose.animation[STRETCHER], abs=0.01)


@pytest.mark.parametrize("roll_deg", [-25.0, 90.0])
def test_the_skin_beside_the_lips_is_where_it_is_however_the_head_is_held(roll_deg: float) -> None:
    """What it looks like is what it looks like upright, so that it is found as it is there."""
    upright, aslant = begun(still().frames[0]), RealtimeTracker()
    sequence = moved_unit(STRETCHER, 0.0, roll_deg)
    aslant.initialize(sequence.frames[0], Landmarks(sequence.landmarks[0], "candide26"), face().camera)
    for looks in zip(*([t.mouth.chin.values, t.skin.upper_lip.values] for t in (upright, aslant)), strict=True):
        assert np.corrcoef(*looks)[0, 1] > 0.9
    for looks in zip(upright.skin.corners.templates, aslant.skin.corners.templates, strict=True):
        assert np.corrcoef(*(look.ravel() for look in looks))[0, 1] > 0.9


def test_the_further_a_head_turns_the_less_the_skin_says_of_the_upper_lip() -> None:
    tracker, frame = begun(raising().frames[0]), raising().frames[1]
    view = _view(tracker, frame)
    entry, ahead = 6 + UPPER_LIP.unit, tracker.prior.seen_from
    added = []
    for degrees in (0, 3, 30):
        tracker.prior.seen_from = matrix_from_euler(np.radians([0, degrees, 0])) @ ahead
        predicted = tracker.prior.prediction(tracker.pose, tracker.pose)
        found = tracker.skin.with_skin(view, predicted)
        added.append(found.information[entry, entry] - predicted.information[entry, entry])
        assert found.pose.animation[UPPER_LIP.unit] > tracker.pose.animation[UPPER_LIP.unit]
    assert added[0] == pytest.approx(2 * added[1], rel=0.01)
    assert added[2] < added[0] / 50


def test_skin_that_is_hidden_says_nothing_of_the_upper_lip() -> None:
    tracker, pixels = begun(raising().frames[0]), raising().frames[1].pixels.copy()
    pixels[:] = np.random.default_rng(0).integers(0, 256, pixels.shape)
    view = _view(tracker, Frame(pixels, 1, 0.04))
    predicted = tracker.prior.prediction(tracker.pose, tracker.pose)
    assert tracker.skin.with_skin(view, predicted) is predicted


def _with_brows(tracker: RealtimeTracker, frame: Frame, landmarks: Array, up: float) -> Frame:
    """The frame with the brows and the skin around them moved up by some CANDIDE units, as of real faces, and bright
    folds above them, which leave their landmarks strange."""
    pixels_per_unit = tracker.camera.focal_px / tracker.pose.t[2]
    v, u = np.indices((frame.height, frame.width)).astype(np.float32)
    moved_by, folds = np.zeros_like(u), np.zeros_like(u, bool)
    for name in ("right_brow_top", "left_brow_top"):
        x, y = landmarks[LANDMARK_NAMES.index(name)]
        across, above = np.abs(u - x) / pixels_per_unit, (y - v) / pixels_per_unit
        fades = np.interp(above, [-0.16, -0.08, 0.1, 0.3], [0, 1, 1, 0])  # lids and hair stay
        moved_by = np.maximum(moved_by, fades * np.clip(2 - across / 0.2, 0, 1))
        folds |= (across < 0.3) & (above > up + 0.14) & (above < up + 0.5) & (v % 4 < 2)
    pixels = cv2.remap(frame.pixels, u, (v + moved_by * up * pixels_per_unit).astype(np.float32), cv2.INTER_LINEAR)
    pixels[folds] = TEETH
    return Frame(np.asarray(pixels, np.uint8), frame.index, frame.time)


def test_folds_do_not_hide_raised_brows() -> None:
    sequence, tracker = still(), begun(still().frames[0])
    for frame, landmarks in zip(sequence.frames[1:], sequence.landmarks[1:], strict=True):
        tracker.track(_with_brows(tracker, frame, landmarks, BROWS_UP))
    lowered = float(tracker.skin.lowering @ (tracker.pose.animation - tracker.first_animation))
    assert -lowered == pytest.approx(BROWS_UP, abs=0.02)


@pytest.mark.parametrize("up", [-0.04, 0.0, 0.08])
def test_the_brows_are_found_where_they_are(up: float) -> None:
    tracker = begun(still().frames[0])
    view = _view(tracker, _with_brows(tracker, still().frames[1], still().landmarks[1], up))
    likeness = tracker.skin.brows.likeness(view.image, tracker.person.arrays, tracker.pose.arrays, view.geometry)
    assert likeness.max() > 0.8
    row, column = np.unravel_index(likeness.argmax(), likeness.shape)
    assert tracker.skin.brows.down[row] == pytest.approx(-up, abs=0.025)
    assert tracker.skin.brows.outwards[column] == pytest.approx(0, abs=0.025)


def _raised_in(tracker: RealtimeTracker, of_pose: float) -> float:
    """By how much the skin of raised brows moves outer_brow_raiser from where it was predicted. of_pose: information of
    each entry of the predicted pose of the head."""
    view = _view(tracker, _with_brows(tracker, still().frames[1], still().landmarks[1], BROWS_UP))
    predicted = Prediction(tracker.pose, np.diag(np.repeat([of_pose, 4.0], 6)), tracker.pose, 0.0)
    found = tracker.skin.with_skin(view, predicted)
    return float((found.pose.animation - predicted.pose.animation)[RAISER])


def test_a_head_that_may_be_elsewhere_has_not_raised_its_brows() -> None:
    """Where the pose is hardly known, it is the pose that explains where the brows are."""
    tracker = begun(still().frames[0])
    assert _raised_in(tracker, KNOWN) > 0.2
    assert abs(_raised_in(tracker, UNKNOWN)) < 0.01


def test_brows_behind_dark_glasses_say_nothing() -> None:
    tracker = begun(still().frames[0])
    tracker.person.wear_glasses()
    assert abs(_raised_in(tracker, KNOWN)) < 0.01


def test_brows_say_nothing_of_units_that_do_not_lift_them() -> None:
    """A face model of one's own may have none."""
    assert abs(_raised_in(_of_model("brow", 0.01), KNOWN)) < 0.01


def test_the_brows_move_as_a_lattice_on_both_sides_of_the_face() -> None:
    right, left = BROWS.sides
    np.testing.assert_allclose(right.offsets * [-1, 1], left.offsets)
    rows, columns = BROWS.shape
    assert len(left.offsets) == rows * columns
    assert left.offsets.reshape(rows, columns, 2)[BROWS.skin].shape[:2] == (12, 13)
