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

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mien.compiled import kernel
from mien.geometry.rotation import Array

Float32 = NDArray[np.float32]

LENGTH = 128
ORIENTATIONS = 8
OPENCV_BLUR = 1.52
"""Standard deviation of the Gaussian, in pixels, with which OpenCV prepares an image for its first octave."""


def orientation_maps(gray: Float32, cell: int, angle: float = 0.0) -> Float32:
    """Gradient magnitude by orientation, smoothed by a triangle of half width `cell`: (H, W) -> (H, W, 8).

    angle: direction in radians, from the u axis to the v axis, from which orientations are counted, up to half a turn.
    """
    maps = np.zeros((*gray.shape, ORIENTATIONS), np.float32)
    _gradients(gray, angle, maps)
    smooth, length = np.empty_like(maps), maps[0].size
    triangle = np.arange(cell, 0, -1, dtype=np.float32) / cell**2
    nothing = np.zeros(length, np.float32), np.zeros(length + 2 * ORIENTATIONS * (cell - 1), np.float32)
    _smooth(maps.reshape(-1, length), triangle, *nothing, smooth)
    return smooth


def describe(
    maps: Float32, points: Array, cell: int, root: float = 0.0, angle: float = 0.0, scale: float = 1.0
) -> Float32:
    """Descriptors of unit length (n, 128) at image points (n, 2). angle: that for which the maps were made; scale: of
    the grid, beside the cell that they were smoothed for."""
    out = np.empty((len(points), LENGTH), np.float32)
    _describe(maps, points, (cell, root, angle, scale), out, None)
    return out


def describe_with_jacobian(maps: Float32, points: Array, cell: int, root: float = 0.0) -> tuple[Float32, Float32]:
    """Descriptors (n, 128) and their derivative by the image point (n, 2, 128)."""
    out = np.empty((len(points), LENGTH), np.float32)
    J = np.empty((len(points), 2, LENGTH), np.float32)
    _describe(maps, points, (cell, root, 0.0, 1.0), out, J)
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
def _gradients(gray: Any, angle_from: float, maps: Any) -> None:
    """Magnitude of the gradient, split between the two nearest of eight orientations, from an angle on."""
    height, width = gray.shape
    turned = np.float32(8.0 - angle_from / (0.25 * np.pi))  # in units of 45 degrees, and positive
    angles, magnitudes = np.empty(width, np.float32), np.empty(width, np.float32)
    one, c0, c1, c2 = np.float32(1.0), np.float32(0.2765881), np.float32(0.2582636), np.float32(0.1778958)
    for y in range(1, height - 1):
        for x in range(1, width - 1):  # without branches, so that it runs several pixels at a time
            gx = gray[y, x + 1] - gray[y, x - 1]
            gy = gray[y + 1, x] - gray[y - 1, x]
            ax, ay = abs(gx), abs(gy)
            r = min(ax, ay) / (max(ax, ay) + np.float32(1e-9))
            # atan(r) in units of 45 degrees, by a polynomial that is right to 0.01 degrees.
            angle = r * (one + (one - r) * (c0 + r * (c1 - c2 * r)))
            angle = np.float32(2.0) - angle if ay > ax else angle
            angle = np.float32(4.0) - angle if gx < 0 else angle
            angles[x] = (np.float32(8.0) - angle if gy < 0 else angle) + turned
            magnitudes[x] = np.sqrt(gx * gx + gy * gy)
        for x in range(1, width - 1):
            k = int(angles[x])
            f = angles[x] - np.float32(k)
            maps[y, x, k & 7] = magnitudes[x] * (one - f)
            maps[y, x, (k + 1) & 7] = magnitudes[x] * f


@kernel()
def _smooth(maps: Any, triangle: Any, beyond: Any, row: Any, out: Any) -> None:
    """Both ways by a symmetric filter, of which triangle (cell,) is the half from the middle on: maps (H, W * 8) into
    out (H, W, 8). Twice as fast as OpenCV's. beyond: the zeros above and below, (W * 8,); row: zeros for a row with
    what is beside it, (W * 8 + 16 (cell - 1),)."""
    height, length = maps.shape
    reach = out.shape[2] * (triangle.size - 1)
    across = row[reach : reach + length]
    for y in range(height):
        here, smooth = maps[y], out[y].reshape(length)
        for i in range(length):
            across[i] = triangle[0] * here[i]
        for k in range(1, triangle.size):
            _add(across, triangle[k], maps[y - k] if y >= k else beyond, maps[y + k] if y + k < height else beyond)
        for i in range(length):
            smooth[i] = triangle[0] * across[i]
        for k in range(1, triangle.size):
            shift = out.shape[2] * k
            _add(smooth, triangle[k], row[reach - shift :], row[reach + shift :])


@kernel(inline="always")
def _add(out: Any, weight: Any, a: Any, b: Any) -> None:
    """Add to out (m,) a weight times the sum of the first m of a and b."""
    for i in range(out.size):
        out[i] += weight * (a[i] + b[i])


@kernel()
def _cell_weight(i: int, j: int) -> Any:
    """Lowe's Gaussian window, of two cells' standard deviation, in the middle of cell (i, j)."""
    return np.float32(np.exp(-0.125 * ((i - 1.5) ** 2 + (j - 1.5) ** 2)))


@kernel()
def _describe(maps: Any, points: Any, reading: Any, out: Any, J: Any) -> None:
    """Descriptors (n, 128) into out; J (n, 2, 128), or None where it is not wanted, takes their derivative. reading:
    cell, root, angle and scale as `describe`'s."""
    height, width = maps.shape[0], maps.shape[1]
    cell, root, angle, scale = reading
    along, across = cell * scale * np.cos(angle), cell * scale * np.sin(angle)
    for n in range(points.shape[0]):
        for i in range(4):
            for j in range(4):
                x = points[n, 0] + along * (j - 1.5) - across * (i - 1.5)
                y = points[n, 1] + across * (j - 1.5) + along * (i - 1.5)
                x, y = min(max(x, 0.0), width - 1.001), min(max(y, 0.0), height - 1.001)
                ix, iy = int(x), int(y)
                fx, fy = np.float32(x - ix), np.float32(y - iy)
                w = _cell_weight(i, j)
                gx, gy = np.float32(1.0) - fx, np.float32(1.0) - fy
                o = 32 * i + 8 * j
                for k in range(8):
                    a, b = maps[iy, ix, k], maps[iy, ix + 1, k]
                    c, d = maps[iy + 1, ix, k], maps[iy + 1, ix + 1, k]
                    out[n, o + k] = w * (gy * (gx * a + fx * b) + fy * (gx * c + fx * d))
                    if J is not None:
                        J[n, 0, o + k] = w * (gy * (b - a) + fy * (d - c))
                        J[n, 1, o + k] = w * (gx * (c - a) + fx * (d - b))
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
