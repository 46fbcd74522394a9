"""The downhill simplex: it finds a minimum, keeps to its evaluations, and does so again."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from mien.arrays import Array
from mien.tracking.optimizers import Minimum, Simplex

SD = np.array([0.1, 2.0, 0.5, 1.0])


@dataclass
class Quadratic:
    """(b - minimum)' A (b - minimum) + 3, which remembers where it was evaluated."""

    minimum: Array
    A: Array
    seen: list[Array] = field(default_factory=list)

    def energy(self, b: Array) -> float:
        self.seen.append(b.copy())
        d = b - self.minimum
        return float(d @ self.A @ d) + 3


def _quadratic() -> Quadratic:
    rng = np.random.default_rng(0)
    X = rng.normal(size=(4, 8))
    return Quadratic(np.array([0.05, -1.0, 0.4, 0.7]), (X @ X.T) / np.outer(SD, SD))


def _minimized(seed: int = 0, evaluations: int = 2000) -> tuple[Minimum, Quadratic]:
    problem = _quadratic()
    return Simplex(SD, evaluations, np.random.default_rng(seed)).minimize(problem, np.zeros(4)), problem


@pytest.mark.parametrize("seed", range(3))
def test_the_minimum_of_a_quadratic(seed: int) -> None:
    found, problem = _minimized(seed)
    np.testing.assert_allclose(found.b, problem.minimum, atol=0.02)
    assert found.energy == pytest.approx(3, abs=0.01)
    assert found.energy == problem.energy(found.b)


def test_the_same_seed_gives_the_same_numbers() -> None:
    first, again, other = _minimized(1)[0], _minimized(1)[0], _minimized(2)[0]
    np.testing.assert_array_equal(first.b, again.b)
    assert first.energy == again.energy
    assert (first.b != other.b).any()


def test_it_begins_with_the_start_and_as_many_points_around_it_as_there_are_dimensions() -> None:
    _, problem = _minimized()
    np.testing.assert_array_equal(problem.seen[0], 0)
    around = np.array(problem.seen[1:5]) / SD
    assert 0.5 < np.abs(around).mean() < 1.5


def test_it_never_ends_above_its_start_and_keeps_to_its_evaluations() -> None:
    for evaluations in (13, 20, 50):
        found, problem = _minimized(3, evaluations)
        assert found.evaluations <= evaluations
        assert len(problem.seen) <= evaluations
        assert found.energy <= _quadratic().energy(np.zeros(4))


def test_one_generator_goes_on_from_frame_to_frame() -> None:
    """Two searches draw different points, two runs of both the same ones."""
    runs = []
    for _ in range(2):
        simplex = Simplex(SD, 20, np.random.default_rng(5))
        runs.append([simplex.minimize(_quadratic(), np.zeros(4)).b for _ in range(2)])
    np.testing.assert_array_equal(runs[0], runs[1])
    assert (runs[0][0] != runs[0][1]).any()
