"""Xiao et al. 2003: the three weights, and the return to a reference."""

from __future__ import annotations

import numpy as np

from mien.baselines.registration import Residuals
from mien.baselines.xiao import XiaoTracker, weights
from mien.geometry.rotation import angle_between
from mien.synthetic import SyntheticSequence, make_sequence, moved
from small_motion import face, run


def test_weights_fall_with_residual_and_slant_and_rise_with_gradient() -> None:
    n = 5
    e, cosine, gradient = np.array([0.0, 0, 0, 60, 1]), np.ones(n), np.full(n, 10.0)
    cosine[1], gradient[2] = 0.3, 1.0
    w = weights(Residuals(e, np.zeros((n, 6)), cosine, gradient, np.zeros(n), np.arange(n)))
    assert w[0] == w.max()
    np.testing.assert_allclose(w[1] / w[0], 0.3, rtol=1e-4)
    assert w[2] < 0.05 * w[0]
    assert w[3] < 0.01 * w[0]


def _turn_and_return() -> SyntheticSequence:
    """The head turns by 30 degrees and comes back, and is at rest at the end."""
    pan = 30 * np.sin(np.linspace(0, np.pi, 17))
    angles = np.column_stack([0.3 * pan, pan, 0 * pan])
    angles = np.vstack([angles, np.zeros((3, 3))])
    n = len(angles)
    return make_sequence(face(), moved(face(), angles, np.zeros((n, 3)), np.zeros((n, 6))), noise_sd=2)


def test_reregistration_takes_the_drift_of_a_turn_back() -> None:
    sequence = _turn_and_return()
    end = {}
    for reregister in (True, False):
        estimates = run(XiaoTracker(reregister=reregister), sequence)
        assert all(e.status.success for e in estimates)
        R = estimates[-1].rotation
        assert R is not None
        end[reregister] = float(np.degrees(angle_between(R, sequence.R[-1])))
    assert end[True] < 0.2
    assert end[True] < 0.5 * end[False]
