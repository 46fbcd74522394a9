"""The fit of the first frame: what is projected is recovered, and the Jacobian is one."""

from __future__ import annotations

import numpy as np
import pytest

from mien.arrays import Array
from mien.candide.model import Candide
from mien.errors import MienError
from mien.geometry.camera import Camera, line_of_sight
from mien.geometry.rotation import FACING, angle_between, euler_from_matrix, exp, matrix_from_euler, ray_rotation
from mien.initialization.fit import (
    AXES_SD_DEG,
    FirstFrame,
    _Problem,
    fit_first_frame,
    most_likely_facing,
    tracked_model,
)
from mien.initialization.landmarks import Landmarks, rows_of_scheme

CAMERA = Camera(280, 159.5, 119.5)
MODEL, PRIOR = tracked_model(Candide.default())
REST = np.zeros(6)
COUNTS = {"candide26": 26, "ibug68": 68, "mediapipe478": 478, "mediapipe468": 468}


def _pose(seed: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    R = matrix_from_euler(np.radians(rng.uniform(-20, 20, 3))) @ FACING
    return R, np.array([*rng.uniform(-0.5, 0.5, 2), rng.uniform(4, 6)])


def _projected(shape: Array, animation: Array, R: Array, t: Array, scheme: str, deep: bool = False) -> Landmarks:
    """Landmarks of a face in a pose; points that belong to no vertex lie in the middle. deep: with depths along the
    line of sight."""
    count = COUNTS[scheme]
    vertices, rows = rows_of_scheme(scheme)
    X = (shape + np.tensordot(animation, MODEL.animation_units, axes=1))[vertices] @ R.T + t
    points, depths = np.tile(CAMERA.project(X.mean(axis=0))[0], (count, 1)), np.zeros(count)
    points[rows] = CAMERA.project(X)[0][:, None]
    depths[rows] = ((X - t) @ line_of_sight(points, CAMERA) * CAMERA.focal_px / t[2])[:, None]
    return Landmarks(points, scheme, depths if deep else None)


def _degrees(fit: FirstFrame, R: Array) -> float:
    return float(np.degrees(angle_between(fit.R, R)))


def _turn(fit: FirstFrame) -> Array:
    """Rotation (3, 3) from the model's axes to those that the head was given."""
    U, _, Vt = np.linalg.svd(fit.model.mean.T @ MODEL.mean)
    return np.asarray(U @ Vt)


@pytest.mark.parametrize("scheme", COUNTS)
@pytest.mark.parametrize("seed", [0, 1])
def test_the_mean_face_is_recovered(scheme: str, seed: int) -> None:
    R, t = _pose(seed)
    fit = fit_first_frame(_projected(PRIOR.mean, REST, R, t, scheme), CAMERA)
    assert fit.residual_px < 0.01
    assert _degrees(fit, R) < 0.02
    np.testing.assert_allclose(fit.t, t, atol=2e-3)
    np.testing.assert_allclose(fit.animation, 0, atol=2e-3)
    np.testing.assert_allclose(fit.shape, PRIOR.mean, atol=2e-3)


@pytest.mark.parametrize("side_deg", [-25.0, 0.0, 25.0])
def test_depths_are_those_along_the_line_of_sight(side_deg: float) -> None:
    """A face at the side of the image, which looks into the camera, is not taken to look past it."""
    turned = matrix_from_euler(np.radians([5.0, side_deg, 0.0]))
    R, t = turned @ FACING, turned @ np.array([0.0, 0.0, 6.0])
    fit = fit_first_frame(_projected(PRIOR.mean, REST, R, t, "mediapipe478", deep=True), CAMERA)
    assert _degrees(fit, R) < 0.1


@pytest.mark.parametrize("scheme", ["candide26", "ibug68"])
@pytest.mark.parametrize("unit", range(6))
def test_an_expression_is_fitted_with_its_unit(scheme: str, unit: int) -> None:
    """The first frame is held for nearly neutral, so that an expression is credited to the shape in part."""
    R, t = _pose(2)
    animation = REST.copy()
    animation[unit] = 0.5
    fit = fit_first_frame(_projected(PRIOR.mean, animation, R, t, scheme), CAMERA)
    assert fit.residual_px < 0.2
    assert _degrees(fit, R) < 3
    assert 0.03 < fit.animation[unit] < 0.5
    assert fit.animation[unit] > fit.animation.max() - 0.02


@pytest.mark.parametrize("scheme", ["candide26", "ibug68"])
@pytest.mark.parametrize("seed", [3, 4, 5])
def test_another_shape_is_fitted_as_far_as_one_view_shows_it(scheme: str, seed: int) -> None:
    R, t = _pose(seed)
    shape = PRIOR.vertices(0.5 * np.random.default_rng(seed).normal(size=len(PRIOR.basis)))
    fit = fit_first_frame(_projected(shape, REST, R, t, scheme), CAMERA)
    assert fit.residual_px < 0.3
    assert _degrees(fit, R) < 9  # what turns and what is a deeper chin looks alike to a few points
    np.testing.assert_allclose(fit.t[:2] / fit.t[2], t[:2] / t[2], atol=0.02)
    np.testing.assert_allclose(PRIOR.vertices(fit.coefficients) @ _turn(fit).T, fit.shape, atol=1e-9)
    np.testing.assert_allclose(PRIOR.sigma(fit.coefficients), fit.sigma)


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_depths_make_the_rotation_known(seed: int) -> None:
    R, t = _pose(seed)
    shape = PRIOR.vertices(0.5 * np.random.default_rng(seed).normal(size=len(PRIOR.basis)))
    fit = fit_first_frame(_projected(shape, REST, R, t, "mediapipe478", deep=True), CAMERA)
    assert _degrees(fit, R) < 3


@pytest.mark.parametrize("degrees", [1, 4, -6])
def test_a_face_near_the_camera_is_taken_to_look_into_it(degrees: float) -> None:
    """The angles shrink towards the ray to the face, tilt most, as it is known least, and keep their sign."""
    t = np.array([0.5, -0.3, 5.0])
    ray = ray_rotation(t)
    angles = np.radians(np.full(3, degrees))
    R, sd = most_likely_facing(ray @ matrix_from_euler(angles) @ FACING, t)
    share = euler_from_matrix(ray.T @ R @ FACING) / angles
    assert 0.4 < share[0] < share[1] < share[2] < 1
    assert (np.degrees(sd) < 1.01 * np.array(AXES_SD_DEG)).all()
    assert (np.diff(sd) < 0).all()


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_face_that_lies_on_its_side_looks_into_the_camera_all_the_same(quarters: int) -> None:
    """An image that is rotated about the ray to the face."""
    t = np.array([0.5, -0.3, 5.0])
    R = exp(np.array([0.04, -0.03, 0.02])) @ FACING
    turn = exp(0.5 * np.pi * quarters * t / np.linalg.norm(t))
    (upright, sd), (turned, sd_turned) = most_likely_facing(R, t), most_likely_facing(turn @ R, t)
    np.testing.assert_allclose(turned, turn @ upright, atol=1e-9)
    np.testing.assert_allclose(sd_turned, sd)
    assert np.degrees(angle_between(upright, R)) > 0.5


@pytest.mark.parametrize("axis", range(3))
def test_a_face_that_looks_elsewhere_stays(axis: int) -> None:
    angles = np.zeros(3)
    angles[axis] = np.radians(20)
    R = matrix_from_euler(angles) @ FACING
    expected, sd = most_likely_facing(R, np.array([0, 0, 5.0]))
    assert np.degrees(angle_between(expected, R)) < 0.05
    np.testing.assert_allclose(np.degrees(sd), AXES_SD_DEG, rtol=0.05)


def test_the_head_axes_move_nothing_in_the_picture() -> None:
    """A near frontal face is turned in its axes; its vertices and their units stay where the landmarks put them."""
    R = matrix_from_euler(np.radians([3, -2, 1])) @ FACING
    t = np.array([0.2, 0.1, 5.0])
    fit = fit_first_frame(_projected(PRIOR.mean, REST, R, t, "ibug68"), CAMERA)
    assert _degrees(fit, R) > 1
    assert fit.residual_px < 0.01
    animation = np.full(6, 0.4)
    X = (PRIOR.mean + np.tensordot(animation, MODEL.animation_units, axes=1)) @ R.T + t
    np.testing.assert_allclose(fit.vertices(animation) @ fit.R.T + fit.t, X, atol=3e-3)


def test_an_outlier_does_not_pull_the_face() -> None:
    R, t = _pose(7)
    landmarks = _projected(PRIOR.mean, REST, R, t, "ibug68")
    landmarks.points[36] += [25, -15]
    assert _degrees(fit_first_frame(landmarks, CAMERA), R) < 3


def test_landmarks_that_no_face_has_are_refused() -> None:
    landmarks = _projected(PRIOR.mean, REST, *_pose(7), "ibug68")
    landmarks.points[36] = [-300, -300]
    with pytest.raises(MienError, match="no face fits the landmarks; correct point 36, which lies farthest"):
        fit_first_frame(landmarks, CAMERA)


@pytest.mark.parametrize("deep", [False, True])
def test_jacobian_against_differences(deep: bool) -> None:
    R, t = _pose(8)
    landmarks = _projected(PRIOR.mean, REST, R, t, "mediapipe478", deep)
    sight = line_of_sight(landmarks.points, CAMERA)
    problem = _Problem(CAMERA, PRIOR, MODEL.animation_units, *landmarks.correspondences(), sight, R, float(t[2]))
    rng = np.random.default_rng(9)
    x = 0.3 * rng.normal(size=problem.size)
    x[3:6] = t
    for direction in rng.normal(size=(5, problem.size)):
        step = 1e-6 * direction
        difference = (problem.residuals(x + step) - problem.residuals(x - step)) / 2e-6
        np.testing.assert_allclose(problem.jacobian(x) @ direction, difference, rtol=1e-5, atol=1e-4)
