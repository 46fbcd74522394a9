"""The head's axes, which lean with the shape as it is learned."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

from long_motion import sequence
from mien.arrays import Array
from mien.config import RealtimeSettings
from mien.config.realtime import AxesSettings
from mien.geometry.rotation import FACING, angle_between, exp, log, matrix_from_euler, ray_rotation
from mien.initialization.landmarks import LANDMARK_VERTICES, VERTICES
from mien.output.track import Track
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.realtime.axes import HeadAxes
from mien.tracking.realtime.pose import Pose
from mien.tracking.realtime.shape import ShapePosterior
from mien.tracking.realtime.uncertainty import Reference
from small_motion import begun, run

SETTINGS = AxesSettings()
_FIRM_NAMES = [k for k, name in enumerate(LANDMARK_VERTICES) if "nose" in name or "eye_" in name]
"""Landmarks that are not drawn elsewhere by an expression or a blink."""
_FIRM = np.array(VERTICES)[_FIRM_NAMES]


@pytest.fixture(scope="module")
def tracker() -> RealtimeTracker:
    """One that has followed a face to all sides."""
    tracker = RealtimeTracker()
    run(tracker, sequence())
    return tracker


def _axes(tracker: RealtimeTracker, lean_deg: Array, settings: AxesSettings = SETTINGS) -> HeadAxes:
    """Axes of a face that looks into the camera, where the learned shape is turned by (2,) tilt and pan from
    what it was in the first frame."""
    shape: ShapePosterior = deepcopy(tracker.person.shape)
    turned = shape.start @ exp(np.radians(np.append(lean_deg, 0.0))).T
    shape.lean = shape.slopes @ (turned - shape.start)[:, 2]
    t = tracker.fit.t
    fit = replace(tracker.fit, R=ray_rotation(t) @ FACING, R_head_fit=np.eye(3))
    pose = Pose(fit.R, t, fit.animation)
    return HeadAxes(fit, Reference(pose.R, pose.line_of_sight, fit.axes_sd), shape, settings)


def test_a_shape_as_in_the_first_frame_leaves_the_axes(tracker: RealtimeTracker) -> None:
    axes = _axes(tracker, np.zeros(2))
    np.testing.assert_array_equal(axes.R_model_head, np.eye(3))
    np.testing.assert_array_equal(axes.first.axes_sd, tracker.fit.axes_sd)


@pytest.mark.parametrize(("lean_deg", "axis"), [([5.0, 0.0], 0), ([0.0, -5.0], 1)])
def test_the_axes_lean_with_the_shape(tracker: RealtimeTracker, lean_deg: list[float], axis: int) -> None:
    """About the same axis, by the share that is set, less what is known of a face that looks into the camera."""
    none = AxesSettings(tilt_share=0.0, pan_share=0.0)
    assert not log(_axes(tracker, np.array(lean_deg), none).R_model_head).any()
    expected = np.zeros(3)
    share = (SETTINGS.tilt_share, SETTINGS.pan_share)[axis]
    expected[axis] = share * lean_deg[axis] * (0.5, 0.85)[axis]
    np.testing.assert_allclose(np.degrees(log(_axes(tracker, np.array(lean_deg)).R_model_head)), expected, atol=0.05)


def test_what_is_learned_turns_nothing_in_the_first_frame(tracker: RealtimeTracker) -> None:
    axes = _axes(tracker, np.array([8.0, -6.0]))
    assert np.linalg.norm(log(axes.R_model_head)) > np.radians(1)
    np.testing.assert_allclose(axes.rotation(axes.first.R), axes.first.R, atol=1e-12)


def test_turns_are_read_in_the_axes_of_the_head(tracker: RealtimeTracker) -> None:
    """A head whose model stands askew in it, turned by tilt, pan and roll of its own."""
    axes = _axes(tracker, np.array([8.0, -6.0]))
    own = matrix_from_euler(np.radians([20.0, -35.0, 10.0]))
    first = axes.first.R @ axes.R_model_head
    R = axes.rotation(first @ own @ axes.R_model_head.T)
    np.testing.assert_allclose(axes.first.R.T @ R, own, atol=1e-12)


def test_what_is_told_anew_turns_all_frames_alike(tracker: RealtimeTracker) -> None:
    """To the rotations that the head has in the axes that are known now, and the model stays where it was."""
    axes = _axes(tracker, np.array([8.0, -6.0]))
    models = [axes.first.R, exp(np.radians([10.0, -30.0, 5.0])) @ axes.first.R]
    before = [axes.rotation(R) for R in models]
    turn = axes.report_anew()
    for R, told in zip(models, before, strict=True):
        np.testing.assert_allclose(turn @ told, R @ axes.R_model_head, atol=1e-12)
        np.testing.assert_allclose(axes.rotation(R), R @ axes.R_model_head, atol=1e-12)
        np.testing.assert_allclose(axes.model_rotation(R @ axes.R_model_head), R, atol=1e-12)
    np.testing.assert_allclose(axes.report_anew(), np.eye(3), atol=1e-12)


def test_the_mesh_stays_on_the_face() -> None:
    """It is drawn where the model is, however far the axes of the head have moved since the first frame."""
    tracker = begun(sequence().frames[0], RealtimeSettings(axes=AxesSettings(tilt_share=3.0, pan_share=3.0)))
    apart, told = [], []
    for frame in sequence().frames[1:]:
        estimate = tracker.track(frame)
        mesh, landmarks = tracker.mesh(estimate), estimate.landmarks
        assert mesh is not None
        assert landmarks is not None
        where = tracker.camera.project(mesh[_FIRM])[0]
        assert np.linalg.norm(where - landmarks.image[_FIRM_NAMES], axis=1).mean() < 2
        apart.append(np.degrees(angle_between(np.asarray(estimate.rotation), tracker.pose.R)))
        told.append((estimate, mesh))
    assert np.max(apart) > 2
    for earlier, mesh in told:  # as where frames are drawn later
        np.testing.assert_array_equal(np.asarray(tracker.mesh(earlier)), mesh)
    table = Track.from_estimates([estimate], {"mm_per_unit": estimate.mm_per_unit})
    (read,) = table.estimates()  # as where several faces are drawn
    np.testing.assert_allclose(np.asarray(tracker.mesh(read)), mesh, atol=1e-3)
