"""Face detection with OpenCV alone, for when MediaPipe is not installed; it has no release with its models for Python
3.13.

The two networks are MediaPipe's and come with mien (NOTICE): the short-range BlazeFace detects faces and their eyes,
and Face Mesh finds 468 points in an upright square around each. MediaPipe's own graph then refines lids and lips with
an attention network, whose layers OpenCV does not support; here Face Mesh runs twice instead.

V. Bazarevsky et al., BlazeFace: sub-millisecond neural face detection on mobile GPUs, 2019; Y. Kartynnik et al.,
Real-time facial surface geometry from monocular video on mobile GPUs, 2019.
"""

from __future__ import annotations

import math
from importlib.resources import files
from itertools import product
from typing import Any

import cv2
import numpy as np

from mien.arrays import Array, Float32, Pixels
from mien.initialization.landmarks import Place, place_of

_DETECTOR_PX, _MESH_PX = 128, 192
"""Input sizes of the networks, in pixels."""
_GRIDS = ((16, 2), (8, 6))
"""Cells along each side of the detector's grids, and anchors per cell."""
_LEAST_SCORE, _MOST_OVERLAP = 0.5, 0.3
_SQUARES = 3
"""Number of squares along the longer side that are searched for distant faces, with more in between that overlap."""
_MARGIN = 1.5
"""Side of the square in which the mesh is fitted, in sizes of the face."""
_EYES = 33, 263
"""Outer corners of the eyes, right and left, in the mesh."""


class OpenCVMesh:
    """Face detector and face mesh, run by OpenCV."""

    def __init__(self, faces: int) -> None:
        """faces: maximum number of faces."""
        self.maximum_faces = faces
        self.detector, self.mesh = (_read(name) for name in ("face_detection_short_range", "face_landmark"))
        anchors = [np.repeat(_cell_centres(cells), count, axis=0) for cells, count in _GRIDS]
        self.anchors = _DETECTOR_PX * np.concatenate(anchors)

    def faces(self, pixels: Pixels) -> list[Array]:
        """Points (468, 3) in pixels of the faces of an image (H, W, 3), RGB; the third coordinate is depth relative to
        the centre of the head."""
        found = []
        for place, eyes in self.detect(pixels)[: self.maximum_faces]:
            face = self._mesh_in(pixels, place, eyes)
            face = None if face is None else self._mesh_in(pixels, place_of(face), face[list(_EYES), :2])
            if face is not None:
                found.append(face)
        return found

    def places(self, pixels: Pixels) -> list[Place]:
        """Candidate places of near and distant faces: in the whole image, and in overlapping squares of a third of its
        longer side."""
        height, width = pixels.shape[:2]
        side = math.ceil(max(height, width) / _SQUARES)
        places = [place for place, _ in self.detect(pixels)]
        for y, x in product(_starts(height, side), _starts(width, side)):
            found = self.detect(np.ascontiguousarray(pixels[y : y + side, x : x + side]))
            places += [(centre + np.array([x, y]), size) for (centre, size), _ in found]
        return places

    def detect(self, pixels: Pixels) -> list[tuple[Place, Array]]:
        """Places of the faces, each with its eyes (2, 2), right and left, in pixels; highest score first."""
        size, side = np.array(pixels.shape[1::-1]), max(pixels.shape[:2])
        shrunk = np.maximum(np.rint(_DETECTOR_PX * size / side).astype(int), 1)
        corner = (_DETECTOR_PX - shrunk) // 2
        (x, y), (w, h) = corner, shrunk
        square = np.zeros((_DETECTOR_PX, _DETECTOR_PX, 3), np.uint8)
        interpolation = cv2.INTER_AREA if side > _DETECTOR_PX else cv2.INTER_LINEAR
        square[y : y + h, x : x + w] = cv2.resize(pixels, shrunk.tolist(), interpolation=interpolation)
        scores, boxes = sorted(_run(self.detector, square / np.float32(127.5) - 1), key=np.size)
        # Each box has a centre, a size and six keypoints, in pixels; all but the size are relative to its anchor.
        decoded, scale = boxes.reshape(-1, 8, 2), size / shrunk
        sizes = scale * decoded[:, 1]
        points = scale * (np.delete(decoded, 1, axis=1) + self.anchors[:, None] - corner)
        found = np.column_stack([points[:, 0] - 0.5 * sizes, sizes])
        score = 1 / (1 + np.exp(-np.clip(scores.ravel(), -50, 50)))
        kept = cv2.dnn.NMSBoxes(found.tolist(), score.tolist(), _LEAST_SCORE, _MOST_OVERLAP)
        return [((points[k, 0], float(sizes[k].max())), points[k, 1:3]) for k in np.ravel(kept).astype(int)]

    def _mesh_in(self, pixels: Pixels, place: Place, eyes: Array) -> Array | None:
        """Points (468, 3) of the face at a place with eyes (2, 2); None if there is no face."""
        (centre, size), (x, y) = place, eyes[1] - eyes[0]
        turn_deg, scale = math.degrees(math.atan2(y, x)), _MESH_PX / max(_MARGIN * size, 1e-6)
        A = crop_matrix(centre, turn_deg, scale, 0.5 * _MESH_PX)
        upright = cv2.warpAffine(pixels, A, (_MESH_PX, _MESH_PX), flags=cv2.INTER_LINEAR)
        points, score = sorted(_run(self.mesh, upright / np.float32(255)), key=np.size, reverse=True)
        if score.item() < 0:  # a logit
            return None
        return uncrop(points.reshape(-1, 3), A)


def _starts(length: int, side: int) -> list[int]:
    """Start positions of squares that cover a length, each overlapping the next by half."""
    count = max(math.ceil(2 * length / side) - 1, 1)
    return [round(start) for start in np.linspace(0, max(length - side, 0), count).tolist()]


def crop_matrix(centre: Array, turn_deg: float, scale: float, middle: float) -> Array:
    """Affine matrix (2, 3) from an image to a square crop that is rotated and scaled about a centre (2,); middle: both
    coordinates of that centre in the crop."""
    A = cv2.getRotationMatrix2D((float(centre[0]), float(centre[1])), turn_deg, scale)
    A[:, 2] += middle - centre
    return np.asarray(A, dtype=float)


def uncrop(points: Array, A: Array) -> Array:
    """Map points (n, 3), the third coordinate a depth, from a crop of `crop_matrix` A back to the image."""
    inverse = cv2.invertAffineTransform(A)
    scale = float(np.sqrt(abs(np.linalg.det(A[:, :2]))))
    return np.column_stack([points[:, :2] @ inverse[:, :2].T + inverse[:, 2], points[:, 2] / scale])


def _cell_centres(cells: int) -> Array:
    """Centres (cells^2, 2), x and y, of the cells of a grid over the unit square, row by row."""
    y, x = np.mgrid[:cells, :cells] + 0.5
    return np.column_stack([x.ravel(), y.ravel()]) / cells


def _read(name: str) -> Any:
    return cv2.dnn.readNetFromTFLite(np.frombuffer((files("mien") / "data" / f"{name}.tflite").read_bytes(), np.uint8))


def _run(network: Any, image: Float32) -> list[Array]:
    """Outputs of a network for an image (H, W, 3)."""
    network.setInput(np.ascontiguousarray(image.transpose(2, 0, 1)[None], dtype=np.float32))
    return [np.asarray(answer, dtype=float) for answer in network.forward(network.getUnconnectedOutLayersNames())]
