"""Eyes behind dark glasses or a light, and mouths behind a mask, painted before a rendered face that moves."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import cache

import cv2
import numpy as np
import pytest

from mien.arrays import Array, Float32
from mien.candide.model import MOVES_MOUTH
from mien.config import RealtimeSettings
from mien.config.realtime import MisplacementSettings, VisibilitySettings
from mien.errors import MienWarning
from mien.frame import Frame
from mien.geometry.rotation import angle_between
from mien.initialization.landmarks import LANDMARK_NAMES
from mien.synthetic import SyntheticSequence, make_sequence, moved
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.state import Estimate
from small_motion import face, run

SIDES = ("right", "left")
EYES = {side: [k for k, name in enumerate(LANDMARK_NAMES) if name.startswith(f"{side}_eye")] for side in SIDES}
REST = [k for k, name in enumerate(LANDMARK_NAMES) if "lip" in name or "mouth" in name or "chin" in name]
OUTER_CORNERS = [f"{side}_eye_outer_corner" for side in SIDES]
FRAMES, PUT_ON = 8, 3
DARK, BRIGHT = 0.08, 255.0

Change = Callable[[Float32], Float32]


@cache
def _sequence() -> SyntheticSequence:
    along = np.linspace(0, 1, FRAMES)[:, None]
    angles, shift = along * [3.0, 10.0, -4.0], along * [0.05, 0.0, 0.0]
    return make_sequence(face(), moved(face(), angles, shift, np.zeros((FRAMES, 6))), noise_sd=1)


def _over_eyes(pixels: Float32, points: Array, size: float, change: Change, sides: tuple[str, ...]) -> Float32:
    """The picture with eyes, at the image points (26, 2), under ellipses of this size, in widths of the eye, that
    change what lies under them."""
    under = np.zeros(pixels.shape[:2], np.float32)
    for side in sides:
        outer, inner = (points[LANDMARK_NAMES.index(f"{side}_eye_{corner}_corner")] for corner in ("outer", "inner"))
        (x, y), (across, down) = (outer + inner) / 2, inner - outer
        width, angle = float(np.hypot(across, down)), float(np.degrees(np.arctan2(down, across)))
        ellipse = (float(x), float(y)), (2 * size * width, 1.5 * size * width), angle
        cv2.ellipse(under, ellipse, 1.0, -1, cv2.LINE_AA)
    share = cv2.GaussianBlur(under, (0, 0), 1.0)[..., None]
    return np.asarray(pixels + share * (change(pixels) - pixels), np.float32)


def _track(
    change: Change, sides: tuple[str, ...] = SIDES, begin: int = 0, size: float = 1.0, seen: Change | None = None,
    settings: RealtimeSettings | None = None,
) -> list[Estimate]:  # fmt: skip
    """Estimates of a face before whose eyes something comes in frame `begin`; seen: what the camera makes of it all."""
    frames = []
    for k, (frame, points) in enumerate(zip(_sequence().frames, _sequence().landmarks, strict=True)):
        pixels = frame.pixels.astype(np.float32)
        pixels = _over_eyes(pixels, points, size, change, sides) if k >= begin else pixels
        pixels = seen(pixels) if seen else pixels
        frames.append(Frame(np.clip(np.round(pixels), 0, 255).astype(np.uint8), frame.index, frame.time))
    truth = _sequence()
    sequence = SyntheticSequence(tuple(frames), truth.landmarks, truth.R, truth.t, truth.animation)
    return run(RealtimeTracker(settings), sequence)


def _visibility(estimates: list[Estimate], landmarks: list[int]) -> Array:
    """(n, k) of some landmarks."""
    visible = [e.landmarks.visibility for e in estimates if e.landmarks is not None]
    assert len(visible) == len(estimates)
    return np.array([of_frame[landmarks] for of_frame in visible if of_frame is not None])


def _dark(pixels: Float32) -> Float32:
    return DARK * pixels


def _bright(pixels: Float32) -> Float32:
    return np.full_like(pixels, BRIGHT)


def _plain(pixels: Float32) -> Float32:
    return np.full_like(pixels, np.median(pixels))


def _as_they_are(pixels: Float32) -> Float32:
    return pixels


COVERS = pytest.mark.parametrize("cover", [_dark, _bright, _plain], ids=["dark glasses", "a light", "something plain"])


@COVERS
def test_nothing_is_told_of_eyes_that_are_covered_while_a_face_is_tracked(cover: Change) -> None:
    estimates = _track(cover, begin=PUT_ON)
    for k, estimate in enumerate(estimates):
        assert (estimate.closing is None) == (k >= PUT_ON)
        assert np.isnan(estimate.expression[-1]) == (k >= PUT_ON)
    for side in SIDES:
        assert (_visibility(estimates[:PUT_ON], EYES[side]) > 0.5).all()
        assert (_visibility(estimates[PUT_ON:], EYES[side]) == 0).all()
    assert (_visibility(estimates, REST) > 0.5).all()


@COVERS
def test_nothing_is_told_of_eyes_that_are_covered_where_the_face_is_learned(cover: Change) -> None:
    with pytest.warns(MienWarning, match=r"eyes cannot be seen at 0\.00 s|the eyes are shut, covered"):
        estimates = _track(cover)
    assert all(estimate.closing is None for estimate in estimates)
    assert (_visibility(estimates, EYES["right"] + EYES["left"]) == 0).all()


def test_dark_glasses_are_warned_of_where_the_face_is_learned() -> None:
    with pytest.warns(MienWarning, match=r"the eyes cannot be seen at 0\.00 s, where the face is learned"):
        _track(_dark)


def test_nothing_is_told_once_glasses_that_were_learned_are_taken_off() -> None:
    """How shut eyes would look is not known then."""
    first, *later = _sequence().frames
    behind = _over_eyes(first.pixels.astype(np.float32), _sequence().landmarks[0], 1.0, _dark, SIDES)
    tracker = RealtimeTracker()
    with pytest.warns(MienWarning, match="the eyes cannot be seen"):
        tracker.initialize(Frame(behind.astype(np.uint8)), face().landmarks, face().camera)
    assert all(tracker.track(frame).closing is None for frame in later)


def _sliding(worn_sd: float, paint: Callable[[Float32, Array, float], Float32]) -> tuple[list[Estimate], float]:
    """Estimates of a face that keeps still, and their largest rotation from the first, in degrees, with something worn
    before it that slides down by a fifth of the distance of the eyes. paint: before the points (26, 2), so far down."""
    frame, points = _sequence().frames[0], _sequence().landmarks[0]
    tracker, estimates = RealtimeTracker(RealtimeSettings(misplacement=MisplacementSettings(worn_sd=worn_sd))), []
    apart = float(np.linalg.norm(np.subtract(*(points[LANDMARK_NAMES.index(name)] for name in OUTER_CORNERS))))
    for k, down in enumerate(np.linspace(0, 0.2 * apart, 12)):
        pixels = paint(frame.pixels.astype(np.float32), points, float(down))
        seen = Frame(np.clip(np.round(pixels), 0, 255).astype(np.uint8), k, k / 30)
        estimates.append(tracker.track(seen) if k else tracker.initialize(seen, face().landmarks, face().camera))
    seen_as = [estimate.model_rotation for estimate in estimates]
    turns = [angle_between(R, seen_as[0]) for R in seen_as if R is not None and seen_as[0] is not None]
    assert len(turns) == len(estimates)
    return estimates, float(np.degrees(np.max(turns)))


def _glasses(pixels: Float32, points: Array, down: float) -> Float32:
    return _over_eyes(pixels, np.add(points, [0.0, down]), 1.0, _dark, SIDES)


def _mask(pixels: Float32, points: Array, down: float) -> Float32:
    at = {name: points[k] + [0.0, down] for k, name in enumerate(LANDMARK_NAMES)}
    (x, y), chin = at["nose_tip"], at["chin_boss"]
    across = float(np.linalg.norm(np.subtract(*(at[name] for name in OUTER_CORNERS))))
    under = np.zeros(pixels.shape[:2], np.float32)
    ellipse = (float(x + chin[0]) / 2, float(y + chin[1]) / 2), (1.3 * across, 1.7 * float(chin[1] - y)), 0.0
    cv2.ellipse(under, ellipse, 1.0, -1, cv2.LINE_AA)
    share = cv2.GaussianBlur(under, (0, 0), 1.0)[..., None]
    return np.asarray(pixels + share * (np.array([150, 185, 205]) - pixels), np.float32)


@pytest.mark.parametrize(
    ("paint", "told"),
    [(_glasses, "the eyes (cannot be seen|are shut, covered)"), (_mask, r"the mouth cannot be seen at 0\.00 s")],
)
def test_what_is_worn_where_the_face_is_learned_slides_without_it(
    paint: Callable[[Float32, Array, float], Float32], told: str
) -> None:
    with pytest.warns(MienWarning, match=told):
        turned, taken_for_it = (_sliding(worn_sd, paint)[1] for worn_sd in (4.0, 0.05))
    assert turned < 0.5 * taken_for_it
    assert turned < 3.0


def test_behind_glasses_that_were_learned_a_face_is_less_certain() -> None:
    with pytest.warns(MienWarning, match="the eyes"):
        estimates, _ = _sliding(4.0, _glasses)
    still = run(RealtimeTracker(), _sequence())
    sd, usual = (
        [np.sqrt(np.trace(e.covariance[:3, :3])) for e in of if e.covariance is not None] for of in (estimates, still)
    )
    assert min(sd) > 1.2 * max(usual)
    assert max(e.confidence for e in estimates) < min(e.confidence for e in still)


def test_of_a_mouth_behind_a_mask_nothing_is_told() -> None:
    with pytest.warns(MienWarning, match="the mouth cannot be seen"):
        estimates, _ = _sliding(4.0, _mask)
    assert (_visibility(estimates, REST) == 0).all()
    assert (_visibility(estimates[:1], EYES["right"] + EYES["left"]) > 0.5).all()
    for estimate in estimates:
        assert estimate.animation is not None
        assert estimate.covariance is not None
        np.testing.assert_array_equal(estimate.animation[MOVES_MOUTH], estimates[0].animation[MOVES_MOUTH])
        assert (np.sqrt(np.diag(estimate.covariance)[6:])[MOVES_MOUTH] >= 0.2).all()


def test_an_eye_that_is_seen_tells() -> None:
    estimates = _track(_dark, sides=("left",), begin=PUT_ON)
    assert all(estimate.closing is not None for estimate in estimates)
    assert (_visibility(estimates[PUT_ON:], EYES["left"]) == 0).all()
    assert (_visibility(estimates[PUT_ON:], EYES["right"]) > 0.5).all()


def _dim(pixels: Float32) -> Float32:
    return 0.12 * pixels


def _hazy(pixels: Float32) -> Float32:
    return 0.3 * pixels + 160


def _blurred(pixels: Float32) -> Float32:
    return np.asarray(cv2.GaussianBlur(pixels, (0, 0), 3.0), np.float32)


@pytest.mark.parametrize("seen", [_as_they_are, _dim, _hazy, _blurred], ids=["well lit", "dim", "hazy", "out of focus"])
def test_eyes_are_seen_whatever_the_camera_makes_of_the_whole_face(seen: Change) -> None:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*the face is blurred", MienWarning)
        estimates = _track(_as_they_are, seen=seen)
    assert all(estimate.closing is not None for estimate in estimates)
    visible = _visibility(estimates, EYES["right"] + EYES["left"] + REST)
    assert (visible > 0).all()


@pytest.mark.parametrize("seen", [_dim, _hazy], ids=["dim", "hazy"])
def test_dark_glasses_are_noticed_whatever_the_light(seen: Change) -> None:
    estimates = _track(_dark, begin=PUT_ON, seen=seen)
    assert [estimate.closing is None for estimate in estimates] == [k >= PUT_ON for k in range(FRAMES)]


def test_lenses_that_let_the_eyes_be_seen_hide_nothing() -> None:
    def tinted(pixels: Float32) -> Float32:
        return 0.5 * pixels

    assert all(estimate.closing is not None for estimate in _track(tinted))


def test_what_is_not_told_of_the_eyes_moves_no_head() -> None:
    never = RealtimeSettings(visibility=VisibilitySettings(least_eye_contrast=0.0, eye_glare=9.0))
    for told, silent in zip(_track(_dark, begin=PUT_ON, settings=never), _track(_dark, begin=PUT_ON), strict=True):
        assert told.closing is not None
        assert told.rotation is not None
        np.testing.assert_array_equal(told.rotation, silent.rotation)
        np.testing.assert_array_equal(told.covariance, silent.covariance)


def test_eyes_that_are_taken_for_shut_are_looked_at_as_well() -> None:
    """They take no part in the pose then."""
    shut = RealtimeSettings(visibility=VisibilitySettings(closing_share=1e-9))
    estimates = _track(_dark, begin=PUT_ON, settings=shut)
    assert [estimate.closing is None for estimate in estimates] == [k >= PUT_ON for k in range(FRAMES)]
