"""Saragih and others 2011: experts, mean-shift, and a start that is too far off for the simplex."""

from __future__ import annotations

import numpy as np
import pytest

from mien.appearance.crop import Crop
from mien.arrays import Array
from mien.baselines.candide_tracker import CandideTracker
from mien.baselines.chen import ChenTracker
from mien.baselines.saragih import Experts, MeanShift, SaragihTracker
from mien.geometry.rotation import angle_between, exp
from mien.synthetic import moved
from mien.tracking.state import pack, unpack
from small_motion import face


@pytest.fixture(scope="module")
def tracker() -> SaragihTracker:
    tracker = SaragihTracker()
    tracker.initialize(face().frame, face().landmarks, face().camera)
    return tracker


def _perturbed(b: Array, db: Array) -> Array:
    R, t, animation = unpack(b)
    return pack(exp(db[:3]) @ R, t + db[3:6], animation + db[6:])


def _search(tracker: SaragihTracker, maps: Array, corners: Array) -> MeanShift:
    crop = Crop((150.0, 100.0), 0.7, 0.2, 150)
    return MeanShift(tracker.landmarks, face().camera, crop, maps.astype(np.float32), corners)


def test_an_expert_knows_its_patch() -> None:
    rng = np.random.default_rng(0)
    pattern = rng.normal(size=(2, 1, 25))
    positives = pattern + 0.1 * rng.normal(size=(2, 40, 25))
    negatives = rng.normal(size=(2, 80, 25))
    unit = [p - p.mean(axis=2, keepdims=True) for p in (positives, negatives)]
    experts = Experts.learn(*(p / np.linalg.norm(p, axis=2, keepdims=True) for p in unit))
    np.testing.assert_allclose(experts.templates.mean(axis=(1, 2)), 0, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(experts.templates, axis=(1, 2)), 1, rtol=1e-5)
    image = rng.normal(size=(30, 40)).astype(np.float32)
    image[6:11, 20:25] = pattern[0].reshape(5, 5)
    maps = experts.responses(image, np.array([[15.0, 4.0], [15.0, 4.0]]), 11)
    assert maps.shape == (2, 11, 11)
    assert np.unravel_index(maps[0].argmax(), (11, 11)) == (4, 7)  # the pattern's middle is (22, 8)
    assert maps[0].max() > 0.9
    assert maps[1].max() < maps[0].max()


def test_a_response_is_the_experts_probability_there(tracker: SaragihTracker) -> None:
    image = np.random.default_rng(1).uniform(0, 255, (60, 60)).astype(np.float32)
    experts = tracker.experts[1]
    corners = np.full((26, 2), 20.0)
    maps = experts.responses(image, corners, 5)
    np.testing.assert_allclose(maps[:, 3, 1], experts.at(image, corners + np.array([1, 3])), atol=1e-4)


def test_the_jacobian_is_the_derivative(tracker: SaragihTracker) -> None:
    search = _search(tracker, np.ones((26, 3, 3)), np.zeros((26, 2)))
    b = moved(face(), np.array([[5.0, 10, -5]]), np.zeros((1, 3)), 0.1 * np.ones((1, 6)))[0]
    _, J = search.points(b)
    h = 1e-6
    for k, e in enumerate(np.eye(12)):
        ahead, behind = (search.points(_perturbed(b, s * h * e))[0] for s in (1, -1))
        np.testing.assert_allclose(J[:, :, k], (ahead - behind) / (2 * h), atol=1e-4)


def test_the_mean_shift_leads_to_the_peak(tracker: SaragihTracker) -> None:
    maps = np.zeros((26, 21, 21))
    maps[:, 12, 7] = 1
    corners = np.tile([30.0, 40.0], (26, 1))
    search = _search(tracker, maps, corners)
    p = corners + np.array([9.0, 10.0])
    np.testing.assert_allclose(p + search.shift(p, 10.0), corners + np.array([7, 12]), atol=1e-4)


def test_steps_lead_all_landmarks_to_their_peaks(tracker: SaragihTracker) -> None:
    start = face().state
    goal = moved(face(), np.array([[3.0, -4, 2]]), np.array([[0.05, 0.02, 0.0]]), np.zeros((1, 6)))[0]
    search = _search(tracker, np.ones((26, 1, 1)), np.zeros((26, 2)))
    peaks = search.points(goal)[0]
    search = _search(tracker, np.ones((26, 1, 1)), peaks)
    b = start
    for _ in range(8):
        b = search.step(b, 1.0)
    assert np.abs(search.points(b)[0] - peaks).max() < 0.6


def test_it_recovers_from_displaced_starts_that_the_simplex_does_not(tracker: SaragihTracker) -> None:
    """The maps answer over a whole window; the simplex sees no further than its steps, and stops in a hollow."""
    simplex = ChenTracker()
    simplex.initialize(face().frame, face().landmarks, face().camera)
    directions = np.radians(np.arange(20.0, 380, 30))
    shifts = 0.21 * np.stack([np.cos(directions), np.sin(directions), 0 * directions], axis=1)
    starts = moved(face(), np.zeros((12, 3)), shifts, np.zeros((12, 6)))
    assert [_returns(tracker, start) for start in starts].count(True) == 12
    assert [_returns(simplex, start) for start in starts].count(True) <= 8


def _returns(tracker: CandideTracker, start: Array) -> bool:
    """Whether one frame leads from this state to the portrait's pose, to 5 degrees."""
    tracker.b = start
    rotation = tracker.track(face().frame).rotation
    return rotation is not None and bool(angle_between(rotation, face().fit.R) < np.radians(5))
