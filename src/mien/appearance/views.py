"""The synthetic database: the textured model seen from a grid of directions (section 3.1 of the paper)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from mien.appearance.crop import Crop, blurred
from mien.appearance.rendering import Texture, render
from mien.appearance.texture import texture_from_frame
from mien.arrays import Array, Float32
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING, exp
from mien.initialization.fit import FirstFrame


def view_rotations(limit_deg: float = 30.0, step_deg: float = 10.0) -> list[Array]:
    """Rotations (3, 3) head -> camera: tilt, pan and roll from -limit to +limit; 7^3 = 343 for 30 by 10."""
    count = math.floor(limit_deg / step_deg + 1e-9)
    angles = np.radians(step_deg) * np.arange(-count, count + 1)
    return [rotation(tilt, pan, roll) for tilt, pan, roll in product(angles, angles, angles)]


def rotation(tilt: float, pan: float, roll: float) -> Array:
    """Head turned by tilt and pan (radians) and then rolled in the image: (3, 3) head -> camera."""
    (a, b, c), (x, y, z) = ((f(tilt), f(pan), f(roll)) for f in (math.cos, math.sin))
    tilted, panned = np.array([[1, 0, 0], [0, a, -x], [0, x, a]]), np.array([[b, 0, y], [0, 1, 0], [-y, 0, b]])
    return np.asarray(np.array([[c, -z, 0], [z, c, 0], [0, 0, 1]]) @ tilted @ panned @ FACING)


CENTRE = np.array([0.0, -0.1, 0.0])
"""The point in head axes that a crop is centred on, in the middle of the landmarks."""


def crop_of_face(
    R: Array, t: Array, camera: Camera, pixels_per_unit: float, size: int, *, upright: bool = True
) -> Crop:
    """Crop, (size, size), in which a CANDIDE unit at the distance of the face measures `pixels_per_unit`.

    R (3, 3), t (3,): pose of the head, camera axes. Unless `upright`, the crop turns with the head, so that roll no
    longer changes what is in it.
    """
    angle = 0.0 if upright else roll_of(R)
    return Crop(centre_of_face(R, t, camera), pixels_per_unit * float(t[2]) / camera.focal_px, angle, size)


def centre_of_face(R: Array, t: Array, camera: Camera) -> tuple[float, float]:
    """Where the image shows `CENTRE`, in pixels, at a pose R (3, 3), t (3,)."""
    x, y, z = (R @ CENTRE + t).tolist()
    z = max(z, 1e-6)
    return camera.focal_px * x / z + camera.cx, camera.focal_px * y / z + camera.cy


def roll_of(R: Array) -> float:
    """Roll in radians of `R = rotation(tilt, pan, roll)`, the turn in the image plane. (3, 3) -> radians."""
    return math.atan2(R[0, 1], -R[1, 1])


def tilt_pan_of(R: Array) -> tuple[float, float]:
    """Tilt and pan in radians of `R = rotation(tilt, pan, roll)`. (3, 3) head -> camera."""
    M = exp(np.array([0, 0, -roll_of(R)])) @ R @ FACING
    return float(np.arctan2(M[2, 1], M[1, 1])), float(np.arctan2(M[0, 2], M[0, 0]))


def crop_camera(camera: Camera, crop: Crop) -> Camera:
    """The camera that sees an upright crop."""
    principal = crop.to_crop(np.array([camera.cx, camera.cy]))
    return Camera(camera.focal_px * crop.scale, float(principal[0]), float(principal[1]))


def render_view(
    vertices: Array,
    triangles: NDArray[np.intp],
    texture: Texture,
    R: Array,
    t: Array,
    camera: Camera,
    pixels_per_unit: float,
    size: int,
    background: float,
) -> tuple[Float32, Array]:
    """Grey crop (size, size) of a model at a pose R (3, 3), t (3,), and its vertices in it (V, 2), pixels. vertices:
    (V, 3) head axes; triangles: (T, 3); background: grey value beside the model."""
    crop = crop_of_face(R, t, camera, pixels_per_unit, size)
    view = crop_camera(camera, crop)
    posed = vertices @ R.T + t
    image = render(posed, triangles, texture, view, size, size, background).image[:, :, 0]
    return image, view.project(posed)[0]


def rendered_views(
    frame: Frame,
    fit: FirstFrame,
    camera: Camera,
    triangles: NDArray[np.intp],
    rotations: Sequence[Array],
    pixels_per_unit: float,
    size: int,
    blur: float,
) -> Iterator[tuple[Float32, Array]]:
    """The first frame's face in these rotations (3, 3): smoothed grey crops (size, size), vertices in them (V, 2).

    triangles: (T, 3) the surfaces that are drawn; blur: standard deviation of the smoothing in crop pixels.
    """
    texture = texture_from_frame(frame, fit, camera, pixels_per_unit=pixels_per_unit)
    background = float(frame.gray.mean())
    vertices = fit.vertices()
    for R in rotations:
        image, p = render_view(vertices, triangles, texture, R, fit.t, camera, pixels_per_unit, size, background)
        yield blurred(image, blur), p
