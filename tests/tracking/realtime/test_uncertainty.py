"""The reported error: a covariance that grows with the turn, a confidence that falls with it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from warnings import catch_warnings, simplefilter

import cv2
import numpy as np
import pytest
from hypothesis import given

from mien.appearance.views import rotation
from mien.arrays import Array
from mien.config import RealtimeSettings
from mien.errors import MienWarning
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING, exp, log, ray_rotation
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.realtime.identity import familiarity
from mien.tracking.realtime.pose import Pose
from mien.tracking.realtime.uncertainty import (
    ACROSS_MOVED_SD,
    ACROSS_TURNED_SD,
    ALONG_MOVED_SD,
    AXES_SCALE,
    COARSE,
    FAR_COSINE,
    FAR_SCALE,
    FLAT_SCALE,
    GRAPHICS_SCALE,
    MISFIT_DISTANCE,
    NOISE_SCALE,
    RELIEF_SCALE,
    SHARP,
    THIN,
    THIN_SCALE,
    TILT_MOVED_SD,
    TILT_WORN_SD,
    TRANSLATION_SCALE,
    TURNED_SCALE,
    UNIT_SCALE,
    Reference,
    ReliefError,
    confidence,
    focal_covariance,
    state_covariance,
    systematic_covariance,
    visibility,
)
from mien.tracking.state import Estimate
from small_motion import begun, face, small_motion
from strategies import head_rotations, rotation_vectors
from videos import frames_of, write_video

RELIEF_SD = 0.1
RELIEF_VARIANCE = (RELIEF_SCALE * RELIEF_SD) ** 2
RELIEF, EXACT = ReliefError(RELIEF_SD), ReliefError(0.0)
SPREAD = np.diag([1 / 400, 1 / 400, 1 / 2500] + [0.01] * 9)
NOISE = NOISE_SCALE**2 * np.diag(np.diag(SPREAD) * np.repeat([1, TRANSLATION_SCALE**2, 1], [3, 3, 6]))
PERFECT = 0.0
STILL = np.zeros(6)
FAMILIAR = familiarity(PERFECT, 0.0)
AXES_SD = np.radians([2.0, 1.3, 0.7])
SCALED_AXES = AXES_SD * AXES_SCALE
AHEAD = np.array([0.0, 0.0, 1.0])
FIRST = Reference(FACING, AHEAD, AXES_SD)


def view(R: Array) -> Array:
    """From where a head on the optical axis is seen."""
    return np.asarray(R.T @ AHEAD)


def covariance_of(
    R: Array = FACING, *, d2: float = PERFECT, seen: float = 1.0, moved: Array = STILL, first: Reference = FIRST
) -> Array:
    """Covariance (12, 12) of a head on the optical axis, at a distance of 10, at R (3, 3); see `state_covariance`."""
    return state_covariance(SPREAD, d2, seen, Pose(R, 10 * AHEAD, moved), moved, first, RELIEF)


def test_a_perfect_fit_at_the_first_pose_leaves_the_noise() -> None:
    np.testing.assert_allclose(covariance_of(), NOISE)


def test_landmarks_that_look_wrong_make_the_frame_less_certain_and_not_the_model() -> None:
    R = rotation(0, 0.5, 0)
    perfect = covariance_of(R)
    misfit = covariance_of(R, d2=MISFIT_DISTANCE)
    np.testing.assert_allclose(misfit - perfect, NOISE, atol=1e-15)


def test_half_the_landmarks_leave_twice_the_variance_that_their_information_does() -> None:
    half = covariance_of(seen=0.5)
    whole = covariance_of()
    np.testing.assert_allclose(half, 2 * whole, atol=1e-15)
    assert np.isfinite(covariance_of(seen=0.0)).all()


def test_an_expression_makes_the_units_of_its_part_of_the_face_less_certain() -> None:
    """The brows move by 0.5 in all: their two units are uncertain by that share of it, those of the mouth as before;
    and so are the tilt and the place of the head, as a share of the distance along the view."""
    moved = np.array([0.0, 0.0, 0.0, 0.3, 0.0, -0.4])
    still = covariance_of()
    expression = covariance_of(moved=moved)
    of_brows = np.array([0, 0, 0, 1, 0, 1]) * (0.5 * UNIT_SCALE) ** 2
    of_place = (0.5 * np.array([ACROSS_MOVED_SD, ACROSS_MOVED_SD, 10 * ALONG_MOVED_SD])) ** 2
    of_head = [(0.5 * TILT_MOVED_SD) ** 2, 0, 0, *of_place]
    np.testing.assert_allclose(expression - still, np.diag([*of_head, *of_brows]), atol=1e-15)


@given(head_rotations(), head_rotations())
def test_it_is_a_covariance_that_the_model_makes_larger(R: Array, R_first: Array) -> None:
    first = Reference(R_first, AHEAD, AXES_SD)
    covariance = covariance_of(R, first=first)
    assert np.linalg.eigvalsh(covariance - NOISE).min() > -1e-12
    there = covariance_of(R_first, first=first)
    across = ACROSS_TURNED_SD**2 * (1 - (view(R) @ view(R_first)) ** 2)
    turned = np.diag([across, across, 0.0] + [0.0] * 6)
    np.testing.assert_allclose(covariance[3:, 3:], there[3:, 3:] + turned, atol=1e-15)


def test_systematic_covariance_by_hand() -> None:
    """Half a radian of pan: out of the plane by its sine, an error of pan alone; axes that are wrong in tilt or roll
    turn with it, those wrong in pan stay so. Of roll: not out of the plane, and the other two turn."""
    relief = RELIEF_VARIANCE * np.sin(0.5) ** 2
    apart = 2 * (1 - np.cos(0.5))  # the length of the difference of an axis that turns and where it was, squared
    pan = rotation(0, 0.5, 0)
    panned = systematic_covariance(pan, view(pan), FIRST, RELIEF)
    assert np.trace(panned) == pytest.approx(relief + apart * (SCALED_AXES[[0, 2]] ** 2).sum())
    assert panned[1, 1] == pytest.approx(relief)
    roll = rotation(0, 0, 0.5)
    rolled = systematic_covariance(roll, view(roll), FIRST, RELIEF)
    assert np.trace(rolled) == pytest.approx(apart * (SCALED_AXES[:2] ** 2).sum())
    np.testing.assert_allclose(systematic_covariance(FACING, view(FACING), FIRST, RELIEF), 0, atol=1e-15)


def test_a_face_that_crosses_the_image_is_seen_from_elsewhere_and_one_that_follows_the_camera_is_not() -> None:
    """A face that looks straight ahead is seen from the side at the border of the image, without a rotation, and one
    that goes on looking into the camera never is."""
    to_the_side, no_axes = np.array([math.sin(0.5), 0.0, math.cos(0.5)]), Reference(FACING, AHEAD, np.zeros(3))
    ahead = systematic_covariance(FACING, FACING.T @ to_the_side, no_axes, RELIEF)
    np.testing.assert_allclose(ahead, np.diag([0.0, RELIEF_VARIANCE * math.sin(0.5) ** 2, 0.0]), atol=1e-15)
    R = ray_rotation(to_the_side) @ FACING
    np.testing.assert_allclose(systematic_covariance(R, R.T @ to_the_side, no_axes, RELIEF), 0, atol=1e-15)


def test_what_graphics_cover_in_the_first_frame_makes_turns_less_certain() -> None:
    R, no_axes = exp(np.array([0.0, 0.4, 0.0])) @ FACING, np.zeros(3)
    clear, covered = (Reference(FACING, AHEAD, no_axes, share) for share in (0.0, 0.6))
    assert systematic_covariance(R, view(R), clear, EXACT)[1, 1] == 0
    sd = np.sqrt(systematic_covariance(R, view(R), covered, EXACT)[1, 1])
    assert sd == pytest.approx(GRAPHICS_SCALE * 0.6 * np.sin(0.4))
    np.testing.assert_allclose(systematic_covariance(FACING, view(FACING), covered, EXACT), 0, atol=1e-12)


def test_turns_of_a_face_without_depths_are_less_certain() -> None:
    R = exp(np.array([0.0, 0.4, 0.0])) @ FACING
    flat = Reference(FACING, AHEAD, np.zeros(3), flat=True)
    assert np.sqrt(systematic_covariance(R, view(R), flat, EXACT)[1, 1]) == pytest.approx(FLAT_SCALE * np.sin(0.4))
    tracker, without = RealtimeTracker(), replace(face().landmarks, depths=None)
    tracker.initialize(face().frame, without, face().camera)
    assert tracker.axes.first.flat
    assert not begun(face().frame).axes.first.flat


def test_beyond_fifty_degrees_the_turn_is_less_certain_by_its_cosine() -> None:
    no_axes = Reference(FACING, AHEAD, np.zeros(3))
    shares = [
        math.sqrt(systematic_covariance(R, view(R), no_axes, EXACT)[1, 1]) / math.sin(math.radians(pan))
        for pan in (49.0, 60.0, 75.0)
        for R in [rotation(0, math.radians(pan), 0)]
    ]
    drops = [max(math.cos(math.radians(50)) - math.cos(math.radians(pan)), 0) for pan in (49.0, 60.0, 75.0)]
    np.testing.assert_allclose(shares, FAR_SCALE * np.array(drops), atol=1e-12)


@given(head_rotations(), head_rotations())
def test_wrong_axes_turn_the_rotation_as_their_covariance_says(R: Array, R_first: Array) -> None:
    """With R exp(d) in place of every R, R_first^T R is turned by R_first^T w; d small, about each axis of the head."""
    small = 1e-5
    turn = np.cross(AHEAD, R @ R_first.T @ AHEAD)
    aside = TURNED_SCALE**2 * (1 - R_first[2, 2] ** 2)  # of a face that the first frame shows from the side
    far = (FAR_SCALE * max(FAR_COSINE - view(R) @ view(R_first), 0)) ** 2
    expected = (RELIEF_VARIANCE + aside + far) * np.outer(turn, turn)
    for d in np.diag(small * SCALED_AXES):
        turned = (R_first @ exp(d)).T @ (R @ exp(d)) @ (R_first.T @ R).T
        w = R_first @ log(turned) / small
        expected += np.outer(w, w)
    np.testing.assert_allclose(
        systematic_covariance(R, view(R), Reference(R_first, AHEAD, AXES_SD), RELIEF), expected, atol=1e-7
    )


@given(head_rotations(), head_rotations(), rotation_vectors())
def test_it_does_not_matter_from_where_one_looks(R: Array, R_first: Array, v: Array) -> None:
    here = systematic_covariance(R, view(R), Reference(R_first, AHEAD, AXES_SD), RELIEF)
    first = Reference(exp(v) @ R_first, exp(v) @ AHEAD, AXES_SD)
    there = systematic_covariance(exp(v) @ R, view(R), first, RELIEF)
    np.testing.assert_allclose(there, exp(v) @ here @ exp(v).T, atol=1e-9)


def test_an_expression_makes_the_tilt_about_the_heads_own_axis_less_certain() -> None:
    R = rotation(0, 0, 0.5)
    no_axes = Reference(R, AHEAD, np.zeros(3))
    covariance = systematic_covariance(R, view(R), no_axes, EXACT, 0.25)
    np.testing.assert_allclose(covariance, (0.5 * TILT_MOVED_SD) ** 2 * np.outer(R[:, 0], R[:, 0]), atol=1e-12)


def test_something_worn_that_slides_makes_the_tilt_less_certain() -> None:
    R = rotation(0, 0, 0.5)
    worn = systematic_covariance(R, view(R), Reference(R, AHEAD, np.zeros(3), worn=True), EXACT)
    np.testing.assert_allclose(worn, TILT_WORN_SD**2 * np.outer(R[:, 0], R[:, 0]), atol=1e-12)


@pytest.mark.parametrize("pan", [0.2, 0.6])
def test_a_thin_layer_of_landmarks_leaves_the_turn_open(pan: float) -> None:
    """Half as thick as it should be: a share more of the turn; nothing of a roll, and nothing where it is thick."""
    no_axes = Reference(FACING, AHEAD, np.zeros(3))

    def sd(R: Array, layer: float) -> float:
        return float(np.sqrt(np.trace(systematic_covariance(R, view(R), no_axes, ReliefError(0.0, layer=layer)))))

    turned = rotation(0, pan, 0)
    assert sd(turned, THIN / 2) == pytest.approx(THIN_SCALE * math.sin(pan))
    assert sd(turned, THIN / 2) < sd(turned, THIN / 3) < sd(turned, 0.0)
    assert sd(turned, THIN) == 0
    assert sd(rotation(0, 0, pan), THIN / 2) == pytest.approx(0, abs=1e-9)


def test_the_layer_is_of_what_a_solution_rests_on() -> None:
    """The depth of the face is less where a half of it weighs nothing, and nothing if a single landmark is left."""
    tracker = RealtimeTracker()
    tracker.initialize(small_motion().frames[0], face().landmarks, face().camera)
    tracker.track(small_motion().frames[1])
    person, view_from = tracker.person, tracker.axes.first.seen_from
    depths = person.neutral @ view_from

    def layer(weight: Array) -> float:
        facing = np.full(len(depths), True)
        solution: Any = SimpleNamespace(seen=facing, w=weight)
        return person.layer(solution, view_from)

    assert layer(np.ones(len(depths))) == pytest.approx(depths.std())
    deep = np.argsort(depths)[: len(depths) // 2]
    weight = np.zeros(len(depths))
    weight[deep] = 0.5
    assert layer(weight) == pytest.approx(depths[deep].std())
    assert layer(np.eye(len(depths))[0]) == pytest.approx(0, abs=1e-6)
    assert layer(np.zeros(len(depths))) == 0


def test_confidence_falls_with_the_spread_and_with_what_is_hidden() -> None:
    spreads = [confidence(scale * np.eye(12), 0.6, FAMILIAR) for scale in (1e-5, 1e-3, 1e-1, 10)]
    assert spreads == sorted(spreads, reverse=True)
    hidden = [confidence(1e-3 * np.eye(12), seen, FAMILIAR) for seen in (1, 0.7, 0.4, 0.1)]
    assert hidden == sorted(hidden, reverse=True)
    assert confidence(1e-4 * np.eye(12), 1.0, FAMILIAR) > 0.99
    assert hidden[-1] < 0.05
    assert confidence(1e9 * np.eye(12), 0.0, familiarity(math.inf, 0.0)) == 0


def test_what_looks_strange_and_came_suddenly_is_hidden() -> None:
    d2, agreement, mouth = (a.ravel() for a in np.meshgrid([20.0, 150.0, 1000.0], [0.0, 1.0], [False, True]))
    seen = visibility(d2, np.full(12, True), agreement, mouth.astype(bool))
    assert ((seen >= 0) & (seen <= 1)).all()
    by_distance = seen.reshape(2, 3, 2)  # by agreement, distance, whether it is the mouth's
    assert (np.diff(by_distance, axis=1) < 0).all()
    assert (np.diff(by_distance, axis=0) > 0).all()
    assert (np.diff(by_distance, axis=2) > 0).all()
    assert (by_distance[:, 0] > 0.99).all()
    assert (by_distance[:, 2] < 0.02).all()
    hidden, came_slowly = by_distance[:, 1, 0]
    assert hidden < 0.1
    assert came_slowly > 0.5
    assert not visibility(d2, np.full(12, False), agreement, mouth.astype(bool)).any()


def test_landmarks_that_all_look_wrong_are_somebody_else() -> None:
    stranger = familiarity(55.0, 0.0)
    assert confidence(1e-5 * np.eye(12), 1.0, stranger) < 0.01
    grimace = familiarity(10.0, 0.0)
    assert confidence(1e-5 * np.eye(12), 1.0, grimace) > 0.9


def test_who_was_known_and_never_left_is_still_believed_to_be_there() -> None:
    """A grimace looks like somebody else."""
    grimace = familiarity(55.0, 0.0)
    believed = [confidence(1e-5 * np.eye(12), 0.5, grimace, known) for known in (0, 0.5, 1)]
    np.testing.assert_allclose(believed, [0, 0.45, 0.9], atol=0.01)
    assert confidence(1e-5 * np.eye(12), 0.1, grimace, 1.0) < 0.05  # hardly anything is seen
    assert confidence(1e-5 * np.eye(12), 1.0, FAMILIAR, 1.0) > 0.99


def test_what_was_learned_out_of_focus_is_less_certain() -> None:
    """Each frame's own error, with the inverse square of the sharpness; what the relief leaves open stays."""
    R = rotation(0.1, 0.4, 0.0)
    sharp, soft = (covariance_of(R, first=replace(FIRST, sharpness=of)) for of in (0.6, SHARP / 2))
    still = covariance_of(R)
    np.testing.assert_array_equal(sharp, still)
    np.testing.assert_allclose(soft - sharp, 15 * NOISE, atol=1e-15)


def test_what_was_learned_in_a_coarsely_compressed_picture_is_less_certain() -> None:
    """Each frame's own variance grows with the step to which it was rounded."""
    R = rotation(0.1, 0.4, 0.0)
    fine, coarse = (covariance_of(R, first=replace(FIRST, rounding=step)) for step in (0.0, 2 / COARSE))
    np.testing.assert_allclose(coarse - fine, 2 * NOISE, atol=1e-15)


def test_a_face_that_is_learned_in_a_coarsely_compressed_picture_is_told_of(tmp_path: Path) -> None:
    """By the quantizer of its stream, relative to the size of the face."""
    images = [frame.pixels for frame in small_motion().frames[:2]]
    spreads = []
    for level in (10, 44):
        options = {"qp": str(level)}
        path = write_video(tmp_path / f"{level}.mp4", images, codec="libx264", pix_fmt="yuv420p", options=options)
        tracker, (first, second) = RealtimeTracker(), frames_of(path)
        if level == 10:
            with catch_warnings():
                simplefilter("error")
                tracker.initialize(first, face().landmarks, face().camera)
        else:
            with pytest.warns(MienWarning, match=r"the face is coarsely compressed at 0\.00 s"):
                tracker.initialize(first, face().landmarks, face().camera)
        sd = tracker.track(second).euler_sd
        assert sd is not None
        spreads.append(sd)
        assert first.quantizer_step is not None
        scale = tracker.face.fine.descriptor.pixels_per_unit * tracker.pose.distance / face().camera.focal_px
        assert tracker.axes.first.rounding == pytest.approx(first.quantizer_step * scale, rel=0.05)
    assert (spreads[1] > 1.3 * spreads[0]).all()


def test_how_sharp_a_face_is_does_not_depend_on_how_its_descriptors_are_smoothed() -> None:
    """With a blur of 1.6 pixels there was nothing to tell it from, and a division by zero."""
    first, second, *_ = small_motion().frames
    of_default = begun(first).axes.first.sharpness
    for blur in (0.0, 1.2, 1.6, 3.0):
        tracker = begun(first, RealtimeSettings.model_validate({"descriptor": {"blur": blur}}))
        assert tracker.axes.first.sharpness == pytest.approx(of_default, rel=0.01)  # at a slightly other pose
        assert tracker.track(second).covariance is not None


def test_a_face_that_is_learned_out_of_focus_is_told_of() -> None:
    first, *_, last = (
        Frame(np.asarray(cv2.GaussianBlur(frame.pixels, (0, 0), 6), np.uint8), frame.index, frame.time)
        for frame in small_motion().frames
    )
    tracker = RealtimeTracker()
    with pytest.warns(MienWarning, match=r"the face is blurred or enlarged at 0\.00 s"):
        tracker.initialize(first, face().landmarks, face().camera)
    assert tracker.axes.first.sharpness < 0.4
    assert tracker.track(last).covariance is not None
    with catch_warnings():
        simplefilter("error")
        RealtimeTracker().initialize(small_motion().frames[0], face().landmarks, face().camera)


@pytest.mark.parametrize("pan_deg", [-25.0, 0.0, 10.0])
def test_a_focal_length_that_is_not_known_by_hand(pan_deg: float) -> None:
    """What is seen at a pixel lies along another ray with another focal length, and turns with it; a face that is as
    large is as much further away."""
    d, known = 1e-3, Camera(500, 160, 120)
    wrong = replace(known, focal_px=500 * (1 + d))
    first, now = (10 * np.array([math.tan(math.radians(a)), 0.3, 1.0]) for a in (5.0, pan_deg))

    def turned(t: Array) -> Array:
        seen = wrong.rays(known.project(t)[0])
        return ray_rotation(seen / np.linalg.norm(seen)) @ ray_rotation(t / np.linalg.norm(t)).T

    error = [*log(turned(now)) - log(turned(first)), 0.0, 0.0, 10 * d]
    covariance = focal_covariance(now, first / np.linalg.norm(first), 0.3)
    np.testing.assert_allclose(covariance, (0.3 / d) ** 2 * np.outer(error, error), rtol=5e-3, atol=1e-6)


def test_an_unknown_camera_makes_what_it_shows_less_certain() -> None:
    def tracked(log_sd: float) -> tuple[RealtimeTracker, Estimate]:
        tracker = RealtimeTracker()
        tracker.initialize(small_motion().frames[0], face().landmarks, replace(face().camera, focal_log_sd=log_sd))
        return tracker, tracker.track(small_motion().frames[-1])

    (_, known), (tracker, unknown) = tracked(0.0), tracked(0.35)
    assert known.covariance is not None
    assert unknown.covariance is not None
    more = unknown.covariance - known.covariance
    np.testing.assert_array_equal(unknown.rotation, known.rotation)
    np.testing.assert_allclose(
        more[:6, :6], focal_covariance(tracker.pose.t, tracker.axes.first.line_of_sight, 0.35), atol=1e-12
    )
    assert np.all(more[6:] == 0)
    assert unknown.confidence < known.confidence
