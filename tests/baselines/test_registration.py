"""The registration's Jacobian is the derivative, and a known motion is found."""

from __future__ import annotations

import numpy as np
import pytest

from mien.arrays import Array
from mien.baselines.registration import Residuals, compare, correlation, register
from mien.baselines.surface import Pose, Surface
from mien.baselines.view import look, take_template
from mien.geometry.rotation import angle_between
from mien.synthetic import make_sequence, moved
from small_motion import face


def test_the_jacobian_is_the_derivative_of_the_view(surface: Surface) -> None:
    pose = Pose(face().fit.R, face().fit.t)
    view = look(face().frame, pose, face().camera)
    assert view is not None
    template = take_template(surface, view, pose)
    r = compare(surface, template, view, pose, 0)
    for k, axis in enumerate(np.eye(6)):
        plus, minus = (take_template(surface, view, pose.moved(s * 5e-3 * axis)).values[0, r.rows] for s in (1, -1))
        slope = (plus - minus) / 1e-2
        assert np.corrcoef(slope, r.J[:, k])[0, 1] > 0.97
        assert (slope @ r.J[:, k]) / (r.J[:, k] @ r.J[:, k]) == pytest.approx(1, abs=0.1)


def test_registration_finds_a_known_motion(surface: Surface) -> None:
    states = moved(
        face(), np.array([[0.0, 0, 0], [2, -4, 3]]), np.array([[0.0, 0, 0], [0.05, -0.04, 0.1]]), np.zeros((2, 6))
    )
    sequence = make_sequence(face(), states)
    poses = [Pose(R, t) for R, t in zip(sequence.R, sequence.t, strict=True)]
    first, second = (look(f, poses[0], face().camera) for f in sequence.frames)
    assert first is not None
    assert second is not None
    r = register(surface, take_template(surface, first, poses[0]), second, poses[0], _by_cosine)
    assert r is not None
    assert np.degrees(angle_between(r.pose.R, poses[1].R)) < 2.5
    assert np.abs(r.pose.t - poses[1].t)[:2].max() < 0.05
    assert r.correlation > 0.95


def _by_cosine(r: Residuals) -> Array:
    return r.cosine


def test_correlation_by_hand() -> None:
    a = np.array([1.0, 2, 3, 9])
    w = np.array([1.0, 1, 1, 0])
    assert correlation(a, 5 - 2 * a, w) == pytest.approx(-1)
    assert correlation(a, np.ones(4), w) == 0
