"""The moving head as binary glTF 2.0, which Blender, Unity, Unreal and three.js read: a mesh with morph targets, its
animation, and the camera.

Lengths are metres. glTF's axes are x right, y up and z towards the viewer; a model has those of mien's head, and looks
along its z. https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mien._version import __version__
from mien.appearance.rendering import vertex_normals
from mien.arrays import Array, Mask
from mien.candide.model import TRACKED_UNITS, Candide, with_eyes_closed
from mien.errors import MienError, require, warn
from mien.files import whole_file
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING, matrix_from_euler
from mien.tracking.state import EYES_CLOSED

if TYPE_CHECKING:
    from mien.output.track import Track

_LATEST_BEGIN = 10_000.0
"""Seconds up to which 32-bit floats, those of glTF, tell milliseconds apart."""
_SURE = 0.5
"""Confidence from which on a pose is shown."""
_MM = 1e-3
_NEAREST = 0.01
"""Distance in metres from which on the camera sees something."""
_OF_VERTICES, _OF_TRIANGLES = {"target": 34962}, {"target": 34963}
"""What a part of the binary is for."""
_MAGIC, _SIGNATURE = b"glTF", b'"generator":"mien '


def write_gltf(track: Track, path: Path) -> None:
    """Write the head of a track to a `.glb` file, so that at every key it is `Track.mesh`, without the eyeballs.

    Each animation unit has a morph target of its name, and so has `eyes_closed`. Eyes close by a share of how far the
    brows leave them open: a unit that moves the lids has another target, UNIT_eyes_closed, whose weight is the product
    of both. A frame in which the face is lost, or the confidence below one half, has no key: players go straight from
    the pose before to the one after it; they hold the first, and the last to the end of the track. The extras of the
    animation have, as `untracked`, the seconds of the first and the last frame of every such stretch. If no frame is
    that sure, all with the face have keys, with a warning. Raises MienError if the track has no mesh, no camera, or no
    frame with the face.
    """
    (vertices, units), t, animation, known = _required(track, path)
    time = _times(track, path)
    sure = known & (track.confidence >= _SURE)
    if not sure.any():
        warn(f"{path}: the confidence is below one half in all of the track; the head moves as it says nevertheless")
    rows, key_times = _key_rows(time, sure if sure.any() else known, path)
    closed = np.zeros(len(track)) if track.eyes_closed is None else np.nan_to_num(track.eyes_closed)
    targets, weights = _morph_targets(vertices, units, animation[rows], closed[rows])
    R = FACING @ matrix_from_euler(np.radians(track.euler_deg[rows])) @ FACING
    keys = {"translation": _MM * t[rows] @ FACING, "rotation": _quaternions(R), "weights": weights.ravel()}
    buffer = _Buffer()
    number = track.metadata.get("face_id") or ""  # several heads in a scene need names of their own
    content = {
        "asset": {"version": "2.0", "generator": f"mien {__version__}"},
        "scene": 0,
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [
            {"name": f"head{number}", "mesh": 0}
            | {name: keys[name][0].tolist() for name in ("translation", "rotation")},
            {"name": f"camera{number}", "camera": 0},
        ],
        "meshes": [{"name": f"face{number}", **_mesh(buffer, vertices, targets)}],
        "materials": [{"doubleSided": True, "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.8}}],
        "cameras": [_camera(track.metadata, path)],
        "animations": [
            {"name": f"track{number}", **_animation(buffer, key_times, keys)}
            | {"extras": {"untracked": _stretches(~sure, time)}}
        ],
    }
    with whole_file(path) as file:
        file.write_bytes(_container(content | buffer.description, buffer.content))


def _required(track: Track, path: Path) -> tuple[tuple[Array, Array], Array, Array, Mask]:
    """What a head is made of: `Track.rest`, positions (n, 3) in millimetres, the animation (n, 6), and which rows (n,)
    have all of a pose. Raises MienError if the track lacks any, or no row has a pose."""
    rest, t, animation = track.rest, track.translation_mm, track.animation
    require(track.lost < len(track), f"{path}: the face is lost in every frame of the track; there is nothing to write")
    if rest is None or t is None or animation is None or not {"camera", "video"} <= track.metadata.keys():
        raise MienError(
            f"{path}: the track has no mesh. If its estimates are of mien.stream, record the video and give that to "
            "mien.track; if it was read, keep the JSON beside the table; if its preset fits no expression, choose one "
            "such as realtime"
        )
    known = np.isfinite(np.column_stack([t, track.euler_deg, animation])).all(axis=1)
    require(
        bool(known.any()),
        f"{path}: no row of the track has pose_Rx, pose_Ry, pose_Rz, a position and an expression; track the video "
        "again",
    )
    return rest, t, animation, np.asarray(known)


def is_gltf_of_mien(path: Path) -> bool:
    """Whether a file begins as those of `write_gltf` do; one that another program has saved again does not."""
    with path.open("rb") as file:
        start = file.read(100)
    return start.startswith(_MAGIC) and _SIGNATURE in start


def _morph_targets(vertices: Array, units: Array, animation: Array, closed: Array) -> tuple[dict[str, Array], Array]:
    """The targets (V, 3) by name, and their weights (n, K), with which `vertices + sum of weights * targets` is the
    face with an animation and its eyes closed.

    vertices: (V, 3) at rest; units: (6, V, 3); animation: (n, 6); closed: (n,), by what share of their opening. With
    that share s, `with_eyes_closed` is x + s C x, and C is linear: C of a unit is what its amount adds to C at rest.
    """
    targets = dict(zip(TRACKED_UNITS, units, strict=True)) | {EYES_CLOSED: with_eyes_closed(vertices, 1.0) - vertices}
    weights = [*animation.T, closed]
    for name, unit, amount in zip(TRACKED_UNITS, units, animation.T, strict=True):
        moves_lids = with_eyes_closed(unit, 1.0) - unit
        if moves_lids.any():
            targets[f"{name}_{EYES_CLOSED}"] = moves_lids
            weights.append(amount * closed)
    return targets, np.stack(weights, axis=1)


class _Buffer:
    """The binary part of a file, and how the JSON part refers to it."""

    def __init__(self) -> None:
        self.content = b""
        self.views: list[dict[str, int]] = []
        self.accessors: list[dict[str, Any]] = []

    @property
    def description(self) -> dict[str, Any]:
        """The properties of glTF that describe the content."""
        buffers = [{"byteLength": len(self.content)}]
        return {"buffers": buffers, "bufferViews": self.views, "accessors": self.accessors}

    def add(self, values: Array | NDArray[np.intp], use: Mapping[str, int] = MappingProxyType({})) -> int:
        """The index of a new accessor of values (n,) or (n, k): real ones as 32-bit floats, integers unsigned."""
        component, kind = (5125, "<u4") if np.issubdtype(values.dtype, np.integer) else (5126, "<f4")
        stored = values.astype(kind).reshape(len(values), -1)
        self.accessors.append(
            {
                "bufferView": len(self.views),
                "componentType": component,
                "count": len(stored),
                "type": "SCALAR" if values.ndim == 1 else f"VEC{stored.shape[1]}",
                "min": stored.min(axis=0).tolist(),
                "max": stored.max(axis=0).tolist(),
            }
        )
        self.views.append({"buffer": 0, "byteOffset": len(self.content), "byteLength": stored.nbytes, **use})
        self.content += stored.tobytes()
        return len(self.accessors) - 1


def _mesh(buffer: _Buffer, vertices: Array, targets: Mapping[str, Array]) -> dict[str, Any]:
    """The mesh of vertices (V, 3) with displacements (V, 3), all in millimetres; of the vertices, those that are
    corners of the surfaces without eyeballs: CANDIDE's eyeballs lie in the lids, which would flicker."""
    triangles = Candide.default(168).triangles
    used, corners = np.unique(triangles, return_inverse=True)
    attributes = {"POSITION": _MM * vertices[used], "NORMAL": vertex_normals(vertices, triangles)[used]}
    primitive = {
        "attributes": {name: buffer.add(values, _OF_VERTICES) for name, values in attributes.items()},
        "indices": buffer.add(corners.ravel(), _OF_TRIANGLES),
        "material": 0,
        "targets": [{"POSITION": buffer.add(_MM * moved[used], _OF_VERTICES)} for moved in targets.values()],
    }
    names = {"targetNames": list(targets)}  # where Blender, Unity and three.js look for them
    return {"primitives": [primitive], "weights": [0.0] * len(targets), "extras": names}


def _animation(buffer: _Buffer, time: Array, keys: Mapping[str, Array]) -> dict[str, Any]:
    """The animation of the first node: what it has at times (n,), by the name of the property."""
    begin = buffer.add(time)
    samplers = [{"input": begin, "output": buffer.add(values)} for values in keys.values()]
    channels = [{"sampler": k, "target": {"node": 0, "path": name}} for k, name in enumerate(keys)]
    return {"samplers": samplers, "channels": channels}


def _camera(metadata: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """The camera of the video, at the origin, which looks along -z; with a warning if it does not look through the
    middle of the picture, as glTF's do. Its extras have what glTF cannot say, by the names of Blender: the shift of the
    picture right and up, as shares of its height, and the resolution in pixels."""
    try:
        focal_px, cx, cy = (float(metadata["camera"][name]) for name in ("focal_px", "cx", "cy"))
        camera = Camera(focal_px, cx, cy)
        width, height = (int(metadata["video"][name]) for name in ("width", "height"))
        require(min(width, height) > 0, f"{width}x{height} is no size")
    except (LookupError, TypeError, ValueError, OverflowError) as error:
        raise MienError(
            f"{path}: the `camera` or the `video` of the track is not as mien has written it; track the video again"
        ) from error
    middle = Camera.centred(camera.focal_px, width, height)
    right, down = camera.cx - middle.cx, camera.cy - middle.cy
    if max(abs(right), abs(down)) > 1:
        warn(
            f"{path}: the camera looks through a point {right:+.1f} pixels right and {down:+.1f} down of the middle of "
            "the picture, which glTF cannot say; the head is seen as far from its place, but where a program takes the "
            "shift from the extras of the camera"
        )
    fov = 2 * math.atan(0.5 * height / camera.focal_px)
    lens = {"yfov": fov, "aspectRatio": width / height, "znear": _NEAREST}
    shift = {"shift_x": -right / height + 0.0, "shift_y": down / height + 0.0}
    return {
        "type": "perspective",
        "perspective": lens,
        "extras": {**shift, "resolution_x": width, "resolution_y": height},
    }


def _times(track: Track, path: Path) -> Array:
    """Seconds (n,) of the rows: those of the video, or, with a warning, those since the first row where glTF cannot
    hold them."""
    begin = track.time[0]
    if 0 <= begin <= _LATEST_BEGIN:
        return track.time
    warn(f"{path}: the times of the track begin at {begin:.2f} s, which glTF cannot hold; they are counted from there")
    return np.asarray(track.time - begin)


def _key_rows(time: Array, known: Mask, path: Path) -> tuple[NDArray[np.intp], Array]:
    """Rows (m,) whose poses have keys, and the seconds (m,) of these, by times (n,): the known rows, and the last of
    them once more at the end of the track, so that the animation is as long as that."""
    rows = np.flatnonzero(known & _is_later(time, known, path))
    if np.float32(time[rows[-1]]) < np.float32(time[-1]):
        return np.append(rows, rows[-1]), np.append(time[rows], time[-1])
    return rows, time[rows]


def _stretches(mask: Mask, time: Array) -> list[list[float]]:
    """Seconds of the first and the last row of every run of rows in a mask (n,), by times (n,)."""
    edges = np.flatnonzero(np.diff(np.pad(mask.astype(int), 1)))  # where runs begin, and the rows after their ends
    seconds: list[list[float]] = np.round(time[edges.reshape(-1, 2) - [0, 1]], 6).tolist()
    return seconds


def _is_later(time: Array, known: Mask, path: Path) -> Mask:
    """Mask (n,) of the rows that are later than all known ones before, as the keys of an animation must be, by times
    (n,) in 32-bit floats; warns of known ones that are not."""
    stored = np.where(known, time, -np.inf).astype(np.float32)
    later = stored > np.concatenate([[-np.inf], np.maximum.accumulate(stored)[:-1]])
    left_out = int(np.count_nonzero(known & ~later))
    if left_out:
        warn(
            f"{path}: {left_out} of {np.count_nonzero(known)} frames are left out, as glTF cannot tell their times, up "
            f"to {time[-1]:.2f} s, from those of frames before"
        )
    return np.asarray(later)


def _quaternions(R: Array) -> Array:
    """(n, 3, 3) -> (n, 4) x, y, z, w, of which each has the sign with which it is nearest to the one before."""
    q = Rotation.from_matrix(R).as_quat()
    flips = np.where((q[1:] * q[:-1]).sum(axis=1) < 0, -1.0, 1.0)
    return np.asarray(q * np.cumprod([1.0, *flips])[:, None])


def _container(content: Mapping[str, Any], binary: bytes) -> bytes:
    """A GLB file: a header, and the chunks of JSON and of binary, each a multiple of four bytes long."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    chunks = b"".join(struct.pack("<I4s", len(c), kind) + c for c, kind in ((text, b"JSON"), (binary, b"BIN\0")))
    return struct.pack("<4sII", _MAGIC, 2, 12 + len(chunks)) + chunks
