"""The camera of a video, given in one of several ways."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mien.errors import MienError, MienWarning
from mien.frame import Frame
from mien.geometry.camera import UNKNOWN_LOG_SD, Camera
from mien.start.footage import Footage, read_camera
from mien.video import StraightVideo, open_video


def test_camera_is_given_in_one_of_three_ways(video: Path, tmp_path: Path) -> None:
    frame = Frame(np.zeros((240, 320, 3), np.uint8))
    (tmp_path / "c.json").write_text('{"focal_px": 100, "cx": 2, "cy": 3}')

    def camera(given: Camera | Path | None = None, **how: float) -> Camera:
        return Footage(open_video(video), given, **how).camera_of(frame)

    assert camera() == replace(Camera.from_fov(320, 240, 60), focal_log_sd=UNKNOWN_LOG_SD)
    assert camera(fov_deg=90).focal_px == pytest.approx(160)
    assert camera(focal_px=300) == Camera(300, 159.5, 119.5)
    assert camera(Camera(100, 2, 3)) == camera(tmp_path / "c.json") == Camera(100, 2, 3)
    with pytest.raises(MienError, match="more than one way"):
        camera(Camera(100, 2, 3), focal_px=5)
    for how in ({"focal_px": 40.0}, {"fov_deg": 155.0}):
        with pytest.raises(MienError, match="pixels sees more than 150 degrees"):
            camera(**how)
    with pytest.warns(MienWarning, match=r"at 960, 540, lies outside the image of 320x240"):
        camera(Camera(1800, 960, 540))
    of_track = {"camera": {"focal_px": 100, "cx": 2, "cy": 3}, "video": {"width": 640, "height": 480}}
    (tmp_path / "c.json").write_text(json.dumps(of_track))
    with pytest.warns(MienWarning, match=r"camera of a video of 640x480 pixels, and this one has 320x240"):
        assert camera(tmp_path / "c.json") == Camera(100, 2, 3)


def test_a_camera_file_without_a_centre_has_that_of_the_image(video: Path, tmp_path: Path) -> None:
    (tmp_path / "c.json").write_text('{"focal_px": 300}')
    camera = Footage(open_video(video), tmp_path / "c.json").camera_of(Frame(np.zeros((240, 320, 3), np.uint8)))
    assert camera == Camera(300, 159.5, 119.5)
    (tmp_path / "c.json").write_text('{"focal_px": -300}')
    with pytest.raises(MienError, match=r"c\.json: the focal length must be positive"):
        Footage(open_video(video), tmp_path / "c.json")


K = [[600, 0, 330], [0, 602, 250], [0, 0, 1]]
TEXT = {"image_width": "320", "image_height": "240.0"}
OF_OPENCV = {"rows": 3, "cols": 3, "dt": "d", "data": [*K[0], *K[1], *K[2]]}


@pytest.mark.parametrize(
    "calibration",
    [
        {"camera_matrix": K},
        {"camera": "in the kitchen", "camera_matrix": K},
        {"camera_matrix": K, "dist_coeff": [[0.01, 0, 0, 0, 0]], "distortion_model": "plumb_bob"},
        {"camera_matrix": OF_OPENCV, "distortion_coefficients": {"rows": 1, "cols": 5, "data": [0.0] * 5}},
    ],
)
def test_a_calibration_is_read(calibration: dict[str, Any], tmp_path: Path) -> None:
    file = tmp_path / "c.json"
    file.write_text(json.dumps(calibration))
    assert read_camera(file) == Camera(601, 330, 250)
    file.write_text(json.dumps(calibration | {"image_width": 640, "image_height": 480}))
    assert read_camera(file, (640, 480)) == Camera(601, 330, 250)
    with pytest.warns(MienWarning, match=r"c\.json has the camera of a video of 640x480 pixels, and this one has 320x"):
        read_camera(file, (320, 240))


@pytest.mark.parametrize(
    "numbers", [{"focal_px": 500}, {"focal_px": 500, "cx": 160, "cy": 120}, {"camera": {"focal_px": 500}}]
)
def test_a_camera_of_images_of_another_size_is_warned_of(
    numbers: dict[str, Any], tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    """If its file says of which; its optical axis lies within the image of both."""
    file = tmp_path / "c.json"
    for stated in ({}, {"image_width": 320, "image_height": 240}, {"image_width": 640}, TEXT):
        file.write_text(json.dumps(numbers | stated))
        read_camera(file, (320, 240))
    assert not recwarn
    file.write_text(json.dumps(numbers | {"image_width": 640, "image_height": 480}))
    with pytest.warns(MienWarning, match=r"c\.json has the camera of a video of 640x480 pixels, and this one has 320x"):
        assert read_camera(file, (320, 240)).focal_px == 500


@pytest.mark.parametrize("name", ["image_width", "image_height"])
@pytest.mark.parametrize("stated", ["a", -3, 0, float("nan"), float("inf"), [640]])
def test_a_size_that_no_image_has_is_named(stated: Any, name: str, tmp_path: Path) -> None:
    for numbers in ({"focal_px": 500, "cx": 160, "cy": 120}, {"camera_matrix": K}):
        (tmp_path / "c.json").write_text(json.dumps({"image_width": 640, "image_height": 480, **numbers, name: stated}))
        for size in (None, (640, 480)):
            with pytest.raises(
                MienError, match=rf"c\.json: {name} is .*; give image_width and image_height as positive"
            ):
                read_camera(tmp_path / "c.json", size)


@pytest.mark.parametrize("distortion", [[-0.3, 0.1, 0, 0], {"data": [-0.3, 0.1, 0, 0, 0]}])
def test_a_calibration_with_distortion_is_that_of_straight_images(distortion: Any, tmp_path: Path) -> None:
    file = tmp_path / "c.json"
    file.write_text(json.dumps({"camera_matrix": K, "dist_coeffs": distortion}))
    camera = read_camera(file)
    assert (camera.focal_px, camera.cx, camera.cy) == (601, 330, 250)
    assert camera.lens is not None
    file.write_text(json.dumps({"camera": camera.to_dict()}))  # as a track has it
    assert read_camera(file) == camera


def test_no_coefficient_is_passed_over(tmp_path: Path) -> None:
    file, bent = tmp_path / "c.json", [-0.3, 0.1, 0, 0, 0]
    for name in ("D", "dist", "distCoeffs", "distortion_coefficients"):
        file.write_text(json.dumps({"camera_matrix": K, name: bent}))
        assert read_camera(file) == Camera.from_matrix(K, bent)
        file.write_text(json.dumps({"camera_matrix": K, name: "none"}))
        with pytest.raises(MienError, match=r"c\.json needs"):
            read_camera(file)
        file.write_text(json.dumps({"focal_px": 500, "cx": 160, "cy": 120, name: bent}))
        with pytest.raises(MienError, match=rf'c\.json: {name} needs the "camera_matrix" of the same calibration'):
            read_camera(file)


def test_coefficients_of_zero_say_nothing(tmp_path: Path) -> None:
    """As cameras state that straighten their images themselves, whatever model they name."""
    file, straight = tmp_path / "c.json", [0.0] * 5
    file.write_text(json.dumps({"camera_matrix": K, "D": straight, "distortion_model": "inverse_brown_conrady"}))
    assert read_camera(file) == Camera.from_matrix(K)
    file.write_text(json.dumps({"focal_px": 500, "cx": 160, "cy": 120, "D": straight}))
    assert read_camera(file) == Camera(500, 160, 120)


def test_a_fisheye_is_known_by_its_model(tmp_path: Path) -> None:
    file = tmp_path / "c.json"
    calibration = {"camera_matrix": K, "dist_coeffs": [-0.03, 0.01, 0, 0], "distortion_model": "equidistant"}
    file.write_text(json.dumps(calibration))
    camera = read_camera(file)
    assert camera == Camera.from_matrix(K, [-0.03, 0.01, 0, 0], fisheye=True)
    assert camera != Camera.from_matrix(K, [-0.03, 0.01, 0, 0])
    file.write_text(json.dumps({"camera": camera.to_dict()}))
    assert read_camera(file) == camera
    file.write_text(json.dumps(calibration | {"distortion_model": "Kannala-Brandt"}))
    assert read_camera(file) == camera
    file.write_text(json.dumps(calibration | {"distortion_model": "division"}))
    with pytest.raises(
        MienError, match=r"c\.json: the distortion_model 'division' is not known; mien knows equidistant, "
    ):
        read_camera(file)
    file.write_text(json.dumps(calibration | {"dist_coeffs": [0.0] * 5}))
    with pytest.raises(MienError, match=r"c\.json: .* no distortion coefficients of a fisheye lens; give the 4 of"):
        read_camera(file)


def test_a_video_through_a_lens_is_straightened_once(video: Path) -> None:
    bending = Camera.from_matrix([[80, 0, 31], [0, 80, 23], [0, 0, 1]], [-0.3, 0.1, 0, 0])
    footage = Footage(open_video(video), bending)
    assert bending.lens is not None
    (straight, *_), (seen, *_) = footage.since(0.0).frames(), open_video(video)
    np.testing.assert_array_equal(straight.pixels, bending.lens.straighten(seen.pixels))
    assert footage.camera_of(straight) == bending
    assert not isinstance(Footage(open_video(video), Camera(500, 160, 120)).video, StraightVideo)


@pytest.mark.parametrize(
    "text",
    [
        "{",
        "[]",
        "{}",
        '{"focal_px": 1, "cx": 1}',
        '{"focal_px": "x", "cx": 1, "cy": 1}',
        f'{{"focal_px": 1{"0" * 400}, "cx": 1, "cy": 1}}',  # beyond any float
        '{"camera_matrix": [1, 2]}',
    ],
)
def test_a_broken_camera_file_is_named(tmp_path: Path, text: str) -> None:
    (tmp_path / "c.json").write_text(text)
    with pytest.raises(MienError, match=r"c\.json needs"):
        read_camera(tmp_path / "c.json")
    (tmp_path / "c.json").write_text('{"focal_px": -1, "cx": 1, "cy": 1}')
    with pytest.raises(MienError, match=r"c\.json: the focal length must be positive"):
        read_camera(tmp_path / "c.json")


def test_the_rest_of_it_ends_by_itself(video: Path) -> None:
    footage = Footage(open_video(video))
    whole, rest = footage.frames(), footage.since(0.1)
    frames = rest.frames()
    assert next(frames).time >= 0.1
    rest.close()
    assert list(frames) == []
    assert next(whole).time == 0
