"""What the squared distances of the landmarks say of a face, against NumPy."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mien.arrays import Array, Mask
from mien.initialization.landmarks import LANDMARK_NAMES
from mien.tracking.realtime.kernels import Linearization
from mien.tracking.realtime.level import Noise
from mien.tracking.realtime.order import median
from mien.tracking.realtime.pose import Pose
from mien.tracking.realtime.posterior import PosePosterior
from mien.tracking.realtime.solution import Solution

LANDMARKS, N, MOST = len(LANDMARK_NAMES), 33, 60.0
NOTHING = np.zeros(N, dtype=bool)


def _solution(d2: Array, facing: Mask, rng: np.random.Generator, contrast: float = 0.8) -> Solution:
    at = Linearization(*([np.zeros(0)] * 3), d2, *([np.zeros(0)] * 4))
    noise = Noise(rng.uniform(0, 5, N), contrast)
    posterior = PosePosterior(*[None] * len(PosePosterior._fields))  # type: ignore[arg-type]  # not asked for
    return Solution(Pose(*[np.zeros(0)] * 3), 0.0, at, posterior, facing, rng.uniform(10, 30, N), noise, MOST)


def _of_best(values: Array, part: int) -> float:
    return float(np.sort(values)[len(values) // part]) if len(values) else math.inf


@pytest.mark.parametrize("seed", range(20))
def test_what_a_face_looks_like_as_a_whole(seed: int) -> None:
    rng = np.random.default_rng(seed)
    d2, facing = rng.gamma(1.0, 30.0, N), rng.random(N) < rng.uniform(0.1, 1)
    found = _solution(d2, facing, rng)
    clean = np.maximum(d2 - found.noise.d2, 0) / 0.8**2
    np.testing.assert_allclose(found.d2_without_noise, clean)
    np.testing.assert_array_equal(found.seen, facing & (clean <= MOST))
    assert found.seen_share == pytest.approx(found.seen.mean())
    assert found.seen_d2 == pytest.approx(_of_best(d2[found.seen], 2) if found.seen.any() else 0)
    ratio = clean / found.expected
    assert found.misfit == pytest.approx(_of_best(ratio[facing], 2))
    assert found.best_misfit == pytest.approx(_of_best(ratio[facing], 4))
    of_eyes = facing & (rng.random(N) < 0.3)
    assert found.misfit_of(of_eyes) == pytest.approx(_of_best(ratio[of_eyes], 2))
    telling = clean[:LANDMARKS][facing[:LANDMARKS]]
    assert found.best_d2 == pytest.approx(_of_best(telling, 4))
    inliers = np.count_nonzero(telling <= MOST)
    assert found.inlier_share == pytest.approx(inliers / len(telling) if inliers >= 6 else 0)


def test_a_face_of_which_nothing_is_seen() -> None:
    found = _solution(np.full(N, 5.0), NOTHING, np.random.default_rng(0))
    assert found.misfit == found.best_misfit == found.best_d2 == found.misfit_of(NOTHING) == math.inf
    assert found.seen_share == found.seen_d2 == found.inlier_share == 0


def test_a_grimace_of_less_than_half_of_the_face_leaves_the_best_half_as_it_is() -> None:
    grimace = np.arange(26)
    assert median(np.where(grimace < 12, 55.0, 10.0)) == 10
    assert median(np.where(grimace < 13, 55.0, 10.0)) == 55
