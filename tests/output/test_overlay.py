"""Overlays: what is drawn where."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from mien.arrays import Array, Mask
from mien.candide.model import Candide
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING, matrix_from_euler
from mien.initialization.landmarks import LANDMARK_NAMES, VERTICES
from mien.output.overlay import (
    HIDDEN,
    SEEN,
    FaceOverlay,
    Mesh,
    Pixels,
    _close_up,
    draw,
    draw_fit,
    save_png,
)
from mien.tracking.state import Estimate, Status, TrackedLandmarks

CAMERA = Camera.from_fov(320, 240)
GREY = Frame(np.full((240, 320, 3), 128, dtype=np.uint8), 4, 0.2)
MODEL = Candide.default()
R = matrix_from_euler(np.radians([5.0, -15.0, 3.0])) @ FACING
T = np.array([0.1, 0.0, 5.0])


def _mesh() -> Mesh:
    return Mesh(MODEL.pose(MODEL.mean, R, T), MODEL.triangles)


def _estimate(visibility: Array | None = None) -> Estimate:
    X = _mesh().vertices[VERTICES]
    landmarks = TrackedLandmarks(LANDMARK_NAMES, CAMERA.project(X)[0], X, visibility)
    return Estimate(4, 0.2, Status.TRACKED, R, T, np.zeros(6), landmarks=landmarks, confidence=0.8)


def _changed(pixels: Pixels) -> Mask:
    return np.abs(pixels.astype(int) - 128).max(axis=2) > 20


def test_the_name_of_a_face_is_above_its_middle_also_in_a_small_frame() -> None:
    frame, points = Frame(np.full((20, 20, 3), 128, dtype=np.uint8)), np.array([[6.0, 10.0], [8.0, 14.0]])
    estimate = Estimate(0, 0, Status.TRACKED, landmarks=TrackedLandmarks(("left", "right"), points))
    bare, named = (draw(frame, [FaceOverlay(estimate, name=name)], CAMERA).astype(int) for name in ("", "0"))
    rows, columns = np.nonzero((named != bare).any(axis=2)[:320])
    assert abs((columns.min() + columns.max()) / 2 - (7 * 32 + 15.5)) < 2
    assert abs(rows.max() - ((10 - 0.6 * 4) * 32 + 15.5)) < 4


def test_small_frames_are_enlarged_and_the_frame_itself_stays() -> None:
    pixels = draw(GREY, [FaceOverlay(_estimate(), _mesh())], CAMERA)
    assert pixels.shape == (480, 640, 3)
    assert pixels.dtype == np.uint8
    assert (GREY.pixels == 128).all()
    large = Frame(np.full((480, 640, 3), 128, dtype=np.uint8))
    assert draw(large, [FaceOverlay(_estimate())], CAMERA).shape == (480, 640, 3)


def _mesh_alone(mesh: Mesh) -> Mask:
    """Where a mesh is drawn."""
    bare = Estimate(4, 0.2, Status.TRACKED)
    without, shown = (draw(GREY, [FaceOverlay(bare, drawn)], CAMERA).astype(int) for drawn in (None, mesh))
    return np.abs(shown - without).max(axis=2) > 20


def test_the_mesh_lies_on_the_face() -> None:
    mesh = _mesh()
    rows, columns = np.nonzero(_mesh_alone(mesh))
    used = np.unique(mesh.triangles)
    low, high = (f(2 * CAMERA.project(mesh.vertices[used])[0] + 0.5, axis=0) for f in (np.min, np.max))
    assert low[0] - 3 <= columns.min() <= columns.max() <= high[0] + 3
    assert low[1] - 3 <= rows.min() <= rows.max() <= high[1] + 3
    assert len(rows) > 1000


def test_a_mesh_seen_from_behind_or_behind_the_camera_is_not_drawn() -> None:
    for posed in (MODEL.pose(MODEL.mean, np.diag([-1.0, -1, 1]), T), MODEL.pose(MODEL.mean, R, -T)):
        assert not _mesh_alone(Mesh(posed, MODEL.triangles)).any()


@pytest.mark.parametrize("frame", [GREY, Frame(np.full((2160, 3840, 3), 128, dtype=np.uint8))])
def test_a_fit_is_drawn_from_near_with_the_names_of_its_points(frame: Frame) -> None:
    mesh, camera = _mesh(), Camera(CAMERA.focal_px, 0.7 * frame.width, 0.4 * frame.height)
    points, everything = (camera.project(X)[0] for X in (mesh.vertices[VERTICES], mesh.vertices))
    pictures = [draw_fit(frame, mesh, camera, points, [name] * len(points)) for name in ("", "133/155")]
    left, top, right, bottom = _close_up(frame, everything)
    scale = pictures[0].shape[1] / (right - left)
    assert pictures[0].shape == (scale * (bottom - top), scale * (right - left), 3)
    assert 1200 < pictures[0].shape[1] < 2000
    x, y = np.round((points - [left, top]) * scale + (scale - 1) / 2).astype(int).T
    assert np.abs(pictures[0][y, x].astype(int) - SEEN).max() < 60
    before, after = (np.count_nonzero(picture.min(axis=2) > 180) for picture in pictures)
    assert after - before > 30 * len(points)  # of seven letters each


def test_the_names_of_points_on_a_huge_face_can_be_read_when_the_picture_is_shown_on_a_screen() -> None:
    frame, camera = Frame(np.full((3200, 3840, 3), 128, dtype=np.uint8)), Camera(6000, 1920, 1600)
    mesh = _mesh()
    points = camera.project(mesh.vertices[VERTICES])[0]
    pictures = [draw_fit(frame, mesh, camera, points, [name] * len(points)) for name in ("", "133/155")]
    assert pictures[0].shape[1] > 2500
    height = round(1600 * pictures[0].shape[0] / pictures[0].shape[1])
    before, after = (cv2.resize(picture, (1600, height), interpolation=cv2.INTER_AREA) for picture in pictures)
    letters = np.count_nonzero(after.min(axis=2) > 180) - np.count_nonzero(before.min(axis=2) > 180)
    assert letters > 30 * len(points)


@pytest.mark.parametrize(("visibility", "colour", "filled"), [(1.0, SEEN, True), (0.0, HIDDEN, False)])
def test_hidden_landmarks_are_hollow(visibility: float, colour: tuple[int, int, int], filled: bool) -> None:
    point = np.array([[100.0, 80.0]])
    landmarks = TrackedLandmarks(("point",), point, visibility=np.array([visibility]))
    pixels = draw(GREY, [FaceOverlay(Estimate(0, 0, Status.TRACKED, landmarks=landmarks))], CAMERA)
    neighbourhood = pixels[155:167, 195:207].reshape(-1, 3).astype(int)
    assert np.abs(neighbourhood - colour).sum(axis=1).min() < 120
    centre = pixels[160:162, 200:202].reshape(-1, 3).astype(int)
    assert (np.abs(centre - colour).sum(axis=1).max() < 60) == filled


def test_the_axis_out_of_the_face_points_at_a_frontal_camera() -> None:
    """Head axes of a face in the centre: the subject's left is image right, up is up."""
    estimate = Estimate(0, 0, Status.TRACKED, FACING, np.array([0.0, 0.0, 5.0]))
    pixels = draw(GREY, [FaceOverlay(estimate)], CAMERA).astype(int)
    red = np.argwhere((pixels[..., 0] > 200) & (pixels[..., 1] < 140) & (pixels[..., 2] < 140))
    green = np.argwhere((pixels[..., 1] > 200) & (pixels[..., 0] < 160) & (pixels[..., 2] < 140))
    assert red[:, 1].mean() > 320 + 20
    assert abs(red[:, 0].mean() - 240) < 5
    assert green[:, 0].mean() < 240 - 20


def test_drawing_works_with_whatever_is_known() -> None:
    lost = Estimate.lost(GREY, "the face left the picture")
    assert _changed(draw(GREY, [FaceOverlay(lost)], CAMERA))[440:].any()
    assert not _changed(draw(GREY, [FaceOverlay(lost, _mesh())], CAMERA))[:430].any()
    landmarks = _estimate(np.linspace(0, 1, 26)).landmarks
    assert landmarks is not None
    image = np.where(np.arange(26)[:, None] == 3, np.nan, landmarks.image)
    behind = replace(_estimate(), landmarks=replace(landmarks, image=image))
    draw(GREY, [FaceOverlay(behind, _mesh())], CAMERA)
    draw(GREY, [FaceOverlay(Estimate(0, 0, Status.TRACKED))], CAMERA)


@pytest.mark.parametrize("shade", [0, 128, 255])
def test_captions_can_be_read_and_leave_the_picture_between_their_letters(shade: int) -> None:
    frame = Frame(np.full((480, 640, 3), shade, np.uint8))
    strip = draw(frame, [FaceOverlay(Estimate.lost(frame, "the face left the image"))] * 2, CAMERA)[440:, :200]
    assert np.mean((strip == shade).all(axis=2)) > 0.5
    assert np.ptp(strip.max(axis=2).astype(int)) > 150


def test_drawings_on_a_huge_frame_are_seen_when_it_is_shown_on_a_screen() -> None:
    """Nearly as strongly as on one of the size of the screen, and not a fifth of that."""
    contrast = []
    for factor in (1, 3):
        frame = Frame(np.full((960 * factor, 1280 * factor, 3), 128, np.uint8))
        camera = Camera.from_fov(frame.width, frame.height)
        drawn = draw(frame, [FaceOverlay(Estimate(4, 0.2, Status.TRACKED, R, T, confidence=0.8), _mesh())], camera)
        shown = cv2.resize(drawn, (1280, 960), interpolation=cv2.INTER_AREA)
        contrast.append([np.abs(part.astype(int) - 128).mean() for part in (shown[:900], shown[900:])])
    np.testing.assert_allclose(contrast[1], contrast[0], rtol=0.4)


def test_png_there_and_back(tmp_path: Path) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (11, 17, 3), dtype=np.uint8)
    save_png(tmp_path / "picture.png", pixels)
    back = cv2.cvtColor(cv2.imread(str(tmp_path / "picture.png")), cv2.COLOR_BGR2RGB)
    np.testing.assert_array_equal(back, pixels)
    assert [p.name for p in tmp_path.iterdir()] == ["picture.png"]


def test_the_captions_of_several_faces_stand_above_each_other() -> None:
    frame = Frame(np.full((480, 640, 3), 128, np.uint8))
    rows = []
    for faces in (1, 2, 3):
        lost = [FaceOverlay(Estimate.lost(frame, "nowhere"), name="0")] * faces
        rows.append(int((draw(frame, lost, CAMERA) != 128).any(axis=(1, 2)).sum()))
    assert rows == [rows[0], 2 * rows[0], 3 * rows[0]]
