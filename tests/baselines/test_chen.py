"""Chen and Davoine 2006: a small motion, a black frame."""

from __future__ import annotations

import numpy as np

from mien.baselines.chen import ChenTracker
from mien.tracking.state import Status
from small_motion import errors_of_all_deg, face, run, small_motion


def test_a_small_motion_is_recovered() -> None:
    sequence = small_motion()
    estimates = run(ChenTracker(evaluations=400), sequence)
    assert [e.status for e in estimates[1:]] == [Status.TRACKED] * 3
    assert errors_of_all_deg(estimates, sequence)[-1] < 4
    assert estimates[-1].landmarks is not None
    distance = np.linalg.norm(estimates[-1].landmarks.image - sequence.landmarks[-1], axis=1)
    assert distance.mean() < 3


def test_a_black_frame_is_a_lost_frame() -> None:
    estimates = run(ChenTracker(evaluations=400), small_motion(blank={2}))
    assert [e.status for e in estimates[1:]] == [Status.TRACKED, Status.LOST, Status.RECOVERED]
    assert "looks like the face" in estimates[2].reason


def test_nothing_is_updated() -> None:
    tracker = ChenTracker(evaluations=20)
    tracker.initialize(face().frame, face().landmarks, face().camera)
    learned = tracker.statistics
    tracker.track(face().frame)
    assert tracker.statistics is learned
