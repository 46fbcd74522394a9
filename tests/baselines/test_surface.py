"""Surfaces lie in the face, and say what of them is seen."""

from __future__ import annotations

import numpy as np
import pytest

from mien.baselines.surface import Pose, Surface
from mien.geometry.rotation import FACING
from small_motion import face


def test_the_surface_lies_in_the_face(surface: Surface) -> None:
    assert np.linalg.norm(surface.normals, axis=1) == pytest.approx(1)
    cheeks = face().fit.shape[[27, 60]]
    distance = np.linalg.norm(surface.points[:, None] - cheeks, axis=2).min(axis=0)
    assert (distance < 0.12).all()
    hairline, chin = (face().fit.shape @ face().fit.R_head_fit)[[2, 10], 1]
    assert np.ptp((surface.points @ face().fit.R_head_fit)[:, 1]) == pytest.approx(hairline - chin)


def test_normals_stand_on_the_surface(surface: Surface) -> None:
    grid = surface.points.reshape(48, 48, 3)
    normals = surface.normals.reshape(48, 48, 3)[1:-1, 1:-1]
    for tangent in (grid[1:-1, 2:] - grid[1:-1, :-2], grid[2:, 1:-1] - grid[:-2, 1:-1]):
        length = np.linalg.norm(tangent, axis=2)
        assert np.abs((tangent * normals).sum(axis=2) / length).max() < 0.05


def test_a_facing_head_is_seen_in_front_and_not_at_the_sides(surface: Surface) -> None:
    _, cosine = surface.seen(Pose(FACING, np.array([0.0, 0, 10])))
    assert (cosine[np.abs(surface.angle) < 0.1] > 0.8).all()
    assert (cosine[np.abs(surface.angle) > 1.35] < 0.3).all()
    _, turned_away = surface.seen(Pose(np.eye(3), np.array([0.0, 0, 10])))
    assert (turned_away < 0).mean() > 0.9
