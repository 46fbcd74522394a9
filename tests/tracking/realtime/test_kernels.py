"""The compiled kernels: their Jacobians against differences, their algebra against dense formulas."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mien.appearance.crop import blurred
from mien.appearance.descriptors import CELLS, describe, orientation_maps
from mien.arrays import Array
from mien.geometry.rotation import FACING, exp
from mien.tracking.optimizers import Simplex
from mien.tracking.realtime import kernels, pose_geometry
from mien.tracking.realtime.kernels import AppearanceArrays, Linearization, PriorArrays
from mien.tracking.realtime.pose_geometry import PoseArrays
from mien.tracking.realtime.posterior import LowestPoint, PosePosterior
from strategies import random_person, random_pose, stepped

PROJECTION = np.array([[252.0, 84.0, 94.4], [-84.0, 252.0, 74.7], [0.0, 0.0, 1.0]])
"""From camera axes to the crop: a similarity of an image with a focal length of 280 pixels."""
N, RANK, CELL = 8, 5, 4
LIMIT = np.array([0.7, 1.4])
SAMPLING = (CELL, 0.01, 0.06, 1.03)
"""How descriptors are read: from a grid that leans a little."""
ANGLES = st.floats(-1.2, 1.2)
FEW = settings(max_examples=40)


def test_polynomial_by_hand() -> None:
    """At 0.35 of 0.7 and -1.4 of 1.4: x = 1/2, y = -1; up to the third degree."""
    terms = kernels.polynomial(0.35, -1.4, LIMIT)[0]
    np.testing.assert_allclose(terms[:10], [1, 0.5, -1, 0.25, -0.5, 1, 0.125, -0.25, 0.5, -1], rtol=1e-6)
    assert len(terms) == kernels.POLYNOMIAL_TERMS


@given(st.floats(-0.65, 0.65), st.floats(-0.65, 0.65))
@FEW
def test_polynomial_derivatives_against_differences(x: float, y: float) -> None:
    _, by_x, by_y = kernels.polynomial(x, y, LIMIT)
    h = 1e-3
    difference_x = (kernels.polynomial(x + h, y, LIMIT)[0] - kernels.polynomial(x - h, y, LIMIT)[0]) / (2 * h)
    difference_y = (kernels.polynomial(x, y + h, LIMIT)[0] - kernels.polynomial(x, y - h, LIMIT)[0]) / (2 * h)
    np.testing.assert_allclose(by_x, difference_x, atol=1e-3)
    np.testing.assert_allclose(by_y, difference_y, atol=1e-3)


def test_polynomial_is_constant_past_the_limit() -> None:
    at, past = kernels.polynomial(LIMIT[0], 0.2, LIMIT), kernels.polynomial(2 * LIMIT[0], 0.2, LIMIT)
    np.testing.assert_allclose(past[0], at[0])
    np.testing.assert_array_equal(past[1], 0)
    assert (past[2] != 0).any()


@dataclass(frozen=True)
class Problem:
    """Eq. (9) of random landmarks in a random picture."""

    posterior: PosePosterior

    @classmethod
    def random(cls, seed: int = 0, precision: float = 1e12) -> Problem:
        """The appearance is that of the random pose of this seed, so that the minimum lies there; away from it the
        skin stretches."""
        rng = np.random.default_rng(seed)
        noise = rng.uniform(0, 255, (150, 150)).astype(np.float32)
        maps = orientation_maps(blurred(noise, 3.0), CELL)
        pose, person = random_pose(seed), random_person(seed)
        ray = exp(np.array([0.05, -0.03, 0]))
        coefficients = rng.normal(0, 0.01, (N, kernels.POLYNOMIAL_TERMS, 128)).astype(np.float32)
        q, _ = pose_geometry.project(person, pose, (PROJECTION, ray))
        tilt, pan, _ = pose_geometry.view_angles(ray.T @ pose[0] @ FACING)
        terms = kernels.polynomial(tilt, pan, LIMIT)[0]
        coefficients[:, 0] += describe(maps, q, *SAMPLING) - np.einsum("p,npc->nc", terms, coefficients)
        U = np.stack([np.linalg.qr(rng.normal(size=(128, RANK)))[0].T for _ in range(N)]).astype(np.float32)
        variance, floor = rng.uniform(0.001, 0.01, (N, RANK)), 4e-3
        appearance = AppearanceArrays(
            coefficients=coefficients,
            limit=LIMIT,
            offset=np.zeros((N, 128), np.float32),
            U=np.ascontiguousarray(U),
            gain=(1 / (variance + floor) - 1 / floor).astype(np.float32),
            learned=0,
            inverse_floor=np.full(N, 1 / floor, np.float32),
            trust=rng.uniform(0.7, 1.3, N).astype(np.float32),
            variance=np.full((N, 4), 1 / precision),
        )
        active = np.ones(N)
        active[3] = 0
        sd = np.array([0.09] * 3 + [0.2, 0.2, 0.3] + [0.2] * 6)
        prior = PriorArrays(pose, np.diag(1 / sd**2), np.zeros(6), np.full(6, 1 / 0.4**2))
        view, stretch = (PROJECTION, ray), (q, rng.uniform(0.5, 1, (N, CELLS)))
        return cls(PosePosterior(maps, SAMPLING, person, appearance, active, np.full(N, 25.0), prior, view, stretch))

    def but(self, **fields: Array) -> Problem:
        """The same problem with other fields of the posterior."""
        return Problem(self.posterior._replace(**fields))

    @property
    def minimum(self) -> PoseArrays:
        """Where the descriptors agree with the appearance and the pose with its prior."""
        return self.posterior.prior.pose

    def evaluate(self, R: Array, t: Array, a: Array) -> tuple[float, Array, Array, Array]:
        """Energy, H (12, 12), G (12,), squared distances (n,)."""
        at = Linearization(*(both[0] for both in kernels.workspace(N)))
        energy = kernels.evaluate((R, t, a), self.posterior.plain, tuple(at))
        return float(energy), at.H, at.G, at.d2

    def energy(self, step: Array) -> float:
        """Energy after a step (12,) from the minimum: what the simplex minimises."""
        return self.evaluate(*stepped(*self.minimum, step))[0]

    def solve(self, step: Array, iterations: int = 40) -> LowestPoint:
        """The lowest point that is found from a step (12,) away from the minimum."""
        return self.posterior.solve(stepped(*self.minimum, step), iterations, 1e-4)


AWAY = np.array([0.03, -0.02, 0.01, 0.01, -0.01, 0.05, 0.05, -0.1, 0.0, 0.1, 0.05, -0.05])


@pytest.mark.parametrize("seed", range(3))
def test_gradient_of_the_energy_against_differences(seed: int) -> None:
    """G is the derivative of half the energy, the weights of Geman and McClure in it."""
    problem = Problem.random(seed)
    at = stepped(*problem.minimum, AWAY)
    energy, _, G, d2 = problem.evaluate(*at)
    assert (
        d2[problem.posterior.active > 0].max() > problem.posterior.scale[0]
    )  # some landmarks are outliers and weigh less
    directions = np.vstack([np.eye(12), np.random.default_rng(seed).normal(size=(8, 12))])
    difference = []
    for direction in directions:
        h = 2e-4 / np.abs(direction).max()
        ahead, behind = (problem.evaluate(*stepped(*at, s * h * direction))[0] for s in (1, -1))
        difference.append((ahead - behind) / (2 * h) / 2)
    error = directions @ G - difference
    # The rest comes from corners: the clip of SIFT, and bilinear sampling at whole pixels.
    assert np.linalg.norm(error) < 0.03 * np.linalg.norm(difference)
    assert energy > 0


def test_the_matrix_is_that_of_gauss_and_newton() -> None:
    """At the minimum, where residuals vanish, H is half the second derivative of the energy."""
    problem = Problem.random(4)
    energy, H, G, d2 = problem.evaluate(*problem.minimum)
    np.testing.assert_allclose(d2, 0, atol=1e-5)
    rest = problem.minimum[2] @ problem.minimum[2] / 0.4**2
    assert energy == pytest.approx(rest, abs=1e-4)
    np.testing.assert_allclose(H, H.T, rtol=1e-5, atol=1e-3)
    assert np.linalg.eigvalsh(0.5 * (H + H.T)).min() > 0
    for direction in np.random.default_rng(0).normal(size=(6, 12)):
        step = 2e-3 * direction / np.linalg.norm(direction)
        grown = problem.energy(step) - energy - 2 * G @ step
        assert grown == pytest.approx(step @ H @ step, rel=0.35)


def test_hidden_landmarks_say_nothing() -> None:
    problem = Problem.random(5)
    neutral, units = problem.posterior.person
    moved = neutral.copy()
    moved[3] += 0.2  # the one that is not active
    other = Problem(problem.posterior._replace(person=(moved, units)))
    at = stepped(*problem.minimum, AWAY)
    for a, b in zip(problem.evaluate(*at)[:3], other.evaluate(*at)[:3], strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("seed", range(3))
def test_solve_finds_the_minimum(seed: int) -> None:
    problem = Problem.random(seed).but(scale=np.full(N, 1e6))
    found = problem.solve(0.3 * AWAY)
    _, _, G, _ = problem.evaluate(*found.pose)
    assert found.energy <= problem.energy(np.zeros(12)) + 1e-3
    assert found.evaluations <= 40
    # What is left of the gradient is worth little, in units of the energy.
    assert G @ np.linalg.solve(found.at.H, G) < 0.05


def test_solve_and_simplex_minimise_the_same_energy() -> None:
    problem = Problem.random(6, precision=100.0)
    found = problem.solve(0.3 * AWAY).energy
    simplex = Simplex(0.3 * np.abs(AWAY) + 0.01, 3000, np.random.default_rng(0)).minimize(problem, 0.3 * AWAY)
    assert problem.energy(simplex.b) == pytest.approx(simplex.energy)
    assert found <= simplex.energy + 0.2


def test_no_active_landmark_leaves_the_prior() -> None:
    problem = Problem.random(7).but(active=np.zeros(N))
    R, t, a = problem.solve(0.3 * AWAY).pose
    np.testing.assert_allclose(R, problem.minimum[0], atol=1e-4)
    np.testing.assert_allclose(t, problem.minimum[1], atol=1e-4)
    # Between the last animation and the one at rest, weighted by their information: 1 / 0.2^2 and 1 / 0.4^2.
    np.testing.assert_allclose(a, 0.8 * problem.minimum[2], atol=1e-3)
