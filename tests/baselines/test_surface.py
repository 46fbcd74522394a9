"""Surfaces lie in the face, the registration's Jacobian is the derivative, and a known motion is found."""

from __future__ import annotations

import numpy as np
import pytest

from mien.arrays import Array
from mien.baselines.registration import Residuals, compare, correlation, register
from mien.baselines.surface import Pose, Surface, cylinder, ellipsoid
from mien.baselines.view import look, take_template
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING, angle_between
from mien.synthetic import make_sequence, moved
from small_motion import face


@pytest.fixture(scope="module", params=[cylinder, ellipsoid])
def surface(request: pytest.FixtureRequest) -> Surface:
    made: Surface = request.param(face().fit)
    return made


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


def test_no_view_of_a_head_outside_the_image() -> None:
    for t in ([60.0, 0, 10], [0, 0, -5], [0, 0, 0.01]):
        assert look(face().frame, Pose(FACING, np.array(t)), face().camera) is None


def test_a_large_head_is_shrunk_and_projects_to_the_same_place() -> None:
    ramp = np.tile(np.arange(640, dtype=float) * 255 / 640, (480, 1))
    frame = Frame(np.repeat(ramp[..., None], 3, axis=2).astype(np.uint8))
    camera = Camera.centred(900, 640, 480)
    X = np.array([[0.1, 0.05, 4.0]])
    view = look(frame, Pose(FACING, np.array([0.0, 0, 4])), camera)
    assert view is not None
    assert view.levels[0].shape[0] < 480
    values, inside = view.read(1, view.camera.project(X)[0])
    assert inside.all()
    assert values[0, 0] == pytest.approx(camera.project(X)[0][0, 0] * 255 / 640, abs=1.0)


def test_correlation_by_hand() -> None:
    a = np.array([1.0, 2, 3, 9])
    w = np.array([1.0, 1, 1, 0])
    assert correlation(a, 5 - 2 * a, w) == pytest.approx(-1)
    assert correlation(a, np.ones(4), w) == 0
