"""A z-buffered renderer of a textured triangle mesh seen by a pinhole camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mien.arrays import Array, Float32
from mien.compiled import kernel
from mien.geometry.camera import Camera


@dataclass(frozen=True)
class Texture:
    """An image mapped onto a mesh: image (H, W, C) float32, and the position of each vertex in it, uv (V, 2) pixels."""

    image: Float32
    uv: Array


@dataclass(frozen=True)
class Rendering:
    """Rendered image (H, W, C) float32, the same image in another light, and depth (H, W) float32 with infinity where
    there is no surface."""

    image: Float32
    lit: Float32
    depth: Float32


def render(
    vertices: Array,
    triangles: NDArray[np.intp],
    texture: Texture,
    camera: Camera,
    width: int,
    height: int,
    background: Float32 | float = 0.0,
    light: Array | None = None,
) -> Rendering:
    """Draw a mesh: vertices (V, 3) in camera axes, triangles (T, 3) counter-clockwise seen from outside.

    Surfaces that face away are not drawn. Interpolation is perspective-correct, sampling bilinear. light: (V,)
    multiplies the texture at each vertex in `Rendering.lit`, which without it is the image itself.
    """
    channels = texture.image.shape[2]
    image = np.empty((height, width, channels), np.float32)
    image[:] = background
    depth = np.full((height, width), np.inf, np.float32)
    lit, gain = (image, np.ones(len(vertices))) if light is None else (image.copy(), light)
    # A copy: for those of the face model, which are read-only, the kernel would be compiled once more.
    _rasterize(vertices, camera.vector, triangles.copy(), texture.image, texture.uv, gain, image, lit, depth)
    return Rendering(image, lit, depth)


def depth_buffer(vertices: Array, triangles: NDArray[np.intp], camera: Camera, width: int, height: int) -> Float32:
    """Depth (H, W) of the mesh alone, infinity where there is none."""
    blank = Texture(np.zeros((1, 1, 1), np.float32), np.zeros((len(vertices), 2)))
    return render(vertices, triangles, blank, camera, width, height).depth


def vertex_normals(vertices: Array, triangles: NDArray[np.intp]) -> Array:
    """Unit normals (V, 3), the mean of the adjacent surfaces weighted by area; zero for unused vertices."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    face = np.cross(b - a, c - a)
    normals = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(normals, triangles[:, k], face)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12))


@kernel(fastmath={"contract", "reassoc", "arcp"})
def _rasterize(
    vertices: Any, camera: Any, triangles: Any, texture: Any, uv: Any, light: Any, image: Any, lit: Any, depth: Any
) -> None:
    """Draw what `render` describes. camera (3,): `Camera.vector`."""
    height, width, channels = image.shape
    th, tw = texture.shape[0], texture.shape[1]
    z, p = vertices[:, 2], np.empty((vertices.shape[0], 2))
    for k in range(p.shape[0]):
        for axis in range(2):
            p[k, axis] = camera[0] * vertices[k, axis] / z[k] + camera[1 + axis]
    for k in range(triangles.shape[0]):
        a, b, c = triangles[k, 0], triangles[k, 1], triangles[k, 2]
        if not (z[a] > 0 and z[b] > 0 and z[c] > 0):
            continue
        ax, ay, bx, by, cx, cy = p[a, 0], p[a, 1], p[b, 0], p[b, 1], p[c, 0], p[c, 1]
        # v points down, so a surface that faces the camera has a negative signed area.
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if area >= -1e-12:
            continue
        x0, x1 = max(int(np.ceil(min(ax, bx, cx))), 0), min(int(np.floor(max(ax, bx, cx))), width - 1)
        y0, y1 = max(int(np.ceil(min(ay, by, cy))), 0), min(int(np.floor(max(ay, by, cy))), height - 1)
        inverse, iza, izb, izc = 1.0 / area, 1.0 / z[a], 1.0 / z[b], 1.0 / z[c]
        da, db = (by - cy) * inverse, (cy - ay) * inverse
        for y in range(y0, y1 + 1):
            # The weights of the corners are linear in x: where all are positive is an interval.
            ea, eb = (bx * (cy - y) - cx * (by - y)) * inverse, (cx * (ay - y) - ax * (cy - y)) * inverse
            left, right = float(x0), float(x1)
            for e, by_x in ((ea, da), (eb, db), (1.0 - ea - eb, -da - db)):
                if by_x > 0.0:
                    left = max(left, -e / by_x)
                elif by_x < 0.0:
                    right = min(right, -e / by_x)
                elif e < 0.0:
                    right = left - 1.0
            if left > right:  # also where an edge that is all but level crosses this row far away
                continue
            for x in range(int(np.ceil(left)), int(np.floor(right)) + 1):
                wa, wb = ea + da * x, eb + db * x
                wa, wb, wc = wa * iza, wb * izb, (1.0 - wa - wb) * izc
                d = 1.0 / (wa + wb + wc)
                if d >= depth[y, x]:
                    continue
                depth[y, x] = d
                tx = (wa * uv[a, 0] + wb * uv[b, 0] + wc * uv[c, 0]) * d
                ty = (wa * uv[a, 1] + wb * uv[b, 1] + wc * uv[c, 1]) * d
                tx, ty = min(max(tx, 0.0), tw - 1.0), min(max(ty, 0.0), th - 1.0)
                ix, iy = min(int(tx), max(tw - 2, 0)), min(int(ty), max(th - 2, 0))
                jx, jy = min(ix + 1, tw - 1), min(iy + 1, th - 1)
                fx, fy = tx - ix, ty - iy
                gain = (wa * light[a] + wb * light[b] + wc * light[c]) * d
                for ch in range(channels):
                    top = texture[iy, ix, ch] * (1 - fx) + texture[iy, jx, ch] * fx
                    bottom = texture[jy, ix, ch] * (1 - fx) + texture[jy, jx, ch] * fx
                    value = top * (1 - fy) + bottom * fy
                    image[y, x, ch] = value
                    lit[y, x, ch] = gain * value
