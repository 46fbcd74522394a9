"""Chen and Davoine 2006: the statistics of the first frame stay."""

from __future__ import annotations

from mien.baselines.chen import ChenTracker
from small_motion import face


def test_nothing_is_updated() -> None:
    tracker = ChenTracker(evaluations=20)
    tracker.initialize(face().frame, face().landmarks, face().camera)
    learned = tracker.statistics
    tracker.track(face().frame)
    assert tracker.statistics is learned
