"""The search for a face: the first frame that shows one, and the later one from which it is learned best."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from itertools import islice, takewhile

import numpy as np

from mien.arrays import Array
from mien.errors import MienError, warn
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.graphics import Graphics
from mien.initialization.fit import fit_first_frame, turned_deg
from mien.initialization.landmarks import Landmarks, Point
from mien.start.footage import Footage
from mien.start.live_search import Patience
from mien.start.looks import TURNED_DEG, detail, disagreement_error, expected_errors, turn_of
from mien.start.still import StillSearch
from mien.tracking.scene import numbered_by_shot
from mien.video import SAME_TIME, Video, decode_frame

_LOOK_SECONDS = 10.0
"""How long the best first frame is searched for once the face looks into the camera."""
_SEARCH_SECONDS = 60.0
"""How long a face that does not look into the camera is given until it does."""
BACK_SECONDS = _LOOK_SECONDS + _SEARCH_SECONDS
"""How far back tracking runs at most."""
DETECTION_INTERVAL = 0.5
"""Seconds between two detections."""
_MOST_REFINED = 8
"""Number of looks of which it is found out at most how well they are detected."""
_LEAST_GAIN = 0.12
"""Smallest improvement for which a later first frame is taken, as a fraction of the error of a track begun at rest."""
EASIER_TO_FIND = "enlarge or brighten the video, or turn it upright"
"""What may help where no face is found."""


def find_face(
    frames: Iterable[Frame],
    video: Video,
    without_face: Callable[[Frame], None],
    patience: Patience | None = None,
    at: Point | None = None,
) -> tuple[Frame, Landmarks]:
    """The first of the frames of a video with a face (or that `patience` accepts), and its largest face or the one at a
    point.

    Calls `without_face` for each frame before it. Raises MienError if no frame has a face; warns if it is not the first
    of the frames, or shows several faces.
    """
    from mien.initialization.detector import first_with_a_face

    name, times = video.name, list[float]()

    def recorded() -> Iterator[Frame]:
        for frame in frames:
            times.append(frame.time)
            yield frame
            without_face(frame)

    if patience is None:
        found = first_with_a_face(recorded(), at)
    else:
        found = next(((frame, faces) for frame in recorded() if (faces := patience(frame))), None)
    if found is None:
        waiting = patience is not None and patience.first_detection is not None
        raise MienError(f"{name}: {_no_face(times, at, waiting, video.repeatable)}")
    first, faces = found
    if first.time > times[0]:
        warn(f"{name}: a face is first found at {first.time:.2f} s")
    if len(faces) > 1:
        every = f", and --faces {len(faces)} tracks all of them" if video.repeatable else ""
        warn(
            f"{name}: {len(faces)} faces in the frame at {first.time:.2f} s; the largest is tracked, "
            f"--face X Y chooses another{every}"
        )
    return first, replace(faces[0], source=f"{name}, detected face")


def _no_face(times: Sequence[float], at: Point | None, waiting: bool, repeatable: bool) -> str:
    """That no face was found at a point in frames with these times, in seconds, and the remedy. waiting: whether one
    was seen that did not look into the camera; repeatable: whether the frames can be read again."""
    place = "" if at is None else f" at {at[0]:g}, {at[1]:g}"
    searched = f"{place} in its {len(times)} frames from {times[0]:.2f} s to {times[-1]:.2f} s"
    if waiting:
        return f"no face looks into the camera{searched}; at_once learns one as it is"
    recorded = f"annotate one and pass --landmarks, or {EASIER_TO_FIND}"
    return f"no face was found{searched}; {recorded if repeatable else 'bring it nearer, or into more light'}"


def best_look(
    first: Frame, landmarks: Landmarks, camera: Camera, footage: Footage
) -> tuple[Frame, list[Landmarks], Graphics | None]:
    """The frame from which a face is learned best, the first one or a later one of the same shot, the looks from the
    first one to that, and what stands still before the face. After a cut, the same place may show another face."""
    from mien.initialization.detector import follow

    fit = fit_first_frame(landmarks, camera)
    looks, details, facing = [landmarks], [detail(first, landmarks)], turned_deg(fit.R, fit.t) <= TURNED_DEG
    still = StillSearch(first, landmarks)
    until = first.time + (_LOOK_SECONDS if facing else _SEARCH_SECONDS)
    with closing(footage.since(first.time)) as rest:
        uncut = takewhile(lambda shot: shot[0] == 0, sampled_frames(rest))
        later = (frame for _, frame in islice(uncut, 1, None))
        in_time = takewhile(lambda frame: frame.time < until, later)
        for frame, face in follow(landmarks, in_time):
            if not face.are_trackable(frame.width, frame.height):
                continue
            looks.append(face)
            details.append(detail(frame, face))
            still.add(frame, face)
            if not facing and turn_of(face, landmarks, camera, fit.R, fit.t) <= TURNED_DEG:
                facing, until = True, face.time + _LOOK_SECONDS
    errors = expected_errors(looks, details, camera, fit.R, fit.t)
    best, looks = _confirmed_best(first, looks, errors, footage)
    return best, looks, still.graphics()


def _confirmed_best(
    first: Frame, looks: Sequence[Landmarks], errors: Array, footage: Footage
) -> tuple[Frame, list[Landmarks]]:
    """See `best_look`. errors: (n,) expected of the looks; to those of the best is added by how much the detections in
    copies of their frames disagree, as in a face that is partly covered, until that is known of the best one."""
    from mien.initialization.detector import refine

    errors, refined = errors.copy(), {0: (first, looks[0])}
    errors[0] += disagreement_error(looks[0])
    for _ in range(_MOST_REFINED):
        best = _best_of(errors)
        if best in refined:
            break
        frame = decode_frame(footage.video, first, looks[best].frame_index, looks[best].time)
        found = refine(frame, looks[best])
        if found is not None and found.are_trackable(frame.width, frame.height):
            refined[best] = frame, found
            errors[best] += disagreement_error(found)
        else:
            errors[best] = math.inf
    errors[[k for k in range(len(looks)) if k not in refined]] = math.inf
    best = _best_of(errors)
    frame, landmarks = refined[best]
    return frame, [*looks[:best], landmarks]


def _best_of(errors: Array) -> int:
    """The look with the smallest error (n,); the first one where a later one gains too little."""
    best = int(np.argmin(errors))
    return best if errors[best] <= errors[0] - _LEAST_GAIN else 0


def sampled_frames(footage: Footage) -> Iterator[tuple[int, Frame]]:
    """The first frame, and then the one nearest to half a second after the last; each with the number of cuts before
    it. By the frames' own times: the rate that a file states may be wrong."""
    due, before = -math.inf, math.inf
    for cuts, frame in numbered_by_shot(footage.frames()):
        halfway = 0.5 * max(frame.time - before, 0.0)
        if frame.time + halfway >= due - SAME_TIME:
            due = frame.time + DETECTION_INTERVAL
            yield cuts, frame
        before = frame.time
