"""Training of the real-time tracker: from the first frame to the appearance of its landmarks by pose."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from mien.appearance.crop import Crop, blurred
from mien.appearance.descriptors import Float32, describe_with_jacobian, orientation_maps
from mien.appearance.eyes import close_eye, turn_eye
from mien.appearance.regression import PoseRegression
from mien.appearance.rendering import Image, Texture, render, vertex_normals
from mien.appearance.surface import Surface, face_surface, on_surface
from mien.appearance.texture import texture_of_vertices
from mien.appearance.views import CENTRE, crop_of_face, rotation
from mien.compiled import kernel
from mien.config import DescriptorSettings, RealtimeSettings
from mien.frame import Frame, Pixels
from mien.geometry.camera import Camera
from mien.geometry.rotation import Array
from mien.initialization.fit import FirstFrame
from mien.initialization.landmarks import LANDMARK_NAMES, Landmarks
from mien.tracking import kernels, pose_geometry

CROP_UNITS = 1.75
"""Side of a crop in CANDIDE units: the landmarks, their patches, and room to move."""
_EYE = ("eye_outer_corner", "eye_inner_corner", "eyelid_upper_mid", "eyelid_lower_mid")
_EYES = (close_eye, 0.5), (close_eye, 1.0), (turn_eye, -0.2), (turn_eye, 0.2)
"""What the eyes do in the views that show them moved, in turn: half closed, shut, looking to either side."""
_EYE_VIEWS = 4
_CLEAR = 0.5
"""Depth behind the face's own surface, as a share of the depth at which a landmark is hidden, beyond which a view
teaches nothing of it."""
_LIT_VIEWS = 2
"""One view in so many is rendered in another light, too. Light goes into the covariance, not into the mean: with a
random light in each view, the mean would be as random."""
_CORNERS = [LANDMARK_NAMES.index(f"{side}_mouth_corner_outer") for side in ("right", "left")]
"""Landmarks that move over skin that stays: the patches whose motion is measured are small there."""


@dataclass(frozen=True)
class Level:
    """One resolution of the appearance: its crop, the descriptors by pose, and the changes (4, n, 128) of the
    descriptors when the eyes do what `_EYES` says. views: tilts and pans (2, k) in radians of the k x k views; behind:
    (k, k, n) how far each landmark lies behind the face's own surface there, CANDIDE units."""

    descriptor: DescriptorSettings
    size: int
    appearance: PoseRegression
    eyes: Float32
    views: Array
    behind: Float32

    def depth_behind(self, angles: Array) -> Float32:
        """How far (n,) the landmarks lie behind the face's own surface in the view nearest to a tilt and pan (2,)."""
        return np.asarray(self.behind[_nearest(self.views[0], angles[0]), _nearest(self.views[1], angles[1])])

    def lack_of_fit(self, angles: Array) -> Float32:
        """Squared distance (n,) between rendered and predicted descriptors at a tilt and pan (2,), interpolated between
        the nearest four views."""
        k = self.views.shape[1]
        fit: Float32 = _bilinear_lookup(self.appearance.lack_of_fit.reshape(k, k, -1), self.views, angles)
        return fit

    def crop(self, R: Array, t: Array, camera: Camera) -> Crop:
        """The crop of a frame for a face at a pose, with the scale and the roll of the face."""
        return crop_of_face(R, t, camera, self.descriptor.pixels_per_unit, self.size, upright=False)


@kernel()
def _nearest(views: Any, angle: float) -> int:
    """Index of the view angle (k,) nearest to an angle."""
    nearest = 0
    for k in range(views.size):
        if abs(views[k] - angle) < abs(views[nearest] - angle):
            nearest = k
    return nearest


@kernel()
def _bilinear_lookup(table: Any, views: Any, angles: Any) -> Any:
    """Row (n,) of a table (k, k, n) over the views' tilts and pans (2, k) at a tilt and pan (2,), by bilinear
    interpolation; constant beyond the last view."""
    row, down = _bracket(views[0], angles[0])
    column, right = _bracket(views[1], angles[1])
    a, b, c, d = table[row, column], table[row, column + 1], table[row + 1, column], table[row + 1, column + 1]
    out = np.empty(a.size, np.float32)
    for i in range(out.size):
        out[i] = (1 - down) * ((1 - right) * a[i] + right * b[i]) + down * ((1 - right) * c[i] + right * d[i])
    return out


@kernel()
def _bracket(views: Any, angle: float) -> Any:
    """Index of the view before an angle, among increasing angles (k,), and the position between it and the next, in [0,
    1]."""
    k = 0
    while k < views.size - 2 and views[k + 1] <= angle:
        k += 1
    return k, min(max((angle - views[k]) / (views[k + 1] - views[k]), 0.0), 1.0)


@dataclass(frozen=True)
class LearnedFace:
    """The result of training: neutral landmarks (n, 3), their normals (n, 3) and the surface around each (n, m, 3),
    relative to it, in head axes; the coarse and the fine level."""

    neutral: Array
    normals: Array
    patches: Array
    coarse: Level
    fine: Level


def learn_face(
    frame: Frame, landmarks: Landmarks, fit: FirstFrame, camera: Camera, vertices: list[int], settings: RealtimeSettings
) -> LearnedFace:
    """Render the first frame's face from a grid of tilts and pans and regress the descriptors on them."""
    surface = face_surface(landmarks, fit, camera)
    points = on_surface(fit.vertices()[vertices] @ fit.R.T + fit.t, surface, camera)
    normals = _normals_at(points, surface, camera) @ fit.R
    part, near = _cut_out(frame, surface, camera)
    pixels = near.project(points)[0]
    eyes = tuple(_with_eyes(part, pixels, draw, share) for draw, share in _EYES)
    background = float(frame.gray.mean())
    posed = _PosedFace(part, eyes, background, surface, (points - fit.t) @ fit.R, normals, fit, near)
    coarse, fine = (_learn_level(posed, d, settings) for d in (settings.coarse, settings.descriptor))
    neutral = posed.points - np.tensordot(fit.animation, fit.model.animation_units[:, vertices], axes=1)
    patches = (_patches_on(surface, points, fit, camera, settings) - points[:, None]) @ fit.R
    return LearnedFace(neutral, normals, np.ascontiguousarray(patches), coarse, fine)


@dataclass(frozen=True)
class _PosedFace:
    """The face of the first frame: points and normals (n, 3) in head axes; the part of the frame that shows it, as it
    is and with the eyes moved as `_EYES` says, its camera, and the grey value behind it."""

    frame: Frame
    eyes: tuple[Frame, ...]
    background: float
    surface: Surface
    points: Array
    normals: Array
    fit: FirstFrame
    camera: Camera


def _learn_level(face: _PosedFace, d: DescriptorSettings, s: RealtimeSettings) -> Level:
    fit, triangles = face.fit, face.surface.triangles
    distance = float(fit.t[2])
    texture, *textures = (_texture(face, frame, d.pixels_per_unit) for frame in (face.frame, *face.eyes))
    head = (face.surface.vertices - fit.t) @ fit.R
    size = round(CROP_UNITS * d.pixels_per_unit)
    # The head stands on the optical axis: what a view shows depends on the ray to the head, not on its place.
    view = Camera.centred(d.pixels_per_unit * distance, size, size)
    limit = np.radians([s.view_limit_tilt_deg, s.view_limit_pan_deg])
    evenly = np.linspace(-1, 1, s.views_per_angle)
    angles = np.outer(limit, np.sign(evenly) * np.abs(evenly) ** s.view_crowding)
    normals = vertex_normals(head, triangles)
    rng = np.random.default_rng(0)

    def look(posed: tuple[Array, Array], picture: Texture, light: Array | None = None) -> tuple[Float32, Image]:
        vertices, points = posed
        drawn = render(vertices, triangles, picture, view, size, size, face.background, light)
        maps = orientation_maps(blurred(drawn.image[:, :, 0], d.blur), d.cell)
        # Tracking compiles this kernel anyway, the one without derivatives would take half a second more.
        return describe_with_jacobian(maps, view.project(points)[0], d.cell, d.root)[0], drawn.depth

    samples, terms, weight, behind, eyes, lights = [], [], [], [], [], []
    for k, (tilt, pan) in enumerate(product(*angles)):
        R = rotation(tilt, pan, 0.0)
        t = np.array([0, 0, distance]) - R @ CENTRE
        posed = head @ R.T + t, face.points @ R.T + t
        seen, depth = look(posed, texture)
        samples.append(seen)
        if k % _EYE_VIEWS == 0:
            eyes.append(look(posed, textures[k // _EYE_VIEWS % len(_EYES)])[0] - seen)
        if k % _LIT_VIEWS == 0:
            lights.append(look(posed, texture, random_light(normals @ R.T, s.light_contrast, rng))[0] - seen)
        terms.append(kernels.polynomial(tilt, pan, limit)[0])
        behind.append(_depth_behind(posed[1], depth, view))
        facing = pose_geometry.facing_camera(posed[1], face.normals, R, view.vector, size, size, s.hidden_cosine)
        towards = -np.sum(face.normals @ R.T * posed[1], axis=1) / np.linalg.norm(posed[1], axis=1)
        clear = facing & (behind[-1] < _CLEAR * s.hidden_depth)
        weight.append(clear * (s.sidelong_weight + (1 - s.sidelong_weight) * np.maximum(towards, 0) ** 2))
    shares = ((eyes, s.eye_share), (lights, 1.0))
    changes = [np.array(looks) * np.float32(math.sqrt(share / len(looks))) for looks, share in shares]
    appearance = PoseRegression.learn(
        np.array(samples), np.array(terms), np.array(weight), limit, s.floor, s.rank, np.concatenate(changes)
    )
    moved_eyes = np.stack([np.mean(eyes[k :: len(_EYES)], axis=0) for k in range(len(_EYES))])
    grid = len(evenly), len(evenly), -1
    return Level(d, size, appearance, moved_eyes, angles, np.reshape(behind, grid).astype(np.float32))


def _depth_behind(points: Array, depth: Image, camera: Camera) -> Array:
    """How far (n,) points (n, 3) in camera axes lie behind a surface with this depth image (H, W); minus infinity where
    there is no surface."""
    last = np.array(depth.shape[::-1]) - 1
    x, y = np.clip(np.round(camera.project(points)[0]), 0, last).astype(int).T
    return np.asarray(points[:, 2] - depth[y, x])


def _cut_out(frame: Frame, surface: Surface, camera: Camera) -> tuple[Frame, Camera]:
    """The part of a frame that shows the surface, and its camera, so that the cost of training depends on the face
    alone."""
    pixels, size = camera.project(surface.vertices)[0], np.array([frame.width, frame.height])
    x0, y0 = np.clip(np.floor(pixels.min(axis=0)).astype(int) - 1, 0, size - 1)
    x1, y1 = np.clip(np.ceil(pixels.max(axis=0)).astype(int) + 2, 1, size)
    gray = frame.gray_part(slice(y0, y1), slice(x0, x1))  # the same grey as will be tracked, also where eyes are drawn
    part = Frame(np.repeat(gray[:, :, None], 3, axis=2), frame.index, frame.time)
    return part, replace(camera, cx=camera.cx - x0, cy=camera.cy - y0)


def _texture(face: _PosedFace, frame: Frame, pixels_per_unit: float) -> Texture:
    """The surface textured with the first frame, or with a picture made from it."""
    return texture_of_vertices(frame, face.surface.vertices, float(face.fit.t[2]), face.camera, pixels_per_unit)


def _with_eyes(frame: Frame, points: Array, draw: Callable[..., Pixels], share: float) -> Frame:
    """The frame with both eyes, at the landmarks' image points (n, 2), closed or turned to the right of the image."""
    pixels = frame.pixels
    for side in ("right", "left"):
        outer, inner, upper, lower = (points[LANDMARK_NAMES.index(f"{side}_{part}")] for part in _EYE)
        corners = [outer, inner] if side == "right" else [inner, outer]
        pixels = draw(pixels, np.array(corners), np.array([upper, lower]), share)
    return Frame(pixels, frame.index, frame.time)


def _patches_on(surface: Surface, points: Array, fit: FirstFrame, camera: Camera, settings: RealtimeSettings) -> Array:
    """Grids (n, m, 3) of points on the surface around points (n, 3), camera axes, regular in the first frame's
    image."""
    side = np.linspace(-1, 1, settings.motion_grid) * camera.focal_px / fit.t[2]
    grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    half = np.full(len(points), settings.motion_patch)
    half[_CORNERS] = settings.motion_corner
    pixels = camera.project(points)[0][:, None] + grid * half[:, None, None]
    grids = np.ones((*pixels.shape[:2], 3))
    grids[..., :2] = (pixels - [camera.cx, camera.cy]) / camera.focal_px
    grids *= points[:, None, 2:]
    return on_surface(grids.reshape(-1, 3), surface, camera).reshape(grids.shape)


def random_light(normals: Array, contrast: float, rng: np.random.Generator) -> Array:
    """Brightness (V,) of a matt surface with normals (V, 3) in camera axes, lit from a random direction."""
    direction = np.append(rng.standard_normal(2), 0.0)
    direction *= contrast * rng.uniform(-1, 1) / np.linalg.norm(direction)
    return np.asarray(np.exp(normals @ direction))


def _normals_at(points: Array, surface: Surface, camera: Camera) -> Array:
    """Normals (n, 3) in camera axes at the vertices of the face that are nearest to the points in the image."""
    face = surface.vertices[: surface.face]
    normals = vertex_normals(surface.vertices, surface.triangles)[: surface.face]
    p, q = camera.project(face)[0], camera.project(points)[0]
    return np.asarray(normals[((q[:, None] - p[None]) ** 2).sum(axis=2).argmin(axis=1)])
