"""Lefevre and Odobez 2009: points on the face and on the sides, and adaptation."""

from __future__ import annotations

import numpy as np
import pytest

from mien.arrays import Array
from mien.baselines.lefevre import (
    FACE_POINTS,
    FORGETTING,
    INITIAL_SD,
    LEAST_SD,
    SIDE_POINTS,
    Appearance,
    LefevreTracker,
    SurfacePoints,
    robust,
    with_sides,
)
from mien.synthetic import make_sequence, moved
from mien.tracking.state import Status
from small_motion import face, run, small_motion


def _turned(pan_deg: float) -> Array:
    return np.asarray(moved(face(), np.array([[0, pan_deg, 0]]), np.zeros((1, 3)), np.zeros((1, 6)))[0])


def test_normals_point_out_of_the_head() -> None:
    shape, units, triangles = with_sides(face().fit.shape, face().fit.model.animation_units)
    assert units.shape == (6, len(shape), 3)
    a, b, c = (shape[triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    outward = np.sign(shape[triangles].mean(axis=1)[:, 0])
    assert (np.sign(normals[:, 0]) == outward).all()
    assert set(outward) == {-1, 1}


def test_each_side_is_seen_when_the_head_turns_it_to_the_camera() -> None:
    points = SurfacePoints.draw(face().fit, np.random.default_rng(0))
    side = np.arange(FACE_POINTS + SIDE_POINTS) >= FACE_POINTS
    left = points.model.neutral[:, 0] > 0
    assert not points.facing(face().state)[side].any()
    for pan in (-40, 40):
        seen = points.facing(_turned(pan)) & side
        assert seen.any()
        # R = Ry(pan) turns the head's own left, which is image right, away from the camera or towards it.
        assert (left[seen] == (pan > 0)).all()


def test_points_lie_on_the_face_and_move_with_it() -> None:
    points = SurfacePoints.draw(face().fit, np.random.default_rng(0)).model
    assert points.neutral.shape == (FACE_POINTS + SIDE_POINTS, 3)
    low, high = face().fit.shape.min(axis=0), face().fit.shape.max(axis=0)
    on_face = points.neutral[:FACE_POINTS]
    assert (on_face >= low - 1e-9).all()
    assert (on_face <= high + 1e-9).all()
    assert np.abs(points.animation_units[:, :FACE_POINTS]).max() > 0.01
    assert not points.animation_units[:, FACE_POINTS:, 2].any()


def test_appearance_adapts_to_what_is_seen() -> None:
    unseen = Appearance.unseen(3)
    first = unseen.adapt(np.array([10, 20, 30], np.float32), np.array([True, True, False]))
    np.testing.assert_array_equal(first.known, [True, True, False])
    np.testing.assert_allclose(first.mean[:2], [10, 20])
    np.testing.assert_allclose(first.variance, INITIAL_SD**2)
    second = first.adapt(np.array([20, 99, 40], np.float32), np.array([True, False, True]))
    np.testing.assert_allclose(second.mean, [10 + 10 * FORGETTING, 20, 40])
    np.testing.assert_allclose(second.variance[0], (1 - FORGETTING) * INITIAL_SD**2 + FORGETTING * 100)
    still = second
    for _ in range(200):
        still = still.adapt(still.mean, np.ones(3, dtype=bool))
    np.testing.assert_allclose(still.variance, LEAST_SD**2)


def test_what_is_far_off_counts_little_more() -> None:
    np.testing.assert_allclose(robust(np.array([0, np.e - 1, np.e**2 - 1], np.float32)), [0, 1, 2], atol=1e-6)


def test_a_black_frame_is_not_learned() -> None:
    tracker = LefevreTracker(evaluations=400)
    run(tracker, small_motion(blank={2}))
    assert tracker.appearance.mean[tracker.appearance.known].mean() > 50


def test_the_sides_are_collected_when_the_head_shows_them() -> None:
    tracker = LefevreTracker(evaluations=20)
    tracker.initialize(face().frame, face().landmarks, face().camera)
    side = np.arange(FACE_POINTS + SIDE_POINTS) >= FACE_POINTS
    assert not tracker.appearance.known[side].any()
    turned = _turned(35)
    tracker.b = turned
    frame = make_sequence(face(), turned[None]).frames[0]
    assert tracker.track(frame).status is Status.TRACKED
    assert tracker.appearance.known[side].mean() == pytest.approx(0.5, abs=0.2)


def test_it_runs_without_sides() -> None:
    tracker = LefevreTracker(evaluations=20, side_points=0)
    tracker.initialize(face().frame, face().landmarks, face().camera)
    assert len(tracker.points.normals) == FACE_POINTS
    assert tracker.track(face().frame).status is Status.TRACKED
