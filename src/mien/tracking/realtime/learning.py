"""Training of the real-time tracker: from the first frame to the appearance of its landmarks by pose."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np

from mien.appearance.crop import blurred
from mien.appearance.descriptors import LENGTH, describe_with_jacobian, orientation_maps
from mien.appearance.eyes import close_eye, turn_eye
from mien.appearance.quality import noise_image, noise_sd
from mien.appearance.regression import PoseRegression
from mien.appearance.rendering import Texture, render, vertex_normals
from mien.appearance.surface import Surface, face_surface, on_surface
from mien.appearance.texture import texture_of_vertices
from mien.appearance.views import CENTRE, rotation
from mien.arrays import Array, Float32, Pixels
from mien.config import DescriptorSettings, RealtimeSettings
from mien.config.realtime import MotionSettings
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING
from mien.initialization.fit import FirstFrame
from mien.initialization.landmarks import EYE_PARTS, LANDMARK_NAMES, MOUTH_CORNERS, Landmarks
from mien.threads import one_blas_thread
from mien.tracking.realtime import kernels, pose_geometry
from mien.tracking.realtime.level import Level, Noise
from mien.tracking.realtime.skin import BROWS, CHIN, CORNERS, UPPER_LIP

CROP_UNITS = 1.75
"""Side of a crop in CANDIDE units: the landmarks, their patches, and room to move."""
_EYES = (close_eye, 0.5), (close_eye, 1.0), (turn_eye, -0.2), (turn_eye, 0.2)
"""What the eyes do in the views that show them moved, in turn: half closed, shut, looking to either side."""
_MIRRORED_EYES = (0, 1, 3, 2)
"""Which of these the mirror image of a face shows."""
_EYE_VIEWS = 2
"""Every how many pairs of views show them so."""
_CLEAR = 0.5
"""Depth behind the face's own surface, as a share of the depth at which a landmark is hidden, beyond which a view
teaches nothing of it."""
_PLASTIC = 1.32471795724474602596
"""The number x with x^3 = x + 1."""
_LEAST_NOISE, _NOISE_SAMPLES = 1.0, 4
"""Standard deviation, in grey values, below which noise changes next to nothing, and how often it is tried."""
_NOISE_FACTOR = 1.35
"""What noise adds to squared distances, as a factor of what it adds to those between two views: the views show that of
the first frame, too. Between 1.2 and 1.5 on rendered heads in noise of 6 to 20 grey values."""
_TURNED_VIEWS = 2
"""Pans to either side that are rendered in addition for a face that has turned aside."""


@dataclass(frozen=True)
class LearnedFace:
    """The result of training: neutral landmarks (n, 3), their normals (n, 3) and the surface around each (n, m, 3),
    relative to it, in head axes; likewise the skin of the chin (k, 3), above the upper lip (l, 3), around the right
    and the left corner of the mouth (2, j, 3), and of the right and the left brow (2, i, 3), relative to the carriers
    of these regions; the coarse and the fine level."""

    neutral: Array
    normals: Array
    patches: Array
    chin: Array
    upper_lip: Array
    corners: Array
    brows: Array
    coarse: Level
    fine: Level


def learn_face(
    frame: Frame, landmarks: Landmarks, fit: FirstFrame, camera: Camera, vertices: list[int], settings: RealtimeSettings
) -> LearnedFace:
    """Render the first frame's face from a grid of tilts and pans and regress the descriptors on them."""
    surface = face_surface(landmarks, fit, camera)
    points = on_surface(fit.in_camera()[vertices], surface, camera)
    normals = _normals_at(points, surface, camera) @ fit.R
    part, near = _cut_out(frame, surface, camera)
    pixels = near.project(points)[0]
    eyes = tuple(_with_eyes(part, pixels, draw, share) for draw, share in _EYES)
    background = _around(part.gray)
    noise = noise_sd(part.gray)
    first = _FirstFace(part, eyes, background, noise, surface, (points - fit.t) @ fit.R, normals, fit, near)
    coarse = _learn_level(first, settings.coarse, settings.views.coarse_per_angle, settings)
    fine = _learn_level(first, settings.descriptor, settings.views.per_angle, settings)
    neutral = first.points - np.tensordot(fit.animation, fit.model.animation_units[:, vertices], axes=1)
    patches = _around_each(points, _patches(len(points), settings.motion), surface, fit, camera)
    chin, upper_lip, *sides = (
        _around_each(points[[region.carrier]], _in_image(region.offsets, fit.R), surface, fit, camera)[0]
        for region in (CHIN, UPPER_LIP, *CORNERS.sides, *BROWS.sides)
    )
    corners, brows = np.stack(sides[:2]), np.stack(sides[2:])
    return LearnedFace(neutral, normals, patches, chin, upper_lip, corners, brows, coarse, fine)


@dataclass(frozen=True)
class _FirstFace:
    """The face of the first frame: points and normals (n, 3) in head axes; the part of the frame that shows it, as it
    is and with the eyes moved as `_EYES` says, its camera, the grey value behind it, and the standard deviation of its
    noise."""

    frame: Frame
    eyes: tuple[Frame, ...]
    background: float
    noise: float
    surface: Surface
    points: Array
    normals: Array
    fit: FirstFrame
    camera: Camera


@dataclass(frozen=True)
class _InViews:
    """The face in one or more views: rotations R (..., 3, 3), surface (..., V, 3) and landmarks (..., n, 3) in camera
    axes, and where these are in the image, pixels (..., n, 2)."""

    R: Array
    vertices: Array
    points: Array
    pixels: Array

    def of(self, view: tuple[int, ...]) -> _InViews:
        """One of the views."""
        return _InViews(self.R[view], self.vertices[view], self.points[view], self.pixels[view])


class _ViewRenderer:
    """Renders the face of the first frame at the resolution of a level, and describes its landmarks.

    texture, moved_eyes: the textures of the frame as it is, and with the eyes as `_EYES` says; camera: sees the head on
    its optical axis, since what a view shows depends on the ray to the head, and not on its position.
    """

    def __init__(self, face: _FirstFace, descriptor: DescriptorSettings) -> None:
        fit, d = face.fit, descriptor
        self.face, self.descriptor, self.distance = face, d, float(np.linalg.norm(fit.t))
        frames = (face.frame, *face.eyes)
        self.texture, *self.moved_eyes = (_texture(face, frame, d.pixels_per_unit) for frame in frames)
        self.head = (face.surface.vertices - fit.t) @ fit.R
        self.normals = vertex_normals(self.head, face.surface.triangles)
        self.size = round(CROP_UNITS * d.pixels_per_unit)
        self.camera = Camera.centred(d.pixels_per_unit * self.distance, self.size, self.size)

    def posed(self, R: Array) -> _InViews:
        """The face at rotations R (..., 3, 3)."""
        turned = np.swapaxes(R, -1, -2)
        t = (np.array([0, 0, self.distance]) - R @ CENTRE)[..., None, :]
        points = self.face.points @ turned + t
        return _InViews(R, self.head @ turned + t, points, self.camera.project(points)[0])

    @property
    def scale(self) -> float:
        """Pixels of a view for one of the frame."""
        return self.descriptor.pixels_per_unit * float(self.face.fit.t[2]) / self.face.camera.focal_px

    def describe(
        self,
        posed: _InViews,
        texture: Texture,
        light: Array | None = None,
        noise: Float32 | None = None,
    ) -> tuple[Float32, Float32, Float32]:
        """Descriptors (n, 128) of the landmarks in a view, the same in a light (V,), see `render`, and its depth image;
        noise (size, size): added to the grey values."""
        d, face, size = self.descriptor, self.face, self.size
        drawn = render(posed.vertices, face.surface.triangles, texture, self.camera, size, size, face.background, light)

        def of(image: Float32) -> Float32:
            maps = orientation_maps(blurred(image if noise is None else image + noise, d.blur), d.cell)
            # Tracking compiles this kernel anyway, the one without derivatives would take half a second more.
            return describe_with_jacobian(maps, posed.pixels, d.cell, d.root)[0]

        seen = of(drawn.image[:, :, 0])
        return seen, seen if light is None else of(drawn.lit[:, :, 0]), drawn.depth

    def weight(self, posed: _InViews, behind: Array, s: RealtimeSettings) -> Array:
        """How much views teach of each landmark, (..., n) in [0, 1]: nothing where it is hidden, little where it is
        seen edge-on. behind: (..., n) see `_depth_behind`."""
        points, normals, camera = posed.points, self.face.normals, (self.camera.vector, self.size, self.size)
        facing = np.empty(behind.shape, bool)
        for view in np.ndindex(facing.shape[:-1]):
            of_view = points[view], normals, posed.R[view]
            facing[view] = pose_geometry.facing_camera(*of_view, *camera, s.visibility.hidden_cosine)
        normals = normals @ np.swapaxes(posed.R, -1, -2)
        cosine = -np.sum(normals * points, axis=-1) / np.linalg.norm(points, axis=-1)
        clear = facing & (behind < _CLEAR * s.visibility.hidden_depth)
        least = s.views.sidelong_weight
        return np.asarray(clear * (least + (1 - least) * np.maximum(cosine, 0) ** 2))


@dataclass(frozen=True)
class _Views:
    """What k x l views at some tilts and pans, radians, show of n landmarks: descriptors (k, l, n, 128), how much each
    view teaches (k, l, n), and how far the landmarks lie behind the surface (k, l, n)."""

    tilts: Array
    pans: Array
    seen: Float32
    weight: Float32
    behind: Float32

    def beside(self, others: _Views) -> _Views:
        """These views and others at the same tilts, in the order of their pans."""
        pans = np.concatenate([self.pans, others.pans])
        order = np.argsort(pans)
        pairs = (self.seen, others.seen), (self.weight, others.weight), (self.behind, others.behind)
        return _Views(self.tilts, pans[order], *(np.concatenate(pair, axis=1)[:, order] for pair in pairs))


@dataclass(frozen=True)
class _Changes:
    """Changes (m, n, 128) of the descriptors in some views: when the eyes do each of what `_EYES` says, when the light
    moves, and by the noise of the picture; contrast: the fraction of the differences of descriptors that noise
    leaves."""

    eyes: tuple[Float32, ...]
    light: Float32
    noise: Float32
    contrast: float


def _learn_level(face: _FirstFace, descriptor: DescriptorSettings, per_angle: int, s: RealtimeSettings) -> Level:
    """The level of a resolution, from `per_angle` tilts and pans, which learns the one for a face that has turned aside
    when that is needed."""
    renderer, evenly = _ViewRenderer(face, descriptor), np.linspace(-1, 1, per_angle)
    limit = np.radians([s.views.limit_tilt_deg, s.views.limit_pan_deg])
    tilts, pans = np.outer(limit, np.sign(evenly) * np.abs(evenly) ** s.views.crowding)
    further = np.radians(np.linspace(s.views.limit_pan_deg, s.views.turned_limit_pan_deg, _TURNED_VIEWS + 1)[1:])
    lights = _mirrored_lights(len(tilts), len(pans), s.views.light_contrast)
    posed = renderer.posed(_rotations(tilts, pans))
    front, lit = _render_views(renderer, tilts, pans, posed, s, lights)
    changes = _render_changes(renderer, front, posed, lit)

    level = _regress(renderer, front, changes, s)
    return replace(level, learn_turned=partial(_learn_turned, renderer, front, further, changes, s))


@one_blas_thread()  # `track` itself does not limit it, and numbers must not depend on the processors
def _learn_turned(
    renderer: _ViewRenderer, front: _Views, further: Array, changes: _Changes, s: RealtimeSettings
) -> Level:
    """The level for a face that has turned aside: of the views at some tilts and pans, and of those at `further`
    pans, radians, to either side."""
    pans = np.concatenate([-further[::-1], further])
    aside, _ = _render_views(renderer, front.tilts, pans, renderer.posed(_rotations(front.tilts, pans)), s)
    return _regress(renderer, front.beside(aside), changes, s)


def _render_views(
    renderer: _ViewRenderer,
    tilts: Array,
    pans: Array,
    posed: _InViews,
    s: RealtimeSettings,
    lights: Array | None = None,
) -> tuple[_Views, Float32]:
    """Render the face as it is posed at these tilts and pans, and describe it. Returns what the views show, and their
    descriptors (k, l, n, 128) in a light for each, lights (k, l, 3), see `spread_lights`; without them the same."""
    light = None if lights is None else np.exp(renderer.normals @ np.swapaxes(posed.R, -1, -2) @ lights[..., None])
    shape = (*posed.points.shape[:-1], LENGTH)
    seen, lit, behind = np.empty(shape, np.float32), np.empty(shape, np.float32), np.empty(shape[:-1])
    for view in np.ndindex(posed.R.shape[:2]):
        one, of_view = posed.of(view), None if light is None else light[view][:, 0]
        seen[view], lit[view], depth = renderer.describe(one, renderer.texture, of_view)
        behind[view] = _depth_behind(one, depth)
    weight = renderer.weight(posed, behind, s)
    return _Views(tilts, pans, seen, weight.astype(np.float32), behind.astype(np.float32)), lit


def _rotations(tilts: Array, pans: Array) -> Array:
    """Rotations (k, l, 3, 3) of the views at k tilts and l pans, radians."""
    return np.array([[rotation(tilt, pan, 0.0) for pan in pans] for tilt in tilts])


def _mirrored_pairs(tilts: int, pans: int) -> list[tuple[int, int, int]]:
    """Tilt and the two pans, as indices, of the pairs of views that are mirror images of each other: what changes in
    one changes mirrored in the other, so that the mirror image of a face is learned like the face."""
    return [(i, j, pans - 1 - j) for i in range(tilts) for j in range((pans + 1) // 2)]


def _mirrored_lights(tilts: int, pans: int, contrast: float) -> Array:
    """A light (tilts, pans, 3) for each view, see `spread_lights`."""
    lights, pairs = np.empty((tilts, pans, 3)), _mirrored_pairs(tilts, pans)
    for (i, j, mirrored), light in zip(pairs, spread_lights(len(pairs), contrast), strict=True):
        lights[i, j], lights[i, mirrored] = light, light * [-1, 1, 1]
    return lights


def _render_changes(renderer: _ViewRenderer, views: _Views, posed: _InViews, lit: Float32) -> _Changes:
    """What light changes in the views, whose descriptors in it are `lit` (k, l, n, 128), and eyes that move in some,
    rendered once more. Light goes into the covariance, not into the mean, which would depend on where it comes from in
    which view."""
    eyes: tuple[list[Float32], ...] = tuple([] for _ in _EYES)
    for k, (i, *columns) in enumerate(_mirrored_pairs(len(views.tilts), len(views.pans))[::_EYE_VIEWS]):
        moved = k % len(_EYES)
        for j, shown in zip(columns, (moved, _MIRRORED_EYES[moved]), strict=True):
            described = renderer.describe(posed.of((i, j)), renderer.moved_eyes[shown])[0]
            eyes[shown].append(described - views.seen[i, j])
    lights = (lit - views.seen).reshape(-1, *views.seen.shape[2:])
    return _Changes(tuple(np.array(shown) for shown in eyes), lights, *_changes_by_noise(renderer))


def _changes_by_noise(renderer: _ViewRenderer) -> tuple[Float32, float]:
    """Changes (m, n, 128) of the descriptors of the face from the front, and the fraction of their differences that is
    left; none, and all, where there is hardly any noise."""
    sd = renderer.face.noise
    if sd < _LEAST_NOISE:
        return np.zeros((1, len(renderer.face.points), LENGTH), np.float32), 1.0
    rng, posed = np.random.default_rng(0), renderer.posed(FACING)
    clean = renderer.describe(posed, renderer.texture)[0]
    noise = (noise_image(sd, renderer.size, renderer.scale, rng) for _ in range(_NOISE_SAMPLES))
    noisy = np.array([renderer.describe(posed, renderer.texture, noise=shown)[0] for shown in noise])
    differ, left = clean - clean.mean(axis=0), noisy.mean(axis=0) - noisy.mean(axis=(0, 1))
    return noisy - clean, float((differ * left).sum() / (differ**2).sum())


def _regress(renderer: _ViewRenderer, views: _Views, changes: _Changes, s: RealtimeSettings) -> Level:
    """Regress what the views show on their tilts and pans."""
    limit = np.array([views.tilts[-1], views.pans[-1]])
    terms = np.array([kernels.polynomial(tilt, pan, limit)[0] for tilt, pan in product(views.tilts, views.pans)])
    samples, weight = (part.reshape(len(terms), *part.shape[2:]) for part in (views.seen, views.weight))
    shares = ((np.concatenate(changes.eyes), s.views.eye_share), (changes.light, 1.0))
    spread = np.concatenate([change * np.float32(math.sqrt(share / len(change))) for change, share in shares])
    appearance = PoseRegression.learn(samples, terms, weight, limit, s.covariance.floor, s.covariance.rank, spread)
    moved_eyes = np.stack([np.mean(moved, axis=0) for moved in changes.eyes])
    angles = (views.tilts, views.pans)
    noise = Noise(_NOISE_FACTOR * appearance.squared_norms(changes.noise).mean(axis=0), changes.contrast)
    return Level(renderer.descriptor, renderer.size, appearance, moved_eyes, angles, views.behind, noise)


def _depth_behind(posed: _InViews, depth: Float32) -> Array:
    """How far (n,) landmarks lie behind the surface in a view with this depth image (H, W); minus infinity where there
    is no surface."""
    last = np.array(depth.shape[::-1]) - 1
    x, y = np.clip(np.round(posed.pixels), 0, last).astype(int).T
    return np.asarray(posed.points[:, 2] - depth[y, x])


def _cut_out(frame: Frame, surface: Surface, camera: Camera) -> tuple[Frame, Camera]:
    """The part of a frame that shows the surface, and its camera, so that the cost of training depends on the face
    alone."""
    pixels, size = camera.project(surface.vertices)[0], np.array([frame.width, frame.height])
    x0, y0 = np.clip(np.floor(pixels.min(axis=0)).astype(int) - 1, 0, size - 1)
    x1, y1 = np.clip(np.ceil(pixels.max(axis=0)).astype(int) + 2, 1, size)
    gray = frame.gray_part(slice(y0, y1), slice(x0, x1))  # the same grey as will be tracked, also where eyes are drawn
    part = Frame(np.repeat(gray[:, :, None], 3, axis=2), frame.index, frame.time)
    return part, replace(camera, cx=camera.cx - x0, cy=camera.cy - y0)


def _around(gray: Pixels) -> float:
    """Mean of the outermost grey values (h, w): those of what is behind the face."""
    return float(np.concatenate([gray[0], gray[-1], gray[:, 0], gray[:, -1]]).mean())


def _texture(face: _FirstFace, frame: Frame, pixels_per_unit: float) -> Texture:
    """The surface textured with the first frame, or with a picture made from it."""
    return texture_of_vertices(frame, face.surface.vertices, float(face.fit.t[2]), face.camera, pixels_per_unit)


def _with_eyes(frame: Frame, points: Array, draw: Callable[..., Pixels], share: float) -> Frame:
    """The frame with both eyes, at the landmarks' image points (n, 2), closed or turned to the right of the image."""
    pixels = frame.pixels
    for side in ("right", "left"):
        outer, inner, upper, lower = (points[LANDMARK_NAMES.index(f"{side}_{part}")] for part in EYE_PARTS)
        corners = [outer, inner] if side == "right" else [inner, outer]
        pixels = draw(pixels, np.array(corners), np.array([upper, lower]), share)
    return Frame(pixels, frame.index, frame.time)


def _patches(count: int, settings: MotionSettings) -> Array:
    """Regular grids (n, m, 2) around as many landmarks in the image: right and down, CANDIDE units."""
    side = np.linspace(-1, 1, settings.grid)
    half = np.full(count, settings.patch)
    half[list(MOUTH_CORNERS)] = settings.corner  # these move over skin that stays
    grids: Array = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2) * half[:, None, None]
    return grids


def _around_each(points: Array, offsets: Array, surface: Surface, fit: FirstFrame, camera: Camera) -> Array:
    """Points (n, m, 3) on the surface around each of points (n, 3), camera axes, relative to it, head axes. offsets:
    (n, m, 2), or (m, 2) for all, of these in the first frame's image: right and down, CANDIDE units."""
    pixels = camera.project(points)[0][:, None] + offsets * camera.focal_px / fit.t[2]
    rays = camera.rays(pixels) * points[:, None, 2:]
    around = on_surface(rays.reshape(-1, 3), surface, camera).reshape(rays.shape)
    relative: Array = (around - points[:, None]) @ fit.R
    return np.ascontiguousarray(relative)


def _in_image(offsets: Array, R: Array) -> Array:
    """Offsets (m, 2), right and down of a face that looks into the camera, in an image of it at a rotation R (3, 3)."""
    return np.asarray(offsets @ np.stack([R[:2, 0], -R[:2, 1]]))


def spread_lights(count: int, contrast: float) -> Array:
    """Lights (count, 3) from all sides across the view, camera axes, of up to a contrast: each multiplies the
    brightness of a matt surface with normals N (V, 3) by `exp(N @ light)`. Spread evenly, so that what is learned does
    not depend on chance: multiples of powers of the plastic number, M. Roberts, 2018."""
    side, strength = np.outer(_PLASTIC ** np.array([-1.0, -2.0]), np.arange(1, count + 1)) % 1
    angle, strength = math.tau * side, contrast * (2 * strength - 1)
    return np.column_stack([strength * np.cos(angle), strength * np.sin(angle), np.zeros(count)])


def _normals_at(points: Array, surface: Surface, camera: Camera) -> Array:
    """Normals (n, 3) in camera axes at the vertices of the face that are nearest to the points in the image."""
    face = surface.vertices[: surface.face]
    normals = vertex_normals(surface.vertices, surface.triangles)[: surface.face]
    p, q = camera.project(face)[0], camera.project(points)[0]
    return np.asarray(normals[((q[:, None] - p[None]) ** 2).sum(axis=2).argmin(axis=1)])
