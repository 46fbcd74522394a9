"""The trackers of Table 1 on a small motion of the portrait, and where a frame of it is black."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from mien.baselines.chen import ChenTracker
from mien.baselines.la_cascia import LaCasciaTracker
from mien.baselines.lefevre import LefevreTracker
from mien.baselines.morency import MorencyTracker
from mien.baselines.saragih import SaragihTracker
from mien.baselines.tran2013 import Tran2013Tracker
from mien.baselines.xiao import XiaoTracker
from mien.tracking.state import Status, Tracker
from small_motion import errors_of_all_deg, run, small_motion

RIGID = {"la-cascia-2000": LaCasciaTracker, "xiao-2003": XiaoTracker, "morency-2008": MorencyTracker}
"""Trackers of a rigid surface; the others have the landmarks of CANDIDE."""
ANIMATED = {
    "lefevre-2009": partial(LefevreTracker, evaluations=400),
    "saragih-2011": SaragihTracker,
    "chen-2006": partial(ChenTracker, evaluations=400),
}
TRACKERS: dict[str, Callable[[], Tracker]] = {
    **RIGID,
    **ANIMATED,
    "tran-2013": partial(Tran2013Tracker, evaluations=300),
}


@pytest.mark.parametrize("name", TRACKERS)
def test_a_small_motion_is_recovered(name: str) -> None:
    sequence = small_motion()
    estimates = run(TRACKERS[name](), sequence)
    assert [e.status for e in estimates] == [Status.INITIALIZED] + [Status.TRACKED] * 3
    assert errors_of_all_deg(estimates, sequence)[-1] < 4
    assert estimates[-1].landmarks is not None
    distance = np.linalg.norm(estimates[-1].landmarks.image - sequence.landmarks[-1], axis=1)
    assert distance.mean() < 3
    assert (estimates[-1].animation is not None) == (name in ANIMATED)


@pytest.mark.parametrize("name", TRACKERS)
def test_a_tracker_that_begins_again_gives_the_same(name: str) -> None:
    tracker, sequence = TRACKERS[name](), small_motion()
    once, again = run(tracker, sequence), run(tracker, sequence)
    for before, after in zip(once, again, strict=True):
        assert before.rotation is not None
        np.testing.assert_array_equal(before.rotation, after.rotation)
        np.testing.assert_array_equal(before.translation, after.translation)


@pytest.mark.parametrize("name", TRACKERS)
def test_a_black_frame_is_a_lost_frame(name: str) -> None:
    estimates = run(TRACKERS[name](), small_motion(blank={2}))
    assert [e.status for e in estimates[1:]] == [Status.TRACKED, Status.LOST, Status.RECOVERED]
    assert estimates[2].rotation is None
    assert ("could not be registered" if name in RIGID else "looks like the face") in estimates[2].reason
