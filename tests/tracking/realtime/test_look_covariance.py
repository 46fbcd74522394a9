"""What is added to the covariance while tracking, against dense formulas."""

from __future__ import annotations

import numpy as np

from mien.appearance.regression import PoseRegression
from mien.arrays import Array, Float32
from mien.config.realtime import CovarianceSettings
from mien.tracking.realtime.look_covariance import _EVERY, LearnedCovariance, follow

N, D, RANK, FLOOR = 3, 128, 5, 1e-3
ALL = np.ones(N, dtype=bool)
USUAL = 6.0
SETTINGS = CovarianceSettings(rank=RANK, floor=FLOOR, learned=2, rate=0.05, share=1.0, usual_distance=USUAL)
HALF = np.full(N, 2 * USUAL)
"""Expected squared distances by which a half of the variance is added."""


def _appearance(rng: np.random.Generator) -> PoseRegression:
    U = np.stack([np.linalg.qr(rng.normal(size=(D, RANK)))[0].T for _ in range(N)]).astype(np.float32)
    gain = (1 / (rng.uniform(0.01, 0.1, (N, RANK)) + FLOOR) - 1 / FLOOR).astype(np.float32)
    floor = np.full(N, 1 / FLOOR, np.float32)
    return PoseRegression(np.zeros((N, 15, D), np.float32), U, gain, floor, np.ones(2), np.zeros((1, N), np.float32))


def _metric(U: Float32, gain: Float32) -> Array:
    """(d, d) of one landmark."""
    rows = U.astype(float)
    return np.asarray(np.eye(D) / FLOOR + rows.T @ (gain[:, None] * rows))


def _swings(rng: np.random.Generator, frames: int) -> Array:
    """Residuals (frames, n, d) that swing along two directions of each landmark, with a little noise."""
    along = rng.normal(size=(N, 2, D)) * [[[0.03], [0.015]]]
    phase = 2 * np.pi * np.arange(frames) / 40
    swing = np.stack([np.sin(phase), np.cos(2 * phase)], axis=1)
    return np.asarray(np.einsum("fk,nkd->fnd", swing, along) + rng.normal(0, 1e-3, (frames, N, D)))


def _after(
    residuals: Array, trusted: Array = ALL, expected: Array = HALF, worth: float = 1.0, covered: bool = False
) -> tuple[PoseRegression, LearnedCovariance]:
    appearance = _appearance(np.random.default_rng(0))
    covariance = LearnedCovariance(appearance, SETTINGS)
    for residual in residuals.astype(np.float32):
        covariance.learn(residual, trusted, expected, covered, worth)
    return appearance, covariance


def test_at_first_the_covariance_is_that_of_the_views() -> None:
    appearance, covariance = _after(np.zeros((0, N, D)))
    for i in range(N):
        expected = _metric(appearance.U[i], appearance.gain[i])
        np.testing.assert_allclose(_metric(covariance.U[i], covariance.gain[i]), expected, rtol=1e-6)


def test_the_metric_is_the_inverse_of_the_sum() -> None:
    """Of the covariance of the views and the directions, with the share of their variance that is asked for."""
    share, strange = np.array([0.0, 0.5, 1.0]), USUAL * np.array([0.5, 2.0, 1e12])
    appearance, covariance = _after(_swings(np.random.default_rng(1), 200), expected=strange)
    for _ in range(_EVERY):  # every metric once more, with nothing new
        covariance.learn(np.zeros((N, D), np.float32), ~ALL, strange, False, 1.0)
    for i in range(N):
        v = covariance.directions[i].astype(float)
        added = share[i] * sum(np.outer(x, x) / np.linalg.norm(x) for x in v)
        expected = np.linalg.inv(np.linalg.inv(_metric(appearance.U[i], appearance.gain[i])) + added)
        found = _metric(covariance.U[i], covariance.gain[i])
        np.testing.assert_allclose(found, expected, atol=1e-3 * np.abs(expected).max())


def test_what_swings_weighs_less_and_what_is_across_as_much_as_before() -> None:
    rng = np.random.default_rng(2)
    residuals = _swings(rng, 200)
    appearance, covariance = _after(residuals)
    for i in range(N):
        before, now = _metric(appearance.U[i], appearance.gain[i]), _metric(covariance.U[i], covariance.gain[i])
        seen = max(residuals[-40:, i], key=np.linalg.norm)
        assert seen @ now @ seen < 0.1 * seen @ before @ seen
        plane = np.linalg.qr(covariance.directions[i].T.astype(float))[0]
        other = rng.normal(size=D)
        other -= plane @ (plane.T @ other)
        assert other @ now @ other > 0.9 * other @ before @ other


def test_directions_are_those_of_the_moving_average() -> None:
    """Their squares, as variances, and their span, against the eigenvectors of the average itself."""
    rng, rate = np.random.default_rng(3), 0.02
    directions, average = np.zeros((2, D), np.float32), np.zeros((D, D))
    for residual in _swings(rng, 600)[:, 0].astype(np.float32):
        average += rate * (np.outer(residual, residual) - average)
        follow(directions, residual.copy(), rate, 1.0)
    variance, vectors = np.linalg.eigh(average)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), variance[:-3:-1], rtol=0.2)
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    assert np.linalg.norm(unit @ vectors[:, -2:]) ** 2 > 1.95


def test_nothing_is_learned_of_what_is_not_trusted_nor_from_a_frame_without_worth() -> None:
    swings = _swings(np.random.default_rng(4), 50)
    trusted = np.array([True, False, True])
    appearance, covariance = _after(swings, trusted)
    assert covariance.directions[trusted].any(axis=(1, 2)).all()
    assert not covariance.directions[~trusted].any()
    assert not _after(swings, worth=0.0)[1].directions.any()
    without = LearnedCovariance(appearance, SETTINGS.model_copy(update={"learned": 0}))
    without.learn(swings[0].astype(np.float32), ALL, HALF, False, 1.0)
    np.testing.assert_array_equal(without.U, appearance.U)


def test_the_same_is_added_to_all_landmarks_of_a_covered_face() -> None:
    swings, strange = _swings(np.random.default_rng(4), 50), np.array([0.5, 2.0, 100.0]) * USUAL
    _, covered = _after(swings, expected=strange, covered=True)
    _, alike = _after(swings, expected=np.full(N, USUAL / (1 - SETTINGS.covered_share)))
    np.testing.assert_allclose(covered.U, alike.U, rtol=1e-4, atol=1e-5)
