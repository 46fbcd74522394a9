"""The shape as a latent variable: what a frame says of it, and how it adds up."""

from __future__ import annotations

import numpy as np
import pytest

from mien.arrays import Array
from mien.config.realtime import ShapeSettings
from mien.geometry.rotation import exp
from mien.initialization.landmarks import LANDMARK_VERTICES, VERTICES
from mien.tracking.realtime.shape import ShapePosterior, prior_covariance, shape_information
from small_motion import face

N = 8
SETTINGS = ShapeSettings()
EYES = np.array(["eye" in name or "brow" in name for name in LANDMARK_VERTICES])


def test_shape_information_is_a_schur_complement() -> None:
    rng = np.random.default_rng(8)
    B, M, g = (
        rng.normal(size=(N, 4, 12)),
        np.stack([X @ X.T for X in rng.normal(size=(N, 4, 8))]),
        rng.normal(size=(N, 4)),
    )
    B[:, 2:, 3:] = 0  # the angles depend on the rotation alone
    weight, R = rng.uniform(0, 1, N), exp(np.array([0.1, 0.2, 0.3]))
    prior = rng.uniform(0.1, 1, 12), rng.normal(size=12)
    weight[2] = 0
    H, gradient = np.zeros((12 + 3 * N, 12 + 3 * N)), np.zeros(12 + 3 * N)
    H[:12, :12], gradient[:12] = np.diag(prior[0]), prior[1]
    for i in range(N):
        J = np.zeros((4, 12 + 3 * N))
        J[:, :12] = B[i]
        J[:2, 12 + 3 * i : 15 + 3 * i] = B[i, :2, 3:6] @ R
        H += weight[i] * J.T @ M[i] @ J
        gradient += weight[i] * J.T @ g[i]
    A = np.linalg.solve(H[:12, :12], H[:12, 12:])
    Lambda, found = shape_information(B, M, g, weight, R, prior)
    np.testing.assert_allclose(Lambda, H[12:, 12:] - H[12:, :12] @ A, atol=1e-8)
    np.testing.assert_allclose(found, gradient[12:] - A.T @ gradient[:12], atol=1e-8)
    assert not Lambda[6:9].any()
    assert np.linalg.eigvalsh(0.5 * (Lambda + Lambda.T)).min() > -1e-8


def _neutral() -> Array:
    return np.asarray(face().fit.shape[VERTICES])


def _rays() -> Array:
    """Unit vectors (26, 3), head axes, from the camera of the first frame to the landmarks."""
    fit = face().fit
    rays = _neutral() @ fit.R.T + fit.t
    return np.asarray((rays / np.linalg.norm(rays, axis=1, keepdims=True)) @ fit.R)


def _normals(slope_deg: float = 20.0) -> Array:
    """Normals (26, 3) so far from the directions to the camera."""
    across = np.cross(_rays(), [0.0, 1, 0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    angle = np.radians(slope_deg)
    return np.asarray(-np.cos(angle) * _rays() + np.sin(angle) * across)


def _prior(settings: ShapeSettings = SETTINGS, slope_deg: float = 20.0) -> Array:
    return prior_covariance(_neutral(), _normals(slope_deg), EYES, face().fit.R, face().fit.t, settings)


def _posterior() -> ShapePosterior:
    return ShapePosterior(_neutral(), _normals(), EYES, face().fit.R, face().fit.t, SETTINGS)


def test_the_prior_is_a_covariance() -> None:
    prior = _prior()
    np.testing.assert_allclose(prior, prior.T, atol=1e-12)
    assert np.linalg.eigvalsh(prior).min() > 0


def test_the_first_frame_leaves_depth_open_and_little_else() -> None:
    """Along the ray of the first frame a landmark is far less certain than across it."""
    fit, prior = face().fit, _prior()
    for k, X in enumerate(_neutral()):
        ray = fit.R.T @ (fit.R @ X + fit.t)
        ray /= np.linalg.norm(ray)
        across = np.cross(ray, [0.0, 1, 0])
        across /= np.linalg.norm(across)
        own = prior[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
        assert np.sqrt(across @ own @ across) == pytest.approx(SETTINGS.lateral_sd, rel=1e-6)
        assert np.sqrt(ray @ own @ ray) > 5 * SETTINGS.lateral_sd


def test_eyes_and_brows_may_stand_off_together() -> None:
    """The depth of their mean, less that of the others, is uncertain by `eyes_sd` more than without it."""
    contrast = np.where(EYES, 1 / EYES.sum(), -1 / (~EYES).sum())
    along = (contrast[:, None] * _rays()).ravel()
    without = _prior(ShapeSettings(eyes_sd=0))
    assert along @ (_prior() - without) @ along == pytest.approx(SETTINGS.eyes_sd**2)


def test_a_slope_leaves_the_depth_more_uncertain() -> None:
    """By its tangent, and no further than a slope of 6; seen in the middle of the face, where a landmark is its own
    mirror image."""
    middle = np.flatnonzero(np.abs(_neutral()[:, 0]) < 0.01)
    assert len(middle) > 3

    def own(slope_deg: float) -> Array:
        prior = _prior(SETTINGS, slope_deg).reshape(26, 3, 26, 3)
        return np.array([_rays()[k] @ prior[k, :, k] @ _rays()[k] for k in middle])

    level = own(0.0)
    np.testing.assert_allclose(own(60.0) - level, 3 * SETTINGS.slope_sd**2, rtol=0.01)
    np.testing.assert_allclose(own(85.0) - level, 36 * SETTINGS.slope_sd**2, rtol=0.01)
    np.testing.assert_allclose(own(120.0) - level, 36 * SETTINGS.slope_sd**2, rtol=0.01)


def test_information_adds_up_to_least_squares() -> None:
    """A measurement of every coordinate, linearised anywhere, is weighed against the prior."""
    posterior = _posterior()
    rng = np.random.default_rng(9)
    measured = _neutral() + rng.normal(0, 0.05, (26, 3))
    weight = 1 / 0.02**2
    prior_information, mean = np.linalg.inv(_prior()), _neutral()
    for _ in range(3):
        gradient = weight * (mean - measured).ravel()
        assert posterior.add(mean, weight * np.eye(78), gradient, novelty=1.0)
        mean = posterior.mean
    difference = np.linalg.solve(
        prior_information + 3 * weight * np.eye(78), 3 * weight * (measured - _neutral()).ravel()
    )
    np.testing.assert_allclose(mean, _neutral() + difference.reshape(-1, 3), atol=1e-8)


def test_the_relief_is_less_uncertain_the_more_is_known() -> None:
    """Its deviation is that of the share of the relief that fits a draw of the posterior best."""
    posterior, weight = _posterior(), 100.0
    before = posterior.relief_sd
    posterior.add(_neutral(), weight * np.eye(78), np.zeros(78), novelty=1.0)
    covariance = np.linalg.inv(np.linalg.inv(_prior()) + weight * np.eye(78))
    stands_out = _neutral()[:, 2] - _neutral()[:, 2].mean()
    share = np.linalg.pinv((stands_out[:, None] * _rays()).reshape(-1, 1))[0]
    assert posterior.relief_sd == pytest.approx(np.sqrt(share @ covariance @ share))
    assert posterior.relief_sd < 0.5 * before


def test_a_mean_that_is_found_later_is_the_same() -> None:
    """Frames at a pose that is known add little: the mean waits for several of them, and loses nothing."""
    rng = np.random.default_rng(4)
    at_once, later = _posterior(), _posterior()
    for novelty, waits in ((0.06, True), (0.05, True), (0.05, False)):
        weight, gradient = 400 * novelty * np.eye(78), rng.normal(0, 1, 78)
        assert at_once.add(_neutral(), weight, gradient, novelty=1.0)
        assert later.add(_neutral(), weight, gradient, novelty) is not waits
        assert np.array_equal(later.mean, _neutral()) is waits
    np.testing.assert_allclose(later.mean, at_once.mean, atol=1e-12)
    assert later.relief_sd == pytest.approx(at_once.relief_sd)


FRONT, REST = np.array([0.01, 0.02]), np.zeros(6)
SMILE = 2 * SETTINGS.expression_sd * np.eye(6)[2]
"""An animation that can teach a fifth of what one at rest can."""


def test_poses_that_come_again_say_less_and_less() -> None:
    posterior = _posterior()
    first, second, third = (posterior.novelty(FRONT, REST) for _ in range(3))
    assert (second, third) == pytest.approx((first / 2, first / 3))
    assert posterior.novelty(np.array([0.01, 0.3]), REST) == first


def test_a_frame_that_teaches_little_leaves_the_rest_to_others() -> None:
    posterior = _posterior()
    assert posterior.novelty(FRONT, SMILE) == pytest.approx(0.2 * SETTINGS.rate)
    assert posterior.novelty(FRONT, REST) == pytest.approx(SETTINGS.rate / 1.2)


def test_a_smile_that_lasts_teaches_little_and_leaves_the_rest_to_others() -> None:
    """Its frames repeat each other, and are few that are learned from; another expression is something new."""
    smiling, resting = (sum(_posterior_after(300, expression)[1]) for expression in (SMILE, REST))
    assert 0.2 * SETTINGS.rate < smiling < 0.2 * resting
    posterior, _ = _posterior_after(300, SMILE)
    assert posterior.novelty(FRONT, -SMILE) > 0.1 * SETTINGS.rate
    assert posterior.novelty(FRONT, REST) > 0.5 * SETTINGS.rate


def _posterior_after(frames: int, expression: Array) -> tuple[ShapePosterior, list[float]]:
    """A shape that has seen so many frames at one pose, and how much of each was new."""
    posterior = _posterior()
    return posterior, [posterior.novelty(FRONT, expression) for _ in range(frames)]
