"""Angles of the three protocols: a perfect tracker scores zero, a known error scores itself."""

from __future__ import annotations

import numpy as np
import pytest

from evaluation.tiny import angles_deg, head_rotations, truth
from mien.arrays import Array
from mien.errors import MienError
from mien.evaluation.datasets.sequence import Truth
from mien.evaluation.metrics import mean_absolute_error
from mien.evaluation.protocols import (
    Comparison,
    Protocol,
    compare,
    hold,
    protocol_named,
    truth_rotations,
    wrap_deg,
)
from mien.evaluation.protocols import (
    angles_deg as angles_of,
)
from mien.geometry.rotation import FACING, euler_from_matrix, euler_jacobian, exp

PROTOCOLS = list(Protocol)


def _tilt(degrees: float) -> Array:
    return exp(np.radians([degrees, 0, 0]))


def _pan(degrees: float) -> Array:
    return exp(np.radians([0, degrees, 0]))


def _random_rotations(n: int, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    return np.array([exp(v) for v in rng.normal(scale=0.4, size=(n, 3))])


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_perfect_tracker_scores_zero(protocol: Protocol) -> None:
    R = FACING @ _random_rotations(20, 1)
    c = compare(protocol, Truth(20, rotations=R), R)
    np.testing.assert_allclose(mean_absolute_error(c.error_deg, c.counted()), 0, atol=1e-9)
    np.testing.assert_allclose(c.rotation_error_deg, 0, atol=1e-5)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_perfect_tracker_scores_zero_on_a_sensors_angles(protocol: Protocol) -> None:
    known = Truth(6, angles_deg=angles_deg())
    c = compare(protocol, known, truth_rotations(protocol, known))
    np.testing.assert_allclose(mean_absolute_error(c.error_deg, c.counted()), 0, atol=1e-9)


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_known_error_scores_itself(protocol: Protocol, axis: int) -> None:
    still = truth(np.zeros((4, 3)))
    off = np.zeros(3)
    off[axis] = 6.0
    R = FACING @ head_rotations(np.array([np.zeros(3), off, off, np.zeros(3)]))
    c = compare(protocol, still, R)
    expected = np.zeros(3)
    expected[axis] = 3.0  # six degrees in two of four frames
    np.testing.assert_allclose(mean_absolute_error(c.error_deg, c.counted()), expected, atol=1e-9)
    np.testing.assert_allclose(c.rotation_error_deg, [0, 6, 6, 0], atol=1e-6)


def test_rebased_and_sensor_differ_where_the_first_frame_is_turned() -> None:
    """First frame panned by 90 degrees, then a nod of 10 about the head's own axis.

    `R_0^T R_t = Rx(10)`: a tilt. `R_t R_0^T = Ry(90) Rx(10) Ry(-90)` turns about `Ry(90) x = -z`: a roll of
    -10.
    """
    H = np.array([_pan(90), _pan(90) @ _tilt(10)])
    known = Truth(2, rotations=FACING @ H)
    rebased = compare(Protocol.REBASED, known, FACING @ H)
    sensor = compare(Protocol.SENSOR, known, FACING @ H)
    np.testing.assert_allclose(rebased.truth_deg[1], [10, 0, 0], atol=1e-9)
    np.testing.assert_allclose(sensor.truth_deg[1], [0, 0, -10], atol=1e-9)


def test_axes_of_the_head_can_be_aligned() -> None:
    """A tracker that is right, but for which way it takes the head to look, and one that turns too far."""
    R = FACING @ _random_rotations(40, 4)
    other = exp(np.radians([4.0, -7.0, 2.0]))
    leaning = compare(Protocol.REBASED, Truth(40, rotations=R), R @ other)
    assert np.abs(leaning.error_deg).mean() > 1.0
    np.testing.assert_allclose(leaning.aligned_error_deg, 0, atol=1e-6)

    pans = np.linspace(0, 30, 10)
    turned = np.stack([FACING @ _pan(a) for a in pans])
    too_far = np.stack([FACING @ _pan(1.1 * a) for a in pans])
    too_far[4] = np.nan  # lost: the last rotation is held, and nothing aligned to it
    wrong = compare(Protocol.REBASED, Truth(10, rotations=turned), too_far)
    np.testing.assert_allclose(wrong.aligned_error_deg, wrong.error_deg, atol=1e-6)
    too_far[1:] = np.nan
    soon_lost = compare(Protocol.REBASED, Truth(10, rotations=turned), too_far)
    np.testing.assert_allclose(soon_lost.aligned_error_deg, soon_lost.error_deg, atol=1e-6)


def test_each_protocol_ignores_the_offset_that_it_should() -> None:
    R = FACING @ _random_rotations(10, 2)
    offset = exp(np.array([0.1, -0.2, 0.15]))
    known = Truth(10, rotations=R)
    np.testing.assert_allclose(compare(Protocol.REBASED, known, offset @ R).error_deg, 0, atol=1e-9)
    np.testing.assert_allclose(compare(Protocol.SENSOR, known, R @ offset).error_deg, 0, atol=1e-9)
    assert np.abs(compare(Protocol.REBASED, known, R @ offset).error_deg).max() > 1
    assert np.abs(compare(Protocol.SENSOR, known, offset @ R).error_deg).max() > 1


def test_the_order_of_the_sensors_angles() -> None:
    """Tilt 90 and pan 90: `Rx Ry` takes x to y (Ry: x -> -z, then Rx: -z -> y); `Ry Rx` takes x to -z."""
    known = Truth(1, angles_deg=np.array([[90.0, 90.0, 0.0]]))
    x = np.array([1.0, 0, 0])
    np.testing.assert_allclose(FACING @ truth_rotations(Protocol.REBASED, known)[0] @ x, [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(FACING @ truth_rotations(Protocol.SENSOR, known)[0] @ x, [0, 0, -1], atol=1e-12)


def test_signs_are_those_of_head_axes() -> None:
    """OpenFace's angles, of `R @ FACING`, have pan and roll with the other sign."""
    c = compare(Protocol.REBASED, truth(), truth().rotations)
    openface = np.degrees([euler_from_matrix(R @ FACING) for R in truth().rotations])
    np.testing.assert_allclose(c.truth_deg, angles_deg(), atol=1e-9)
    np.testing.assert_allclose(openface * [1, -1, -1], angles_deg(), atol=1e-9)


def test_a_lost_frame_holds_the_last_rotation() -> None:
    angles = np.array([[0.0, 0, 0], [0, 4, 0], [0, 8, 0], [0, 12, 0]])
    R = FACING @ head_rotations(angles)
    R[2] = np.nan
    c = compare(Protocol.REBASED, truth(angles), R)
    np.testing.assert_array_equal(c.lost, [False, False, True, False])
    np.testing.assert_allclose(c.error_deg[:, 1], [0, 0, -4, 0], atol=1e-9)
    assert mean_absolute_error(c.error_deg, c.counted())[1] == pytest.approx(1.0)


def test_the_papers_protocol_leaves_lost_frames_out() -> None:
    still = truth(np.zeros((4, 3)))
    R = FACING @ head_rotations(np.array([[0.0, 0, 0], [3, 0, 4], [0, 40, 0], [0, 0, 0]]))
    R[3] = np.nan
    c = compare(Protocol.PAPER, still, R)
    np.testing.assert_allclose(c.squared_error, [0, 25, 1600, np.inf], atol=1e-6)
    np.testing.assert_array_equal(c.counted(30), [True, True, False, False])
    np.testing.assert_array_equal(c.counted(4.9), [True, False, False, False])
    np.testing.assert_allclose(mean_absolute_error(c.error_deg, c.counted(30)), [1.5, 0, 2], atol=1e-9)


def test_frames_without_truth_do_not_count_and_the_first_with_truth_is_the_origin() -> None:
    angles = np.array([[np.nan] * 3, [0, 5, 0], [0, 7, 0]])
    R = FACING @ head_rotations(np.array([[0.0, 1, 0], [0, 5, 0], [0, 8, 0]]))
    c = compare(Protocol.REBASED, Truth(3, angles_deg=angles), R)
    np.testing.assert_array_equal(c.known, [False, True, True])
    np.testing.assert_allclose(c.error_deg[1:], [[0, 0, 0], [0, 1, 0]], atol=1e-9)
    assert np.isnan(c.error_deg[0]).all()


def test_hold_keeps_leading_losses_unknown() -> None:
    R = np.array([np.full((3, 3), np.nan), np.eye(3), np.full((3, 3), np.nan)])
    held = hold(R)
    assert np.isnan(held[0]).all()
    np.testing.assert_array_equal(held[2], np.eye(3))


def test_covariance_of_the_angles_is_that_of_the_rotation_vector_seen_through_the_jacobian() -> None:
    rng = np.random.default_rng(3)
    R = FACING @ _random_rotations(5, 4)
    half = 0.02 * rng.normal(size=(5, 3, 3))
    C = half @ np.swapaxes(half, 1, 2)
    c = compare(Protocol.REBASED, Truth(5, rotations=R), R, C)
    for i in range(5):
        J = euler_jacobian(R[0].T @ R[i]) @ R[0].T
        np.testing.assert_allclose(c.covariance_deg2[i], np.degrees(1) ** 2 * J @ C[i] @ J.T, rtol=1e-4)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_covariance_is_that_of_a_later_rotation_where_the_first_frame_is_turned(protocol: Protocol) -> None:
    rng = np.random.default_rng(5)
    R, step = FACING @ _random_rotations(5, 6), 1e-5
    half = 0.02 * rng.normal(size=(5, 3, 3))
    C = half @ np.swapaxes(half, 1, 2)
    c = compare(protocol, Truth(5, rotations=R), R, C)
    moved = [np.concatenate([R[:1], exp(step * axis) @ R[1:]]) for axis in np.eye(3)]
    angles = [compare(protocol, Truth(5, rotations=R), turned).estimate_deg for turned in moved]
    J = np.stack([wrap_deg(a - c.estimate_deg) / step for a in angles], axis=-1)
    np.testing.assert_allclose(c.covariance_deg2[1:], (J @ C @ np.swapaxes(J, 1, 2))[1:], rtol=1e-3, atol=1e-4)


def test_an_error_at_the_threshold_is_tracked() -> None:
    zero, nowhere = np.zeros((2, 3)), np.full((2, 3, 3), np.nan)
    estimate = np.array([[3.0, 0, 4], [3, 0, 4.001]])
    c = Comparison(Protocol.PAPER, zero, estimate, np.zeros(2), np.zeros(2, dtype=bool), nowhere)
    np.testing.assert_array_equal(c.tracked(5), [True, False])


def test_at_the_first_frame_the_deviations_of_the_angles_are_those_about_the_axes() -> None:
    C = np.diag(np.radians([1.0, 2.0, 3.0]) ** 2)
    for protocol in PROTOCOLS:
        c = compare(protocol, truth(), truth().rotations, np.stack([C] * 6))
        np.testing.assert_allclose(c.sd_deg[0], [1, 2, 3], rtol=1e-6)


def test_angles_wrap() -> None:
    np.testing.assert_allclose(wrap_deg(np.array([190.0, -190.0, 20.0])), [-170, 170, 20])
    np.testing.assert_allclose(angles_of(head_rotations(np.array([[10.0, 20, 30]])), "XYZ"), [[10, 20, 30]])


def test_bad_input() -> None:
    lost = np.full((6, 3, 3), np.nan)
    with pytest.raises(MienError, match="no pose in the first frame"):
        compare(Protocol.REBASED, truth(), lost)
    with pytest.raises(MienError, match="no true pose"):
        compare(Protocol.REBASED, Truth(6), lost)
    with pytest.raises(MienError, match="5 frames and the truth 6"):
        compare(Protocol.REBASED, truth(), lost[:5])
    with pytest.raises(MienError, match="a pose for one frame only, whose error is zero by definition"):
        compare(Protocol.REBASED, truth(np.array([[np.nan] * 3, [0, 5, 0]])), truth().rotations[:2])
    with pytest.raises(MienError, match="paper, rebased, sensor"):
        protocol_named("best")
