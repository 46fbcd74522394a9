"""SIFT descriptors at given points, by our kernel or by OpenCV.

D. Lowe, Distinctive image features from scale-invariant keypoints, IJCV 60, 2004: 4x4 cells of eight gradient
orientations, interpolated linearly between cells and orientations, weighted by a Gaussian window, normalised,
clipped at 0.2, normalised again. The kernel builds the eight orientation maps of an image once, smooths them with
the triangle that linear interpolation between cells amounts to, and then reads a descriptor at any point, and
its derivative by the point, from sixteen bilinear samples. It weights by the Gaussian per cell where Lowe
weights per pixel; `tests/appearance/test_descriptors.py` holds it to OpenCV's descriptor.

`root` above 0 takes the square root of every entry, plus that constant, in place of clipping: distances between
such descriptors are those of Hellinger, in which a few strong edges no longer outweigh the rest (R. Arandjelovic and
A. Zisserman, Three things everyone should know to improve object retrieval, CVPR 2012).

A point's keypoint size in OpenCV's terms is `cell * 2 / 3`: a cell is 3 sizes / 2 wide.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import cv2
import numpy as np

from mien.arrays import Array, Float32
from mien.compiled import kernel

LENGTH = 128
CELLS = 16
ORIENTATIONS = 8

StretchArrays = tuple[Array, Array]
"""How what is seen around n points stretches where these move: where they would be if they had not (n, 2), and which
share (n, 16) of their motion each cell of their descriptors follows."""


def rigid(n: int) -> StretchArrays:
    """The stretch around n points whose cells follow them entirely, wherever they have been."""
    return np.zeros((n, 2)), np.ones((n, CELLS))


def orientation_maps(gray: Float32, cell: int, angle: float = 0.0) -> Float32:
    """Gradient magnitude by orientation, smoothed by a triangle of half width `cell`: (H, W) -> (H, W, 8).

    angle: direction in radians, from the u axis to the v axis, from which orientations are counted, up to half a turn.
    """
    height, width = gray.shape
    length = width * ORIENTATIONS
    triangle = _triangle(cell)
    turned = 8.0 - angle / (0.25 * math.pi)  # in units of 45 degrees, and positive
    maps = np.empty((height, width, ORIENTATIONS), np.float32)
    rows = np.zeros((2 * cell - 1, length), np.float32)
    row = np.zeros(length + 2 * cell * ORIENTATIONS, np.float32)
    _orientation_maps(gray, turned, triangle, rows, row, maps.reshape(height, length))
    return maps


@cache
def _triangle(cell: int) -> Float32:
    """Half of the filter, (cell + 1,), from the middle to the first zero."""
    return np.asarray(np.arange(cell, -1, -1, dtype=np.float32) / cell**2)


def describe(
    maps: Float32, points: Array, cell: int, root: float = 0.0, angle: float = 0.0, scale: float = 1.0
) -> Float32:
    """Descriptors of unit length (n, 128) at image points (n, 2). angle: that for which the maps were made; scale: of
    the grid, beside the cell that they were smoothed for."""
    out = np.empty((len(points), LENGTH), np.float32)
    describe_into(maps, points, (cell, root, angle, scale), out, None, rigid(len(points)))
    return out


def describe_with_jacobian(maps: Float32, points: Array, cell: int, root: float = 0.0) -> tuple[Float32, Float32]:
    """Descriptors (n, 128) and their derivative by the image point (n, 2, 128)."""
    out = np.empty((len(points), LENGTH), np.float32)
    J = np.empty((len(points), 2, LENGTH), np.float32)
    describe_into(maps, points, (cell, root, 0.0, 1.0), out, J, rigid(len(points)))
    return out, J


def describe_with_opencv(gray: Float32, points: Array, cell: int) -> Float32:
    """Upright SIFT descriptors by OpenCV, scaled to unit length (n, 128).

    OpenCV reads at the nearest pixel; a point outside the image is moved to its edge.
    """
    height, width = gray.shape
    inside = np.clip(points, 0, [width - 1, height - 1])
    keypoints = [cv2.KeyPoint(float(x), float(y), cell * 2 / 3, 0.0) for x, y in inside]
    _, descriptors = cv2.SIFT.create().compute(np.clip(gray, 0, 255).astype(np.uint8), keypoints)
    return _to_kernel_order(descriptors)


def _to_kernel_order(descriptors: Float32) -> Float32:
    """OpenCV's orientations turn the other way (its angle is 360 - angle, v counted upwards)."""
    d = descriptors.reshape(-1, 4, 4, ORIENTATIONS)
    d = d[:, :, :, (-np.arange(ORIENTATIONS)) % ORIENTATIONS]
    d = d.reshape(-1, LENGTH).astype(np.float32)
    return np.asarray(d / np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-12))


@kernel()
def _orientation_maps(gray: Any, turned: float, triangle: Any, rows: Any, row: Any, maps: Any) -> None:
    """Gradients by orientation, smoothed both ways by a symmetric filter, into maps (H, W * 8): row by row, so that
    intermediate results stay in the fastest cache.

    turned: see `_gradients`; triangle: half of the filter, from the middle to the first zero, (cell + 1,); rows (2 cell
    - 1, W * 8), zero: buffer of the rows that are smoothed into one; row (W * 8 + 16 cell,), zero: buffer of that one
    with its margins.
    """
    height, length = maps.shape
    cell, kept = triangle.size - 1, rows.shape[0]
    angles, magnitudes = np.empty(gray.shape[1], np.float32), np.empty(gray.shape[1], np.float32)
    across = row[8 * cell : 8 * cell + length]
    for newest in range(height + cell - 1):
        entries = rows[newest % kept]
        for i in range(length):
            entries[i] = 0.0
        if 0 < newest < height - 1:
            _gradients(gray[newest - 1 : newest + 2], np.float32(turned), angles, magnitudes, entries)
        y = newest - cell + 1
        if y < 0:
            continue
        below = y + kept
        _begin(across, triangle, rows[y % kept], rows[(below - 1) % kept], rows[(y + 1) % kept])
        for k in range(2, cell, 2):
            near = rows[(below - k) % kept], rows[(y + k) % kept]
            far = rows[(below - k - 1) % kept], rows[(y + k + 1) % kept]
            _add(across, triangle[k:], near, far)
        _begin(maps[y], triangle, across, row[8 * (cell - 1) :], row[8 * (cell + 1) :])
        for k in range(2, cell, 2):
            near = row[8 * (cell - k) :], row[8 * (cell + k) :]
            far = row[8 * (cell - k - 1) :], row[8 * (cell + k + 1) :]
            _add(maps[y], triangle[k:], near, far)


@kernel()
def _gradients(gray: Any, turned: Any, angles: Any, magnitudes: Any, entries: Any) -> None:
    """Magnitude of the gradient in the middle one of three rows (3, W), split between the two nearest of eight
    orientations, into entries (W * 8,), which are zero. turned: added to its angle, in units of 45 degrees, positive;
    angles and magnitudes (W,): buffers."""
    above, here, below = gray[0], gray[1], gray[2]
    one, c0, c1, c2 = np.float32(1.0), np.float32(0.2765881), np.float32(0.2582636), np.float32(0.1778958)
    for x in range(1, here.size - 1):  # without branches, so that it runs several pixels at a time
        gx = here[x + 1] - here[x - 1]
        gy = below[x] - above[x]
        ax, ay = abs(gx), abs(gy)
        r = min(ax, ay) / (max(ax, ay) + np.float32(1e-9))
        # atan(r) in units of 45 degrees, by a polynomial that is right to 0.01 degrees.
        angle = r * (one + (one - r) * (c0 + r * (c1 - c2 * r)))
        angle = np.float32(2.0) - angle if ay > ax else angle
        angle = np.float32(4.0) - angle if gx < 0 else angle
        angles[x] = (np.float32(8.0) - angle if gy < 0 else angle) + turned
        magnitudes[x] = np.sqrt(gx * gx + gy * gy)
    for x in range(1, here.size - 1):
        k = int(angles[x])
        f = angles[x] - np.float32(k)
        entries[8 * x + (k & 7)] = magnitudes[x] * (one - f)
        entries[8 * x + ((k + 1) & 7)] = magnitudes[x] * f


@kernel(inline="always")
def _begin(out: Any, weights: Any, middle: Any, before: Any, after: Any) -> None:
    """Set out (m,) to the first m entries of the middle row and of its two neighbours, with two weights."""
    here, beside = weights[0], weights[1]
    for i in range(out.size):
        out[i] = here * middle[i] + beside * (before[i] + after[i])


@kernel(inline="always")
def _add(out: Any, weights: Any, near: Any, far: Any) -> None:
    """Add to out (m,) the first m entries of two near and two further neighbours, with two weights."""
    (a, b), (c, d) = near, far
    by_near, by_far = weights[0], weights[1]
    for i in range(out.size):
        out[i] += by_near * (a[i] + b[i]) + by_far * (c[i] + d[i])


@kernel()
def _cell_weight(i: int, j: int) -> Any:
    """Lowe's Gaussian window, of two cells' standard deviation, in the middle of cell (i, j)."""
    return np.float32(np.exp(-0.125 * ((i - 1.5) ** 2 + (j - 1.5) ** 2)))


@kernel()
def describe_into(maps: Any, points: Any, sampling: Any, out: Any, J: Any, stretch: Any) -> None:
    """Descriptors (n, 128) into out, and their derivative into J (n, 2, 128), or None if it is not wanted. sampling:
    cell, root, angle and scale as of `describe`; stretch: see `StretchArrays`."""
    height, width = maps.shape[0], maps.shape[1]
    (cell, root, angle, scale), (still, follows) = sampling, stretch
    along, across = cell * scale * np.cos(angle), cell * scale * np.sin(angle)
    for n in range(points.shape[0]):
        for i in range(4):
            for j in range(4):
                x = points[n, 0] + along * (j - 1.5) - across * (i - 1.5)
                y = points[n, 1] + across * (j - 1.5) + along * (i - 1.5)
                share = follows[n, 4 * i + j]
                x -= (1.0 - share) * (points[n, 0] - still[n, 0])
                y -= (1.0 - share) * (points[n, 1] - still[n, 1])
                w = _cell_weight(i, j)
                moves = w * np.float32(share)
                x, y = min(max(x, 0.0), width - 1.001), min(max(y, 0.0), height - 1.001)
                ix, iy = int(x), int(y)
                fx, fy = np.float32(x - ix), np.float32(y - iy)
                gx, gy = np.float32(1.0) - fx, np.float32(1.0) - fy
                o = 32 * i + 8 * j
                for k in range(8):
                    a, b = maps[iy, ix, k], maps[iy, ix + 1, k]
                    c, d = maps[iy + 1, ix, k], maps[iy + 1, ix + 1, k]
                    out[n, o + k] = w * (gy * (gx * a + fx * b) + fy * (gx * c + fx * d))
                    if J is not None:
                        J[n, 0, o + k] = moves * (gy * (b - a) + fy * (d - c))
                        J[n, 1, o + k] = moves * (gx * (c - a) + fx * (d - b))
        _normalize(out[n], None if J is None else J[n])
        for i in range(128):
            slope = np.float32(1.0)
            if root > 0.0:
                out[n, i] = np.sqrt(out[n, i] + np.float32(root))
                slope = np.float32(0.5) / out[n, i]
            elif out[n, i] > np.float32(0.2):
                out[n, i] = np.float32(0.2)
                slope = np.float32(0.0)
            if J is not None:
                J[n, 0, i] *= slope
                J[n, 1, i] *= slope
        _normalize(out[n], None if J is None else J[n])


@kernel()
def _normalize(v: Any, J: Any) -> None:
    """v (128,) to unit length; its derivatives J (2, 128): d (v / |v|) = (dv - u (u . dv)) / |v| with u = v / |v|."""
    squared = np.float32(1e-12)
    for i in range(v.size):
        squared += v[i] * v[i]
    inverse = np.float32(1.0) / np.sqrt(squared)
    for i in range(v.size):
        v[i] *= inverse
    if J is not None:
        for a in range(2):
            along = np.float32(0.0)
            for i in range(v.size):
                along += v[i] * J[a, i]
            for i in range(v.size):
                J[a, i] = (J[a, i] - v[i] * along) * inverse
