"""Draw an estimate on its frame: mesh, landmarks, pose axes, a caption."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mien.arrays import Array, Pixels
from mien.errors import require
from mien.files import whole_file
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.graphics import Graphics
from mien.initialization.landmarks import LANDMARK_VERTICES, place_of
from mien.tracking.state import Estimate, TrackedLandmarks

SMALLEST_WIDTH = 640
"""Narrower frames are enlarged by an integer factor before drawing, so that the mesh lines stay thin."""
_CLOSE_UP_WIDTH, _NAME_SIZE = 1600, 0.4
"""Width in pixels of a picture of one face, unless the face is larger, and size of the names of points in it."""
MESH, GRAPHICS = (120, 220, 255), (255, 90, 220)
SEEN, HIDDEN, DOUBTFUL = (90, 255, 120), (255, 120, 90), (255, 220, 90)
AXES = ((255, 90, 80), (110, 235, 90), (90, 150, 255))  # x, y, z in red, green, blue
TEXT, LOST_TEXT, RIM = (255, 255, 255), (255, 110, 100), (20, 30, 40)
AXIS_LENGTH = 0.9  # CANDIDE units
_SCREEN = 1280
"""Longer side, in pixels, at which a screen may show any picture."""
_SHIFT = 4  # fractional bits of OpenCV's subpixel drawing
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_MAXIMUM_CAPTIONS = 6
"""Number of faces with a caption: more would cover the image."""


@dataclass(frozen=True)
class Mesh:
    """A posed face: vertices (V, 3) in camera axes, triangles (T, 3), counter-clockwise seen from outside."""

    vertices: Array
    triangles: NDArray[np.intp]


@dataclass(frozen=True)
class FaceOverlay:
    """A face to draw, with its mesh if the tracker has one, and its name if there are several."""

    estimate: Estimate
    mesh: Mesh | None = None
    name: str = ""


def draw(frame: Frame, faces: Iterable[FaceOverlay], camera: Camera) -> Pixels:
    """Draw the estimates of faces on their frame; returns (H, W, 3) RGB, of the frame's size or a multiple.

    The mesh shows its visible triangles. Landmarks are green if visible, yellow if doubtful, red rings if hidden.
    The axes are those of the head: red to the subject's left, green up, blue out of the face.
    """
    canvas, scale = _enlarge(frame)
    drawn, bottom = list(faces), canvas.shape[0]
    for face in drawn:
        estimate, mesh = face.estimate, face.mesh
        if mesh is not None and estimate.status.success:
            _draw_mesh(canvas, mesh, camera, scale)
        if estimate.landmarks is not None:
            _draw_landmarks(canvas, estimate.landmarks, scale)
            if face.name:
                _draw_name(canvas, face.name, _enlarged(estimate.landmarks.image, scale))
        _draw_axes(canvas, estimate, _axes_origin(estimate, mesh), camera, scale)
    for face in reversed(drawn[:_MAXIMUM_CAPTIONS]):
        caption = f"{face.name}  {_caption(face.estimate)}".strip()
        bottom = _draw_text(canvas, caption, TEXT if face.estimate.status.success else LOST_TEXT, bottom)
    return canvas


def draw_fit(
    frame: Frame,
    mesh: Mesh,
    camera: Camera,
    landmarks: Array,
    names: Sequence[str],
    graphics: Graphics | None = None,
) -> Pixels:
    """Draw a fitted mesh, the landmarks (n, 2) in pixels with their names, and the outlines of graphics, on the face of
    the frame, so large that the names can be read."""
    left, top, right, bottom = _close_up(frame, np.vstack([landmarks, camera.project(mesh.vertices)[0]]))
    part = Frame(frame.pixels[top:bottom, left:right])
    canvas, scale = _enlarge(part, _CLOSE_UP_WIDTH)
    if graphics is not None:
        mask = cv2.resize(graphics.mask.astype(np.uint8), None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST)
        place = ((graphics.x - left) * scale, (graphics.y - top) * scale)
        outlines = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE, offset=place)[0]
        cv2.polylines(canvas, outlines, True, GRAPHICS, 1, cv2.LINE_AA)
    _draw_mesh(canvas, mesh, replace(camera, cx=camera.cx - left, cy=camera.cy - top), scale)
    points = _enlarged(landmarks - [left, top], scale)
    _draw_points(canvas, points, [SEEN] * len(points))
    _draw_point_names(canvas, points, names)
    return canvas


def save_png(path: Path, pixels: Pixels) -> None:
    """Write (H, W, 3) RGB pixels as a PNG, atomically."""
    encoded, buffer = cv2.imencode(".png", cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR))
    require(bool(encoded), f"{path}: the picture cannot be encoded")
    with whole_file(path) as file:
        file.write_bytes(buffer.tobytes())


def _close_up(frame: Frame, points: Array) -> tuple[int, int, int, int]:
    """The part of a frame with a face of points (n, 2): the column and the row where it begins, and where it ends."""
    centre, size = place_of(points)
    low, high = np.floor(centre - 0.6 * size), np.ceil(centre + 0.6 * size)
    left, top = (max(int(v), 0) for v in low)
    return left, top, min(int(high[0]), frame.width), min(int(high[1]), frame.height)


def _enlarge(frame: Frame, width: int = SMALLEST_WIDTH) -> tuple[Pixels, int]:
    """A copy of the frame to draw on, and the factor by which it is enlarged to have about this width."""
    scale = max(1, round(width / frame.width))
    if scale == 1:
        return np.array(frame.pixels), 1
    size = (frame.width * scale, frame.height * scale)
    return np.asarray(cv2.resize(frame.pixels, size, interpolation=cv2.INTER_CUBIC), dtype=np.uint8), scale


def _to_canvas(X: Array, camera: Camera, scale: int) -> Array:
    """Project points (n, 3) in camera axes to pixels (n, 2) of the enlarged image; NaN behind the camera."""
    return _enlarged(camera.project(X)[0], scale)


def _enlarged(p: Array, scale: int) -> Array:
    """Pixels (n, 2) of the frame in the enlarged image, in which the centre of the first is that of scale x scale."""
    return np.asarray(p * scale + (scale - 1) / 2)


def _fixed_point(p: Array) -> NDArray[np.int32]:
    """Fixed-point coordinates for OpenCV's subpixel drawing."""
    return np.asarray(np.round(np.clip(p, -1e4, 1e4) * (1 << _SHIFT)), dtype=np.int32)


def _draw_mesh(canvas: Pixels, mesh: Mesh, camera: Camera, scale: int) -> None:
    p = _to_canvas(mesh.vertices, camera, scale)
    edges = _visible_edges(p, mesh.triangles)
    layer = canvas.copy()
    cv2.polylines(layer, list(_fixed_point(p[edges])), False, MESH, _line_width(canvas), cv2.LINE_AA, _SHIFT)
    cv2.addWeighted(layer, 0.8, canvas, 0.2, 0, dst=canvas)


def _visible_edges(p: Array, triangles: NDArray[np.intp]) -> NDArray[np.intp]:
    """Unique edges (E, 2) of the front-facing triangles; p (V, 2) with v pointing down."""
    a, b, c = (p[triangles[:, k]] for k in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    front = triangles[area < 0]  # counter-clockwise from outside, so negative with v pointing down; NaN is excluded
    edges = np.vstack([front[:, [0, 1]], front[:, [1, 2]], front[:, [2, 0]]])
    return np.asarray(np.unique(np.sort(edges, axis=1), axis=0))


def _draw_landmarks(canvas: Pixels, landmarks: TrackedLandmarks, scale: int) -> None:
    visibility = landmarks.visibility
    v = np.ones(len(landmarks.image)) if visibility is None else visibility
    colours = [SEEN if x > 0.75 else DOUBTFUL if x > 0.25 else HIDDEN for x in v]
    _draw_points(canvas, _enlarged(landmarks.image, scale), colours)


def _draw_points(canvas: Pixels, points: Array, colours: Iterable[tuple[int, int, int]]) -> None:
    """Draw dots with a dark rim, smaller on a small face; hidden landmarks are rings."""
    known = [(point, colour) for point, colour in zip(points, colours, strict=True) if np.isfinite(point).all()]
    if not known:
        return
    face = float(np.ptp([point for point, _ in known], axis=0).max()) or np.inf  # unknown from a single point
    radius, width = min(max(2.6, canvas.shape[1] / 250), max(1.2, face / 45)), _line_width(canvas)
    for point, colour in known:
        centre, r = tuple(_fixed_point(point).tolist()), int(radius * (1 << _SHIFT))
        if colour == HIDDEN:
            cv2.circle(canvas, centre, r, colour, width, cv2.LINE_AA, _SHIFT)
        else:
            cv2.circle(canvas, centre, r + 14 * width, RIM, -1, cv2.LINE_AA, _SHIFT)
            cv2.circle(canvas, centre, r, colour, -1, cv2.LINE_AA, _SHIFT)


def _draw_point_names(canvas: Pixels, points: Array, names: Sequence[str]) -> None:
    """Draw the names of points (n, 2) to their right, or to their left where another point is close by."""
    size, line = _NAME_SIZE * max(1.0, canvas.shape[1] / _CLOSE_UP_WIDTH), _line_width(canvas)
    for point, name in zip(points, names, strict=True):
        (width, height), _ = cv2.getTextSize(name, _FONT, size, 1)
        across, down = (points - point).T
        close = np.any((across > 0) & (across < width) & (np.abs(down) < height))
        corner = int(point[0] + (-width - height if close else height)), int(point[1] + height // 2)
        for colour, thickness in ((RIM, 3 * line), (TEXT, line)):
            cv2.putText(canvas, name, corner, _FONT, size, colour, thickness, cv2.LINE_AA)


def _axes_origin(estimate: Estimate, mesh: Mesh | None) -> Array | None:
    """The tip of the nose if known, else the origin of the head: (3,) camera axes."""
    if mesh is not None:
        return np.asarray(mesh.vertices[LANDMARK_VERTICES["nose_tip"]])
    known = estimate.landmarks
    if known is not None and known.camera is not None and "nose_tip" in known.names:
        return np.asarray(known.camera[known.names.index("nose_tip")])
    return estimate.translation


def _draw_axes(canvas: Pixels, estimate: Estimate, origin: Array | None, camera: Camera, scale: int) -> None:
    if estimate.rotation is None or origin is None:
        return
    tips = origin + AXIS_LENGTH * estimate.rotation.T
    p = _to_canvas(np.vstack([origin, tips]), camera, scale)
    if not np.isfinite(p).all():
        return
    start, *ends = (tuple(q) for q in _fixed_point(p).tolist())
    towards_camera = np.argsort(-tips[:, 2])  # the nearest axis is drawn last
    for k in towards_camera:
        for colour, width in ((RIM, 4), (AXES[k], 2)):
            cv2.line(canvas, start, ends[k], colour, width * _line_width(canvas), cv2.LINE_AA, _SHIFT)


def _caption(estimate: Estimate) -> str:
    """`tracked  confidence 97%  yaw +12.3  pitch -4.0  roll +0.8 deg`, or the reason for which the face is lost."""
    if estimate.euler is None:
        return f"{estimate.status.value}  {estimate.reason}".strip()
    pitch, yaw, roll = np.degrees(estimate.euler)
    return (
        f"{estimate.status.value}  confidence {100 * estimate.confidence:.0f}%"
        f"   yaw {yaw:+.1f}  pitch {pitch:+.1f}  roll {roll:+.1f} deg"
    )


def _draw_name(canvas: Pixels, name: str, points: Array) -> None:
    """Draw the name of a face above its landmarks (n, 2)."""
    place = points[:, 0].mean(), points[:, 1].min() - 0.6 * np.ptp(points[:, 1])
    if np.isfinite(place).all():
        (width, height), _ = cv2.getTextSize(name, _FONT, _text_size(canvas), 1)
        corner = int(place[0] - width / 2), max(int(place[1]), height + 4)
        for colour, thickness in ((RIM, 5 * _line_width(canvas)), (TEXT, 2 * _line_width(canvas))):
            cv2.putText(canvas, name, corner, _FONT, _text_size(canvas), colour, thickness, cv2.LINE_AA)


def _draw_text(canvas: Pixels, text: str, colour: tuple[int, int, int], bottom: int) -> int:
    """Draw a line of text, as large as the width allows, with a dark rim, above row `bottom`; returns its top row."""
    size = _text_size(canvas)
    (width, height), baseline = cv2.getTextSize(text, _FONT, size, 1)
    size *= min(1.0, (canvas.shape[1] - 16) / max(width, 1))
    top = max(bottom - int(height) - int(baseline) - 8, 0)
    for shade, thickness in ((RIM, 3 * _line_width(canvas)), (colour, _line_width(canvas))):
        cv2.putText(canvas, text, (8, bottom - baseline - 3), _FONT, size, shade, thickness, cv2.LINE_AA)
    return top


def _text_size(canvas: Pixels) -> float:
    return max(0.45, canvas.shape[1] / 1300)


def _line_width(canvas: Pixels) -> int:
    """Pixels of the thinnest line: in a picture that a screen shows at a third of its size, one of one pixel would not
    be seen."""
    return max(1, max(canvas.shape[:2]) // _SCREEN)
