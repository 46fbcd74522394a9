"""What the tracker says of its own error, calibrated against truth.

The inverse of the Gauss-Newton matrix at the optimum knows the noise of one frame. What it does not know is that the
model is wrong by a little, everywhere the same way: an error of the relief turns into an error of the angle that grows
with the turn out of the first frame's view. Both are scaled to the errors measured on rendered sequences with exact
truth; docs/benchmark.md gives the coverage and the reliability that result, and the command.
"""

from __future__ import annotations

import math

import numpy as np

from mien.geometry.rotation import Array

NOISE_SCALE = 0.40
"""Factor of the standard deviations from the Gauss-Newton matrix."""
TURN_SD = 0.0127
"""Standard deviation of the rotation, in radians, by the sine of the turn out of the image plane."""
MISFIT_DISTANCE = 8.0
"""Median squared distance of the landmarks at which every variance is twice what it is for a perfect fit."""
_CONFIDENCE = (-13.22, -1.553, 7.5)
"""Bias, weight of the logarithm of the spread, and of the share that is seen; the last is not the best fit (4.9) but
more, since the sequences hold few frames with nearly everything hidden, and such a frame must not be believed."""
_STRANGER = (42.0, 18.0, 2.5)
"""Squared distance that even the best quarter of the landmarks of another person exceeds, its growth by radian of
turn, and the width of the step: between strangers and the same face of three subjects."""


def state_covariance(spread: Array, d2: Array, R: Array, R_first: Array) -> Array:
    """Covariance (12, 12) of `[w, t, a]` from the inverse (12, 12) of the Gauss-Newton matrix and the squared distances
    d2 (n,) of the landmarks that are seen, at a rotation (3, 3), relative to the first frame's."""
    covariance = NOISE_SCALE**2 * spread
    covariance[:3, :3] += systematic_variance(R, R_first) * np.eye(3)
    median = float(np.sort(d2)[len(d2) // 2]) if len(d2) else 0.0
    return np.asarray((1 + median / MISFIT_DISTANCE) * covariance)


def systematic_variance(R: Array, R_first: Array) -> float:
    """Variance (radians squared) about each axis that comes from the model and not from the frame."""
    return TURN_SD**2 * turn_squared(R, R_first)


def turn_squared(R: Array, R_first: Array) -> float:
    """Squared sine of the turn of the face, out of the image plane, from one rotation (3, 3) to another."""
    return max(0.0, 1 - float(R[:, 2] @ R_first[:, 2]) ** 2)


def confidence(covariance: Array, d2: Array, seen: float, R: Array, R_first: Array) -> float:
    """Probability that the rotation is right to 5 degrees.

    d2: (n,) squared distances of the landmarks that face the camera; seen: share of all landmarks that are seen.
    A logistic regression, fitted to measured errors, on the spread of the rotation and on what is seen, times the
    probability that this is the face of the first frame at all.
    """
    bias, by_spread, by_seen = _CONFIDENCE
    right = _logistic(bias + by_spread * math.log(float(np.trace(covariance[:3, :3]))) + by_seen * seen)
    return right * familiarity(d2, R, R_first)


def familiarity(d2: Array, R: Array, R_first: Array) -> float:
    """Probability that this is the face of the first frame, from the squared distances d2 (n,) of the landmarks that
    face the camera."""
    if not len(d2):
        return 0.0
    stranger, by_turn, width = _STRANGER
    turn = math.acos(min(max(float(R[:, 2] @ R_first[:, 2]), -1.0), 1.0))
    best_quarter = float(np.sort(d2)[len(d2) // 4])
    return _logistic((stranger + by_turn * turn - best_quarter) / width)


def _logistic(x: float) -> float:
    return 1 / (1 + math.exp(-min(max(x, -30.0), 30.0)))
