"""Overlays: what is drawn where, and videos that keep the frames' own times."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from mien.arrays import Array
from mien.candide.model import Candide
from mien.errors import MienError
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING, matrix_from_euler
from mien.initialization.landmarks import LANDMARK_NAMES, VERTICES
from mien.output.overlay import (
    HIDDEN,
    SEEN,
    FaceOverlay,
    Mesh,
    OverlayWriter,
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


def _changed(pixels: Pixels) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
    return np.abs(pixels.astype(int) - 128).max(axis=2) > 20


def test_small_frames_are_enlarged_and_the_frame_itself_stays() -> None:
    pixels = draw(GREY, [FaceOverlay(_estimate(), _mesh())], CAMERA)
    assert pixels.shape == (480, 640, 3)
    assert pixels.dtype == np.uint8
    assert (GREY.pixels == 128).all()
    large = Frame(np.full((480, 640, 3), 128, dtype=np.uint8))
    assert draw(large, [FaceOverlay(_estimate())], CAMERA).shape == (480, 640, 3)


def _mesh_alone(mesh: Mesh) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
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


def test_png_there_and_back(tmp_path: Path) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (11, 17, 3), dtype=np.uint8)
    save_png(tmp_path / "picture.png", pixels)
    back = cv2.cvtColor(cv2.imread(str(tmp_path / "picture.png")), cv2.COLOR_BGR2RGB)
    np.testing.assert_array_equal(back, pixels)
    assert [p.name for p in tmp_path.iterdir()] == ["picture.png"]


def test_a_video_keeps_times_colours_and_an_even_size(tmp_path: Path) -> None:
    times = [2.0, 2.04, 2.5, 2.5, 3.25]
    colour = np.array([200, 60, 40], dtype=np.uint8)
    with OverlayWriter(tmp_path / "overlay.mp4") as writer:
        for time in times:
            writer.write(np.full((91, 121, 3), colour), time)
        assert not (tmp_path / "overlay.mp4").exists()
    assert [p.name for p in tmp_path.iterdir()] == ["overlay.mp4"]
    with av.open(str(tmp_path / "overlay.mp4")) as container:
        frames = list(container.decode(video=0))
        assert container.streams.video[0].codec_context.name == "h264"
    np.testing.assert_allclose([f.time for f in frames], np.array(times) - 2, atol=1e-4)
    assert {(f.width, f.height, f.format.name) for f in frames} == {(120, 90, "yuv420p")}
    assert np.abs(frames[2].to_ndarray(format="rgb24").astype(int) - colour).max() < 12


@pytest.mark.parametrize("size", [(120, 16386), (32770, 200)])
def test_what_is_too_large_for_the_encoder_is_scaled_down(size: tuple[int, int], tmp_path: Path) -> None:
    colour = np.array([200, 60, 40], dtype=np.uint8)
    with OverlayWriter(tmp_path / "overlay.mp4") as writer:
        writer.write(np.full((*size, 3), colour), 0.0)
    with av.open(str(tmp_path / "overlay.mp4")) as container:
        frame = next(container.decode(video=0))
    assert max(frame.width, frame.height) == 16384
    assert frame.width / frame.height == pytest.approx(size[1] / size[0], rel=0.02)
    assert np.abs(frame.to_ndarray(format="rgb24").astype(int) - colour).max() < 12


def test_what_the_encoder_refuses_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mien.output.overlay._LARGEST_SIDE", 1 << 20)
    with (
        pytest.raises(MienError, match=r"overlay\.mp4 cannot be encoded \(.*external library\); scale"),
        OverlayWriter(tmp_path / "overlay.mp4") as writer,
    ):
        writer.write(np.zeros((120, 16386, 3), dtype=np.uint8), 0.0)
    assert not list(tmp_path.iterdir())


def test_a_video_without_frames_leaves_nothing(tmp_path: Path) -> None:
    with OverlayWriter(tmp_path / "overlay.mp4"):
        pass
    assert not list(tmp_path.iterdir())


def test_an_interrupted_video_holds_what_was_written(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), OverlayWriter(tmp_path / "overlay.mp4") as writer:  # noqa: PT012
        writer.write(np.zeros((90, 120, 3), dtype=np.uint8), 0.0)
        raise KeyboardInterrupt
    with av.open(str(tmp_path / "overlay.mp4")) as container:
        assert len(list(container.decode(video=0))) == 1


def test_a_video_that_fails_leaves_the_one_that_is_there(tmp_path: Path) -> None:
    path = tmp_path / "overlay.mp4"
    path.write_bytes(b"of yesterday")
    with pytest.raises(ZeroDivisionError), OverlayWriter(path) as writer:  # noqa: PT012
        writer.write(np.zeros((48, 64, 3), np.uint8), 0.0)
        raise ZeroDivisionError
    assert path.read_bytes() == b"of yesterday"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_cannot_be_created_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(MienError, match=r"file/overlay.*cannot be written"):
        OverlayWriter(tmp_path / "file" / "overlay.mp4")
