"""Synthetic sequences: the truth is the truth, and each disturbance is where it was asked for."""

from __future__ import annotations

import numpy as np
import pytest

from mien.arrays import Array
from mien.geometry.rotation import FACING, angle_between, matrix_from_euler
from mien.initialization.landmarks import LANDMARK_NAMES
from mien.synthetic import FPS, OCCLUDER_COLOUR, Portrait, make_sequence, moved, portrait


@pytest.fixture(scope="module")
def face() -> Portrait:
    return portrait()


def _still(face: Portrait, n: int) -> Array:
    return np.tile(face.state, (n, 1))


def test_the_portrait_is_fitted_to_its_landmarks(face: Portrait) -> None:
    assert face.frame.pixels.shape == (240, 320, 3)
    assert face.fit.residual_px < 2
    assert angle_between(face.fit.R, FACING) < np.radians(15)


def test_at_rest_the_face_is_the_portrait(face: Portrait) -> None:
    frame = make_sequence(face, _still(face, 1)).frames[0]
    x, y = np.round(face.landmarks.correspondences()[1].mean(axis=0)).astype(int)
    window = (slice(y - 35, y + 35), slice(x - 35, x + 35))
    difference = np.abs(frame.pixels[window].astype(int) - face.frame.pixels[window])
    assert difference.mean() < 6


def test_truth_follows_the_states(face: Portrait) -> None:
    angles = np.array([[0.0, 0, 0], [10, -20, 5]])
    shift, animation = np.array([[0.0, 0, 0], [0.1, -0.2, 0.3]]), np.zeros((2, 6))
    animation[1, 1] = 0.4
    sequence = make_sequence(face, moved(face, angles, shift, animation))
    np.testing.assert_allclose(sequence.R[0], face.fit.R, atol=1e-9)
    np.testing.assert_allclose(sequence.R[1], matrix_from_euler(np.radians(angles[1])) @ face.fit.R, atol=1e-9)
    np.testing.assert_allclose(sequence.t - face.fit.t, shift, atol=1e-9)
    np.testing.assert_allclose(sequence.animation - face.fit.animation, animation, atol=1e-9)
    assert sequence.landmarks.shape == (2, 26, 2)
    assert [f.index for f in sequence.frames] == [0, 1]
    assert sequence.frames[1].time == pytest.approx(1 / FPS)
    chin = LANDMARK_NAMES.index("chin_boss")
    still = make_sequence(face, moved(face, angles, shift, 0 * animation))
    assert sequence.landmarks[1, chin, 1] > still.landmarks[1, chin, 1] + 2  # the open jaw is lower


def test_only_the_head_moves(face: Portrait) -> None:
    angles = np.array([[0.0, 0, 0], [0, 5, 0]])
    sequence = make_sequence(face, moved(face, angles, np.zeros((2, 3)), np.zeros((2, 6))))
    first, second = sequence.frames
    changed = np.abs(first.pixels.astype(int) - second.pixels).max(axis=2)
    assert changed[:60, :30].max() <= 1
    (left, top), (right, bottom) = (f(sequence.landmarks[0], axis=0).round().astype(int) for f in (np.min, np.max))
    assert changed[top:bottom, left:right].mean() > 6


def test_disturbances_are_where_they_were_asked_for(face: Portrait) -> None:
    clean = make_sequence(face, _still(face, 4)).frames
    disturbed = make_sequence(
        face,
        _still(face, 4),
        gain=np.array([1, 0.5, 1, 1]),
        occluders={2: (100, 90, 180, 140)},
        blank={3},
    ).frames
    np.testing.assert_array_equal(disturbed[0].pixels, clean[0].pixels)
    np.testing.assert_allclose(disturbed[1].pixels, clean[1].pixels / 2, atol=1)
    assert (disturbed[2].pixels[90:140, 100:180] == OCCLUDER_COLOUR).all()
    np.testing.assert_array_equal(disturbed[2].pixels[:90], clean[2].pixels[:90])
    assert (disturbed[3].pixels == 0).all()


def test_noise_is_seeded_and_as_strong_as_asked(face: Portrait) -> None:
    clean = make_sequence(face, _still(face, 1)).frames[0].pixels.astype(float)
    a, b, c = (make_sequence(face, _still(face, 1), noise_sd=4, seed=s).frames[0].pixels for s in (1, 1, 2))
    np.testing.assert_array_equal(a, b)
    assert (a != c).any()
    inner = (clean > 30) & (clean < 220)
    assert (a - clean)[inner].std() == pytest.approx(4, rel=0.1)
