"""Bad pictures of a face with known truth: each is survived, or the track says that it is lost and why.

Found again here means found by keyframes: the detector, which not everybody has, is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import cv2
import numpy as np
import pytest

from long_motion import NOISE_SD, in_order, leaving, sequence, shown, states
from mien.arrays import Array, Pixels
from mien.config import RealtimeSettings
from mien.config.realtime import RecoverySettings, WeightSettings
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import angle_between, matrix_from_euler
from mien.initialization.landmarks import LANDMARK_NAMES
from mien.synthetic import SyntheticSequence, make_sequence, moved
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.state import Estimate, Status
from small_motion import begun, errors_deg, face, run, seen_by_turned, with_border

CLOSE_DEG = 4.5
"""What counts as followed: the undisturbed sequence stays below three degrees."""
BACK_WITHIN = 5
"""Frames after the end of a disturbance until the face is followed again."""
COUNT = len(sequence().frames)


@pytest.fixture(autouse=True)
def _without_detector(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mien.tracking.realtime.recovery.find_by_detector", lambda *_: iter(()))


def _changed(change: Callable[[Array], Array], rows: Iterable[int]) -> SyntheticSequence:
    """The sequence with some of its pictures changed: (H, W, 3) float -> (H, W, 3) float."""
    frames = list(sequence().frames)
    for k in rows:
        frames[k] = Frame(_rounded(change(frames[k].pixels.astype(float))))
    return shown(frames)


def _rounded(image: Array) -> Pixels:
    return np.clip(np.round(image), 0, 255).astype(np.uint8)


def _track(truth: SyntheticSequence) -> tuple[list[Estimate], Array]:
    estimates = run(RealtimeTracker(), truth)
    for estimate in estimates:
        lost = estimate.status is Status.LOST
        assert lost == (estimate.rotation is None)
        assert lost == bool(estimate.reason)
    return estimates, errors_deg(estimates, truth)


def _assert_honest(estimates: list[Estimate], errors: Array) -> None:
    """A frame whose rotation is far off is lost, or its confidence says that it may be."""
    for estimate, error in zip(estimates, errors, strict=True):
        assert np.isnan(error) or error < 2 * CLOSE_DEG or estimate.confidence < 0.5, (estimate.index, error)


def _assert_followed(truth: SyntheticSequence) -> None:
    _, errors = _track(truth)
    assert np.isfinite(errors).all()
    assert errors.max() < CLOSE_DEG


# Frames without a face.
@pytest.mark.parametrize("value", [0, 255])
@pytest.mark.parametrize("length", [1, 5])
def test_black_and_white_frames(value: int, length: int) -> None:
    blank = range(18, 18 + length)
    estimates, errors = _track(_changed(lambda image: np.full_like(image, value), blank))
    assert all(estimates[k].status is Status.LOST for k in blank)
    assert errors[18 + length + BACK_WITHIN :].max() < CLOSE_DEG


def test_the_noise_of_a_dark_camera_is_no_face() -> None:
    """Descriptors have unit length, of however little."""
    rng = np.random.default_rng(0)
    estimates, errors = _track(_changed(lambda image: rng.normal(2, 2, image.shape), range(18, 23)))
    assert {estimates[k].reason for k in range(18, 23)} == {"the image is blank where the face was"}
    assert errors[23 + BACK_WITHIN :].max() < CLOSE_DEG


def test_frames_of_noise() -> None:
    rng = np.random.default_rng(0)
    estimates, errors = _track(_changed(lambda image: rng.uniform(0, 255, image.shape), range(18, 23)))
    assert all(estimates[k].status is Status.LOST for k in range(18, 23))
    assert errors[23 + BACK_WITHIN :].max() < CLOSE_DEG


@pytest.mark.parametrize("pan", [-50.0, 60.0])
def test_a_face_that_looks_aside_from_one_frame_to_the_next(pan: float) -> None:
    """And back: the neck stays where it is."""
    frames, aside = 24, slice(6, 16)
    angles, shift = np.zeros((frames, 3)), np.zeros((frames, 3))
    angles[aside, 1] = pan
    neck = face().fit.R @ [0.0, 0.0, -0.7]
    shift[aside] = neck - matrix_from_euler(np.radians([0.0, pan, 0.0])) @ neck
    states = moved(face(), angles, shift, np.zeros((frames, 6)))
    estimates, errors = _track(make_sequence(face(), states, noise_sd=NOISE_SD))
    assert np.isfinite(errors).all()
    assert errors[aside].max() < 0.2 * abs(pan)
    assert errors[aside.stop :].max() < CLOSE_DEG
    assert estimates[-1].confidence > 0.9


@pytest.mark.parametrize("turn_deg", [(0.0, 28.0), (-10.0, -24.0)])
def test_a_face_at_the_side_of_the_image_is_tracked_as_in_its_middle(turn_deg: tuple[float, float]) -> None:
    """The camera turns away once the face is learned, within ten frames, which moves its image by a homography."""
    border = (240, 120)
    camera = replace(face().camera, cx=face().camera.cx + border[0], cy=face().camera.cy + border[1])
    landmarks = replace(face().landmarks, points=face().landmarks.points + border)
    rotations = []
    for share in (0.0, 1.0):
        tracker, rotated = RealtimeTracker(), []
        for k, frame in enumerate(sequence().frames):
            turn = matrix_from_euler(np.radians([*turn_deg, 0.0]) * share * min(k / 10, 1))
            seen = Frame(seen_by_turned(with_border(frame, *border), camera, turn)[0], k, frame.time)
            found = tracker.track(seen) if k else tracker.initialize(seen, landmarks, camera)
            assert found.rotation is not None
            rotated.append(turn.T @ found.rotation)
        rotations.append(np.array(rotated))
    apart = np.degrees(angle_between(*rotations))
    assert apart.mean() < 0.4
    assert apart.max() < 1.0


def test_a_face_that_stays_away_is_looked_for_less_thoroughly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keyframes and distant faces take most of the time of a search."""
    frames = shown(list(sequence().frames)).frames
    thorough: dict[int, bool] = {}
    known: list[int] = []

    def by_detector(frame: Frame, *given: object) -> Iterator[tuple[Array, Array]]:
        thorough[frame.index] = bool(given[-1])
        return iter(())

    monkeypatch.setattr("mien.tracking.realtime.recovery.find_by_detector", by_detector)
    tracker = begun(frames[0], RealtimeSettings(recovery=RecoverySettings(interval=2, patience=10)))
    monkeypatch.setattr(tracker.recovery.keyframes, "find", lambda frame, _: known.append(frame.index))
    rng = np.random.default_rng(0)
    for k in range(24):  # the first frame that is lost has index 0
        tracker.track(Frame(_rounded(rng.uniform(0, 255, (240, 320, 3))), k))
    assert list(thorough) == [0, 1, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22]
    assert known == [k for k, everywhere in thorough.items() if everywhere] == [0, 1, 2, 4, 6, 8, 12, 18]


def _known(agreement: float | None, monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """How far it is known whose face it is, after each frame, where three are black; agreement: of the face that is
    there then with the one before, as it is if None."""
    truth = _changed(lambda image: 0 * image, range(10, 13))
    tracker, known = begun(truth.frames[0]), []
    for frame in truth.frames[1:]:
        if frame.index == 13 and agreement is not None:
            with monkeypatch.context() as patch:
                patch.setattr(tracker, "_remember", lambda frame, view, solution: (agreement, agreement))
                tracker.track(frame)
        else:
            tracker.track(frame)
        known.append(tracker.identity.probability)
    assert min(known[:12]) > 0.99
    return known[12:]


def test_a_face_that_is_the_same_after_a_loss_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    assert min(_known(None, monkeypatch)) > 0.99


def test_after_a_loss_it_takes_a_while_until_another_face_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    known = _known(0.5, monkeypatch)
    assert known[0] == 0
    assert 0.05 < known[1] < 0.2
    assert known[-1] > 0.85


# The time is not what it should be.
@pytest.mark.parametrize(("last", "then"), [(19, 2), (10, 29), (10, 20), (29, 10)])
def test_a_cut(last: int, then: int) -> None:
    """From one pose to another at once, up to 50 degrees away."""
    truth = in_order([*range(last + 1), *range(then, min(then + 11, COUNT))])
    _, errors = _track(truth)
    assert errors[last + 1 + BACK_WITHIN :].max() < CLOSE_DEG


@pytest.mark.parametrize("times", [2, 3])
def test_every_frame_repeated(times: int) -> None:
    _assert_followed(in_order(np.repeat(np.arange(COUNT), times).tolist()))


def test_one_frame_repeated_for_a_while() -> None:
    _assert_followed(in_order([*range(12), *[12] * 20, *range(13, COUNT)]))


@pytest.mark.parametrize("step", [2, 3])
def test_frames_left_out(step: int) -> None:
    estimates, errors = _track(in_order(range(0, COUNT, step)))
    assert all(e.status.success for e in estimates)
    assert errors.max() < 2 * CLOSE_DEG
    assert errors[-1] < CLOSE_DEG


def test_forwards_and_backwards_ends_where_it_began() -> None:
    there = list(range(COUNT))
    _, errors = _track(in_order(3 * [*there, *there[-2:0:-1]] + [0]))
    assert np.isfinite(errors).all()
    assert errors[-1] < 2


# The face leaves the image, on each side, and comes back.
@pytest.mark.parametrize(("across", "down"), [(3.0, 0.0), (-3.0, 0.0), (0.0, 2.5), (0.0, -2.5)])
def test_a_face_that_leaves_the_image(across: float, down: float) -> None:
    truth = leaving(across, down)
    estimates, errors = _track(truth)
    _assert_honest(estimates, errors)
    inside = np.array([((p >= 0) & (p <= [319, 239])).all(axis=1).mean() for p in truth.landmarks])
    for estimate, share in zip(estimates, inside, strict=True):
        if share == 0:
            assert estimate.status is Status.LOST
    whole = np.flatnonzero(inside == 1)
    back = whole[whole > np.flatnonzero(inside == 0).max()][0]
    assert errors[back + BACK_WITHIN :].max() < CLOSE_DEG
    assert any(e.status is Status.RECOVERED for e in estimates)


# The picture is poor.
@pytest.mark.parametrize("length", [5, 9])
@pytest.mark.parametrize("rows", [range(1, COUNT), range(10, 20)])
def test_motion_blur(length: int, rows: range) -> None:
    _assert_followed(_changed(lambda image: cv2.blur(image, (length, 1)), rows))


@pytest.mark.parametrize("sd", [10, 20])
def test_noise(sd: float) -> None:
    rng = np.random.default_rng(1)
    _assert_followed(_changed(lambda image: image + rng.normal(0, sd, image.shape), range(1, COUNT)))


@pytest.mark.parametrize("quality", [20, 10])
def test_strong_compression(quality: int) -> None:
    def compressed(image: Array) -> Array:
        _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), float)

    _assert_followed(_changed(compressed, range(1, COUNT)))


def test_a_picture_that_becomes_worse_is_not_taken_for_another_face() -> None:
    """While it was good, little was expected to differ; noise that then comes to stay must not cost the landmarks their
    weight."""
    still = np.zeros((200, 3))
    frames = make_sequence(face(), moved(face(), still, still, np.zeros((200, 6))), noise_sd=NOISE_SD).frames
    rng, misfits = np.random.default_rng(1), {}
    noisy = [_rounded(frame.pixels + rng.normal(0, 35, frame.pixels.shape)) for frame in frames[120:]]
    for rate in (0.0, RealtimeSettings().weights.quality_rate):
        tracker = begun(frames[0], RealtimeSettings(weights=WeightSettings(quality_rate=rate)))
        for frame in frames[1:120]:
            tracker.track(frame)
        before = np.median(tracker.person.expected)
        for frame, pixels in zip(frames[120:], noisy, strict=True):
            tracker.track(Frame(pixels, frame.index, frame.time))
        misfits[rate] = np.median(tracker._search(Frame(noisy[-1], 200))[1].d2 / tracker.person.expected)
        assert before < 10
    assert min(misfits) == 0
    assert misfits[0.0] > 1.5
    assert misfits[max(misfits)] < 1.2


# The light changes.
@pytest.mark.parametrize(("gain", "offset"), [(1.5, 0.0), (0.4, 0.0), (1.0, 25.0)])
def test_a_lamp_switched_on_or_off(gain: float, offset: float) -> None:
    _assert_followed(_changed(lambda image: gain * image + offset, range(15, COUNT)))


def test_hardly_any_light() -> None:
    """A face of a dozen grey values."""
    _assert_followed(_changed(lambda image: 0.06 * image, range(10, COUNT)))


def test_a_lamp_on_one_side() -> None:
    across = np.linspace(0.3, 1.7, 320)[None, :, None]
    _assert_followed(_changed(lambda image: image * across, range(15, COUNT)))


def test_a_lamp_too_bright_for_the_camera() -> None:
    """Much of the face is white then. It is followed, or lost until the lamp goes off."""
    estimates, errors = _track(_changed(lambda image: image + 60, range(15, 25)))
    _assert_honest(estimates, errors)
    assert errors[25 + BACK_WITHIN :].max() < CLOSE_DEG


# Something comes before the face.
def test_a_board_before_the_lower_half() -> None:
    def covered(image: Array) -> Array:
        image[150:] = 90
        return image

    _assert_followed(_changed(covered, range(15, 25)))


@pytest.mark.parametrize("side", [-1, 1])
def test_a_board_on_one_half_that_moves_along(side: int) -> None:
    """Its edge runs along the nose, and most of what faces the camera is not the face's: none of it is learned in
    turns, and the face is not looked for elsewhere."""
    truth = make_sequence(face(), states(2 * COUNT, share=0.7), noise_sd=NOISE_SD)
    above, below = (LANDMARK_NAMES.index(name) for name in ("nose_bump", "chin_boss"))
    frames = list(truth.frames)
    for k in range(3, len(frames)):
        along = truth.landmarks[k, below] - truth.landmarks[k, above]
        aside = side * np.array([along[1], -along[0]])
        top, bottom = truth.landmarks[k, above] - along, truth.landmarks[k, below] + along
        board = np.round([top, bottom, bottom + aside, top + aside]).astype(np.int32)
        frames[k] = Frame(cv2.fillConvexPoly(frames[k].pixels.copy(), board, (100, 120, 150)))
    estimates, errors = _track(replace(truth, frames=tuple(frames)))
    _assert_honest(estimates, errors)
    assert np.isfinite(errors).all()
    assert errors.mean() < 2.5
    sure = np.array([estimate.confidence for estimate in estimates]) > 0.75
    assert errors[sure].max() < CLOSE_DEG


def test_a_face_that_comes_back_beside_another_one_is_found() -> None:
    """What is tracked meanwhile has a face of its own, in the place of the one that was learned."""
    portrait = sequence().frames[0].pixels
    x, y = np.meshgrid(np.arange(320, dtype=np.float32), np.arange(240, dtype=np.float32))
    across, down = x + 8 * np.sin(y / 18), y + 8 * np.sin(x / 22 + 1)
    stranger = cv2.remap(portrait, across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[:, ::-1]
    nobody = np.full_like(portrait, 90)
    tracker = RealtimeTracker()
    tracker.initialize(Frame(np.hstack([portrait, nobody])), face().landmarks, Camera(1000, 319.5, 119.5))
    alone = [tracker.track(Frame(np.hstack([stranger, nobody]), k)) for k in range(1, 11)]
    assert all(estimate.status is Status.TRACKED and estimate.confidence < 0.05 for estimate in alone)
    wait = tracker.settings.recovery.doubt_interval
    beside = [tracker.track(Frame(np.hstack([stranger, portrait]), k)) for k in range(11, 12 + wait)]
    assert [estimate.status for estimate in beside].count(Status.RECOVERED) == 1
    assert beside[-1].landmarks is not None
    known = face().landmarks.correspondences()[1].mean(axis=0)
    np.testing.assert_allclose(beside[-1].landmarks.image.mean(axis=0) - known, [320, 0], atol=12)
    assert beside[-1].confidence > 0.9
