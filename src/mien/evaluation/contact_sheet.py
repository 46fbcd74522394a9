"""Contact sheet of the frames with the largest errors, with mesh, landmarks and truth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from mien.arrays import Array, Pixels
from mien.candide.model import Candide
from mien.evaluation.scores import Score
from mien.evaluation.worst import WORST_FRAMES, frame_errors

SHEET_COLUMNS, TILE = 5, 320
"""Frames in a row, and side of the picture of each in pixels."""
MESH, ESTIMATE, TRUTH = (255, 220, 120), (120, 255, 90), (60, 60, 255)  # BGR


def contact_sheet(scores: Sequence[Score]) -> Pixels | None:
    """A BGR image of the frames with the largest errors of all sequences, with mesh, landmarks (green) and truth (red);
    None without images."""
    worst = sorted(_pictured(scores), key=lambda item: -item[0])[:WORST_FRAMES]
    if not worst:
        return None
    tiles = [_tile(score, frame, error) for error, score, frame in worst]
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % SHEET_COLUMNS)
    rows = [np.hstack(tiles[i : i + SHEET_COLUMNS]) for i in range(0, len(tiles), SHEET_COLUMNS)]
    return np.asarray(np.vstack(rows), dtype=np.uint8)


def _pictured(scores: Sequence[Score]) -> Iterator[tuple[float, Score, int]]:
    for score in scores:
        track, truth = score.result.track, score.result.truth
        if track is not None and truth is not None:
            errors = frame_errors(track, truth)
            yield from ((float(errors[f]), score, f) for f in score.result.pictures)


def _tile(score: Score, frame: int, error: float) -> Pixels:
    """A square crop around the face, with estimate and truth."""
    track, truth = score.result.track, score.result.truth
    assert track is not None
    assert truth is not None
    image = cv2.imdecode(score.result.pictures[frame], cv2.IMREAD_COLOR)
    true_points = np.empty((0, 2)) if truth.landmarks is None else truth.landmarks[frame]
    mesh = score.result.meshes.get(frame, np.empty((0, 2))).astype(float)
    A = _around(np.vstack([true_points, track.landmarks[frame], mesh]), image.shape)
    tile = cv2.warpAffine(image, A, (TILE, TILE), flags=cv2.INTER_LINEAR)
    _draw_mesh(tile, _on_tile(mesh, A))
    _draw_points(tile, _on_tile(true_points, A), TRUTH)
    _draw_points(tile, _on_tile(track.landmarks[frame], A), ESTIMATE)
    unit = "deg" if score.comparison is not None else "px"
    text = f"{score.result.sequence} {frame}: {error:.1f} {unit}{' lost' if track.lost[frame] else ''}"
    for colour, width in (((0, 0, 0), 3), ((255, 255, 255), 1)):
        cv2.putText(tile, text, (6, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, width, cv2.LINE_AA)
    return np.asarray(tile, dtype=np.uint8)


def _around(points: Array, shape: tuple[int, ...]) -> Array:
    """Affine matrix (2, 3) from a square around these points, or from the whole image without any, to the tile."""
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) == 0:
        points = np.array([[0.0, 0.0], [shape[1], shape[0]]])
    low, high = points.min(axis=0), points.max(axis=0)
    scale = TILE / (1.3 * float((high - low).max()) + 1.0)
    return np.column_stack([scale * np.eye(2), TILE / 2 - scale * (low + high) / 2])


def _on_tile(points: Array, A: Array) -> Array:
    """Map points (n, 2) from pixels of the frame to pixels of the tile."""
    return np.asarray(points @ A[:, :2].T + A[:, 2])


def _draw_mesh(tile: Pixels, vertices: Array) -> None:
    """Draw the triangles of CANDIDE that face the camera."""
    for triangle in Candide.default().triangles if len(vertices) else ():
        a, b, c = corners = vertices[triangle]
        facing = (b - a)[0] * (c - a)[1] < (b - a)[1] * (c - a)[0]
        if facing and np.isfinite(corners).all():
            cv2.polylines(tile, [np.round(corners * 16).astype(np.int32)], True, MESH, 1, cv2.LINE_AA, 4)


def _draw_points(tile: Pixels, points: Array, colour: tuple[int, int, int]) -> None:
    for x, y in points[np.isfinite(points).all(axis=1)]:
        cv2.circle(tile, (round(16 * x), round(16 * y)), 42, colour, -1, cv2.LINE_AA, 4)
