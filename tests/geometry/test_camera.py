"""The pinhole camera: projection, validity, Jacobian, and points that relative depths put back in space."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given

from mien.arrays import Array
from mien.errors import MienError
from mien.geometry.camera import Camera, back_project, line_of_sight
from mien.geometry.rotation import matrix_from_euler, similarity
from strategies import cameras, head_translations


def test_project_by_hand() -> None:
    points, valid = Camera(100, 160, 120).project(np.array([[0.0, 0, 2], [1, -0.5, 2]]))
    np.testing.assert_allclose(points, [[160, 120], [210, 95]])
    assert valid.all()


def test_points_behind_the_camera_are_not_valid_and_nan() -> None:
    points, valid = Camera(100, 160, 120).project(np.array([[1.0, 1, 5], [1, 1, -5], [1, 1, 0]]))
    assert valid.tolist() == [True, False, False]
    assert np.isfinite(points[0]).all()
    assert np.isnan(points[1:]).all()


@given(cameras(), head_translations())
def test_jacobian_against_differences(camera: Camera, X: Array) -> None:
    step = 1e-5
    columns = [(camera.project(X + step * e)[0] - camera.project(X - step * e)[0]) / (2 * step) for e in np.eye(3)]
    np.testing.assert_allclose(camera.J_pixel_point(X), np.stack(columns, axis=-1), atol=1e-5)


@given(cameras(), head_translations())
def test_scale_cannot_be_seen(camera: Camera, X: Array) -> None:
    np.testing.assert_allclose(camera.project(3 * X)[0], camera.project(X)[0], atol=1e-8)


def test_field_of_view_reaches_the_borders() -> None:
    camera = Camera.from_fov(320, 240, 90)
    assert camera.focal_px == pytest.approx(160)
    assert (camera.cx, camera.cy) == (159.5, 119.5)


@pytest.mark.parametrize(
    "values", [(0, 1, 1), (-5, 1, 1), (float("nan"), 1, 1), (100, float("inf"), 1), ("100", 1, 1), (100, None, 1)]
)
def test_bad_cameras_are_refused(values: tuple[Any, Any, Any]) -> None:
    with pytest.raises(MienError):
        Camera(*values)


@pytest.mark.parametrize("fov", [0, -10, 180, 270])
def test_bad_fields_of_view_are_refused(fov: float) -> None:
    with pytest.raises(MienError, match="field of view"):
        Camera.from_fov(320, 240, fov)


def test_what_lies_in_the_image() -> None:
    camera = Camera(100.0, 50.0, 40.0)
    X = np.array([[0.0, 0, 1], [-0.5, -0.4, 1], [0.5, 0, 1], [0, -0.41, 1], [0, 0, -1]])
    np.testing.assert_array_equal(camera.in_image(X, 100, 80), [True, True, False, False, False])


def test_numbers_of_numpy_become_plain() -> None:
    """They are saved as JSON."""
    K = np.array([[500, 0, 160], [0, 500, 120], [0, 0, 1]], np.float32)
    camera = Camera(K[0, 0], K[0, 2], K[1, 2])
    assert json.loads(json.dumps(camera.to_dict())) == {"focal_px": 500, "cx": 160, "cy": 120, "focal_log_sd": 0}


K = [[600.0, 0, 320], [0, 606, 240], [0, 0, 1]]


def test_the_camera_of_a_calibration() -> None:
    assert Camera.from_matrix(K) == Camera.from_matrix(np.array(K), np.zeros((1, 5))) == Camera(603, 320, 240)
    assert Camera.from_matrix(K, None) == Camera(603, 320, 240)  # as OpenCV is told of no distortion
    seen = Camera.from_matrix(np.array(K, np.float32), [0.01, 0, 0, 0])  # at the corner by 0.01 r^2, with r = 0.67
    assert seen == Camera(603, 320, 240)


@pytest.mark.parametrize(
    ("matrix", "distortion", "told"),
    [
        (np.transpose(K), (), r"is no camera matrix; give \[\[fx, 0, cx\]"),
        (K[:2], (), "is no camera matrix"),
        ([[0, 0, 320], [0, 606, 240], [0, 0, 1]], (), "is no camera matrix"),
        ([[float("nan"), 0, 320], [0, 606, 240], [0, 0, 1]], (), "is no camera matrix"),
        (K, [-9, 0, 0, 0], r"coefficients \[-9\.0, 0\.0, 0\.0, 0\.0\] the lens shows 13 % of the image; .* fisheye"),
        ("K.npy", (), "camera matrix: 'K.npy' is no array of numbers"),
        ([[600, 0, 320], [0, 606], [0, 0, 1]], (), "camera matrix: .* is no array of numbers"),
        (K, ["k1", 0, 0, 0], r"distortion coefficients: \['k1', 0, 0, 0\] is no array of numbers"),
        (K, [0.1, 0], r"\[0\.1, 0\.0\] are no distortion coefficients; give the 4, 5"),
    ],
)
def test_a_calibration_of_another_camera_is_refused(matrix: Any, distortion: Any, told: str) -> None:
    with pytest.raises(MienError, match=told):
        Camera.from_matrix(matrix, distortion)


CENTRED = Camera(500, 160, 120)


def test_back_projection_keeps_the_pixels_and_the_depths() -> None:
    points = np.array([[160.0, 120.0, 0.0], [210.0, 70.0, 25.0], [110.0, 170.0, 0.0]])
    X = back_project(points, CENTRED)
    np.testing.assert_allclose(X[0], [0, 0, 500])
    np.testing.assert_allclose(X[1], [52.5, -52.5, 525])  # 50 pixels at 525 / 500
    np.testing.assert_allclose(CENTRED.project(X)[0], points[:, :2])


def test_back_projection_at_the_side_of_the_image() -> None:
    """Depths are along the line of sight: there a cube that faces the camera stays one."""
    corners = np.array([[x, y, z] for x in (-20, 20) for y in (-20, 20) for z in (-20, 20)], dtype=float)
    turned = matrix_from_euler(np.radians([0.0, 20.0, 0.0]))
    X = corners @ turned.T + turned @ [0, 0, 500 / np.cos(np.radians(20))]
    pixels = CENTRED.project(X)[0]
    sight = line_of_sight(pixels, CENTRED)
    found = back_project(np.column_stack([pixels, X @ sight - 500 / sight[2]]), CENTRED)
    np.testing.assert_allclose(found, X, atol=1e-6)
    scale, R, _ = similarity(corners, found)
    assert scale == pytest.approx(1)
    np.testing.assert_allclose(R, turned, atol=1e-9)
