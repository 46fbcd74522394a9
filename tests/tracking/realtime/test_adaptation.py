"""Adaptation by hand, and on a rendered face with reflections on its eyes, or before which a board passes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from mien.arrays import Array
from mien.config import RealtimeSettings
from mien.config.realtime import AdaptationSettings
from mien.frame import Frame
from mien.initialization.landmarks import LANDMARK_NAMES, VERTICES
from mien.synthetic import SyntheticSequence, make_sequence, moved
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.realtime.adaptation import Adaptation
from mien.tracking.realtime.person import SPECTACLES, TRACKED
from small_motion import errors_of_all_deg, face, run

FIRST = np.array([0.1, -0.2])
EYES = [i for i, name in enumerate(LANDMARK_NAMES) if "eye" in name and "brow" not in name]
OTHERS = np.setdiff1d(np.arange(len(TRACKED)), EYES)
FRAMES = 160
RUN_PX = 30.0


def _adaptation(n: int = 2, **settings: float) -> Adaptation:
    return Adaptation(n, FIRST, AdaptationSettings(**settings))


def test_a_step_by_hand() -> None:
    """At the turn at which half is learned, half of alpha times the residual is added there."""
    adaptation = _adaptation(forgetting=0.2, turn_deg=10.0)
    residual = np.random.default_rng(0).normal(size=(1, 128)).astype(np.float32)
    angles = FIRST + np.radians([0, 10.0])
    adaptation.learn_eyes(angles, residual, np.array([True, False]))
    np.testing.assert_allclose(adaptation.offset(angles)[0], 0.5 * 0.2 * residual[0], rtol=1e-4)
    np.testing.assert_allclose(adaptation.offset(FIRST - np.radians([0, 10.0]))[0], -0.5 * 0.2 * residual[0], rtol=1e-4)
    assert not adaptation.offset(angles)[1].any()


def test_what_grows_with_the_turn_is_learned_and_nothing_in_the_first_view() -> None:
    rng = np.random.default_rng(1)
    truth = rng.normal(size=(2, 2, 128))
    adaptation = _adaptation()
    for _ in range(400):
        turn = rng.uniform(-0.5, 0.5, 2)
        residual = np.einsum("a,ank->nk", turn, truth) - adaptation.offset(FIRST + turn)
        adaptation.learn_eyes(FIRST + turn, residual.astype(np.float32), np.array([True, True]))
    turn = np.array([0.3, -0.4])
    np.testing.assert_allclose(adaptation.offset(FIRST + turn), np.einsum("a,ank->nk", turn, truth), atol=0.01)
    assert not adaptation.offset(FIRST).any()


def test_a_view_is_learned_where_the_face_has_turned_and_nothing_in_the_first_view() -> None:
    residual = np.random.default_rng(0).normal(size=(1, 128)).astype(np.float32)
    adaptation, turned = _adaptation(), FIRST + np.radians([5.0, 40.0])
    for _ in range(60):
        adaptation.learn_view(turned, residual - adaptation.offset(turned)[:1], np.array([True, False]))
    np.testing.assert_allclose(adaptation.offset(turned)[0], residual[0], atol=0.01)
    np.testing.assert_allclose(adaptation.share(turned), [1, 0], atol=0.01)
    for elsewhere in (FIRST, FIRST + np.radians([0, -40.0])):
        np.testing.assert_allclose(adaptation.offset(elsewhere), 0, atol=1e-6)
        np.testing.assert_allclose(adaptation.share(elsewhere), 0, atol=1e-6)
    near = FIRST + np.radians([0, 25.0])
    assert 0 < adaptation.share(near)[0] < 0.5


def test_a_share_is_never_more_than_all() -> None:
    """Learned where the views count for half, and asked where they count for all."""
    adaptation, nothing = _adaptation(), np.zeros((2, 128), np.float32)
    for _ in range(200):
        adaptation.learn_view(FIRST + np.radians([0, 14.0]), nothing, np.array([True, True]))
    assert adaptation.learned.max() > 1.2
    np.testing.assert_allclose(adaptation.share(FIRST + np.radians([0, 22.0])), 1)


@cache
def _turning() -> SyntheticSequence:
    """The face turning from side to side, by up to 20 degrees."""
    angles = np.zeros((FRAMES, 3))
    angles[:, 1] = 20 * np.sin(np.arange(FRAMES) / 12)
    still = np.zeros((FRAMES, 3))
    return make_sequence(face(), moved(face(), angles, still, np.zeros((FRAMES, 6))), noise_sd=1)


@cache
def _with_reflections() -> SyntheticSequence:
    """The same, with a bright spot on each eye, which runs over it as the head turns."""
    sequence, fit = _turning(), face().fit
    vertices = fit.vertices()[VERTICES]
    sides = ([i for i in EYES if side in LANDMARK_NAMES[i]] for side in ("right", "left"))
    centres = np.array([vertices[side].mean(axis=0) for side in sides])
    frames = []
    for frame, R, t in zip(sequence.frames, sequence.R, sequence.t, strict=True):
        spots = np.zeros(frame.pixels.shape[:2], np.float32)
        for x, y in face().camera.project(centres @ R.T + t)[0] - RUN_PX * (R @ fit.R.T)[:2, 2]:
            cv2.ellipse(spots, (round(8 * x), round(8 * y)), (8 * 8, 8 * 5), -30, 0, 360, 1, -1, cv2.LINE_AA, 3)
        pixels = frame.pixels + 90 * cv2.GaussianBlur(spots, (0, 0), 1)[:, :, None]
        frames.append(Frame(np.clip(pixels, 0, 255).astype(np.uint8), frame.index, frame.time))
    return replace(sequence, frames=tuple(frames))


def _run(sequence: SyntheticSequence, **settings: float) -> tuple[RealtimeTracker, Array, Array]:
    """A tracker after a sequence, the errors of its rotations, and which of the eyes' landmarks looked like them."""
    tracker = RealtimeTracker(RealtimeSettings(adaptation=AdaptationSettings(**settings)))
    estimates = run(tracker, sequence)
    distance = np.array([e.landmarks.distance[EYES] for e in estimates if e.landmarks is not None])
    seen = (distance > 0) & (
        distance**2 <= tracker.settings.recovery.seen_distance
    )  # 0 where they do not face the camera
    return tracker, errors_of_all_deg(estimates, sequence), seen


def test_eyes_behind_reflections_are_seen_again() -> None:
    """After half of the turns; without it a third of them has turned away there, or looks strange."""
    tracker, error, seen = _run(_with_reflections())
    _, error_without, seen_without = _run(_with_reflections(), forgetting=0, view_rate=0)
    later = slice(FRAMES // 2, None)
    assert seen_without[later].mean() < 0.75
    assert seen[later].mean() > 0.9
    assert error[later].mean() < 1.15 * error_without[later].mean()
    assert tracker.person.spectacles_evidence > SPECTACLES


def test_a_face_that_looks_as_it_should_is_left_alone() -> None:
    tracker, error, _ = _run(_turning())
    _, error_without, _ = _run(_turning(), forgetting=0)
    assert not tracker.person.adaptation.slope.reshape(2, -1, 128)[:, OTHERS].any()
    assert error.mean() == pytest.approx(error_without.mean(), abs=0.05)
    assert tracker.person.spectacles_evidence < SPECTACLES


def test_what_passes_before_the_face_is_not_learned() -> None:
    """A board that crosses it while it turns."""
    frames = list(_turning().frames)
    for i in range(60, 84):
        pixels = frames[i].pixels.copy()
        left = 40 + 9 * (i - 60)
        pixels[:, left : left + 25] = np.random.default_rng(2).integers(0, 255, (240, 1, 1))
        frames[i] = Frame(pixels, frames[i].index, frames[i].time)
    tracker, error, _ = _run(replace(_turning(), frames=tuple(frames)))
    as_it_is, _, _ = _run(_turning())
    assert np.abs(tracker.person.adaptation.slope).max() <= np.abs(as_it_is.person.adaptation.slope).max() + 1e-6
    assert error[90:].mean() < 0.5


@cache
def _unlike_the_first() -> SyntheticSequence:
    """The face turning by 36 degrees to one side and back in ten seconds, blotched all over beyond 12."""
    angles = np.zeros((240, 3))
    angles[:, 1] = -18 * (1 - np.cos(np.arange(240) / 239 * 2 * np.pi))
    states = moved(face(), angles, np.zeros((240, 3)), np.zeros((240, 6)))
    blotches = cv2.GaussianBlur(np.random.default_rng(3).normal(size=(240, 320)), (0, 0), 3)
    blotched = face().frame.pixels * np.clip(1 + 5 * blotches, 0.3, 1.7)[:, :, None]
    other = replace(face(), frame=Frame(np.clip(blotched, 0, 255).astype(np.uint8)))
    plain, strange = (make_sequence(portrait, states, noise_sd=1) for portrait in (face(), other))
    share = np.clip((-angles[:, 1] - 12) / 18, 0, 1)
    frames = tuple(
        Frame(cv2.addWeighted(a.pixels, 1 - s, b.pixels, s, 0), a.index, a.time)
        for a, b, s in zip(plain.frames, strange.frames, share.tolist(), strict=True)
    )
    return replace(plain, frames=frames)


def test_a_face_that_looks_otherwise_when_it_has_turned_is_followed() -> None:
    """What the first frame shows says nothing there: without what is learned on the way, it is not believed."""
    followed = RealtimeTracker()
    estimates = run(followed, _unlike_the_first())
    alone = run(RealtimeTracker(RealtimeSettings(adaptation=AdaptationSettings(view_rate=0.0))), _unlike_the_first())
    turned = slice(90, 150)
    assert errors_of_all_deg(estimates, _unlike_the_first()).max() < 3
    sure, unsure = (np.array([e.confidence for e in track]) for track in (estimates, alone))
    assert sure[turned].mean() > 0.5 > unsure[turned].mean()
    assert sure[turned].max() < sure[:10].min()  # what is learned on the way is less certain
    assert sure[-1] > 0.95


def test_what_comes_before_an_eye_for_a_moment_is_not_learned() -> None:
    """The face turns aside and stays; then something passes before one eye, again and again, for two frames each."""
    angles = np.zeros((FRAMES, 3))
    angles[:, 1] = np.minimum(0.4 * np.arange(FRAMES), 12.0)
    state = moved(face(), angles, np.zeros((FRAMES, 3)), np.zeros((FRAMES, 6)))
    eye = [i for i in EYES if "left" in LANDMARK_NAMES[i]]
    points = make_sequence(face(), state).landmarks[60][eye]
    (x0, y0), (x1, y1) = points.min(axis=0) - 8, points.max(axis=0) + 8
    place = (round(float(x0)), round(float(y0)), round(float(x1)), round(float(y1)))
    covered = {first + k: place for first in (60, 90, 120) for k in range(2)}
    tracker = RealtimeTracker()
    run(tracker, make_sequence(face(), state, noise_sd=1, occluders=covered))
    assert not tracker.person.adaptation.offset(tracker.pose.angles)[eye].any()
    assert tracker.person.spectacles_evidence < SPECTACLES
