"""La Cascia et al. 2000: templates, and another light."""

from __future__ import annotations

import numpy as np

from mien.baselines.la_cascia import (
    LaCasciaTracker,
    Unrolled,
    displaced,
    illumination_templates,
    solve,
    warping_templates,
)
from mien.baselines.surface import Pose, cylinder
from mien.baselines.view import look, take_template
from mien.frame import Frame
from mien.geometry.rotation import angle_between
from mien.synthetic import make_sequence, moved
from small_motion import face


def test_illumination_templates_are_orthonormal_and_hold_the_texture() -> None:
    surface = cylinder(face().fit)
    rng = np.random.default_rng(0)
    texture, weight = rng.uniform(50, 200, len(surface.points)), rng.uniform(0, 1, len(surface.points))
    U = illumination_templates(surface, texture, weight)
    np.testing.assert_allclose(U.T @ (weight[:, None] * U), np.eye(5), atol=1e-4)
    brighter = 1.2 * texture * (1 + 0.3 * np.sin(surface.angle))
    rest = brighter - U @ (U.T @ (weight * brighter))
    assert np.abs(rest).max() < 0.1


def test_motion_and_light_are_told_apart() -> None:
    rng = np.random.default_rng(1)
    texture, warping = rng.uniform(50, 200, 500), rng.normal(0, 100, (500, 6))
    unrolled = Unrolled(texture, warping, np.linalg.qr(rng.normal(size=(500, 3)))[0])
    motion, light = np.array([0.02, -0.03, 0.01, 0.05, -0.04, 0.02]), np.array([30.0, -20, 10])
    seen = texture + warping @ motion + unrolled.illumination @ light
    found, explained = solve(unrolled, seen, np.ones(500))
    np.testing.assert_allclose(found, motion, atol=1e-3)
    np.testing.assert_allclose(explained, seen - warping @ motion, atol=0.5)


def test_warping_templates_predict_a_displaced_texture() -> None:
    surface, pose = cylinder(face().fit), Pose(face().fit.R, face().fit.t)
    view = look(face().frame, pose, face().camera)
    assert view is not None
    first = take_template(surface, view, pose)
    B = warping_templates(surface, view, pose)[0]
    motion = np.array([0.02, -0.02, 0.03, 0.01, 0.02, 0.05])
    change = take_template(surface, view, displaced(pose, motion)).values[0] - first.values[0]
    inner = first.cosine > 0.5
    assert np.corrcoef(change[inner], (B @ motion)[inner])[0, 1] > 0.95


def _in_moving_light(tracker: LaCasciaTracker) -> float:
    """Degrees by which a head at rest seems to turn while a lamp moves to its side."""
    n = 6
    still = make_sequence(face(), moved(face(), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 6))))
    centre = face().camera.project(face().fit.t)[0][0]
    across = np.clip((np.arange(face().frame.width) - centre) / 50, -1, 1)
    tracker.initialize(still.frames[0], face().landmarks, face().camera)
    for strength, frame in zip(np.linspace(0, 0.6, n), still.frames, strict=True):
        lit = frame.pixels * (0.8 + strength * across)[None, :, None]
        estimate = tracker.track(Frame(np.clip(lit, 0, 255).astype(np.uint8), frame.index, frame.time))
    return 90.0 if estimate.rotation is None else float(np.degrees(angle_between(estimate.rotation, still.R[0])))


def test_illumination_templates_hold_the_pose_when_the_light_moves() -> None:
    with_templates = _in_moving_light(LaCasciaTracker())
    without = _in_moving_light(LaCasciaTracker(use_illumination=False))
    assert with_templates < 4
    assert with_templates < 0.5 * without
