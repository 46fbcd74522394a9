"""The camera that looks at the face: where it sees points, and that its image is theirs."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mien.appearance.face_camera import FaceCamera
from mien.arrays import Array
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import exp, ray_rotation

REAL = Camera(500.0, 399.5, 299.5)
WIDTH, HEIGHT, SIZE = 800, 600, 101


def _at(point: Array, roll: float = 0.0, distance: float = 5.0) -> FaceCamera:
    return FaceCamera(REAL, ray_rotation(point), roll, 60 * distance, SIZE)


def _project(camera: FaceCamera, X: Array) -> Array:
    homogeneous = X @ camera.projection.T
    return np.asarray(homogeneous[..., :2] / homogeneous[..., 2:])


directions = st.builds(lambda x, y: np.array([x, y, 1.0]), st.floats(-0.8, 0.8), st.floats(-0.6, 0.6))


@given(directions, st.floats(-np.pi, np.pi), st.floats(1, 20))
def test_what_it_looks_at_is_in_its_middle(ray: Array, roll: float, distance: float) -> None:
    np.testing.assert_allclose(_project(_at(ray, roll, distance), ray), 0.5 * (SIZE - 1), atol=1e-9)


@given(directions, st.floats(-np.pi, np.pi))
def test_a_head_looks_the_same_wherever_it_is(ray: Array, roll: float) -> None:
    """A head that is carried around the camera without turning towards it or away, and rolls."""
    head = np.random.default_rng(0).uniform(-0.6, 0.6, (20, 3))
    ahead = _project(_at(np.array([0, 0, 1.0])), head + np.array([0, 0, 5]))
    rolled = exp(np.array([0, 0, roll]))
    carried = (head @ rolled.T + np.array([0, 0, 5])) @ ray_rotation(ray).T
    np.testing.assert_allclose(_project(_at(ray, roll), carried), ahead, atol=1e-8)


@pytest.mark.parametrize("ray", [[0, 0, 1], [0.7, 0.1, 1], [-0.6, -0.5, 1], [0.05, 0.5, 1]])
@pytest.mark.parametrize(("roll", "distance"), [(0.0, 5.0), (0.8, 6.0), (-2.5, 17.0)])
def test_its_image_shows_points_where_it_projects_them(ray: list[float], roll: float, distance: float) -> None:
    """Blurred dots of an image, also where several of its pixels make one of the crop."""
    camera = _at(np.array(ray, float), roll, distance)
    for q in np.array([[50.0, 50], [20, 30], [70, 85]]):
        X = np.linalg.solve(camera.projection, [*q, 1])
        p = REAL.project(X)[0]
        if not (0 <= p[0] < WIDTH and 0 <= p[1] < HEIGHT):
            continue
        u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
        dot = 250 * np.exp(-((u - p[0]) ** 2 + (v - p[1]) ** 2) / (2 * (4 / camera.scale) ** 2))
        seen = camera.sample(Frame(np.repeat(dot.astype(np.uint8)[..., None], 3, axis=2)), blur=0.0)
        bright = np.where(seen > 40, seen, 0)
        v, u = np.mgrid[:SIZE, :SIZE]
        found = np.array([(u * bright).sum(), (v * bright).sum()]) / bright.sum()
        np.testing.assert_allclose(found, q, atol=0.25)


def test_its_scale_is_that_of_the_face() -> None:
    """Across the direction to the optical axis: a CANDIDE unit at a distance of five is 60 pixels in the crop."""
    ray = np.array([0.7, 0.0, 1.0])
    camera, X = _at(ray), 5 * ray / np.linalg.norm(ray)
    up = np.array([0, 1e-3, 0])
    in_image = np.linalg.norm(REAL.project(X + up)[0] - REAL.project(X)[0])
    in_crop = np.linalg.norm(_project(camera, X + up) - _project(camera, X))
    assert in_crop == pytest.approx(0.06, rel=1e-3)
    assert in_crop / in_image == pytest.approx(camera.scale, rel=1e-3)


def test_it_agrees_with_opencv() -> None:
    picture = cv2.GaussianBlur(np.random.default_rng(1).uniform(0, 255, (HEIGHT, WIDTH, 3)), (0, 0), 4)
    frame = Frame(cv2.normalize(picture, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8))
    camera = _at(np.array([0.55, -0.3, 1.0]), 0.4)
    homography = camera.projection @ np.linalg.inv(REAL.matrix)
    expected = cv2.warpPerspective(
        frame.gray.astype(np.float32), homography, (SIZE, SIZE), borderMode=cv2.BORDER_REPLICATE
    )
    np.testing.assert_allclose(camera.sample(frame), expected, atol=1.0)


@pytest.mark.parametrize("ray", [[1, 0, 0], [1, 0.3, -0.2], [0.2, 0.1, -1]])
def test_nothing_is_seen_beside_and_behind_the_camera(ray: list[float]) -> None:
    frame = Frame(np.full((HEIGHT, WIDTH, 3), 90, np.uint8))
    np.testing.assert_allclose(_at(np.array(ray, float), 0.3).sample(frame), 90, atol=0.5)


def test_a_face_behind_the_border_of_the_image_repeats_the_border() -> None:
    """Where half of the crop would be behind the real camera, too."""
    frame = Frame(np.full((HEIGHT, WIDTH, 3), 90, np.uint8))
    near = FaceCamera(REAL, ray_rotation(np.array([3.0, 0, 1.0])), 0.3, 60 * 0.4, SIZE)
    np.testing.assert_allclose(near.sample(frame), 90, atol=0.5)
