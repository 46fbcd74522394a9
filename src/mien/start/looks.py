"""Choose the first frame: of several detections ("looks") of a face, one towards the camera with its usual expression.

Tracking learns a face from one frame. If in that frame the head is turned, the eyes blink, the brows are raised, or the
image is blurred or coarsely compressed, as the first one of a video often is, all later angles are worse; by how much
was measured (docs/benchmark.md).
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from mien.arrays import Array
from mien.frame import Frame
from mien.geometry.camera import Camera, back_project, line_of_sight
from mien.geometry.rotation import similarity
from mien.initialization.fit import turned_deg
from mien.initialization.landmarks import LANDMARK_NAMES, Landmarks, opening_of, rows_by_name

PER_DEGREE, PER_UPPER, PER_LOWER = 1 / 50, 20.0, 3.5
"""Increase in the error of a track, relative to that of one begun at rest: per degree of rotation, and per displacement
of brows and lids, and of the lips, from their usual positions, in units of the distance between the eyes."""
PER_DETAIL, LEAST_DETAIL = 7.0, 0.8
"""Increase in that error per missing fraction of the usual detail, and the fraction below which detail is missing: in
clean video, looks at one face differ by a sixth. First frames compressed by x264 at rate factors of 28 and 33, with
0.91 and 0.87 of the detail, make errors of 1.2 and 1.6."""
PER_WIDTH, WIDEST_MOUTH = 8.0, 0.66
"""Penalty on the width of a mouth beyond that of one that does not grin, in units of the distance between the eyes: the
animation counts from the face that is learned, and from a grin a neutral face would be a frown. In recordings of twelve
people neutral mouths are 0.49 to 0.60 wide, grins 0.74 to 0.78."""
PER_SHUT, HALF_OPEN = 6.0, 0.5
"""Penalty on eyes that are less open than half of the widest of the looks, as a fraction of these: somebody may weep or
blink in most of the looks, but what eyes look like can only be learned where they are open."""
PER_DISAGREEMENT, USUAL_DISAGREEMENT = 400.0, 0.0022
"""Penalty on how far the detections in copies of a look disagree, see `Landmarks`, beyond what is usual: faces
that are partly covered are detected all the same, with an invented part. In looks at six people the median is 0.0016,
with the eyes or the lower half of the face behind a bar 0.003 to 0.005, with a mask or a phone 0.005, with one half
behind a bar 0.009; dark glasses make no difference."""
COVERED, COVERED_WITHIN_DEG = 0.0033, 10.0
"""Disagreement beyond which part of a face is probably covered, if it is turned by less than this from the camera. It
is beyond that in 1 of 100 frames of rendered and modelled heads, with spectacles and without."""
TURNED_DEG = 15.0
"""Rotation of the face in the first frame beyond which errors are two to four times as large (docs/benchmark.md)."""
_DETAIL_PX = 96
"""Side of the image of a face in which its detail is measured."""
_MORE_TURNED_DEG = 15.0
"""Looks that are turned by more than this beyond the most frontal one are excluded."""
_NAMES = tuple(name for name in LANDMARK_NAMES if name in rows_by_name("mediapipe478"))
_UPPER = np.array(["brow" in name or "eyelid" in name for name in _NAMES])
_LOWER = np.array(["lip" in name or "mouth" in name for name in _NAMES])
_MOUTH_CORNERS = [_NAMES.index(f"{side}_mouth_corner_outer") for side in ("right", "left")]
_LIDS = [[_NAMES.index(f"{side}_eyelid_{lid}_mid") for side in ("right", "left")] for lid in ("upper", "lower")]
_RIGID = ~(_UPPER | _LOWER)


def detail(frame: Frame, look: Landmarks) -> float:
    """Fine detail of a face in a frame, independent of its size, brightness and contrast: mean absolute Laplacian over
    the standard deviation of the grey values."""
    size = np.array([frame.width, frame.height])
    (x0, y0), (x1, y1) = (np.clip(at(look.points, axis=0), 0, size).astype(int) for at in (np.min, np.max))
    if x1 - x0 < 2 or y1 - y0 < 2:
        return 0.0
    part = frame.gray_part(slice(y0, y1), slice(x0, x1)).astype(np.float32)
    smaller = min(part.shape) > _DETAIL_PX
    face = cv2.resize(part, (_DETAIL_PX, _DETAIL_PX), interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR)
    return float(np.abs(cv2.Laplacian(face, cv2.CV_32F)).mean() / max(float(face.std()), 1.0))


def eye_opening(look: Landmarks) -> float:
    """Height of the eyes between the lids over their width, the mean of both, as the image shows them."""
    return opening_of({name: look.points[rows].mean(axis=0) for name, rows in rows_by_name(look.scheme).items()})


def expected_errors(looks: Sequence[Landmarks], details: Sequence[float], camera: Camera, R: Array, t: Array) -> Array:
    """Expected errors (n,) of tracks that start from each of n looks at one face, relative to one that starts at rest
    and facing the camera; infinite for looks that are much more turned than another.

    looks: with depths, in a scheme of MediaPipe; details (n,): see `detail`; R (3, 3), t (3,): pose of the face in
    the first look.
    """
    points = [_points(look, camera) for look in looks]
    t = _as_far_as(looks[0], t, camera)
    poses = [_pose(p, points[0], R, t) for p in points]
    turned = np.array([turned_deg(*pose) for pose in poses])
    # Turning distorts detected landmarks like an expression: turned looks must not define the usual face.
    facing = np.flatnonzero(turned <= turned.min() + _MORE_TURNED_DEG)
    moved, typical = _typical([points[k] for k in facing])
    lateral = ((moved - typical) @ poses[facing[0]][0])[:, :, :2]  # without depth
    displacement = np.linalg.norm(lateral, axis=2)
    upper, lower = (np.sqrt((displacement[:, part] ** 2).mean(axis=1)) for part in (_UPPER, _LOWER))
    width = np.linalg.norm(np.diff(moved[:, _MOUTH_CORNERS], axis=1)[:, 0], axis=1)
    errors = np.full(len(looks), np.inf)
    sharpness = np.asarray(details)[facing]
    missing = np.maximum(LEAST_DETAIL - sharpness / max(float(np.median(sharpness)), 1e-6), 0)
    errors[facing] = 1 + PER_DEGREE * turned[facing] + PER_UPPER * upper + PER_LOWER * lower + PER_DETAIL * missing
    errors[facing] += PER_WIDTH * np.maximum(width - max(WIDEST_MOUTH, width.min()), 0)
    gap = np.linalg.norm(moved[:, _LIDS[0]] - moved[:, _LIDS[1]], axis=2).mean(axis=1)
    errors[facing] += PER_SHUT * np.maximum(HALF_OPEN - gap / gap.max(), 0)
    return errors


def disagreement_error(look: Landmarks) -> float:
    """What the disagreement of the detections in copies of a look adds to its expected error."""
    return PER_DISAGREEMENT * max((look.disagreement or 0.0) - USUAL_DISAGREEMENT, 0.0)


def turn_of(look: Landmarks, first: Landmarks, camera: Camera, R: Array, t: Array) -> float:
    """Angle in degrees by which a face is turned away from the camera in a look, given its pose R (3, 3), t (3,) in the
    first; it differs from that of a fit by two degrees in the median, and takes a fortieth of the time."""
    return turned_deg(*_pose(_points(look, camera), _points(first, camera), R, _as_far_as(first, t, camera)))


def _as_far_as(look: Landmarks, t: Array, camera: Camera) -> Array:
    """The translation t (3,) of a face in the units of `_points`."""
    sight = line_of_sight(look.points, camera)
    return np.asarray(t * (camera.focal_px / (sight[2] * float(t @ sight))))


def _pose(points: Array, first: Array, R: Array, t: Array) -> tuple[Array, Array]:
    """Pose (3, 3), (3,) of a face with points (m, 3), given its pose with the first ones: also where it is seen, from
    which it may be turned away, has moved."""
    scale, A, shift = similarity(first[_RIGID], points[_RIGID])
    return A @ R, scale * A @ t + shift


def _points(look: Landmarks, camera: Camera) -> Array:
    """Points (m, 3) in camera axes, from `back_project`."""
    assert look.depths is not None, "looks are the detector's, and have depths"
    points = back_project(np.column_stack([look.points, look.depths]), camera)
    rows = rows_by_name(look.scheme)
    return np.array([points[rows[name]].mean(axis=0) for name in _NAMES])


def _typical(looks: Sequence[Array]) -> tuple[Array, Array]:
    """Align n looks (m, 3) to their median face by the rigid landmarks; returns them (n, m, 3) and that face (m, 3),
    scaled to a distance of 1 between the eyes' outer corners."""
    typical = looks[0] - looks[0][_RIGID].mean(axis=0)
    outer = [_NAMES.index(f"{side}_eye_outer_corner") for side in ("left", "right")]
    for _ in range(5):  # as each alignment changes the median
        typical = typical / np.linalg.norm(typical[outer[0]] - typical[outer[1]])
        moved = np.array([_aligned(look, *similarity(look[_RIGID], typical[_RIGID])[:2]) for look in looks])
        typical = np.median(moved, axis=0)
    return moved, typical


def _aligned(points: Array, scale: float, A: Array) -> Array:
    """Points (m, 3), centred on their rigid landmarks, scaled and rotated."""
    return np.asarray(scale * (points - points[_RIGID].mean(axis=0)) @ A.T)
