"""The evolution model of the real-time tracker."""

from __future__ import annotations

import numpy as np

from mien.config import RealtimeSettings
from mien.geometry.rotation import FACING, exp
from mien.tracking.realtime.pose import Pose
from mien.tracking.realtime.prior import StatePrior, student_information


def test_the_rest_is_firmer_where_a_prediction_has_turned() -> None:
    """Also of two predictions from the same last pose, as while a lost face is searched for."""
    first = Pose(FACING, np.array([0.0, 0.0, 9.0]), np.zeros(6))
    prior = StatePrior(first, RealtimeSettings())
    turned = Pose(exp(np.array([0.0, 0.7, 0.0])) @ FACING, first.t, first.animation)
    front, side = (prior.arrays(prior.prediction(pose, first)).rest_information for pose in (first, turned))
    assert (side > 5 * front).all()


def test_rest_is_firmest_where_nothing_has_moved() -> None:
    found = student_information(
        np.array([1.0, 2.0, 1.0, 1.0]), np.array([8.0, 8, 8, 4]), np.array([0.0, 0.5, 1e6, 0.0]), 0.5, 3.0
    )
    np.testing.assert_allclose(found, [27, 30, 3, 15])
