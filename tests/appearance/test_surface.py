"""The surface that is rendered for learning: the face, its skirt, points moved onto it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import Delaunay

from mien.appearance.rendering import depth_buffer
from mien.appearance.surface import Surface, _nearest, _triangulated, face_surface, on_surface
from mien.arrays import Array
from mien.errors import MienError
from mien.geometry.camera import Camera, line_of_sight
from mien.initialization.fit import fit_first_frame
from mien.initialization.landmarks import Landmarks, rows_of_scheme
from small_motion import face

CAMERA = Camera(100, 0, 0)


def _without_depths() -> Landmarks:
    """The landmarks of the portrait as somebody would have annotated them."""
    given = face().landmarks
    return Landmarks(given.points, given.scheme)


def _signed_areas(surface: Surface, camera: Camera) -> Array:
    a, b, c = (camera.project(surface.vertices)[0][surface.triangles[:, k]] for k in range(3))
    return (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]


@pytest.mark.parametrize("deep", [False, True])
def test_the_whole_surface_faces_the_camera_that_saw_it(deep: bool) -> None:
    portrait = face()
    assert portrait.landmarks.depths is not None
    landmarks = portrait.landmarks if deep else _without_depths()
    surface = face_surface(landmarks, portrait.fit, portrait.camera)
    assert surface.face == (468 if deep else 113)
    assert (_signed_areas(surface, portrait.camera) <= 0).all()
    assert surface.triangles.max() == len(surface.vertices) - 1


@pytest.mark.parametrize("deep", [False, True])
def test_the_skirt_surrounds_the_face_and_lies_behind_it(deep: bool) -> None:
    portrait = face()
    landmarks = portrait.landmarks if deep else _without_depths()
    surface = face_surface(landmarks, portrait.fit, portrait.camera)
    skirt, front = surface.vertices[surface.face :], surface.vertices[: surface.face]
    p = portrait.camera.project(surface.vertices)[0]
    low, high = p[: surface.face].min(axis=0), p[: surface.face].max(axis=0)
    assert (p[surface.face :].min(axis=0) < low).all()
    assert (p[surface.face :].max(axis=0) > high).all()
    assert skirt[:, 2].max() > front[:, 2].max()
    # Every pixel of the face, and around it, is covered.
    depth = depth_buffer(surface.vertices, surface.triangles, portrait.camera, 320, 240)
    u, v = np.round(p[: surface.face]).astype(int).T
    assert np.isfinite(depth[v, u]).all()


def test_landmarks_with_depths_project_onto_themselves() -> None:
    portrait = face()
    surface = face_surface(portrait.landmarks, portrait.fit, portrait.camera)
    p = portrait.camera.project(surface.vertices[: surface.face])[0]
    np.testing.assert_allclose(p, portrait.landmarks.points[:468], atol=1e-9)


def test_landmarks_with_depths_lie_where_the_fitted_model_is() -> None:
    portrait = face()
    surface = face_surface(portrait.landmarks, portrait.fit, portrait.camera)
    vertices, rows = rows_of_scheme(portrait.landmarks.scheme)
    sight = line_of_sight(portrait.landmarks.points, portrait.camera)
    fitted = portrait.fit.vertices()[vertices] @ portrait.fit.R.T + portrait.fit.t
    difference = (surface.vertices[rows].mean(axis=1) - fitted) @ sight
    assert abs(np.median(difference)) < 1e-9
    assert np.abs(difference).max() < 0.2


def test_depths_that_put_a_part_of_the_face_behind_the_camera_are_refused() -> None:
    """As those of a source that counts them towards the camera, of a face near to one that sees 90 degrees."""
    near, given = replace(face().camera, focal_px=160.0), face().landmarks
    assert given.depths is not None
    turned = replace(given, depths=-4 * given.depths, source="face.json")
    turned.check(320, 240)  # they are in pixels
    fit = fit_first_frame(turned, near)
    assert fit.t[2] > 1
    with pytest.raises(MienError, match=r"face\.json: by its depths a part of the face lies behind the camera"):
        face_surface(turned, fit, near)


def test_without_depths_the_surface_is_candide() -> None:
    portrait = face()
    fit = fit_first_frame(_without_depths(), portrait.camera)
    surface = face_surface(_without_depths(), fit, portrait.camera)
    np.testing.assert_allclose(surface.vertices[:113], fit.vertices() @ fit.R.T + fit.t)
    assert len(surface.triangles) > len(fit.model.triangles)


def test_points_move_along_their_rays_onto_the_surface() -> None:
    """A slanted plane Z = 2 + X / 10: the ray (x, y, 1) meets it at Z = 2 / (1 - x / 10)."""
    corners = np.array([[x, y, 2 + 0.1 * x] for x, y in [(-1.0, -1), (1, -1), (1, 1), (-1, 1)]])
    surface = Surface(corners, np.array([[0, 1, 2], [0, 2, 3]]), 4)
    points = np.array([[0.0, 0, 5], [1.0, 0.4, 4], [-0.2, 0.3, 1]])
    moved = on_surface(points, surface, CAMERA)
    rays = points / points[:, 2:]
    np.testing.assert_allclose(moved / moved[:, 2:], rays)
    # Between the corners depth is linear in the image, which is right for a surface that is not too steep.
    np.testing.assert_allclose(moved[:, 2], 2 / (1 - 0.1 * rays[:, 0]), atol=0.01)


def test_points_beside_the_face_stay() -> None:
    surface = Surface(np.array([[0.0, 0, 2], [1, 0, 2], [0, 1, 2]]), np.array([[0, 1, 2]]), 3)
    point = np.array([[-3.0, 0, 4]])
    np.testing.assert_array_equal(on_surface(point, surface, CAMERA), point)


def test_depths_are_those_that_scipy_interpolates() -> None:
    rng = np.random.default_rng(0)
    known, depths, at = rng.normal(size=(200, 2)), rng.normal(size=200), 1.5 * rng.normal(size=(300, 2))
    expected = LinearNDInterpolator(known, depths)(at)
    found = _nearest(known, Delaunay(known).simplices.astype(np.intp), depths, at)
    assert 0 < np.isnan(expected).sum() < 300
    np.testing.assert_allclose(np.where(np.isfinite(found), found, np.nan), expected, atol=1e-12)


def test_where_a_surface_covers_itself_the_nearer_part_counts() -> None:
    corners = np.array([[0.0, 0], [1, 0], [0, 1]])
    depths = np.array([3.0, 3, 3, 2, 2, 2])
    triangles = np.array([[3, 4, 5], [0, 1, 2], [0, 0, 1]])  # the last one has no area
    assert _nearest(np.vstack([corners, corners]), triangles, depths, np.array([[0.2, 0.2], [0, 0]])).tolist() == [2, 2]


def test_triangles_are_those_of_delaunay() -> None:
    points = face().landmarks.points[:468]
    ours, scipys = (
        {tuple(sorted(t)) for t in of.tolist()} for of in (_triangulated(points), Delaunay(points).simplices)
    )
    assert len(ours) > 890
    assert len(ours ^ scipys) <= 3  # thin ones at the outline may differ
