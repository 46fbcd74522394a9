"""The evolution model, the posterior, and the state they are of."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from mien.arrays import Array
from mien.frame import Frame
from mien.geometry.rotation import FACING
from mien.tracking.likelihood import LandmarkModel
from mien.tracking.prior import GaussianPrior, state_sd
from mien.tracking.state import STATE_NAMES, Estimate, Status, pack, unpack
from strategies import animations, head_rotations, head_translations, vectors


def test_psi_by_hand() -> None:
    sd = state_sd(4.0, 0.1, 0.3, 0.2)
    assert len(sd) == len(STATE_NAMES) == 12
    np.testing.assert_allclose(sd, [np.radians(4)] * 3 + [0.1, 0.1, 0.3] + [0.2] * 6)


def test_eq_4_by_hand() -> None:
    """One and two standard deviations away in two entries: 1 + 4."""
    prior = GaussianPrior(np.array([1.0, 2, 3]), np.array([0.5, 0.1, 2]))
    assert prior.energy(np.array([1.5, 2.2, 3])) == pytest.approx(5)
    assert prior.energy(prior.mean) == 0


@given(vectors(-3, 3), vectors(-3, 3))
def test_the_energy_is_that_of_the_diagonal_psi(b: Array, mean: Array) -> None:
    sd = np.array([0.2, 1.0, 3.0])
    assert GaussianPrior(mean, sd).energy(b) == pytest.approx((b - mean) @ np.linalg.inv(np.diag(sd**2)) @ (b - mean))


@given(head_rotations(), head_translations(), animations())
def test_unpack_inverts_pack(R: Array, t: Array, animation: Array) -> None:
    found = unpack(pack(R, t, animation))
    for a, b in zip(found, (R, t, animation), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)


def test_a_frontal_face_has_no_rotation() -> None:
    np.testing.assert_allclose(pack(FACING, np.array([1.0, 2, 3]), np.zeros(6)), [0, 0, 0, 1, 2, 3] + [0] * 6)


def test_eq_1_by_hand() -> None:
    """One landmark, moved by half of its first unit, half a turn about x, and moved back."""
    units = np.zeros((6, 1, 3))
    units[0, 0] = [0, 0.4, 0]
    model = LandmarkModel(np.array([[0.1, 0.2, 0.3]]), units)
    b = pack(FACING, np.array([1.0, 2, 5]), np.array([0.5, 0, 0, 0, 0, 0]))
    np.testing.assert_allclose(model.in_camera(b), [[1.1, 2 - 0.4, 5 - 0.3]])


def test_an_estimate_says_angles_and_their_error() -> None:
    frame = Frame(np.zeros((4, 4, 3), np.uint8), 7, 0.5)
    lost = Estimate.lost(frame, "gone")
    assert (lost.index, lost.time, lost.status, lost.reason) == (7, 0.5, Status.LOST, "gone")
    assert lost.euler is None
    assert lost.euler_sd is None
    covariance = np.diag([0.01, 0.04, 0.09] + [1.0] * 9)
    frontal = Estimate(0, 0.0, Status.TRACKED, FACING, np.zeros(3), None, covariance)
    np.testing.assert_allclose(frontal.euler, 0, atol=1e-12)
    np.testing.assert_allclose(frontal.euler_sd, [0.1, 0.2, 0.3])
