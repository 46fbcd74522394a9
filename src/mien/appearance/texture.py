"""The texture of the first frame: the image, warped onto the mesh by its projection (section 2 of the paper)."""

from __future__ import annotations

import cv2
import numpy as np

from mien.appearance.rendering import Texture
from mien.arrays import Array
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.initialization.fit import FirstFrame


def texture_from_frame(frame: Frame, fit: FirstFrame, camera: Camera, pixels_per_unit: float) -> Texture:
    """Grey texture of the CANDIDE that is fitted to a frame; pixels_per_unit: as of `texture_of_vertices`."""
    return texture_of_vertices(frame, fit.in_camera(), float(fit.t[2]), camera, pixels_per_unit)


def texture_of_vertices(
    frame: Frame, vertices: Array, distance: float, camera: Camera, pixels_per_unit: float
) -> Texture:
    """Grey texture of a mesh (V, 3) in camera axes, at a distance, on the frame that shows it.

    pixels_per_unit: the resolution at which it will be drawn; a frame of more than twice that is shrunk first,
    so that drawing it does not alias.
    """
    uv, _ = camera.project(vertices)
    pixels = frame.gray
    factor = int(camera.focal_px / distance / pixels_per_unit)
    if factor >= 2:
        size = (pixels.shape[1] // factor, pixels.shape[0] // factor)
        pixels = cv2.resize(pixels[: size[1] * factor, : size[0] * factor], size, interpolation=cv2.INTER_AREA)
        uv = (uv + 0.5) / factor - 0.5
    return Texture(np.atleast_3d(pixels).astype(np.float32), uv)
