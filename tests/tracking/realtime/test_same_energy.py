"""Levenberg-Marquardt and the simplex minimise the same energy, Eq. (9), of one frame of a rendered face."""

from __future__ import annotations

import numpy as np
import pytest

from long_motion import sequence
from mien.arrays import Array
from mien.tracking.optimizers import Simplex
from mien.tracking.prior import state_sd
from mien.tracking.realtime.posterior import LevenbergMarquardt, PosePosterior
from mien.tracking.state import pack
from small_motion import begun


@pytest.fixture(scope="module")
def problem() -> tuple[PosePosterior, Array]:
    """The posterior of a frame and the state of the frame before it."""
    frames = sequence().frames
    tracker = begun(frames[0])
    for frame in frames[1:4]:
        tracker.track(frame)
    pose = tracker.pose
    view = tracker.solver.view(tracker.face.fine, frames[4], pose)
    return tracker.solver.posterior(view, tracker.prior.prediction(tracker.pose, tracker.pose)), pack(
        pose.R, pose.t, pose.animation
    )


def test_the_gradient_goes_where_the_simplex_goes(problem: tuple[PosePosterior, Array]) -> None:
    posterior, start = problem
    by_gradient = LevenbergMarquardt(40, 1e-6).minimize(posterior, start)
    sd = 0.3 * state_sd(3.0, 0.1, 0.2, 0.2)
    by_simplex = Simplex(sd, 6000, np.random.default_rng(0)).minimize(posterior, by_gradient.b)
    # From the other's minimum the simplex finds nothing better, and both read one energy there.
    assert posterior.energy(by_gradient.b) == pytest.approx(by_gradient.energy, rel=1e-4)
    assert by_simplex.energy > 0.98 * by_gradient.energy
    assert by_gradient.energy < posterior.energy(start)


def test_the_simplex_comes_close_from_the_start(problem: tuple[PosePosterior, Array]) -> None:
    posterior, start = problem
    by_gradient = LevenbergMarquardt(40, 1e-6).minimize(posterior, start)
    by_simplex = Simplex(0.3 * state_sd(3.0, 0.1, 0.2, 0.2), 6000, np.random.default_rng(0)).minimize(posterior, start)
    gained = posterior.energy(start) - by_gradient.energy
    assert by_simplex.energy < by_gradient.energy + 0.1 * gained
    assert by_simplex.evaluations > 20 * by_gradient.evaluations
