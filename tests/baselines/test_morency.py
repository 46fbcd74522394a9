"""GAVAM: keyframes against drift, and the filter."""

from __future__ import annotations

import numpy as np

from mien.baselines.morency import KEYFRAME_SPACING_DEG, MorencyTracker
from mien.geometry.rotation import angle_between
from mien.synthetic import SyntheticSequence, make_sequence, moved
from small_motion import face, run


def _swing() -> SyntheticSequence:
    """The head turns to one side, to the other, and back."""
    phase = np.linspace(0, 2 * np.pi, 33)
    angles = np.column_stack([6 * np.sin(2 * phase), 25 * np.sin(phase), 0 * phase])
    n = len(angles)
    return make_sequence(face(), moved(face(), angles, np.zeros((n, 3)), np.zeros((n, 6))), noise_sd=2)


def test_keyframes_drift_less_than_frame_to_frame() -> None:
    sequence = _swing()
    gavam, chain = MorencyTracker(), MorencyTracker(keyframes=False)
    end = {}
    for tracker in (gavam, chain):
        estimates = run(tracker, sequence)
        assert all(e.status.success for e in estimates)
        R = estimates[-1].rotation
        assert R is not None
        end[tracker.keyframes] = float(np.degrees(angle_between(R, sequence.R[-1])))
    assert end[True] < 1
    assert end[True] < 0.5 * end[False]
    assert len(chain.frames) == 2
    poses = [f.pose.R for f in gavam.frames[:-1]]
    assert 3 <= len(poses) <= 12
    apart = [angle_between(a, b) for i, a in enumerate(poses) for b in poses[:i]]
    assert min(apart) > np.radians(0.5 * KEYFRAME_SPACING_DEG)


def test_the_covariance_is_one_and_the_first_frame_stays() -> None:
    tracker = MorencyTracker()
    sequence = _swing()
    tracker.initialize(sequence.frames[0], face().landmarks, face().camera)
    for frame in sequence.frames[1:12]:
        tracker.track(frame)
    P = tracker.covariance
    assert P.shape == (6 * len(tracker.frames),) * 2
    np.testing.assert_allclose(P, P.T, atol=1e-12)
    assert np.linalg.eigvalsh(P).min() > -1e-9
    assert P[0, 0] < 1e-6 < P[-6, -6]  # the first frame is known, the others less
    assert angle_between(tracker.frames[0].pose.R, face().fit.R) < 1e-3
