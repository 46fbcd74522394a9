"""The part of a frame that contains the head, blurred at coarse to fine levels, and what a surface looks like in it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from mien.arrays import Array, Float32, Mask
from mien.baselines.surface import GRAZING, Pose, Surface
from mien.errors import MienError
from mien.frame import Frame
from mien.geometry.camera import Camera

REACH = 1.7
"""Half the side of a view, in CANDIDE units: the head, with room to move between two frames."""
MAXIMUM_PIXELS_PER_UNIT = 100.0
"""A larger head is first shrunk by an integer factor, as the grid of points would alias."""
BLURS = (0.06, 0.02)
"""Standard deviations of the Gaussians of a view, coarse to fine, in CANDIDE units."""


@dataclass(frozen=True)
class View:
    """The part of a frame around the head: its camera, and for each level the grey value and its gradient (h, w, 3)."""

    camera: Camera
    levels: tuple[Float32, ...]

    def read(self, level: int, p: Array) -> tuple[Array, Mask]:
        """Grey value and gradient (N, 3) at pixels (N, 2) of the view, and a mask of those inside it."""
        image = self.levels[level]
        q = p.astype(np.float32)
        if not len(q):
            return np.zeros((0, 3)), np.zeros(0, dtype=bool)
        values = cv2.remap(image, q[None, :, 0], q[None, :, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[0]
        inside = (p[:, 0] >= 0) & (p[:, 1] >= 0) & (p[:, 0] <= image.shape[1] - 1) & (p[:, 1] <= image.shape[0] - 1)
        return values.astype(np.float64), inside


def look(frame: Frame, pose: Pose, camera: Camera) -> View | None:
    """The view of a frame around a head with this pose; None if the head is not in the image."""
    pixels_per_unit = camera.focal_px / pose.t[2]
    if not 0 < pixels_per_unit < max(frame.width, frame.height):
        return None
    centre, _ = camera.project(pose.t)
    reach = REACH * pixels_per_unit
    size = np.array([frame.width, frame.height])
    (x0, y0), (x1, y1) = (np.clip(np.round(centre + s * reach), 0, size).astype(int) for s in (-1, 1))
    shrink = int(np.ceil(pixels_per_unit / MAXIMUM_PIXELS_PER_UNIT))
    width, height = int(x1 - x0) // shrink, int(y1 - y0) // shrink
    if min(width, height) * shrink < 0.25 * reach:
        return None
    region = frame.gray[y0 : y0 + height * shrink, x0 : x0 + width * shrink].astype(np.float32)
    if shrink > 1:
        region = cv2.resize(region, (width, height), interpolation=cv2.INTER_AREA)
    cx, cy = (camera.cx - x0 + 0.5) / shrink - 0.5, (camera.cy - y0 + 0.5) / shrink - 0.5
    blurs = (blur * pixels_per_unit / shrink for blur in BLURS)
    return View(Camera(camera.focal_px / shrink, cx, cy), tuple(_with_gradient(region, sd) for sd in blurs))


def look_first(frame: Frame, pose: Pose, camera: Camera) -> View:
    """The view of the first frame. Raises MienError if its landmarks place the head outside the image."""
    view = look(frame, pose, camera)
    if view is None:
        raise MienError("the landmarks place the head outside the image; check that they belong to this video")
    return view


def _with_gradient(image: Float32, sd: float) -> Float32:
    """(h, w) -> (h, w, 3): the blurred image and its derivatives with respect to u and v."""
    smooth = cv2.GaussianBlur(image, (0, 0), max(sd, 0.5))
    du = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    dv = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8)
    return np.asarray(np.dstack([smooth, du, dv]), np.float32)


@dataclass(frozen=True)
class Template:
    """Appearance of the surface at a pose: grey values (levels, N), gradient magnitude (N,) on the finest level, cosine
    (N,) between normal and viewing ray, known (N,) mask of visible points."""

    values: Array
    gradient: Array
    cosine: Array
    known: Mask


def take_template(surface: Surface, view: View, pose: Pose) -> Template:
    """Sample the appearance of the surface at a pose from a view."""
    X, cosine = surface.seen(pose)
    p, _ = view.camera.project(X)
    read = [view.read(level, p) for level in range(len(view.levels))]
    gradient = np.hypot(read[-1][0][:, 1], read[-1][0][:, 2])
    values = np.stack([values[:, 0] for values, _ in read])
    return Template(values, gradient, cosine, (cosine > GRAZING) & read[-1][1])
