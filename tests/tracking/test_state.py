"""What is told of one frame."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from mien.frame import Frame
from mien.geometry.rotation import FACING, matrix_from_euler
from mien.tracking.state import Estimate, Status, TrackedLandmarks

FRAME = Frame(np.zeros((48, 64, 3), np.uint8), 12, 0.5)


def _estimate() -> Estimate:
    """A tracked face with everything that is estimated, of 26 landmarks."""
    R = matrix_from_euler(np.radians([-4.0, 12.34, 0.8])) @ FACING
    landmarks = TrackedLandmarks(("nose_tip",) * 26, *(np.zeros((26, k)) for k in (2, 3)), np.ones(26), np.ones(26))
    return Estimate(
        12, 0.5, Status.TRACKED, R, np.array([0.0, 0, 5]), np.zeros(6), np.eye(12), landmarks, 0.97, model_rotation=R
    )


def test_one_line_tells_of_an_estimate() -> None:
    told = "<Estimate of frame 12 at 0.50 s: tracked, yaw +12.3, pitch -4.0, roll +0.8 degrees, confidence 97%>"
    assert repr(_estimate()) == told
    assert repr(_estimate().landmarks) == "<TrackedLandmarks: 26>"
    lost = Estimate.lost(FRAME, "the face left the image")
    assert repr(lost) == "<Estimate of frame 12 at 0.50 s: lost, the face left the image>"
    assert repr(Estimate(0, 0.0, Status.LOST)) == "<Estimate of frame 0 at 0.00 s: lost>"


def test_a_status_is_written_as_in_tables() -> None:
    assert f"{Status.LOST}" == str(Status.LOST) == Status.LOST.value == "lost"


def test_arrays_of_an_estimate_cannot_be_written_to_and_those_of_its_tracker_can() -> None:
    estimate, covariance = _estimate(), np.eye(12)
    sent = pickle.loads(pickle.dumps(estimate))
    for value in (estimate, replace(estimate, covariance=covariance), estimate.landmarks, sent, sent.landmarks):
        arrays = [array for array in vars(value).values() if isinstance(array, np.ndarray)]
        assert len(arrays) >= 4
        for array in arrays:
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0
    covariance[0, 0] = 2.0


def test_an_estimate_stays_as_it_is_where_its_tracker_goes_on_in_its_own_arrays() -> None:
    """Rows of a table are written many at a time."""
    t, points = np.array([0.0, 0, 5]), np.zeros((1, 2))
    estimate = Estimate(0, 0.0, Status.TRACKED, translation=t, landmarks=TrackedLandmarks(("nose_tip",), points))
    t += 1
    points += 1
    assert estimate.translation is not None
    assert estimate.translation.tolist() == [0, 0, 5]
    assert estimate.landmarks is not None
    assert not estimate.landmarks.image.any()
