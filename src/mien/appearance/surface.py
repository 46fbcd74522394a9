"""The surface that is rendered for learning: the face of the first frame and what surrounds it.

CANDIDE's 113 vertices are too few for the relief of a patch around a landmark. Where the first frame's landmarks
come with depths they are a surface themselves, of 468 points; otherwise CANDIDE is drawn. A skirt behind the
outline carries the first frame's surroundings along, so that patches at the chin and the brows do not look into
an empty background.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mien.arrays import Array
from mien.candide.model import MOUTH_TRIANGLES
from mien.compiled import kernel
from mien.errors import require
from mien.geometry.camera import Camera, at_distances, line_of_sight
from mien.initialization.fit import FirstFrame
from mien.initialization.landmarks import Landmarks

_SKIRT = ((0.12, 0.12), (0.3, 0.5))
"""Rings around the outline: distance outwards and backwards in CANDIDE units."""
_MESH_POINTS = 468  # the points of MediaPipe's face mesh; the ten after them are the irises
_EDGE = 1e-9
"""How far outside of a triangle a point on its edge may be, as a barycentric coordinate."""


@dataclass(frozen=True)
class Surface:
    """A mesh of vertices (V, 3) in camera axes that covers the first frame, and triangles (T, 3); the first `face`
    vertices are the face, the others its skirt."""

    vertices: Array
    triangles: NDArray[np.intp]
    face: int


def face_surface(landmarks: Landmarks, fit: FirstFrame, camera: Camera) -> Surface:
    """The surface of the face in the first frame, camera axes. Raises MienError for depths by which a part of it would
    be behind the camera."""
    if landmarks.depths is None:
        vertices = fit.in_camera()
        triangles = np.vstack([fit.model.triangles, MOUTH_TRIANGLES])
    else:
        vertices = _from_depths(landmarks, fit, camera)
        triangles = _triangulated(camera.project(vertices)[0])
    return _with_skirt(vertices, triangles, camera)


def on_surface(points: Array, surface: Surface, camera: Camera) -> Array:
    """Points (n, 3) in camera axes, moved along their rays onto the face; unchanged where the ray misses it."""
    face = surface.vertices[: surface.face]
    triangles = surface.triangles[(surface.triangles < surface.face).all(axis=1)]
    depth = _nearest(camera.project(face)[0], triangles, face[:, 2].copy(), camera.project(points)[0])
    return np.asarray(points * np.where(np.isfinite(depth), depth / points[:, 2], 1.0)[:, None])


def _triangulated(points: Array) -> NDArray[np.intp]:
    """Delaunay triangles (T, 3) of points (n, 2). By OpenCV: SciPy's module takes a tenth of a second to import."""
    near = np.asarray(points - points.min(axis=0) + 1, np.float32)
    width, height = np.ceil(near.max(axis=0)).astype(int).tolist()
    subdivision = cv2.Subdiv2D((0, 0, width + 1, height + 1))
    subdivision.insert(near)
    rows = {tuple(point): row for row, point in enumerate(near.tolist())}
    corners = np.asarray(subdivision.getTriangleList()).reshape(-1, 3, 2).tolist()
    found = [[rows.get(tuple(corner), -1) for corner in triangle] for triangle in corners]
    triangles = np.array(found, np.intp).reshape(-1, 3)
    return np.asarray(triangles[(triangles >= 0).all(axis=1)])  # some have a corner far outside


@kernel()
def _nearest(known: Any, triangles: Any, depths: Any, at: Any) -> Any:
    """Depth (n,) of the nearest of the triangles (T, 3) of vertices at points (V, 2) of the image, with depths (V,),
    that lie at points (n, 2); linear in each triangle, infinite beside all."""
    nearest = np.full(at.shape[0], np.inf)
    for k in range(triangles.shape[0]):
        a, b, c = triangles[k, 0], triangles[k, 1], triangles[k, 2]
        ax, ay, bx, by, cx, cy = known[a, 0], known[a, 1], known[b, 0], known[b, 1], known[c, 0], known[c, 1]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if area == 0.0:
            continue
        inverse = 1.0 / area
        for i in range(at.shape[0]):
            x, y = at[i, 0], at[i, 1]
            wa = ((bx - x) * (cy - y) - (cx - x) * (by - y)) * inverse
            wb = ((cx - x) * (ay - y) - (ax - x) * (cy - y)) * inverse
            wc = 1.0 - wa - wb
            if wa >= -_EDGE and wb >= -_EDGE and wc >= -_EDGE:
                nearest[i] = min(nearest[i], wa * depths[a] + wb * depths[b] + wc * depths[c])
    return nearest


def _cross(a: Array, b: Array) -> Array:
    """Twice the signed areas (n,) of the triangles that vectors a, b (n, 2) span."""
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _from_depths(landmarks: Landmarks, fit: FirstFrame, camera: Camera) -> Array:
    """The vertices given by the landmarks themselves, their relative depths anchored to the fitted model."""
    assert landmarks.depths is not None
    known, _, depths = landmarks.correspondences()
    assert depths is not None
    unit = float(fit.t[2]) / camera.focal_px  # CANDIDE units in a pixel at the distance of the face
    sight = line_of_sight(landmarks.points, camera)
    fitted = fit.in_camera()[known] @ sight
    distances = np.median(fitted - depths * unit) + landmarks.depths[:_MESH_POINTS] * unit
    vertices = at_distances(landmarks.points[:_MESH_POINTS], distances, sight, camera)
    require(
        bool(camera.project(vertices)[1].all()),
        f"{landmarks.source}: by its depths a part of the face lies behind the camera; give depths in pixels of the "
        "image that increase away from the camera, or none",
    )
    return vertices


def _with_skirt(vertices: Array, triangles: NDArray[np.intp], camera: Camera) -> Surface:
    outline = cv2.convexHull(camera.project(vertices)[0].astype(np.float32), returnPoints=False)[:, 0]
    ring = vertices[outline]
    middle = vertices.mean(axis=0)
    sight = middle / np.linalg.norm(middle)
    outwards = ring - middle
    outwards -= (outwards @ sight)[:, None] * sight
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    parts, strips, inner = [vertices], [triangles], outline
    for distance, backwards in _SKIRT:
        outer = sum(len(p) for p in parts) + np.arange(len(ring))
        parts.append(ring + outwards * distance + sight * backwards)
        after_inner, after_outer = np.roll(inner, -1), np.roll(outer, -1)
        strips += [np.column_stack([inner, after_inner, outer]), np.column_stack([after_inner, after_outer, outer])]
        inner = outer
    all_vertices = np.concatenate(parts)
    return Surface(all_vertices, _facing(all_vertices, np.concatenate(strips), camera), len(vertices))


def _facing(vertices: Array, triangles: NDArray[np.intp], camera: Camera) -> NDArray[np.intp]:
    """Order the corners of the triangles so that each faces the camera of the first frame."""
    a, b, c = (camera.project(vertices)[0][triangles[:, k]] for k in range(3))
    away = _cross(b - a, c - a) > 0
    return np.where(away[:, None], triangles[:, [0, 2, 1]], triangles)
