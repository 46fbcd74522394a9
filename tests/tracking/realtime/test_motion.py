"""Motion measured from frame to frame: on a rendered face that moves by known steps, and in its parts."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from mien.appearance.views import rotation
from mien.arrays import Array
from mien.candide.model import MOVES_MOUTH, TRACKED_UNITS
from mien.config.realtime import MotionSettings
from mien.frame import Frame
from mien.geometry.rotation import angle_between, exp
from mien.synthetic import SyntheticSequence, make_sequence, moved
from mien.tracking.prior import JAW_DROP
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.realtime.motion import Motion, extract_patches
from mien.tracking.realtime.person import TRACKED
from mien.tracking.realtime.pose import Pose, Prediction
from mien.tracking.realtime.solution import View
from small_motion import begun, face, run

STEP_DEG, STEP = np.array([1.5, -2.0, 1.0]), np.array([0.02, -0.01, 0.0])


@cache
def two_frames() -> SyntheticSequence:
    """The face as it is, and a step further."""
    along = np.array([[0.0], [1.0]])
    return make_sequence(face(), moved(face(), along * STEP_DEG, along * STEP, np.zeros((2, 6))))


@pytest.fixture(scope="module")
def tracker() -> RealtimeTracker:
    tracker = begun(two_frames().frames[0])
    return tracker


@pytest.fixture
def next_frame() -> Frame:
    return two_frames().frames[1]


def _measured(tracker: RealtimeTracker, frame: Frame) -> Pose:
    view = tracker.solver.view(tracker.face.fine, frame, tracker.pose)
    return tracker._predict_from_motion(view, tracker.prior.prediction(tracker.pose, tracker.pose)).pose


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
    mouth = tracker.camera.project(tracker.person.in_camera(tracker.pose))[0][lips].mean(axis=0).astype(int)
    pixels = next_frame.pixels.copy()
    pixels[mouth[1] - 8 : mouth[1] + 40, mouth[0] - 40 : mouth[0] + 40] = (200, 40, 40)
    found = _measured(tracker, Frame(pixels, next_frame.index, next_frame.time))
    assert _error_deg(tracker, found) < 0.6


@pytest.mark.parametrize("step", [0.25, 0.5])
def test_a_mouth_that_widens_at_once_is_measured(step: float) -> None:
    """By some 1.5 and 3 pixels of the crop at either corner, while the rest of the face stays: half of it, as the skin
    next to the corners moves less. Where its patches are outliers among those of the head, a third and none are."""
    animation = np.zeros((2, 6))
    animation[1, TRACKED_UNITS.index("lip_stretcher")] = step
    frames = make_sequence(face(), moved(face(), np.zeros((2, 3)), np.zeros((2, 3)), animation)).frames
    tracker = begun(frames[0])
    found = _measured(tracker, frames[1])
    widened = (found.animation - tracker.pose.animation) / step
    wide = np.array([unit == "lip_stretcher" for unit in TRACKED_UNITS])
    assert widened[wide] > 0.4
    assert np.abs(widened[MOVES_MOUTH & ~wide]).max() < 0.2
    assert np.degrees(angle_between(found.R, tracker.pose.R)) < 0.2


def test_without_patches_the_prediction_stays(tracker: RealtimeTracker, next_frame: Frame) -> None:
    view = tracker.solver.view(tracker.face.fine, next_frame, tracker.pose)
    person, prior = tracker.person.arrays, tracker.prior.arrays(tracker.prior.prediction(tracker.pose, tracker.pose))
    motion = Motion(tracker.face.patches, tracker.person.mouth, 0.6, tracker.settings.motion)
    motion.remember(view.image, person, tracker.pose.arrays, view.geometry)
    (R, t, _), information = motion.measure(view.image, person, prior, view.geometry)
    np.testing.assert_allclose(R, tracker.pose.R, atol=1e-9)
    np.testing.assert_allclose(t, tracker.pose.t, atol=1e-9)
    np.testing.assert_array_equal(information, 0)


def test_derivatives_against_differences() -> None:
    """On an image that bilinear interpolation reads exactly, so that its derivatives are exact too."""
    rng = np.random.default_rng(0)
    v, u = np.mgrid[:112, :112].astype(np.float32)
    image = np.asarray(0.5 * u + 0.3 * v + 0.01 * u * v, np.float32)
    person = rng.uniform(-0.3, 0.3, (3, 3)), rng.normal(0, 0.1, (6, 3, 3))
    patches = rng.uniform(-0.1, 0.1, (3, 3, 9))
    R, t, a = rotation(0.1, -0.2, 0.05), np.array([0.02, 0.0, 5.0]), rng.uniform(-0.2, 0.2, 6)
    view = np.array([[288.0, 32.0, 55.0], [-32.0, 288.0, 55.0], [0.2, -0.1, 1.0]]), np.eye(3)

    def values(step: Array) -> Array:
        pose = exp(step[:3]) @ R, t + step[3:6], a + step[6:]
        return np.asarray(extract_patches(image, person, patches, pose, view)[0], float)

    _, norms, rigid, JJ, turned = extract_patches(image, person, patches, (R, t, a), view)
    J = np.concatenate([rigid, np.einsum("nkr,nrm->nkm", turned, rigid[:, 3:])], axis=1)
    np.testing.assert_allclose(norms, np.linalg.norm(values(np.zeros(12)), axis=1), rtol=1e-5)
    np.testing.assert_allclose(JJ, np.einsum("nkm,nlm->nkl", J, J), rtol=1e-4, atol=1e-2)
    for step in 0.01 * np.eye(12):
        expected = (values(step) - values(-step)) / 0.02
        np.testing.assert_allclose(np.einsum("nkm,k->nm", J, step / 0.01), expected, atol=0.02 * np.abs(expected).max())


def test_information_of_a_measured_step_by_hand() -> None:
    settings = MotionSettings(rotation_deg=0.3, translation=0.01, animation=0.02, share=0.5, noise=4.0)
    motion = Motion(np.zeros((2, 4, 3)), np.ones(2, bool), 0.8, settings)
    step = np.array([0.03, 0.04, 0, 0, 0, 0.2, *np.zeros(5), 0.1])
    rng = np.random.default_rng(0)
    measured, prior, since = (X @ X.T + np.eye(12) for X in rng.normal(size=(3, 12, 12)))
    drift = np.repeat([np.radians(0.3) ** 2 + 0.025**2, 0.01**2 + 0.1**2, 0.02**2], [3, 3, 6])
    drift[[6 + JAW_DROP, 11]] = 0.8**2, 0.02**2 + 0.05**2
    expected = np.linalg.inv(np.linalg.inv(measured / 4 + prior) + since + np.diag(drift))
    np.testing.assert_allclose(motion.information_of(measured, prior, since, step), expected, rtol=1e-6, atol=1e-9)


class _Unmoved(RealtimeTracker):
    def _predict_from_motion(self, view: View, predicted: Prediction) -> Prediction:
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
        tracker = begun(first)
        view, solution = tracker.solver.refine(next_frame, tracker.prior.prediction(tracker.pose, tracker.pose))
        tracker.pose = solution.pose
        seen = tracker.solver.view(tracker.face.fine, frame, solution.pose)
        agreements.append(tracker._remember(frame, replace(seen, facing=view.facing), solution)[0])
    same, noised, other = agreements
    assert same > 0.97
    assert 0.5 < noised < same
    assert other < 0.4
