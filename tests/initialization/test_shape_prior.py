"""The prior of the shape: its fields are symmetric or antisymmetric, its units are CANDIDE's."""

from __future__ import annotations

import numpy as np
import pytest

from mien.candide.model import Candide
from mien.initialization.shape_prior import ASYMMETRY, FIELD_LENGTH, FIELD_SD, UNIT_SD, proximity, shape_prior

MODEL = Candide.default()
PRIOR = shape_prior(MODEL)
K = len(MODEL.shape_units)
FIELDS = PRIOR.basis[K:]
MIRROR = np.array([-1.0, 1, 1])


def test_every_field_is_symmetric_or_antisymmetric() -> None:
    opposite = np.linalg.norm(MODEL.mean[:, None] - MODEL.mean[None] * MIRROR, axis=2).argmin(axis=1)
    mirrored = FIELDS[:, opposite] * MIRROR
    symmetric = np.isclose(mirrored, FIELDS, atol=1e-9).all(axis=(1, 2))
    antisymmetric = np.isclose(mirrored, -FIELDS, atol=1e-9).all(axis=(1, 2))
    assert (symmetric ^ antisymmetric).all()
    assert 0.4 < symmetric.mean() < 0.6


def test_faces_are_more_symmetric_than_not() -> None:
    """On the line of symmetry a vertex moves sideways only by what is antisymmetric: a ratio of ASYMMETRY."""
    tip = MODEL.vertex_names.index("nose_tip")
    sd = np.sqrt((FIELDS[:, tip] ** 2).sum(axis=0))
    np.testing.assert_allclose(sd[1:], FIELD_SD * np.sqrt(2), rtol=0.03)
    assert sd[0] / sd[1] == pytest.approx(ASYMMETRY, rel=0.03)


def test_the_fields_are_smooth() -> None:
    """The covariance of the depths of two vertices of one side falls as their proximity."""
    depth = FIELDS[:, :, 2].T @ FIELDS[:, :, 2]
    left = MODEL.mean[:, 0] > FIELD_LENGTH * 1.5
    expected = 0.5 * proximity(MODEL.mean[left], MODEL.mean[left]) * 2 * FIELD_SD**2 * (1 + ASYMMETRY**2)
    np.testing.assert_allclose(depth[np.ix_(left, left)], expected, atol=0.1 * FIELD_SD**2)


def test_the_first_coefficients_are_the_shape_units() -> None:
    c = np.zeros(len(PRIOR.basis))
    np.testing.assert_array_equal(PRIOR.vertices(c), MODEL.mean)
    c[3] = 2.0
    moved = PRIOR.vertices(c) - MODEL.mean
    assert np.linalg.norm(moved, axis=1).max() == pytest.approx(2 * UNIT_SD)
    np.testing.assert_allclose(MODEL.vertices(PRIOR.sigma(c)), PRIOR.vertices(c), atol=1e-12)


def test_proximity_by_hand() -> None:
    a, b = np.zeros((1, 3)), np.array([[0.0, 0, 0], [FIELD_LENGTH, 0, 0]])
    np.testing.assert_allclose(proximity(a, b), [[1, np.exp(-0.5)]])
