"""A face that is out of the image or looks like nothing that was learned is lost, and may be found again."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from mien.arrays import Array
from mien.baselines.candide_tracker import CandideTracker, SearchResult
from mien.errors import MienError
from mien.frame import Frame
from mien.registry import create_tracker
from mien.tracking.state import Status
from small_motion import face


class Scripted(CandideTracker):
    """Finds what it is told to find."""

    least_similarity = 0.5

    def _learn(self, frame: Frame) -> None:
        self.script: list[SearchResult] = []
        self.adapted: list[Array] = []

    def _search(self, frame: Frame) -> SearchResult:
        return self.script.pop(0)

    def _adapt(self, frame: Frame) -> None:
        self.adapted.append(self.b)


def _started() -> Scripted:
    tracker = Scripted()
    estimate = tracker.initialize(face().frame, face().landmarks, face().camera)
    assert estimate.status is Status.INITIALIZED
    return tracker


def _moved(tracker: Scripted, dx: float) -> Array:
    return tracker.b + np.r_[np.zeros(3), dx, np.zeros(8)]


def test_what_is_found_is_the_state_and_is_learned_from() -> None:
    tracker = _started()
    b = _moved(tracker, 0.1)
    tracker.script = [SearchResult(b, 0.9)]
    estimate = tracker.track(face().frame)
    assert estimate.status is Status.TRACKED
    assert estimate.translation is not None
    np.testing.assert_array_equal(estimate.translation, b[3:6])
    assert len(tracker.adapted) == 1
    vertices = tracker.mesh(estimate)
    assert vertices is not None
    assert vertices.shape == (113, 3)


def test_a_face_that_looks_like_nothing_is_lost_and_found_from_where_it_was() -> None:
    tracker = _started()
    good = _moved(tracker, 0.1)
    tracker.script = [
        SearchResult(good, 0.9),
        SearchResult(_moved(tracker, 0.5), 0.3),
        SearchResult(good, 0.9),
        SearchResult(good, 0.9),
    ]
    estimates = [tracker.track(face().frame) for _ in range(4)]
    statuses = [e.status for e in estimates]
    assert statuses == [Status.TRACKED, Status.LOST, Status.RECOVERED, Status.TRACKED]
    assert "0.30 < 0.5" in estimates[1].reason
    assert estimates[1].rotation is None
    assert tracker.mesh(estimates[1]) is None
    assert len(tracker.adapted) == 3
    np.testing.assert_array_equal(tracker.b, good)


def test_a_face_that_left_the_image_is_waited_for_where_it_began() -> None:
    tracker = _started()
    start = tracker.b
    tracker.script = [
        SearchResult(_moved(tracker, 20.0), 1.0),
        SearchResult(np.r_[start[:5], -start[5], start[6:]], 1.0),
    ]
    for _ in range(2):
        estimate = tracker.track(face().frame)
        assert estimate.status is Status.LOST
        assert "left the image" in estimate.reason
        np.testing.assert_array_equal(tracker.b, start)


@pytest.mark.parametrize("name", ["saragih-2011", "tran-2013"])
def test_without_scikit_learn_it_says_how_to_get_it(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "sklearn", None)  # type: ignore[arg-type]
    with pytest.raises(MienError, match=rf"{name}.*pip install scikit-learn"):
        create_tracker(name)
