"""Synthetic sequences with ground truth: a portrait, textured onto the fitted model, moves before its own background.

Pure: a portrait and the states of Eq. (2) go in, frames and ground truth come out. The demo and the tests of the
trackers use it. A rim of hair and neck moves with the head and fades into the blurred background.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import as_file, files

import cv2
import numpy as np
from numpy.typing import NDArray

from mien.appearance.rendering import Texture, render
from mien.arrays import Array, Float32, Pixels
from mien.candide.model import MOUTH_TRIANGLES
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import matrix_from_euler
from mien.initialization.fit import FirstFrame, fit_first_frame
from mien.initialization.landmark_files import read_landmarks
from mien.initialization.landmarks import VERTICES, Landmarks
from mien.tracking.state import pack, unpack

PORTRAIT_SIZE = (320, 240)
PORTRAIT_ZOOM, PORTRAIT_CORNER = 1.25, (97.0, 8.0)
"""The crop of scikit-image's photograph that is the portrait: its zoom, and the pixel at its corner."""
FPS = 25.0
SUPERSAMPLING = 2
OCCLUDER_COLOUR = (70, 90, 120)
RIM_WIDTH, RIM_DEPTH = 1.0, 0.4
"""How far the rim extends beyond the outline of the mesh, as a fraction of its size, and backwards, in units."""

_OUTLINE = (0, 11, 12, 14, 29, 28, 30, 32, 10, 65, 63, 61, 62, 47, 45, 44)


@dataclass(frozen=True)
class Portrait:
    """A frame with a face, its landmarks, and the model fitted to them."""

    frame: Frame
    landmarks: Landmarks
    camera: Camera
    fit: FirstFrame

    @property
    def state(self) -> Array:
        """State (12,) of the fitted face, Eq. (2)."""
        return pack(self.fit.R, self.fit.t, self.fit.animation)


@dataclass(frozen=True)
class SyntheticSequence:
    """Frames and ground truth: R (n, 3, 3) head -> camera, t (n, 3), animation (n, 6), landmarks (n, 26, 2) pixels."""

    frames: tuple[Frame, ...]
    R: Array
    t: Array
    animation: Array
    landmarks: Array


def portrait() -> Portrait:
    """The portrait from scikit-image, at 320x240 pixels, with the landmarks that are part of this package."""
    from skimage.data import astronaut  # slow to import

    A = np.hstack([PORTRAIT_ZOOM * np.eye(2), -PORTRAIT_ZOOM * np.array(PORTRAIT_CORNER)[:, None]])
    pixels = cv2.warpAffine(astronaut(), A, PORTRAIT_SIZE, flags=cv2.INTER_CUBIC)
    with as_file(files("mien") / "data" / "portrait_landmarks.json") as path:
        landmarks = read_landmarks(path)
    camera = Camera.from_fov(*PORTRAIT_SIZE)
    return Portrait(Frame(np.asarray(pixels, np.uint8)), landmarks, camera, fit_first_frame(landmarks, camera))


def moved(portrait: Portrait, angles_deg: Array, shift: Array, animation: Array) -> Array:
    """States (n, 12) of the portrait rotated by Euler angles (n, 3) in degrees, shifted by (n, 3) CANDIDE units in
    camera axes, with animation (n, 6) added to its own."""
    fit = portrait.fit
    return np.stack(
        [
            pack(matrix_from_euler(np.radians(angle)) @ fit.R, fit.t + dt, fit.animation + da)
            for angle, dt, da in zip(angles_deg, shift, animation, strict=True)
        ]
    )


def make_sequence(
    portrait: Portrait,
    states: Array,
    *,
    noise_sd: float = 0.0,
    gain: Array | None = None,
    occluders: Mapping[int, tuple[int, int, int, int]] | None = None,
    blank: Collection[int] = (),
    seed: int = 0,
) -> SyntheticSequence:
    """Render the portrait in the states (n, 12).

    noise_sd: standard deviation of the sensor noise in grey values; gain: (n,) brightness factors;
    occluders: frame -> occluded rectangle (x0, y0, x1, y1) in pixels; blank: frames that are black.
    """
    rng = np.random.default_rng(seed)
    poses = [unpack(b) for b in states]
    frames = []
    for index, image in enumerate(pictures(portrait, states)):
        if occluders and index in occluders:
            x0, y0, x1, y1 = occluders[index]
            image[y0:y1, x0:x1] = OCCLUDER_COLOUR
        if index in blank:
            image[:] = 0
        if gain is not None:
            image *= gain[index]
        image += rng.normal(0, noise_sd, image.shape) if noise_sd > 0 else 0
        frames.append(Frame(np.clip(np.round(image), 0, 255).astype(np.uint8), index, index / FPS))
    R, t, animation = (np.stack(values) for values in zip(*poses, strict=True))
    landmarks = np.stack([_project_landmarks(portrait, *pose) for pose in poses])
    return SyntheticSequence(tuple(frames), R, t, animation, landmarks)


def pictures(portrait: Portrait, states: Array) -> Iterator[Float32]:
    """The portrait in the states (n, 12), before noise and rounding: (H, W, 3) float32 images."""
    head = _HeadRenderer(portrait)
    return (head.draw(*unpack(b)) for b in states)


def _project_landmarks(portrait: Portrait, R: Array, t: Array, animation: Array) -> Array:
    X = portrait.fit.vertices(animation)[VERTICES]
    return portrait.camera.project(X @ R.T + t)[0]


class _HeadRenderer:
    """Draws the textured head: the mesh, the mouth between the lips, and the rim that fades out."""

    def __init__(self, portrait: Portrait) -> None:
        self.fit, self.frame = portrait.fit, portrait.frame
        self.triangles = np.vstack([self.fit.model.triangles, MOUTH_TRIANGLES, _rim_triangles(len(self.fit.shape))])
        s = SUPERSAMPLING
        camera = portrait.camera
        self.camera = Camera(camera.focal_px * s, camera.cx * s + (s - 1) / 2, camera.cy * s + (s - 1) / 2)
        uv = camera.project(self._vertices(self.fit.animation) @ self.fit.R.T + self.fit.t)[0]
        self.texture = Texture(_fading(self.frame.pixels, uv), uv)
        self.background = _background(self.frame.pixels, uv)

    def _vertices(self, animation: Array) -> Array:
        """Vertices in head axes: those of the model, then those of the rim."""
        vertices = self.fit.vertices(animation)
        outline = vertices[list(_OUTLINE)]
        rim = outline + RIM_WIDTH * (outline - outline.mean(axis=0)) * [1, 1, 0] - [0, 0, RIM_DEPTH]
        return np.vstack([vertices, rim])

    def draw(self, R: Array, t: Array, animation: Array) -> Float32:
        """(H, W, 3) float32 image of the head in this state in front of the background."""
        size = (self.frame.width, self.frame.height)
        large = (SUPERSAMPLING * size[0], SUPERSAMPLING * size[1])
        X = self._vertices(animation) @ R.T + t
        drawn = render(X, self.triangles, self.texture, self.camera, *large).image
        drawn = cv2.resize(drawn, size, interpolation=cv2.INTER_AREA)
        return np.asarray(drawn[..., :3] + (1 - drawn[..., 3:]) * self.background, np.float32)


def _rim_triangles(vertex_count: int) -> NDArray[np.intp]:
    """Triangles of the band between the outline, clockwise seen from outside, and the vertices of the rim."""
    n = len(_OUTLINE)
    ring = [(_OUTLINE[k], _OUTLINE[(k + 1) % n], vertex_count + k, vertex_count + (k + 1) % n) for k in range(n)]
    return np.array([t for a, b, c, d in ring for t in ((a, d, c), (a, b, d))], dtype=np.intp)


def _fading(pixels: Pixels, uv: Array) -> Float32:
    """The image premultiplied by its opacity, which is the fourth channel: 1 on the face, 0 at the end of the rim."""
    outline, rim = uv[list(_OUTLINE)], uv[-len(_OUTLINE) :]
    width = float(np.linalg.norm(rim - outline, axis=1).mean()) / 6
    opacity = cv2.GaussianBlur(_filled(0.4 * outline + 0.6 * rim, pixels).astype(np.float32), (0, 0), width)[..., None]
    return np.asarray(np.concatenate([pixels * opacity, opacity], axis=2), np.float32)


def _background(pixels: Pixels, uv: Array) -> Float32:
    """The portrait with the head inpainted, out of focus: (H, W, 3) float32."""
    without = cv2.inpaint(pixels, _filled(uv[-len(_OUTLINE) :], pixels), 5, cv2.INPAINT_TELEA)
    return np.asarray(cv2.GaussianBlur(without, (0, 0), 6), np.float32)


def _filled(polygon: Array, pixels: Pixels) -> Pixels:
    """Mask (H, W), 1 inside the polygon (n, 2)."""
    mask = np.zeros(pixels.shape[:2], np.uint8)
    cv2.fillPoly(mask, [np.round(polygon).astype(np.int32)], (1,))
    return mask
