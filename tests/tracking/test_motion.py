"""Motion measured from frame to frame: on a rendered face that moves by known steps, and in its parts."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from mien.appearance.views import rotation
from mien.config import RealtimeSettings
from mien.frame import Frame
from mien.geometry.rotation import Array, angle_between, exp
from mien.synthetic import SyntheticSequence, make_sequence, moved
from mien.tracking.motion import JAW_DROP, Motion, take_patches
from mien.tracking.person import TRACKED
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.solution import Pose, Prediction, View
from small_motion import face, run

STEP_DEG, STEP = np.array([1.5, -2.0, 1.0]), np.array([0.02, -0.01, 0.0])


@cache
def two_frames() -> SyntheticSequence:
    """The face as it is, and a step further."""
    along = np.array([[0.0], [1.0]])
    return make_sequence(face(), moved(face(), along * STEP_DEG, along * STEP, np.zeros((2, 6))))


@pytest.fixture(scope="module")
def tracker() -> RealtimeTracker:
    tracker = RealtimeTracker()
    tracker.initialize(two_frames().frames[0], face().landmarks, face().camera)
    return tracker


@pytest.fixture
def next_frame() -> Frame:
    return two_frames().frames[1]


def _measured(tracker: RealtimeTracker, frame: Frame) -> Pose:
    view = tracker._look(tracker.face.fine, frame, tracker.pose)
    return tracker._move(view, tracker._stay()).pose


def _error_deg(tracker: RealtimeTracker, found: Pose) -> float:
    turn = two_frames().R[1] @ two_frames().R[0].T
    return float(np.degrees(angle_between(found.R @ tracker.pose.R.T, turn)))


def test_a_step_is_measured(tracker: RealtimeTracker, next_frame: Frame) -> None:
    """Of 2.7 degrees, to a tenth of them."""
    found = _measured(tracker, next_frame)
    assert _error_deg(tracker, found) < 0.2
    np.testing.assert_allclose(found.t - tracker.pose.t, STEP, atol=0.02)


def test_brightness_and_contrast_do_not_matter(tracker: RealtimeTracker, next_frame: Frame) -> None:
    found = _measured(tracker, next_frame)
    dimmed = Frame((0.7 * next_frame.pixels + 20).astype(np.uint8), next_frame.index, next_frame.time)
    of_dimmed = _measured(tracker, dimmed)
    assert np.degrees(angle_between(found.R, of_dimmed.R)) < 0.1


def test_what_comes_before_the_face_is_left_out(tracker: RealtimeTracker, next_frame: Frame) -> None:
    """A board over the mouth, which was not there before."""
    lips = ["lip" in name or "mouth" in name for name in TRACKED]
    mouth = tracker.camera.project(tracker.person.posed(tracker.pose))[0][lips].mean(axis=0).astype(int)
    pixels = next_frame.pixels.copy()
    pixels[mouth[1] - 8 : mouth[1] + 40, mouth[0] - 40 : mouth[0] + 40] = (200, 40, 40)
    found = _measured(tracker, Frame(pixels, next_frame.index, next_frame.time))
    assert _error_deg(tracker, found) < 0.6


def test_patches_agree_that_have_long_been_the_same(tracker: RealtimeTracker) -> None:
    """Sixty frames of the same picture, then one of noise: what came before the face has to stay as long again."""
    view = tracker._look(tracker.face.fine, two_frames().frames[0], tracker.pose)
    person, weight = tracker.person.arrays, np.ones(len(tracker.person.neutral))
    noise = np.random.default_rng(0).normal(128, 40, view.image.shape).astype(np.float32)
    motion = Motion(tracker.face.patches, tracker.settings)
    for _ in range(60):
        motion.remember(view.image, person, tracker.pose.arrays, view.geometry, weight)
    assert motion.agreement.min() > 0.9
    motion.remember(noise, person, tracker.pose.arrays, view.geometry, weight)
    assert motion.agreement.max() < 0.7
    for _ in range(20):
        motion.remember(view.image, person, tracker.pose.arrays, view.geometry, weight)
    assert motion.agreement.max() < 0.9


def test_a_picture_that_dissolves_into_another_is_the_same_from_frame_to_frame_and_not_after_a_while(
    tracker: RealtimeTracker,
) -> None:
    view = tracker._look(tracker.face.fine, two_frames().frames[0], tracker.pose)
    other = np.random.default_rng(0).normal(0, 40, view.image.shape)
    other = cv2.GaussianBlur(other.astype(np.float32), (0, 0), 2) * 6 + 128
    person, weight = tracker.person.arrays, np.ones(len(tracker.person.neutral))
    motion, agreements = Motion(tracker.face.patches, tracker.settings), []
    for share in np.clip(np.arange(50) / 20 - 1, 0, 1).astype(np.float32):
        image = (1 - share) * view.image + share * other
        agreements.append(motion.remember(image, person, tracker.pose.arrays, view.geometry, weight))
    last, later = np.array(agreements[1:]).T
    assert last.min() > 0.9
    assert later[:20].min() > 0.99
    assert later.min() < 0.6
    assert later[-1] > 0.95  # the other picture, which stays


def test_a_face_that_was_hidden_is_known_again_where_it_looks_as_before(tracker: RealtimeTracker) -> None:
    """However long something else was there; and once, so that a later doubt is another one."""
    view = tracker._look(tracker.face.fine, two_frames().frames[0], tracker.pose)
    other = np.random.default_rng(0).normal(0, 40, view.image.shape).astype(np.float32)
    other = cv2.GaussianBlur(other, (0, 0), 2) * 6 + 128
    person, weight = tracker.person.arrays, np.ones(len(tracker.person.neutral))
    motion = Motion(tracker.face.patches, tracker.settings)

    def again(*images: Array) -> list[bool]:
        found = []
        for image in images:
            motion.remember(image.astype(np.float32), person, tracker.pose.arrays, view.geometry, weight)
            found.append(motion.is_again(0.85))
        return found

    assert again(*[view.image] * 13) == [False] * 13  # nothing is kept
    assert again(other) == [False]
    motion.keep()
    assert again(*[other] * 40, 0.5 * view.image + 0.5 * other) == [False] * 41
    assert again(view.image, view.image) == [True, False]


@pytest.mark.parametrize(("surroundings", "known"), [(1.0, True), (0.5, False)])
def test_a_known_face_is_known_again_after_a_single_frame_of_something_else(
    surroundings: float, known: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Unless its surroundings have changed. It does not look as in the first frame, so that familiarity cannot tell."""
    tracker = RealtimeTracker()
    first = two_frames().frames[0]
    tracker.initialize(first, face().landmarks, face().camera)
    monkeypatch.setattr("mien.tracking.realtime.familiarity", lambda *of: 0.0)
    for _ in range(14):
        tracker.track(first)
    before = tracker.known
    with monkeypatch.context() as doubt:
        doubt.setattr("mien.tracking.realtime.is_same", lambda *of, surroundings: False)
        doubt.setattr(tracker, "_surroundings", lambda frame: surroundings)
        tracker.track(first)
    doubted = tracker.known
    tracker.track(first)
    assert before > 0.9
    assert doubted == 0
    assert (tracker.known > 0.9) is known


def test_what_looks_strange_everywhere_is_compared_everywhere(tracker: RealtimeTracker) -> None:
    """Weights of nothing but strange landmarks say that they can be seen, no more."""
    view = tracker._look(tracker.face.fine, two_frames().frames[0], tracker.pose)
    person, strange = tracker.person.arrays, np.full(len(tracker.person.neutral), 0.01)
    motion = Motion(tracker.face.patches, tracker.settings)
    found = [motion.remember(view.image, person, tracker.pose.arrays, view.geometry, strange) for _ in range(2)]
    np.testing.assert_allclose(found, [(0, 0), (1, 1)], atol=1e-4)
    hidden = motion.remember(view.image, person, tracker.pose.arrays, view.geometry, 0 * strange)
    assert motion.remember(view.image, person, tracker.pose.arrays, view.geometry, 0 * strange)[0] == 0
    assert hidden[0] == pytest.approx(1)  # they were seen in the frame before


def test_patches_that_are_alike_on_all_faces_do_not_say_whose_this_is(tracker: RealtimeTracker) -> None:
    """Two thirds of them stay as they are, the others become noise."""
    view = tracker._look(tracker.face.fine, two_frames().frames[0], tracker.pose)
    noise = np.random.default_rng(0).normal(128, 40, view.image.shape).astype(np.float32)
    n = len(tracker.person.neutral)
    person, weight, alike = tracker.person.arrays, np.ones(n), np.arange(n) % 3 > 0
    found = []
    for motion in (
        Motion(tracker.face.patches, tracker.settings, alike),
        Motion(tracker.face.patches, tracker.settings),
    ):
        motion.remember(view.image, person, tracker.pose.arrays, view.geometry, weight)
        patches, norms, seen = motion.seen[0]
        motion.remember(noise, person, tracker.pose.arrays, view.geometry, weight)
        noisy, noisy_norms, _ = motion.seen[-1]
        motion.seen[-1] = np.where(alike[:, None], patches, noisy), np.where(alike, norms, noisy_norms), seen
        found.append(motion.remember(view.image, person, tracker.pose.arrays, view.geometry, weight)[0])
    assert found[0] < 0.5
    assert found[1] > 0.99


def test_without_patches_the_prediction_stays(tracker: RealtimeTracker, next_frame: Frame) -> None:
    view = tracker._look(tracker.face.fine, next_frame, tracker.pose)
    person, prior = tracker.person.arrays, tracker._prior(tracker._stay())
    motion = Motion(tracker.face.patches, tracker.settings)
    motion.remember(view.image, person, tracker.pose.arrays, view.geometry, np.zeros(len(tracker.person.neutral)))
    (R, t, _), covariance = motion.measure(view.image, person, prior, view.geometry)
    np.testing.assert_allclose(R, tracker.pose.R, atol=1e-9)
    np.testing.assert_allclose(t, tracker.pose.t, atol=1e-9)
    np.testing.assert_allclose(covariance, np.linalg.inv(tracker.information))


def test_derivatives_against_differences() -> None:
    """On an image that bilinear interpolation reads exactly, so that its derivatives are exact too."""
    rng = np.random.default_rng(0)
    v, u = np.mgrid[:112, :112].astype(np.float32)
    image = np.asarray(0.5 * u + 0.3 * v + 0.01 * u * v, np.float32)
    person = rng.uniform(-0.3, 0.3, (3, 3)), rng.normal(0, 0.1, (6, 3, 3))
    patches = rng.uniform(-0.1, 0.1, (3, 3, 9))
    R, t, a = rotation(0.1, -0.2, 0.05), np.array([0.02, 0.0, 5.0]), rng.uniform(-0.2, 0.2, 6)
    view = np.array([320.0, 0, 0]), np.array([[0.9, 0.1], [-0.1, 0.9]]), np.array([55.0, 55.0]), np.eye(3)

    def values(step: Array) -> Array:
        pose = exp(step[:3]) @ R, t + step[3:6], a + step[6:]
        return np.asarray(take_patches(image, person, patches, pose, view)[0], float)

    _, norms, rigid, JJ, turned = take_patches(image, person, patches, (R, t, a), view)
    J = np.concatenate([rigid, np.einsum("nkr,nrm->nkm", turned, rigid[:, 3:])], axis=1)
    np.testing.assert_allclose(norms, np.linalg.norm(values(np.zeros(12)), axis=1), rtol=1e-5)
    np.testing.assert_allclose(JJ, np.einsum("nkm,nlm->nkl", J, J), rtol=1e-4, atol=1e-2)
    for step in 0.01 * np.eye(12):
        expected = (values(step) - values(-step)) / 0.02
        np.testing.assert_allclose(np.einsum("nkm,k->nm", J, step / 0.01), expected, atol=0.02 * np.abs(expected).max())


def test_drift_by_hand() -> None:
    settings = RealtimeSettings(
        motion_rotation_deg=0.3, motion_translation=0.01, motion_animation=0.02, motion_share=0.5, prior_jaw=0.8
    )
    step = np.array([0.03, 0.04, 0, 0, 0, 0.2, *np.zeros(5), 0.1])
    found = Motion(np.zeros((2, 4, 3)), settings).drift(step)
    np.testing.assert_allclose(found[:3], np.radians(0.3) ** 2 + 0.025**2)
    np.testing.assert_allclose(found[3:6], 0.01**2 + 0.1**2)
    assert found[11] == pytest.approx(0.02**2 + 0.05**2)
    assert found[6 + JAW_DROP] == pytest.approx(0.8**2)


class _Unmoved(RealtimeTracker):
    def _move(self, view: View, predicted: Prediction) -> Prediction:
        return predicted


def test_it_takes_out_noise_and_does_not_lag() -> None:
    """A face that turns back and forth by a degree from frame to frame, with the noise of a camera."""
    angles = np.zeros((30, 3))
    angles[1:, 1] = np.random.default_rng(1).normal(0, 1.0, 29)
    shaking = make_sequence(face(), moved(face(), angles, np.zeros((30, 3)), np.zeros((30, 6))), noise_sd=4)
    true = np.array([R @ shaking.R[0].T for R in shaking.R])
    jitter, gain = {}, {}
    for cls in (RealtimeTracker, _Unmoved):
        R = np.array([e.rotation for e in run(cls(), shaking)])
        turn = np.array([r @ R[0].T for r in R])
        error = np.degrees((turn - true)[:, 0, 2])
        jitter[cls] = np.diff(error, 2).std()
        gain[cls] = np.polyfit(np.diff(true[:, 0, 2], 2), np.diff(turn[:, 0, 2], 2), 1)[0]
    assert jitter[RealtimeTracker] < 0.8 * jitter[_Unmoved]
    assert gain[RealtimeTracker] == pytest.approx(1, abs=0.1)


def test_a_face_is_the_same_in_the_next_frame_and_another_picture_is_not(next_frame: Frame) -> None:
    """At the pose where it is. Noise of 30 grey values leaves more than half, a face upside down nothing."""
    first, *_ = two_frames().frames
    noise = np.random.default_rng(0).normal(0, 30, first.pixels.shape)
    noisy = Frame(np.clip(next_frame.pixels + noise, 0, 255).astype(np.uint8), next_frame.index, next_frame.time)
    turned = Frame(np.ascontiguousarray(next_frame.pixels[::-1]), next_frame.index, next_frame.time)
    agreements = []
    for frame in (next_frame, noisy, turned):
        tracker = RealtimeTracker()
        tracker.initialize(first, face().landmarks, face().camera)
        view, solution = tracker._fine(next_frame, tracker._stay())
        tracker.pose = solution.pose
        seen = tracker._look(tracker.face.fine, frame, solution.pose)
        agreements.append(tracker._remember(frame, replace(seen, facing=view.facing), solution)[0])
    same, noised, other = agreements
    assert same > 0.97
    assert 0.5 < noised < same
    assert other < 0.4
