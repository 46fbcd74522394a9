"""A rigid head that leaves the image is lost, and found again where it comes back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from mien.baselines.la_cascia import LaCasciaTracker
from mien.baselines.morency import MorencyTracker
from mien.baselines.rigid_head import RigidHead
from mien.baselines.surface import Pose, cylinder
from mien.baselines.xiao import XiaoTracker
from mien.frame import Frame
from mien.geometry.rotation import FACING, exp
from mien.synthetic import make_sequence, moved
from mien.tracking.state import Status, Tracker
from small_motion import face, run


@pytest.fixture(scope="module")
def head() -> RigidHead:
    return RigidHead.from_first_frame(face().frame, face().fit, face().camera, cylinder(face().fit))


def test_the_face_is_found_where_it_is(head: RigidHead) -> None:
    shift = np.array([[0.7, -0.3, 0.0]])
    sequence = make_sequence(face(), moved(face(), np.zeros((1, 3)), shift, np.zeros((1, 6))))
    found = head.relocate(sequence.frames[0])
    np.testing.assert_allclose(found.t, sequence.t[0], atol=0.08)
    np.testing.assert_allclose(found.R, face().fit.R)


def test_a_face_that_the_border_cuts_is_found_where_it_is(head: RigidHead) -> None:
    """The template is then not about the middle of the face."""
    (u, _), _ = face().camera.project(face().fit.t)
    for left in (0, round(u) - 10):
        frame = Frame(np.ascontiguousarray(face().frame.pixels[:, left:]))
        camera = replace(face().camera, cx=face().camera.cx - left)
        cut = RigidHead.from_first_frame(frame, face().fit, camera, head.surface)
        np.testing.assert_allclose(cut.relocate(frame).t, face().fit.t, atol=1e-9)


def test_a_head_is_out_of_sight_outside_the_image_and_from_behind(head: RigidHead) -> None:
    aside, behind = np.array([5.0, 0, 0]), exp(np.array([0, 2.5, 0]))
    t = face().fit.t
    assert head.in_sight(face().frame, head.first)
    assert not head.in_sight(face().frame, Pose(FACING, t + aside))
    assert not head.in_sight(face().frame, Pose(behind @ FACING, t))
    assert "left the image" in head.lost(face().frame, Pose(FACING, t + aside)).reason


def test_a_head_that_is_registered_outside_the_image_has_left_it(monkeypatch: pytest.MonkeyPatch) -> None:
    outside = Pose(FACING, face().fit.t + np.array([5.0, 0, 0]))
    monkeypatch.setattr(LaCasciaTracker, "_follow", lambda self, view: outside)
    still = make_sequence(face(), moved(face(), np.zeros((2, 3)), np.zeros((2, 3)), np.zeros((2, 6))))
    assert "left the image" in run(LaCasciaTracker(), still)[-1].reason


@pytest.mark.parametrize("make", [LaCasciaTracker, XiaoTracker, MorencyTracker])
def test_a_face_that_leaves_the_image_is_lost_and_found_again(make: Callable[[], Tracker]) -> None:
    across = [0, 0.4, 0.8, 1.2, 1.6, 2.0, 2.4, 2.8, 2.4, 1.6, 0.8, 0, 0, 0]
    shift = np.outer(across, [1.0, 0, 0])
    n = len(shift)
    sequence = make_sequence(face(), moved(face(), np.zeros((n, 3)), shift, np.zeros((n, 6))))
    estimates = run(make(), sequence)
    lost = [e for e in estimates if e.status is Status.LOST]
    assert lost
    assert all(e.rotation is None and e.reason for e in lost)
    assert estimates[-1].translation is not None
    np.testing.assert_allclose(estimates[-1].translation, face().fit.t, atol=0.15)


@pytest.mark.parametrize("make", [LaCasciaTracker, XiaoTracker, MorencyTracker])
def test_a_face_is_lost_in_a_frame_without_contrast(make: Callable[[], Tracker]) -> None:
    tracker = make()
    tracker.initialize(face().frame, face().landmarks, face().camera)
    plain = Frame(np.zeros_like(face().frame.pixels), 1)
    assert [tracker.track(plain).status for _ in range(2)] == [Status.LOST] * 2
