"""Closing eyes by hand, and on a rendered face that blinks."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from mien.appearance.descriptors import Float32
from mien.config import RealtimeSettings
from mien.geometry.rotation import Array
from mien.initialization.landmarks import LANDMARK_NAMES
from mien.synthetic import SyntheticSequence, make_sequence, moved
from mien.tracking.eyelids import closing
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.state import Estimate
from mien.video import Pixels
from small_motion import face, run

N, LEAST = 4, 0.2
SEEN = np.ones(N, bool)
CLOSED = np.random.default_rng(0).normal(0, 0.05, (N, 128)).astype(np.float32)
OTHER = np.random.default_rng(1).normal(0, 0.05, (N, 128)).astype(np.float32)
EYE = ("eye_outer_corner", "eye_inner_corner", "eyelid_upper_mid", "eyelid_lower_mid")
CLOSING = (0.3, 0.7, 1.0, 1.0, 0.7, 0.3)
FIRST_BLINK, FRAMES = 12, 24
LASHES = (60, 40, 40)


def test_eyes_that_look_half_closed_are_closing() -> None:
    assert closing(0.5 * CLOSED, CLOSED, SEEN, LEAST)
    assert not closing(0.5 * CLOSED, CLOSED, SEEN, 0.6)


@pytest.mark.parametrize("residual", [0 * CLOSED, 0.1 * CLOSED, -CLOSED, OTHER, 0.3 * CLOSED + OTHER])
def test_eyes_that_look_otherwise_are_not(residual: Float32) -> None:
    """As expected; hardly closed; wider than in the first frame; like something else, and that with a little of it."""
    assert not closing(residual, CLOSED, SEEN, LEAST)


def test_what_is_hidden_says_nothing() -> None:
    residual = 0.5 * CLOSED
    residual[2:] = 9.0
    assert closing(residual, CLOSED, np.arange(N) < 2, LEAST)
    assert not closing(CLOSED, CLOSED, ~SEEN, LEAST)


def test_nothing_is_known_of_eyes_that_were_closed_already() -> None:
    assert not closing(CLOSED, 0.02 * CLOSED, SEEN, LEAST)


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
        frames[i] = replace(frames[i], pixels=pixels)
    return replace(sequence, frames=tuple(frames))


def _tilt_deg(estimates: list[Estimate]) -> Array:
    """Error (n,) of the tilt since the first frame."""
    R = np.stack([e.rotation for e in estimates if e.rotation is not None])
    truth = _blinking().R
    wrong = np.swapaxes(truth @ truth[0].T, 1, 2) @ R @ R[0].T
    return np.asarray(np.degrees(wrong[:, 2, 1]))


def test_a_blink_is_no_nod() -> None:
    estimates = run(RealtimeTracker(), _blinking())
    assert all(estimate.confidence > 0.9 for estimate in estimates)
    blink = slice(FIRST_BLINK, FIRST_BLINK + len(CLOSING))
    eyes = [LANDMARK_NAMES.index(f"{side}_{part}") for side in ("right", "left") for part in EYE]
    seen = np.array([e.landmarks.visibility[eyes].any() for e in estimates if e.landmarks is not None])
    np.testing.assert_array_equal(np.flatnonzero(~seen), np.arange(blink.start, blink.stop))
    tilt = _tilt_deg(estimates)
    nod = np.abs(tilt[blink] - tilt[FIRST_BLINK - 1])
    unnoticed = _tilt_deg(run(RealtimeTracker(RealtimeSettings(closing_share=9.0)), _blinking()))
    assert nod.mean() < 0.7 * np.abs(unnoticed[blink] - unnoticed[FIRST_BLINK - 1]).mean()
    after = slice(blink.stop + 1, None)
    assert np.abs(tilt[after] - unnoticed[after]).max() < 0.25
