"""Whether a face is still that of the first frame."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mien.synthetic import make_sequence, moved
from mien.tracking.realtime.identity import Identity, _is_same, _updated, familiarity
from small_motion import begun, face


def test_a_stranger_differs_everywhere_and_a_grimace_in_places() -> None:
    assert familiarity(55.0, 0.0) < 0.01
    assert familiarity(10.0, 0.0) > 0.99
    assert familiarity(math.inf, 0.0) == 0  # nothing is seen


def test_identity_is_recognised_soon_and_doubted_slowly() -> None:
    probability = [0.0]
    for familiar in [1.0] * 30 + [0.0] * 100:
        probability.append(_updated(probability[-1], familiar, same=True))
    assert probability[10] == pytest.approx(1 - 0.9**10)
    assert probability[-1] == pytest.approx(probability[30] * 0.998**100)
    assert probability[45] > 0.9  # a grimace of half a second changes little
    assert _updated(1.0, 1.0, same=False) == 0


@pytest.mark.parametrize(
    ("familiar", "lately", "later", "surroundings", "same"),
    [
        (1.0, 0.95, 0.4, 0.0, True),  # it looks like itself
        (1.0, 0.8, 1.0, 0.0, False),  # a cut
        (1.0, 0.8, 1.0, 0.9, True),  # a blurred frame
        (1.0, 0.6, 1.0, 1.0, False),  # another face in the same room
        (0.0, 0.95, 0.9, 0.0, True),  # a head that turns before a moving background
        (0.0, 0.95, 0.7, 0.0, False),  # a picture that dissolves into another one
        (0.0, 0.95, 0.8, 0.9, True),  # a hand before the face
        (0.0, 0.95, 0.7, 0.9, False),  # a turn in a jump
        (0.0, 0.95, 0.5, 1.0, False),  # a picture that dissolves into another one of the same room
    ],
)
def test_whether_a_face_is_the_same(
    familiar: float, lately: float, later: float, surroundings: float, same: bool
) -> None:
    assert _is_same(familiar, (lately, later), lambda: surroundings) == same


def test_it_is_steady_where_it_is_known_and_as_twelve_frames_ago() -> None:
    identity = Identity(np.ones(4))
    identity.patches.later.add(0.9, 0.0)
    assert identity.is_steady
    identity.patches.later.add(0.8, 0.1)
    assert not identity.is_steady
    identity.patches.later.add(0.9, 0.0)
    identity.update(1.0, (0.5, 1.0), lambda: 0.0)  # a cut
    assert identity.is_doubted
    assert not identity.is_steady


@pytest.mark.parametrize("frames", [5, 30])
@pytest.mark.parametrize("entering", [8, 12])
def test_a_known_face_is_known_again_when_what_covered_it_goes(frames: int, entering: int) -> None:
    """Something comes before a face that no longer looks as in the first frame, and goes at once."""
    rng = np.random.default_rng(0)
    covered, bare = rng.normal(0, 40, (2, 30, 49)).astype(np.float32)
    identity = Identity(np.ones(30))
    identity.probability = 0.9
    shares = [0.0] * 20 + np.linspace(0, 1, entering).tolist() + [1.0] * frames + [0.0] * 30
    for share in shares:
        patches = share * covered + (1 - share) * bare
        norms = np.linalg.norm(patches, axis=1).astype(np.float64)
        agreements = identity.patches.add(patches, norms, np.ones(30), 0.0)
        if len(identity.patches.frames) > 1:
            identity.update(0.0, agreements, lambda: 1.0)
    assert identity.probability > 0.75  # doubted by a five-hundredth a frame


@pytest.mark.parametrize(("surroundings", "known"), [(1.0, True), (0.5, False)])
def test_a_known_face_is_known_again_after_a_single_frame_of_something_else(
    surroundings: float, known: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Unless its surroundings have changed. It does not look as in the first frame, so that familiarity cannot tell."""
    first = make_sequence(face(), moved(face(), np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 6)))).frames[0]
    tracker = begun(first)
    monkeypatch.setattr("mien.tracking.realtime.tracker.familiarity", lambda *of: 0.0)
    for _ in range(14):
        tracker.track(first)
    before = tracker.identity.probability
    with monkeypatch.context() as doubt:
        doubt.setattr("mien.tracking.realtime.identity._is_same", lambda *of: False)
        doubt.setattr(tracker, "_surroundings", lambda: surroundings)
        tracker.track(first)
    doubted = tracker.identity.probability
    tracker.track(first)
    assert before > 0.9
    assert doubted == 0
    assert (tracker.identity.probability > 0.9) is known
