"""The search for a face: the first frame that shows one, and the later one from which it is learned best."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from itertools import cycle, islice, takewhile

import numpy as np

from mien.arrays import Array
from mien.errors import MienError, warn
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.graphics import Graphics
from mien.initialization.fit import FirstFrame, fit_first_frame, turned_deg
from mien.initialization.landmarks import Landmarks, Point
from mien.initialization.straight import straightened
from mien.initialization.upright import Upright, quarters_of, roll_of
from mien.start.footage import Footage
from mien.start.looks import detail, disagreement_error, expected_errors, eye_opening, turn_of
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
TURNED_DEG = 15.0
"""Rotation of the face in the first frame beyond which errors are two to four times as large (docs/benchmark.md)."""
_GONE_SECONDS = 1.0
"""How long a live camera's face may not be detected before the wait for it begins anew."""
_PATIENCE = 3.0
"""Seconds that a live camera waits for a face to look into it with open eyes."""
EASIER_TO_FIND = "enlarge or brighten the video, or turn it upright"
"""What may help where no face is found."""
_SHUT = 0.15
"""Height of the eyes over their width below which they are shut: on recordings of 12 people mostly 0.2 to 0.4, and 0.03
to 0.1 in blinks."""

_UPRIGHT = math.radians(60.0)
"""Roll of a face up to which detectors see it as well as an upright one."""


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


class Patience:
    """Face search on a live camera: waits a while for the face to look into the camera, with open eyes, as there is no
    going back to a better frame.

    Where no upright face is seen, each frame is also turned, by another quarter turn than the last: cameras hang upside
    down, or lie on their side. A face that is found so is then looked for in frames that are turned likewise.
    """

    def __init__(self, camera: Camera, at: Point | None = None, quarters: int = 0) -> None:
        """at: pixels; only a face at this point is considered. quarters: by how many quarter turns the face has
        probably rolled, clockwise."""
        self.camera, self.at, self.quarters = camera, at, quarters
        self.first_detection: tuple[Landmarks, FirstFrame] | None = None
        self.last_seen = -math.inf
        self._confirmed = False  # whether copies of the frame have shown the face of the first detection, too
        self._turns, self._turned_distant = cycle((2, 1, 3)), cycle((False, False, False, True))

    def anew(self) -> Patience:
        """One that waits for another face before the same camera."""
        return Patience(self.camera, self.at, self.quarters)

    def __call__(self, frame: Frame) -> list[Landmarks]:
        """The faces of a frame, largest first, if tracking may start with it; else none."""
        from mien.initialization.detector import detect

        face = self._face(frame)
        if face is not None:
            self.last_seen = frame.time
        elif frame.time - self.last_seen > _GONE_SECONDS:
            self.first_detection = None
        if face is None or self.first_detection is None:
            return []
        first, fit = self.first_detection
        waited = frame.time - first.time
        if waited < _PATIENCE and not self._is_ready(face, first, fit):
            return []
        view = Upright(frame, self.quarters)
        return _trackable(view, detect(view.frame, view.point(self.at)))

    def _face(self, frame: Frame) -> Landmarks | None:
        """The largest face that can be tracked, by a single detection; from the first one on `first_detection` is
        known."""
        if self.first_detection is not None and self._confirmed:
            return self._largest(Upright(frame, self.quarters))
        distant = next(self._turned_distant)  # a search that takes long, so not in both
        view, turned = (Upright(frame, (self.quarters + turn) % 4) for turn in (0, next(self._turns)))
        seen = self._largest(view, not distant)
        if seen is not None and self.first_detection is None and self._begins(view, seen):
            return seen
        other = self._largest(turned, distant)
        if other is not None and self._begins(turned, other):
            return other
        if seen is not None and self.first_detection is None and self.quarters == view.quarters:
            self._remember(frame, seen)
        return seen

    def _largest(self, view: Upright, distant: bool = True) -> Landmarks | None:
        from mien.initialization.detector import detect_once

        faces = _trackable(view, detect_once(view.frame, view.point(self.at), distant))
        return faces[0] if faces else None

    def _begins(self, view: Upright, seen: Landmarks) -> bool:
        """Whether copies of the frame show the face of a view, upright there, where it was `seen`; if so, it becomes
        the first detection, unless no face has such landmarks. One that lies in the view is looked for in another one
        from then on."""
        from mien.initialization.detector import TURNED_AGREEMENT, refine

        # All later turns are measured from this detection, so it is found as well as it can be.
        face = refine(view.frame, view.turned_upright(seen))
        # As in a face upside down the detector sees an upright one, others must agree as well as they do mostly.
        if face is None or (view.quarters != self.quarters and (face.disagreement or 0.0) > TURNED_AGREEMENT):
            return False
        roll = roll_of(face)
        if abs(roll) > _UPRIGHT:
            self.quarters, self.first_detection = (view.quarters + quarters_of(roll)) % 4, None
            return False
        self.quarters = view.quarters
        self._remember(view.seen, view.seen_by_camera(face), confirmed=True)
        return True

    def _remember(self, frame: Frame, face: Landmarks, confirmed: bool = False) -> None:
        """Let this be the first detection."""
        self._confirmed = confirmed
        with suppress(MienError):  # no face has such landmarks; the next frame may show it better
            straight = straightened(frame, face, self.camera)
            self.first_detection = straight, fit_first_frame(straight, self.camera)

    def _is_ready(self, face: Landmarks, first: Landmarks, fit: FirstFrame) -> bool:
        """Whether a face looks into the camera with open eyes; fit: of its first detection."""
        return turn_of(face, first, self.camera, fit.R, fit.t) <= TURNED_DEG and eye_opening(face) > _SHUT


def _trackable(view: Upright, faces: Iterable[Landmarks]) -> list[Landmarks]:
    """Those of the faces of a view that can be tracked, as the camera has seen them."""
    size = view.seen.width, view.seen.height
    return [face for face in map(view.seen_by_camera, faces) if face.are_trackable(*size)]


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
