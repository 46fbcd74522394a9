"""Closing eyes by hand, and on a rendered face that blinks."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from mien.arrays import Array, Float32, Mask, Pixels
from mien.config import RealtimeSettings
from mien.config.realtime import MotionSettings, VisibilitySettings
from mien.errors import MienWarning
from mien.frame import Frame
from mien.initialization.landmarks import LANDMARK_NAMES, Landmarks
from mien.synthetic import SyntheticSequence, make_sequence, moved
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.realtime.eyes import closing_of
from mien.tracking.state import Closing, Estimate, Status
from small_motion import begun, face, run

N = 4
SEEN = np.ones(N, bool)
HALF, SHUT, OTHER, LEFT, RIGHT = np.random.default_rng(0).normal(0, 0.05, (5, N, 128)).astype(np.float32)
CHANGES = np.stack([HALF, SHUT, LEFT, RIGHT])
EYE = ("eye_outer_corner", "eye_inner_corner", "eyelid_upper_mid", "eyelid_lower_mid")
CLOSING = (0.3, 0.7, 1.0, 1.0, 0.7, 0.3)
FIRST_BLINK, FRAMES = 12, 24
LASHES = (60, 40, 40)


def _closing(residual: Float32, seen: Mask = SEEN) -> Closing:
    found = closing_of(residual, CHANGES, seen)
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("residual", "share"),
    [(0 * HALF, 0.0), (0.5 * HALF, 0.2), (HALF, 0.4), (SHUT, 0.8), (1.5 * SHUT - 0.5 * HALF, 1.0)],
    ids=["open", "a fifth", "drawn half closed", "drawn shut", "shut"],
)
def test_how_far_eyes_have_closed_is_where_they_lie_on_the_way(residual: Float32, share: float) -> None:
    """Real lids are shut a quarter beyond drawn ones; the way is known to 0.05 and a quarter of the share."""
    found = _closing(residual)
    assert found.share == pytest.approx(share, abs=0.01)
    assert found.sd == pytest.approx(np.hypot(0.05, 0.25 * share), abs=0.01)


@pytest.mark.parametrize("residual", [-SHUT, OTHER, 0.15 * HALF + OTHER], ids=["wider", "else", "a little, and else"])
def test_eyes_that_look_otherwise_are_rather_open(residual: Float32) -> None:
    assert _closing(residual).share < 0.1


def test_what_lies_far_beside_the_way_says_little() -> None:
    near, far = (_closing(0.5 * HALF + amount * OTHER) for amount in (0.1, 0.8))
    assert near.share == pytest.approx(0.2, abs=0.02)
    assert far.share < 0.5 * near.share
    assert far.sd > 1.2 * near.sd


def test_eyes_that_were_closed_are_believed_sooner_to_be_so() -> None:
    residual = 0.5 * HALF + 0.9 * OTHER
    opened, shut = (closing_of(residual, CHANGES, SEEN, before) for before in (None, Closing(1.0, 0.1)))
    assert opened is not None
    assert shut is not None
    assert shut.share > 1.5 * opened.share


def test_a_glance_aside_is_no_closing() -> None:
    """A glance that looks much like shut eyes, since where the iris was there is white; by half as far, too."""
    glance = 0.5 * LEFT + SHUT
    aside, elsewhere = (np.stack([HALF, SHUT, look, RIGHT]) for look in (glance, OTHER))
    for far in (0.5, 1.0):
        found, unaware = (closing_of(far * glance, known, SEEN) for known in (aside, elsewhere))
        assert found is not None
        assert unaware is not None
        assert found.share < 0.1 < unaware.share
    both = closing_of(glance + SHUT, aside, SEEN)
    assert both is not None
    assert both.share > 0.6


def test_what_is_hidden_says_nothing() -> None:
    residual = HALF.copy()
    residual[2:] = 9.0
    assert _closing(residual, np.arange(N) < 2).share == pytest.approx(0.4, abs=0.01)
    assert closing_of(SHUT, CHANGES, ~SEEN) is None


def test_nothing_is_known_of_eyes_that_were_closed_already() -> None:
    assert closing_of(SHUT, 0.02 * CHANGES, SEEN) is None


def _lid(pixels: Pixels, points: Array, share: float) -> Pixels:
    """One eye, of image points [outer, inner, upper, lower] (4, 2), covered with skin down to a share of its opening,
    and with a line of lashes at its edge."""
    outer, inner, upper, lower = points
    middle, along = 0.5 * (outer + inner), np.linspace(-1, 1, 21)[:, None]
    chord, arch = middle + along * 0.5 * (inner - outer), 1 - along**2
    crease = chord + np.sqrt(arch) * 1.6 * (upper - middle)
    edge = chord + arch * (upper - middle + share * (lower - upper))
    drawn = pixels.copy()
    above = upper - 0.9 * (lower - upper)
    skin = pixels[round(float(above[1])), round(float(above[0]))]
    polygon = np.round(8 * np.concatenate([crease, edge[::-1]])).astype(np.int32)
    cv2.fillPoly(drawn, [polygon], skin.tolist(), cv2.LINE_AA, 3)
    cv2.polylines(drawn, [np.round(8 * edge).astype(np.int32)], False, LASHES, 2, cv2.LINE_AA, 3)
    return drawn


@cache
def _blinking() -> SyntheticSequence:
    """The face looking to the side and back, and closing both eyes for six frames."""
    angles = np.zeros((FRAMES, 3))
    angles[:, 1] = 10 * np.sin(np.pi * np.arange(FRAMES) / FRAMES)
    sequence = make_sequence(face(), moved(face(), angles, np.zeros((FRAMES, 3)), np.zeros((FRAMES, 6))), noise_sd=1)
    frames = list(sequence.frames)
    for i, share in enumerate(CLOSING, FIRST_BLINK):
        pixels = frames[i].pixels
        for side in ("right", "left"):
            eye = [LANDMARK_NAMES.index(f"{side}_{part}") for part in EYE]
            pixels = _lid(pixels, sequence.landmarks[i, eye], share)
        frames[i] = Frame(pixels, frames[i].index, frames[i].time)
    return replace(sequence, frames=tuple(frames))


def _tilt_deg(estimates: list[Estimate]) -> Array:
    """Error (n,) of the tilt since the first frame."""
    R = np.stack([e.rotation for e in estimates if e.rotation is not None])
    truth = _blinking().R
    wrong = np.swapaxes(truth @ truth[0].T, 1, 2) @ R @ R[0].T
    return np.asarray(np.degrees(wrong[:, 2, 1]))


def test_eyes_whose_landmarks_are_shut_say_nothing_of_their_closing() -> None:
    """Also where what is between the lids, as lashes, looks like an eye."""
    points = _blinking().landmarks[0].copy()
    for side in ("right", "left"):
        upper, lower = (LANDMARK_NAMES.index(f"{side}_eyelid_{lid}_mid") for lid in ("upper", "lower"))
        points[upper] = points[lower] - [0, 1]
    tracker = RealtimeTracker()
    with pytest.warns(MienWarning, match="the eyes are shut"):
        first_estimate = tracker.initialize(_blinking().frames[0], Landmarks(points, "candide26"), face().camera)
    assert first_estimate.closing is None
    assert tracker.track(_blinking().frames[1]).closing is None


def test_where_the_face_is_lost_nothing_is_remembered_of_its_eyes() -> None:
    first, second, *_ = _blinking().frames
    tracker = begun(first)
    noise = np.random.default_rng(0).integers(0, 255, second.pixels.shape, dtype=np.uint8)
    assert tracker.closing is not None
    assert tracker.track(Frame(noise, second.index, second.time)).closing is None
    assert tracker.closing is None


def test_closing_eyes_are_not_seen_however_the_rest_of_the_face_looks() -> None:
    """As where a grin makes the face look strange, so that they are tracked all the same."""
    first, second, *_ = _blinking().frames
    tracker = begun(first)
    _, solution = tracker._search(second)
    eyes = [LANDMARK_NAMES.index(f"{side}_{part}") for side in ("right", "left") for part in EYE]
    for closing, seen in ((Closing(0.1, 0.1), True), (Closing(0.9, 0.1), False)):
        tracker.closing = closing
        found = tracker._estimate(second, Status.TRACKED, solution, 1.0).landmarks
        assert found is not None
        assert found.visibility is not None
        assert (found.visibility[eyes] > 0.5).all() == seen
        assert (np.delete(found.visibility, eyes) > 0.5).all()


def test_a_blink_is_no_nod() -> None:
    estimates = run(RealtimeTracker(), _blinking())
    assert all(estimate.confidence > 0.9 for estimate in estimates)
    blink = slice(FIRST_BLINK, FIRST_BLINK + len(CLOSING))
    eyes = [LANDMARK_NAMES.index(f"{side}_{part}") for side in ("right", "left") for part in EYE]
    seen = np.array([e.landmarks.visibility[eyes].any() for e in estimates if e.landmarks is not None])
    np.testing.assert_array_equal(np.flatnonzero(~seen), np.arange(blink.start, blink.stop))
    told = np.array([e.closing.share for e in estimates if e.closing is not None])
    assert len(told) == FRAMES
    np.testing.assert_allclose(told[blink], CLOSING, atol=0.16)
    assert np.delete(told, np.arange(blink.start, blink.stop)).max() < 0.1
    tilt = _tilt_deg(estimates)
    nod = np.abs(tilt[blink] - tilt[FIRST_BLINK - 1])
    # One that believes lids, and patches that move with them: a stricter weight of the motion stops a part of the nod.
    believing = RealtimeSettings(
        visibility=VisibilitySettings(closing_share=9.0), motion=MotionSettings(robust_factor=2.0)
    )
    unnoticed = _tilt_deg(run(RealtimeTracker(believing), _blinking()))
    assert nod.mean() < 0.7 * np.abs(unnoticed[blink] - unnoticed[FIRST_BLINK - 1]).mean()
    assert nod.mean() < 0.22
    after = slice(blink.stop + 1, None)
    assert np.abs(tilt[after] - unnoticed[after]).max() < 0.25
