"""What stands still in the image while a face moves behind it: graphics, which would hold the landmarks in their place.

Where there are graphics, the gradient of the image is the same in all frames; the edges of a face move with it. An edge
that stays where it is while the face moves across it does not belong to the face. After the median of the gradients
over many images by T. Dekel, M. Rubinstein, C. Liu and W. T. Freeman, On the effectiveness of visible watermarks, CVPR
2017.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mien.arrays import Array, Float32, Mask, Pixels
from mien.frame import Frame
from mien.graphics import Graphics
from mien.initialization.landmarks import Landmarks, place_of

_FACE_PX = 160.0
"""Larger side of a face in pixels beyond which images are shrunk for the search."""
_AROUND = 1.0
"""How far around the first look is searched, in sizes of the face."""
_LEAST_LOOKS, _LEAST_SHARE_OF_LOOKS = 4, 0.5
"""In how many looks, and in which share of them, a pixel must lie within the face."""
_BLUR = 0.8
"""Standard deviation in pixels of the blur before gradients are taken."""
_CROSSED, _CROSSED_PX, _LEAST_CROSSED = 0.03, 2.5, 3
"""How far a face must have moved across an edge from where it was, in sizes of the face and in pixels, and the least
number of looks in which it has."""
_FLAT = 0.25
"""Within still edges, a pixel is covered if its grey values vary by less than this share of what is usual."""
_LEAST_SHARE, _LEAST_PX = 0.004, 20
"""Least share and number of the pixels of a face that are certainly still edges; fewer are chance."""
_MARGIN = 2
"""Pixels around what is found that are covered as well, as the blur spreads edges."""


class _Stillness(NamedTuple):
    """What makes an edge still. strength: grey values per pixel, at least; deviation: of the gradients in a look that
    agrees, over that, at most; share: of the looks in which the face has moved across it that agree, at least."""

    strength: float
    deviation: float
    share: float


_CERTAIN, _POSSIBLE = _Stillness(10.0, 0.5, 0.7), _Stillness(8.0, 0.6, 0.6)
"""Possible still edges count where they touch certain ones. In 165 videos without graphics, of real, rendered and
modelled people, no face has as many certain ones as `_LEAST_SHARE` (docs/experiments.md)."""


class StillSearch:
    """Several looks at one face, and the search for graphics before it."""

    def __init__(self, frame: Frame, look: Landmarks) -> None:
        """The first look."""
        self.image_size = frame.width, frame.height
        centre, size = place_of(look.points)
        reach = (0.5 + _AROUND) * size
        self.low = np.maximum(np.floor(centre - reach), 0).astype(int)
        self.high = np.minimum(np.ceil(centre + reach), [frame.width, frame.height]).astype(int)
        scale = min(1.0, _FACE_PX / size)
        width, height = np.maximum(np.rint((self.high - self.low) * scale), 4).astype(int).tolist()
        self.size, self.face_px = (width, height), scale * size
        self.images: list[Pixels] = []
        self.points: list[Array] = []
        self.add(frame, look)

    def add(self, frame: Frame, look: Landmarks) -> None:
        """Add a look, by the same detector as the first."""
        (x0, y0), (x1, y1) = self.low, self.high
        part = frame.gray_part(slice(y0, y1), slice(x0, x1))
        self.images.append(np.asarray(cv2.resize(part, self.size, interpolation=cv2.INTER_AREA), np.uint8))
        self.points.append((look.points - self.low + 0.5) * self.size / (self.high - self.low) - 0.5)

    def graphics(self) -> Graphics | None:
        """What covers the face and stands still; None if there is nothing, or if the face moves too little to tell."""
        faces = np.array([_hull(points, self.size) for points in self.points])
        searched = faces.sum(axis=0) >= max(_LEAST_LOOKS, _LEAST_SHARE_OF_LOOKS * len(faces))
        if not searched.any():
            return None
        part = _box(searched, _MARGIN)
        images = np.array([cv2.GaussianBlur(im.astype(np.float32), (0, 0), _BLUR)[part] for im in self.images])
        faces, searched = faces[:, part[0], part[1]], searched[part]
        certain, possible = self._still_edges(images, faces, searched, part)
        if certain.sum() < max(_LEAST_PX, _LEAST_SHARE * searched.sum()):
            return None
        return self._in_image(_covered(certain, possible | _flat(images, faces, searched)), part)

    def _still_edges(
        self, images: Float32, faces: Mask, searched: Mask, part: tuple[slice, slice]
    ) -> tuple[Mask, Mask]:
        """Pixels (h, w) of which the gradient is certainly, or possibly, the same in most looks (n, h, w) in which the
        face has moved across it. part: rows and columns of the shrunk images that these are."""
        gradients = np.array([_gradient(image) for image in images])
        usual = _median(gradients, faces[..., None])
        strength = np.linalg.norm(usual, axis=-1)
        rows, columns = np.nonzero(searched & (strength > _POSSIBLE.strength))
        usual, strength, faces = usual[rows, columns], strength[rows, columns], faces[:, rows, columns]
        deviation = np.linalg.norm(gradients[:, rows, columns] - usual, axis=-1)
        places = self._places_in_face(rows + part[0].start, columns + part[1].start)
        across = (places * (usual / strength[:, None])).sum(axis=-1)
        found = []
        for least in (_CERTAIN, _POSSIBLE):
            agrees = faces & (deviation < least.deviation * strength)
            crossed = faces & (np.abs(across - _median(across, agrees)) > max(_CROSSED * self.face_px, _CROSSED_PX))
            still = (agrees & crossed).sum(axis=0) >= least.share * crossed.sum(axis=0)
            mask = np.zeros_like(searched)
            mask[rows, columns] = still & (crossed.sum(axis=0) >= _LEAST_CROSSED) & (strength > least.strength)
            found.append(mask)
        return found[0], found[1]

    def _places_in_face(self, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> Array:
        """Where (n, m, 2) these pixels are in the face of each look, as positions in the first one: a map of second
        degree for each, as a nose stands out of the plane."""
        pixels, first = np.column_stack([columns, rows]).astype(float), self.points[0]
        maps = (np.linalg.lstsq(self._terms(points), first, rcond=None)[0] for points in self.points)
        return np.array([self._terms(pixels) @ coefficients for coefficients in maps])

    def _terms(self, points: Array) -> Array:
        """The terms (n, 6) up to the second degree of points (n, 2)."""
        x, y = (points / self.size).T
        return np.column_stack([np.ones(len(x)), x, y, x * x, x * y, y * y])

    def _in_image(self, covered: Mask, part: tuple[slice, slice]) -> Graphics:
        """The graphics of a mask (h, w) of a part of the shrunk images."""
        shrunk = np.zeros(self.size[::-1], np.uint8)
        shrunk[part] = covered
        mask = cv2.resize(shrunk, (self.high - self.low).tolist(), interpolation=cv2.INTER_NEAREST) > 0
        rows, columns = _box(mask)
        x, y = (int(low) + place.start for low, place in zip(self.low, (columns, rows), strict=True))
        return Graphics(*self.image_size, x, y, np.ascontiguousarray(mask[rows, columns]))


def _flat(images: Float32, faces: Mask, searched: Mask) -> Mask:
    """Pixels (h, w) whose grey values hardly vary, as inside opaque graphics."""
    n = np.maximum(faces.sum(axis=0), 1)
    mean = (images * faces).sum(axis=0) / n
    variation = np.sqrt((((images - mean) * faces) ** 2).sum(axis=0) / n)
    return np.asarray(searched & (variation < _FLAT * np.median(variation[searched])))


def _covered(certain: Mask, possible: Mask) -> Mask:
    """Possible pixels (h, w) that are connected with certain ones, and a margin."""
    labels = cv2.connectedComponents((certain | possible).astype(np.uint8))[1]
    covered = np.isin(labels, np.unique(labels[certain]))
    shape = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _MARGIN + 1, 2 * _MARGIN + 1))
    return np.asarray(cv2.dilate(covered.astype(np.uint8), shape) > 0)


def _box(mask: Mask, margin: int = 0) -> tuple[slice, slice]:
    """The rows and columns of a mask (h, w) that hold it, and as many more each way."""
    places = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    rows, columns = (slice(max(int(p[0]) - margin, 0), int(p[-1]) + 1 + margin) for p in places)
    return rows, columns


def _hull(points: Array, size: tuple[int, int]) -> Mask:
    """The pixels (h, w) within the convex hull of points (n, 2)."""
    inside = np.zeros(size[::-1], np.uint8)
    cv2.fillConvexPoly(inside, np.rint(cv2.convexHull(points.astype(np.float32))).astype(np.int32), 1)
    return inside > 0


def _gradient(image: Float32) -> Float32:
    """Gradient (h, w, 2) of an image (h, w), grey values per pixel."""
    return np.asarray(np.stack([cv2.Scharr(image, cv2.CV_32F, *by) for by in ((1, 0), (0, 1))], axis=-1) / 32)


def _median(values: Float32, counted: Mask) -> Float32:
    """Median over the first axis of those values (n, ...) that are counted (n, ...); infinite where none is."""
    counted = np.broadcast_to(counted, values.shape)
    ordered = np.sort(np.where(counted, values, np.inf), axis=0)
    middle = np.maximum(counted.sum(axis=0) - 1, 0) // 2
    return np.asarray(np.take_along_axis(ordered, middle[None], axis=0)[0])
