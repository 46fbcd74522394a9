"""Every measure against values worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from mien.evaluation import metrics
from mien.evaluation.points12 import (
    POINT_NAMES,
    TWELVE,
    names_of_scheme,
    outer_eye_distance,
    points_of_names,
    points_of_scheme,
)
from mien.initialization.landmarks import LANDMARK_NAMES


def test_mean_absolute_error() -> None:
    error = np.array([[1.0, -2.0, 0.0], [3.0, 2.0, -6.0], [100.0, 100.0, 100.0]])
    counted = np.array([True, True, False])
    np.testing.assert_allclose(metrics.mean_absolute_error(error, counted), [2, 2, 3])
    assert np.isnan(metrics.mean_absolute_error(error, np.zeros(3, dtype=bool))).all()


def test_success_rate() -> None:
    squared = np.array([0.0, 25.0, 26.0, np.inf])
    known = np.array([True, True, True, True])
    assert metrics.success_rate(squared, known, 5.0) == 0.5
    assert metrics.success_rate(squared, known, 6.0) == 0.75
    assert metrics.success_rate(squared, np.array([True, False, False, False]), 5.0) == 1.0


def test_jitter_of_a_zigzag_and_of_a_ramp() -> None:
    """0 1 0 1 0 has second differences -2, 2, -2: mean -2/3, deviation sqrt(4 - 4/9)."""
    zigzag = np.array([0.0, 1, 0, 1, 0])
    error = np.column_stack([zigzag, 3 * np.arange(5.0), np.full(5, 7.0)])
    lost = np.zeros(5, dtype=bool)
    np.testing.assert_allclose(metrics.jitter_deg(error, lost), [np.sqrt(32) / 3, 0, 0], atol=1e-12)


def test_jitter_leaves_out_what_touches_a_lost_frame() -> None:
    error = np.repeat(np.array([[0.0], [1], [2], [90], [4], [5], [6]]), 3, axis=1)
    lost = np.arange(7) == 3
    np.testing.assert_allclose(metrics.jitter_deg(error, lost), 0, atol=1e-12)
    assert np.isnan(metrics.jitter_deg(error[:2], lost[:2])).all()


def test_jitter_of_white_noise_is_root_six_times_its_deviation() -> None:
    noise = np.random.default_rng(5).normal(size=(20000, 3))
    np.testing.assert_allclose(metrics.jitter_deg(noise, np.zeros(20000, dtype=bool)), np.sqrt(6), rtol=0.05)


def test_landmark_rms() -> None:
    truth = np.zeros((2, 2, 2))
    estimate = np.array([[[3.0, 4.0], [0.0, 0.0]], [[1.0, 0.0], [0.0, 1.0]]])
    np.testing.assert_allclose(metrics.landmark_rms(estimate, truth), [np.sqrt(12.5), 1.0])
    assert metrics.root_mean_square(np.array([3.0, np.nan, 4.0])) == pytest.approx(np.sqrt(12.5))


def test_landmark_rms_without_offset() -> None:
    """The first frame that both have is without error; one more pixel afterwards is all that is left."""
    truth = np.zeros((3, 1, 2))
    truth[0] = np.nan
    estimate = np.array([[[9.0, 9.0]], [[5.0, 5.0]], [[6.0, 5.0]]])
    free = metrics.landmark_rms(metrics.without_offset(estimate, truth), truth)
    np.testing.assert_allclose(free[1:], [0, 1])
    assert np.isnan(free[0])


def test_counterparts_and_correlation() -> None:
    names = ("browDown_L", "browDown_R", "browInnerUp_L", "jawOpen")
    expression = np.array([[0.0, 0.0, 0.5, 0.1], [0.4, 0.2, 0.0, 0.2], [1.0, 1.0, 0.0, 0.3]])
    lowered = metrics.counterpart("brow_lowerer", expression, names)
    np.testing.assert_allclose(lowered, [-0.5, 0.3, 1.0])
    np.testing.assert_allclose(metrics.counterpart("jaw_drop", expression, names), [0.1, 0.2, 0.3])
    assert metrics.counterpart("upper_lip_raiser", expression, names) is None
    assert metrics.correlation(np.array([1.0, 2, 3]), np.array([-2.0, -4, -6])) == pytest.approx(-1)
    assert metrics.correlation(np.array([1.0, 2, np.nan, 4]), np.array([2.0, 4, 99, 8])) == pytest.approx(1)
    # Deviations -1 0 1 and -1 2 -1 from the means have a product of zero.
    assert metrics.correlation(np.array([0.0, 1, 2]), np.array([0.0, 3, 0])) == pytest.approx(0)
    assert np.isnan(metrics.correlation(np.array([1.0, 1, 1]), np.array([0.0, 1, 2])))
    assert np.isnan(metrics.correlation(np.array([0.0, 1, np.nan]), np.array([0.0, 1, 2])))


def test_false_movement() -> None:
    nan = np.nan
    expression = np.array([[0.1, 0.0, nan, nan], [0.4, -0.2, nan, 0.2], [nan, nan, nan, nan], [0.0, 0.1, nan, 0.7]])
    np.testing.assert_allclose(metrics.false_movement(expression), [0.3, 0.2, nan, 0.5])


def test_coverage() -> None:
    """Half widths for a deviation of 2: 1.349 at 50, 3.290 at 90, 3.920 at 95 per cent."""
    error = np.array([1.3, -1.4, 3.2, -3.9, 4.0])
    sd = np.full(5, 2.0)
    assert metrics.coverage(error, sd, 0.50) == 0.2
    assert metrics.coverage(error, sd, 0.90) == 0.6
    assert metrics.coverage(error, sd, 0.95) == 0.8
    assert np.isnan(metrics.coverage(error, np.full(5, np.nan), 0.5))
    assert metrics.coverage(error, np.array([2.0, 2, 2, 0, 0]), 0.50) == 1 / 3


def test_normalised_error_squared() -> None:
    error = np.array([[2.0, 3.0], [1.0, 1.0], [1.0, 1.0]])
    covariance = np.array([np.diag([4.0, 9.0]), [[2.0, 1.0], [1.0, 2.0]], np.full((2, 2), np.nan)])
    # (1 + 1) / 2, and [1 1] C^-1 [1 1] = 2/3 over two dimensions
    np.testing.assert_allclose(metrics.normalised_error_squared(error, covariance), [1, 1 / 3, np.nan])
    covariance = np.array([np.diag([4.0, 9e-8]), np.ones((2, 2)), np.zeros((2, 2))])  # the second and third singular
    error[0] = [2.0, 3e-4]
    np.testing.assert_allclose(metrics.normalised_error_squared(error, covariance), [1, np.nan, np.nan])


def test_calibrated_errors_are_covered_and_normalised() -> None:
    rng = np.random.default_rng(6)
    C = np.array([[2.0, 0.5, 0], [0.5, 1.0, 0], [0, 0, 4.0]])
    error = rng.multivariate_normal(np.zeros(3), C, size=5000)
    assert metrics.normalised_error_squared(error, np.tile(C, (5000, 1, 1))).mean() == pytest.approx(1, abs=0.05)
    assert metrics.coverage(error, np.sqrt(np.diag(C)) * np.ones((5000, 1)), 0.9) == pytest.approx(0.9, abs=0.02)


def test_reliability() -> None:
    confidence = np.array([0.95, 0.95, 0.91, 1.0, 0.25, np.nan])
    error = np.array([1.0, 4.9, 5.0, 20.0, 1.0, 1.0])
    r = metrics.reliability(confidence, error)
    assert r.count[9] == 4
    assert r.right[9] == 0.5
    assert r.confidence[9] == pytest.approx(0.9525)
    assert r.count[2] == 1
    assert r.right[2] == 1
    assert np.isnan(r.right[5])
    assert r.gap == pytest.approx((4 * 0.4525 + 0.75) / 5)


def test_the_twelve_points() -> None:
    ibug = np.arange(68.0)[None, :, None] * np.ones(2)
    rows = points_of_scheme(ibug, "ibug68")[0, :, 0]
    np.testing.assert_array_equal(rows, [36, 39, 42, 45, 30, 33, 31, 35, 48, 54, 51, 57])
    mediapipe = np.arange(478.0)[None, :, None] * np.ones(2)
    rows = points_of_scheme(mediapipe, "mediapipe478")[0, :, 0]
    np.testing.assert_array_equal(rows, [20, 144, 372, 256, 4, 129, 97.5, 326.5, 61, 291, 0, 17])
    np.testing.assert_array_equal(points_of_scheme(ibug[:, :12], TWELVE), ibug[:, :12])


def test_points_by_name() -> None:
    points = np.arange(26.0)[None, :, None] * np.ones(2)
    by_name = points_of_names(points, LANDMARK_NAMES)
    assert by_name is not None
    assert by_name[0, 4, 0] == LANDMARK_NAMES.index("nose_tip")
    assert points_of_names(points[:, :5], LANDMARK_NAMES[:5]) is None
    names = names_of_scheme("ibug68", 68)
    assert names[30] == "nose_tip"
    assert len(set(names)) == 68
    assert set(POINT_NAMES) <= set(names)


def test_distance_of_the_outer_corners_of_the_eyes() -> None:
    points = np.zeros((1, 12, 2))
    points[0, 0], points[0, 3] = (0, 0), (3, 4)
    np.testing.assert_allclose(outer_eye_distance(points), [5])
