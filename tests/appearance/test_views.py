"""The views for training: their rotations, and where the face lies in them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mien.appearance.rendering import Texture
from mien.appearance.texture import texture_from_frame
from mien.appearance.views import (
    CENTRE,
    crop_camera,
    crop_of_face,
    render_view,
    rendered_views,
    roll_of,
    rotation,
    tilt_pan_of,
    view_rotations,
)
from mien.arrays import Array
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING, angle_between
from small_motion import face

ANGLES = st.floats(-1.2, 1.2)


def test_343_rotations_about_the_frontal_view() -> None:
    rotations = np.stack(view_rotations())
    assert len(rotations) == 343
    assert len({tuple(np.round(R, 9).ravel()) for R in rotations}) == 343
    np.testing.assert_allclose(rotations[171], FACING, atol=1e-12)
    assert np.degrees([tilt_pan_of(R) for R in rotations]).max() == pytest.approx(30)
    assert np.degrees([roll_of(R) for R in rotations]).min() == pytest.approx(-30)


def test_the_grid_follows_its_settings() -> None:
    assert len(view_rotations(20, 20)) == 27
    assert np.degrees(angle_between(view_rotations(20, 20)[13], view_rotations(20, 20)[14])) == pytest.approx(20)


@given(ANGLES, ANGLES, st.floats(-3, 3))
def test_angles_invert_the_rotation(tilt: float, pan: float, roll: float) -> None:
    R = rotation(tilt, pan, roll)
    assert roll_of(R) == pytest.approx(roll, abs=1e-9)
    np.testing.assert_allclose(tilt_pan_of(R), (tilt, pan), atol=1e-9)


def test_signs_of_the_angles() -> None:
    """Pan to the right of the image moves the nose there, tilt down moves it down, roll turns to the right."""
    nose = np.array([0.0, 0, 1])
    assert (rotation(0, 0.3, 0) @ nose)[0] < 0
    assert (rotation(0.3, 0, 0) @ nose)[1] > 0
    crown = rotation(0, 0, 0.3) @ np.array([0.0, 1, 0])
    assert crown[0] > 0


@pytest.mark.parametrize("upright", [True, False])
def test_the_crop_holds_the_face_at_its_size(upright: bool) -> None:
    camera = Camera.from_fov(320, 240)
    R, t = rotation(0.1, -0.2, 0.5), np.array([0.4, -0.3, 5.0])
    crop = crop_of_face(R, t, camera, 40, 101, upright=upright)
    centre = camera.project(R @ CENTRE + t)[0]
    np.testing.assert_allclose(crop.to_crop(centre), [50, 50], atol=1e-9)
    # A unit across the view at the distance of the face measures 40 pixels.
    unit = camera.project(t + np.eye(3)[0])[0] - camera.project(t)[0]
    assert np.linalg.norm(crop.linear @ unit) == pytest.approx(40)
    assert crop.angle == pytest.approx(0 if upright else 0.5)


def test_a_crop_that_turns_with_the_head_does_not_see_its_roll() -> None:
    camera = Camera.from_fov(320, 240)
    t = -rotation(0.1, -0.2, 0) @ CENTRE + np.array([0, 0, 5.0])
    up = np.array([0.0, 0.5, 0.2])
    seen = []
    for roll in (0.0, 0.7, -2.0):
        R = rotation(0.1, -0.2, roll)
        t = np.array([0, 0, 5.0]) - R @ CENTRE
        crop = crop_of_face(R, t, camera, 40, 101, upright=False)
        seen.append(crop.to_crop(camera.project(R @ up + t)[0]))
    # The distance t[2] is that of the head's origin, so it changes a little with the roll of the centre.
    np.testing.assert_allclose(seen, np.tile(seen[0], (3, 1)), atol=0.05)


def test_the_camera_of_a_crop_projects_into_it() -> None:
    camera = Camera.from_fov(320, 240)
    crop = crop_of_face(rotation(0.1, 0.2, 0), np.array([0.4, -0.3, 5.0]), camera, 40, 101)
    X = np.array([[0.1, 0.2, 4], [-1, 0.5, 6]])
    np.testing.assert_allclose(crop_camera(camera, crop).project(X)[0], crop.to_crop(camera.project(X)[0]))


def test_a_view_shows_the_texture_of_a_vertex_where_the_vertex_is() -> None:
    """Surfaces of one grey value each: a small square around a point, at its place in the view."""
    camera = Camera.from_fov(320, 240)
    corners = np.array([[-0.2, -0.2, 0.3], [0.2, -0.2, 0.3], [0.2, 0.2, 0.3], [-0.2, 0.2, 0.3]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    texture = Texture(np.full((1, 1, 1), 200, np.float32), np.zeros((4, 2)))
    R, t = rotation(0.2, -0.3, 0.4), np.array([0.3, 0.2, 5.0])
    image, p = render_view(corners, triangles, texture, R, t, camera, 60, 120, background=10)
    crop = crop_of_face(R, t, camera, 60, 120)
    np.testing.assert_allclose(p, crop.to_crop(camera.project(corners @ R.T + t)[0]))
    u, v = np.meshgrid(np.arange(120), np.arange(120))
    bright = image == 200
    np.testing.assert_allclose([u[bright].mean(), v[bright].mean()], p.mean(axis=0), atol=0.5)
    assert set(np.unique(image)) == {10, 200}


def test_the_frontal_view_is_the_frame() -> None:
    """Rendered in its own pose, the first frame's face is what a crop of the frame shows."""
    portrait = face()
    fit, camera, frame = portrait.fit, portrait.camera, portrait.frame
    ((image, p),) = rendered_views(frame, fit, camera, fit.model.triangles, [fit.R], 64, 154, 0.0)
    crop = crop_of_face(fit.R, fit.t, camera, 64, 154)
    original = crop.sample(frame)
    np.testing.assert_allclose(p, crop.to_crop(camera.project(fit.vertices() @ fit.R.T + fit.t)[0]), atol=1e-9)
    middle: Array = np.abs(image - original)[50:110, 50:110]
    assert np.median(middle) < 3


def test_a_large_frame_is_shrunk_before_it_is_drawn_small() -> None:
    """A texture at twice the resolution or more is averaged, and a vertex keeps its place in it."""
    portrait = face()
    fit, camera = portrait.fit, portrait.camera
    large = Frame(np.repeat(np.repeat(portrait.frame.pixels, 3, axis=0), 3, axis=1))
    wide = Camera(3 * camera.focal_px, 3 * camera.cx + 1, 3 * camera.cy + 1)
    pixels_per_unit = camera.focal_px / float(fit.t[2]) * 0.99
    small = texture_from_frame(portrait.frame, fit, camera, pixels_per_unit)
    texture = texture_from_frame(large, fit, wide, pixels_per_unit)
    np.testing.assert_allclose(texture.uv, small.uv, atol=1e-6)
    np.testing.assert_allclose(texture.image, small.image, atol=1)
