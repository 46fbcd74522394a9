"""The surroundings of a face: on pictures of noise, in which something stays and something changes."""

from __future__ import annotations

import numpy as np
import pytest

from mien.frame import Frame
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.scene import Scene, numbered_by_shot
from small_motion import begun, run, small_motion

SIZE = (120, 160)
FACE, RADIUS = np.array([80.0, 60.0]), 30.0
Y, X = np.mgrid[: SIZE[0], : SIZE[1]]
IN_FACE = np.hypot(X - FACE[0], Y - FACE[1]) < RADIUS


def _noise(seed: int) -> Frame:
    return Frame(np.random.default_rng(seed).integers(0, 256, (*SIZE, 3), np.uint8))


def _correlation(*frames: Frame, radius: float = RADIUS) -> float:
    scene = Scene(frames=2)
    for frame in frames:
        scene.remember(frame)
    return scene.correlation(FACE, radius)


def test_a_hand_before_the_face_leaves_its_surroundings_as_they_were() -> None:
    hand = Frame(np.where(IN_FACE[..., None], 200, _noise(0).pixels).astype(np.uint8))
    assert _correlation(_noise(0), hand) == pytest.approx(1)


def test_cuts_are_counted() -> None:
    """A hand before the face is none, nor the first half of a dissolve; black in between is two."""
    hand = Frame(np.where((IN_FACE & (X < 80))[..., None], 200, _noise(0).pixels).astype(np.uint8))
    mixed = Frame((0.6 * _noise(0).pixels + 0.4 * _noise(1).pixels).astype(np.uint8))
    black = Frame(np.zeros((*SIZE, 3), np.uint8))
    shots = numbered_by_shot([_noise(0), hand, _noise(0), mixed, _noise(1), _noise(2), black, _noise(2)])
    assert [cuts for cuts, _ in shots] == [0, 0, 0, 0, 1, 2, 3, 4]


def test_bars_beside_the_picture_do_not_hide_a_cut() -> None:
    def between_bars(picture: Frame) -> Frame:
        return Frame(np.where(((X > 50) & (X < 110))[..., None], picture.pixels, 5).astype(np.uint8))

    shots = numbered_by_shot([between_bars(_noise(k)) for k in (0, 0, 1, 1)])
    assert [cuts for cuts, _ in shots] == [0, 0, 1, 1]


def test_a_night_is_no_row_of_cuts() -> None:
    """Nearly all is dark, and its noise is the same in no two frames."""
    scene, rng = 3 + 15 * (X > 80) + 60 * ((X > 70) & (X < 78) & (Y < 30)), np.random.default_rng(0)
    night = [Frame(np.clip(scene[..., None] + rng.normal(0, 2, (*SIZE, 3)), 0, 255).astype(np.uint8)) for _ in range(3)]
    assert [cuts for cuts, _ in numbered_by_shot(night)] == [0, 0, 0]


def test_brighter_surroundings_are_the_same() -> None:
    brighter = Frame((40 + 0.7 * _noise(0).pixels).astype(np.uint8))
    assert _correlation(_noise(0), brighter) > 0.999


def test_another_picture_has_other_surroundings() -> None:
    assert abs(_correlation(_noise(0), _noise(1))) < 0.2


def test_noise_does_not_hide_a_plain_wall() -> None:
    wall, rng = 120 + 20 * X / SIZE[1], np.random.default_rng(0)
    first, second = (
        Frame(np.round(wall[..., None] + rng.normal(0, 3.5, (*SIZE, 3))).astype(np.uint8)) for _ in range(2)
    )
    assert _correlation(first, second) > 0.85  # of single pixels 0.74


def test_it_looks_back_as_far_as_it_was_told() -> None:
    assert _correlation(_noise(0), _noise(1), _noise(0)) == pytest.approx(1)
    assert abs(_correlation(_noise(0), _noise(1), _noise(1), _noise(0))) < 0.2


def test_of_a_face_that_fills_the_picture_and_of_a_blank_one_it_says_nothing() -> None:
    assert _correlation(_noise(0), _noise(0), radius=95.0) == 0
    blank = Frame(np.zeros((*SIZE, 3), np.uint8))
    assert _correlation(blank, blank) == 0


def test_pictures_of_a_few_pixels() -> None:
    tiny = Frame(np.arange(27, dtype=np.uint8).reshape(3, 3, 3))
    assert _correlation(tiny, tiny, radius=0.1) == pytest.approx(1)


def test_the_surroundings_of_the_face_that_is_tracked() -> None:
    truth, tracker = small_motion(), RealtimeTracker()
    run(tracker, truth)
    last = truth.frames[-1]
    assert tracker._surroundings() > 0.8
    tracker.identity.scene.remember(Frame(np.rot90(last.pixels, 2), last.index))
    assert tracker._surroundings() < 0.8


def test_a_cut_after_the_first_frame_is_another_scene() -> None:
    truth = small_motion()
    tracker = begun(truth.frames[0])
    tracker.identity.scene.remember(Frame(np.rot90(truth.frames[1].pixels, 2), 1))
    assert tracker._surroundings() < 0.8


def test_frames_of_another_size_are_another_scene() -> None:
    large = Frame(np.repeat(np.repeat(_noise(0).pixels, 2, axis=0), 2, axis=1)[:, :-40])
    assert _correlation(large, _noise(0)) == 0
