"""The surface that is rendered for learning: the face of the first frame and what surrounds it.

CANDIDE's 113 vertices are too few for the relief of a patch around a landmark. Where the first frame's landmarks
come with depths they are a surface themselves, of 468 points; otherwise CANDIDE is drawn. A skirt behind the
outline carries the first frame's surroundings along, so that patches at the chin and the brows do not look into
an empty background.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, Delaunay

from mien.arrays import Array
from mien.candide.model import MOUTH_TRIANGLES
from mien.errors import require
from mien.geometry.camera import Camera, at_distances, line_of_sight
from mien.initialization.fit import FirstFrame
from mien.initialization.landmarks import Landmarks

_SKIRT = ((0.12, 0.12), (0.3, 0.5))
"""Rings around the outline: distance outwards and backwards in CANDIDE units."""
_MESH_POINTS = 468  # the points of MediaPipe's face mesh; the ten after them are the irises


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
        triangles = np.asarray(Delaunay(camera.project(vertices)[0]).simplices, dtype=np.intp)
    return _with_skirt(vertices, triangles, camera)


def on_surface(points: Array, surface: Surface, camera: Camera) -> Array:
    """Points (n, 3) in camera axes, moved along their rays onto the face; unchanged where the ray misses it."""
    face = surface.vertices[: surface.face]
    depth = _interpolate(camera.project(face)[0], face[:, 2], camera.project(points)[0], points[:, 2])
    return np.asarray(points * (depth / points[:, 2])[:, None])


def _interpolate(known: Array, values: Array, at: Array, outside: Array) -> Array:
    """Values at points (n, 2) of the plane, linear in the triangles between known points (k, 2) with values (k,), and
    `outside` (n,) beyond them. scipy's LinearNDInterpolator does the same, but its module takes a third of a second to
    import; and the barycentric coordinates of its Delaunay call LAPACK for every triangle, which takes seconds with
    several threads on a busy machine."""
    triangulation = Delaunay(known)
    found = triangulation.find_simplex(at)
    corners = triangulation.simplices[found]
    a, b, c = (known[corners[:, k]] for k in range(3))
    with np.errstate(divide="ignore", invalid="ignore"):  # a triangle without an area has no inside
        areas = np.column_stack([_cross(b - at, c - at), _cross(c - at, a - at), _cross(a - at, b - at)])
        inside = (values[corners] * areas).sum(axis=1) / _cross(b - a, c - a)
    return np.where((found < 0) | ~np.isfinite(inside), outside, inside)


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
    outline = ConvexHull(camera.project(vertices)[0]).vertices
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
