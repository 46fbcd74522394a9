"""Where tracking starts: the camera, and a first frame with its landmarks.

In a file, the first frame is the one from which the face is learned best, out of those between the first detection and
ten seconds after the face first looks into the camera; tracking runs forwards and backwards from there. With a live
camera, it is the first frame in which the face looks into the camera.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain, islice, takewhile
from numbers import Real
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from mien.arrays import Array
from mien.errors import MienError, require, warn
from mien.frame import Frame
from mien.geometry.camera import DEFAULT_FOV_DEG, Camera
from mien.initialization.fit import FirstFrame, fit_first_frame, turned_deg
from mien.initialization.landmark_files import read_landmarks
from mien.initialization.landmarks import Landmarks, Point, is_same_place, place_of
from mien.initialization.looks import detail, expected_errors, rotation_of
from mien.tracking.scene import numbered_by_shot
from mien.tracking.state import Estimate
from mien.video import Video, decode_frame, expected_count, select

_LOOK_SECONDS = 10.0
"""How long the best first frame is searched for once the face looks into the camera."""
_SEARCH_SECONDS = 60.0
"""How long a face that does not look into the camera is given until it does."""
_BACK_SECONDS = _LOOK_SECONDS + _SEARCH_SECONDS
"""How far back tracking runs at most."""
DETECTION_INTERVAL = 0.5
"""Seconds between two detections."""
_LEAST_GAIN = 0.12
"""Smallest improvement for which a later first frame is taken, as a fraction of the error of a track begun at rest."""
TURNED_DEG = 15.0
"""Rotation of the face in the first frame beyond which errors are twice as large (docs/benchmark.md)."""
CONFIDENT = 0.5
"""Confidence above which a track has the face that it began with."""
_GONE_SECONDS = 1.0
"""How long a live camera's face may not be detected before the wait for it begins anew."""
_PATIENCE = 3.0
"""Seconds that a live camera waits for a face to look into it."""
_WIDEST_DEG = 150.0
"""Horizontal field of view beyond which no real lens follows the pinhole model."""


@dataclass(frozen=True)
class Footage:
    """The part of a video to track, and what is known about its camera.

    camera: a camera or its JSON file; or focal_px; or fov_deg (horizontal); by default 60 degrees. start, end: seconds,
    a half-open interval.
    """

    video: Video
    camera: Camera | str | Path | None = None
    focal_px: float | None = None
    fov_deg: float | None = None
    start: float | None = None
    end: float | None = None

    def __post_init__(self) -> None:
        for name in ("start", "end", "focal_px", "fov_deg"):
            value = getattr(self, name)
            number = value is None or (isinstance(value, Real) and math.isfinite(value))
            require(number, f"{name} is {value!r}; give a number, or omit it")
        given = [v for v in (self.camera, self.focal_px, self.fov_deg) if v is not None]
        require(
            len(given) <= 1, "the camera is given in more than one way; give a file, a focal length or a field of view"
        )
        if self.camera is not None and not isinstance(self.camera, Camera):
            read_camera(self.camera)  # report errors in it now, not at the first frame

    def frames(self) -> Iterator[Frame]:
        """The frames of this part, decoded from the beginning; see `select`."""
        return select(self.video, self.start, self.end)

    @property
    def frame_count(self) -> int | None:
        """Expected number of frames, None if unknown."""
        return expected_count(self.video, self.start, self.end)

    def camera_of(self, frame: Frame) -> Camera:
        """The camera for images of the size of this frame. Raises MienError if its field of view is too wide."""
        if self.focal_px is not None:
            camera = Camera.centred(self.focal_px, frame.width, frame.height)
        elif self.camera is None:
            fov_deg = DEFAULT_FOV_DEG if self.fov_deg is None else self.fov_deg
            camera = Camera.from_fov(frame.width, frame.height, fov_deg)
        else:
            camera = self.camera if isinstance(self.camera, Camera) else read_camera(self.camera, frame)
        widest = 0.5 * frame.width / math.tan(math.radians(_WIDEST_DEG) / 2)
        require(
            camera.focal_px >= widest,
            f"a focal length of {camera.focal_px:g} pixels sees more than {_WIDEST_DEG:g} degrees across a width of "
            f"{frame.width} pixels; mien assumes a lens without distortion; correct the focal length",
        )
        if not (0 <= camera.cx <= frame.width and 0 <= camera.cy <= frame.height):
            warn(
                f"the optical axis of the camera, at {camera.cx:g}, {camera.cy:g}, lies outside the image of "
                f"{frame.width}x{frame.height} pixels; if the video was scaled, scale focal_px, cx and cy alike"
            )
        return camera


class FootageOptions(Protocol):
    """Options that `Footage` and `mien batch` have in common."""

    @property
    def camera(self) -> Camera | str | Path | None: ...
    @property
    def focal_px(self) -> float | None: ...
    @property
    def fov_deg(self) -> float | None: ...
    @property
    def start(self) -> float | None: ...
    @property
    def end(self) -> float | None: ...


def requested_options(options: FootageOptions, at_once: bool, face: Point | None = None) -> dict[str, Any]:
    """The options of a run apart from the tracker, as plain values for NAME.json."""
    camera = asdict(options.camera) if isinstance(options.camera, Camera) else options.camera and str(options.camera)
    numbers = {
        "focal_px": options.focal_px,
        "fov_deg": options.fov_deg,
        "start": options.start,
        "end": options.end,
    }
    plain = {name: value if value is None else float(value) for name, value in numbers.items()}
    return {"camera": camera, **plain, "at_once": at_once, "face": face and list(face)}


@dataclass(frozen=True)
class Start:
    """Everything that tracking starts with.

    first: the frame to which the landmarks belong; frames: all frames that get a row, including the first; since: time
    in seconds down to which tracking runs backwards from the first frame; reported: index of the first frame that
    `prepare` has not yet reported as progress; at_once, face: as passed to `prepare`; passed: estimates of the frames
    before `first` that cannot be read again; sightings: the face from where it was first seen to `first`, if that is
    another frame; instead: the start with the first of these.
    """

    footage: Footage
    first: Frame
    frames: Iterator[Frame]
    landmarks: Landmarks
    camera: Camera
    since: float
    reported: int = 0
    at_once: bool = False
    face: Point | None = None
    passed: tuple[Estimate, ...] = ()
    sightings: tuple[Landmarks, ...] = ()
    instead: Start | None = None

    def moved_to(self, frame: Frame, sightings: Sequence[Landmarks]) -> Start:
        """The start with a later frame. sightings: the face from this start to that frame."""
        return replace(
            self,
            first=frame,
            frames=self.footage.frames(),
            landmarks=_rounded_as_saved(replace(sightings[-1], source=self.landmarks.source)),
            since=max(self.since, frame.time - _BACK_SECONDS),
            sightings=tuple(sightings),
            instead=replace(self, frames=self.footage.frames()),
        )

    def has_strayed(self, estimates: Mapping[int, Estimate]) -> bool:
        """Whether the face that was tracked back, with its estimates by index, is another one than was seen first:
        where people pass each other, detections in one place need not be of one face."""
        for seen in self.sightings:
            estimate = estimates.get(seen.frame_index)
            if estimate and estimate.landmarks and estimate.confidence > CONFIDENT:
                tracked, face = place_of(estimate.landmarks.image), place_of(seen.correspondences()[1])
                if not is_same_place(*tracked, *face):
                    return True
        return False


def prepare(
    footage: Footage,
    landmarks: Landmarks | str | Path | None = None,
    at_once: bool = False,
    face: Point | None = None,
    report: Callable[[Estimate], None] = lambda estimate: None,
    show: Callable[[Frame], None] = lambda frame: None,
) -> Start:
    """Find the first frame and its landmarks: the frame of the given landmarks, else the first frame with a face or,
    unless `at_once`, a later one from which the face is learned better.

    Of several faces, takes the largest or the one at the point `face`. Calls `report` and `show` for each frame before
    the first detection. Raises MienError for bad input.
    """
    face = face if face is None else _as_point(face)
    source, frames = footage.video, footage.frames()
    earliest = next(frames)
    camera = footage.camera_of(earliest)
    seekable = source.path is not None  # a live camera yields each frame once: those before the face are gone
    reported, passed = 0, list[Estimate]()

    def pass_over(estimate: Estimate) -> None:
        report(estimate)
        if not seekable:
            passed.append(estimate)

    def without_face(frame: Frame) -> None:
        show(frame)
        pass_over(before_start(frame))

    if face is not None:
        require(landmarks is None, "landmarks are given, which already say where the face is; omit --face")
        _require_inside(face, earliest)
    better: tuple[Frame, list[Landmarks]] | None = None
    if landmarks is None:
        search = chain([earliest], frames)
        patience = None if seekable or at_once else Patience(camera, face)
        first, landmarks = find_face(search, source.name, without_face, patience, face)
        reported = first.index
        if seekable and not at_once:
            better = best_look(first, landmarks, camera, footage)
    else:
        if not isinstance(landmarks, Landmarks):
            landmarks = read_landmarks(landmarks, earliest.index, earliest.time)
        first, skipped = _frame_of(landmarks, chain([earliest], frames), source)
        for estimate in () if seekable else skipped:
            pass_over(estimate)
    landmarks.check(first.width, first.height)
    later = seekable and first is not earliest
    begin = Start(
        footage=footage,
        first=first,
        frames=footage.frames() if later else chain([first], frames),
        landmarks=_rounded_as_saved(landmarks),
        camera=camera,
        since=max(earliest.time, first.time - _BACK_SECONDS) if later else first.time,
        reported=reported,
        at_once=at_once,
        face=face,
        passed=tuple(passed),
    )
    return begin.moved_to(*better) if better else begin


def _as_point(face: Point) -> Point:
    """A point as plain numbers. Raises MienError if it is none."""
    valid = np.shape(face) == (2,) and bool(np.isfinite(face).all())
    require(valid, f"face is {face!r}; give a point in the image as two pixel coordinates")
    return float(face[0]), float(face[1])


def _require_inside(face: Point, frame: Frame) -> None:
    x, y = face
    inside = 0 <= x < frame.width and 0 <= y < frame.height
    require(inside, f"--face {x:g} {y:g} lies outside the image of {frame.width}x{frame.height} pixels")


def before_start(frame: Frame) -> Estimate:
    """The estimate for a frame before tracking starts: lost."""
    return Estimate.lost(frame, "no face was seen yet")


def before_landmarks(frame: Frame) -> Estimate:
    """The estimate for a frame before the one whose face is learned, down to which it was not followed: lost."""
    return Estimate.lost(frame, "tracking begins later")


def sampled_frames(footage: Footage) -> Iterator[tuple[int, Frame]]:
    """One frame every half second, starting with the first, each with the number of cuts before it."""
    step = max(1, round(DETECTION_INTERVAL * footage.video.fps))
    return islice(numbered_by_shot(footage.frames()), None, None, step)


def best_look(
    first: Frame, landmarks: Landmarks, camera: Camera, footage: Footage
) -> tuple[Frame, list[Landmarks]] | None:
    """The frame from which a face is learned best, a later one of the same shot, and the looks from the first one to
    that; None if the first one is best. After a cut, the same place may show another face."""
    from mien.initialization.detector import follow, refine

    uncut = takewhile(lambda shot: shot[0] == 0, sampled_frames(replace(footage, start=first.time)))
    later = (frame for _, frame in islice(uncut, 1, None))
    fit = fit_first_frame(landmarks, camera)
    looks, details, facing = [landmarks], [detail(first, landmarks)], _into_camera(fit.R, fit.t)
    until = first.time + (_LOOK_SECONDS if facing else _SEARCH_SECONDS)
    in_time = takewhile(lambda frame: frame.time < until, later)
    for frame, face in follow(landmarks, in_time):
        if not face.are_trackable(frame.width, frame.height):
            continue
        looks.append(face)
        details.append(detail(frame, face))
        if not facing and _into_camera(rotation_of(face, landmarks, camera, fit.R), fit.t):
            facing, until = True, face.time + _LOOK_SECONDS
    errors = expected_errors(looks, details, camera, fit.R, fit.t)
    best = int(np.argmin(errors))
    if errors[0] - errors.min() < _LEAST_GAIN:
        return None
    frame = decode_frame(footage.video, first, looks[best].frame_index, looks[best].time)
    refined = refine(frame, looks[best])
    if refined is None or not refined.are_trackable(frame.width, frame.height):
        return None
    return frame, [*looks[:best], refined]


def _into_camera(R: Array, t: Array) -> bool:
    """Whether a face with pose R (3, 3), t (3,) is close enough to frontal to be learned well."""
    return turned_deg(R, t) <= TURNED_DEG


def _frame_of(landmarks: Landmarks, frames: Iterator[Frame], source: Video) -> tuple[Frame, list[Estimate]]:
    """The frame to which landmarks belong, and estimates for those before it; if they belong to an earlier one, the
    first frame, with a warning."""
    skipped = list[Estimate]()
    for first in frames:
        if first.time > landmarks.time - 0.5 / source.fps:
            break
        skipped.append(before_landmarks(first))
    else:
        raise MienError(f"{landmarks.source} belongs to {landmarks.time:.2f} s, where {source.name} has no frame")
    if first.time - landmarks.time > 1.5 / source.fps:
        warn(
            f"{landmarks.source} belongs to {landmarks.time:.2f} s and tracking begins at {first.time:.2f} s; "
            f"--start {landmarks.time:.2f} begins where it belongs"
        )
    return first, skipped


class Patience:
    """Face search on a live camera: waits a while for the face to look into the camera, as there is no going back to a
    better frame."""

    def __init__(self, camera: Camera, at: Point | None = None) -> None:
        """at: pixels; only a face at this point is considered."""
        self.camera, self.at = camera, at
        self.first_detection: tuple[Landmarks, FirstFrame] | None = None
        self.last_seen = -math.inf

    def __call__(self, frame: Frame) -> list[Landmarks]:
        """The faces of a frame, largest first, if tracking may start with it; else none."""
        from mien.initialization.detector import detect, detect_once

        def trackable(faces: Iterable[Landmarks]) -> list[Landmarks]:
            return [face for face in faces if face.are_trackable(frame.width, frame.height)]

        faces = trackable(detect_once(frame, self.at))
        if not faces:
            if frame.time - self.last_seen > _GONE_SECONDS:
                self.first_detection = None
            return []
        self.last_seen = frame.time
        self.first_detection = self.first_detection or (faces[0], fit_first_frame(faces[0], self.camera))
        first, fit = self.first_detection
        waited = frame.time - first.time
        if waited < _PATIENCE and not _into_camera(rotation_of(faces[0], first, self.camera, fit.R), fit.t):
            return []
        return trackable(detect(frame, self.at))


def find_face(
    frames: Iterable[Frame],
    name: str,
    without_face: Callable[[Frame], None],
    patience: Patience | None = None,
    at: Point | None = None,
) -> tuple[Frame, Landmarks]:
    """The first frame with a face (or the first that `patience` accepts), and its largest face or the one at a point.

    Calls `without_face` for each frame before it. Raises MienError if no frame has a face; warns if it is not the first
    of the frames, or shows several faces.
    """
    from mien.initialization.detector import first_with_a_face

    times: list[float] = []

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
        place = "" if at is None else f" at {at[0]:g}, {at[1]:g}"
        raise MienError(
            f"{name}: no face was found{place} in its {len(times)} frames from {times[0]:.2f} s to {times[-1]:.2f} s; "
            "annotate one and pass --landmarks, or enlarge or brighten the video"
        )
    first, faces = found
    if len(times) > 1:
        warn(f"{name}: a face is first found at {first.time:.2f} s")
    if len(faces) > 1:
        warn(
            f"{name}: {len(faces)} faces in the frame at {first.time:.2f} s; the largest is tracked, "
            f"--face X Y chooses another, and --faces {len(faces)} tracks all of them"
        )
    return first, replace(faces[0], source=f"{name}, detected face")


def read_camera(path: str | Path, frame: Frame | None = None) -> Camera:
    """Read a camera from JSON {"focal_px": .., "cx": .., "cy": ..}, or from the NAME.json of a track; warns if that was
    of images of another size than the frame's."""
    require(isinstance(path, (str, Path)), f"the camera is {type(path)}; give mien.Camera or the name of a JSON file")
    path = Path(path)
    try:
        values = json.loads(path.read_text(encoding="utf-8-sig"))
        tracked = values.get("video", {})
        values = values.get("camera", values)
        if frame and "width" in tracked and (tracked["width"], tracked["height"]) != (frame.width, frame.height):
            warn(
                f"{path} has the camera of a video of {tracked['width']}x{tracked['height']} pixels, and this one has "
                f"{frame.width}x{frame.height}; if it was scaled, scale focal_px, cx and cy alike"
            )
        return Camera(*(float(values[name]) for name in ("focal_px", "cx", "cy")))
    except MienError as error:
        raise MienError(f"{path}: {error}") from error
    except OSError as error:
        raise MienError(f"{path} cannot be read ({error.strerror}); check the name") from error
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise MienError(f'{path} needs {{"focal_px": .., "cx": .., "cy": ..}} in pixels ({error})') from error


def _rounded_as_saved(landmarks: Landmarks) -> Landmarks:
    """The landmarks rounded as in a saved file, so that a run from that file is identical."""
    saved = landmarks.to_dict()
    depths = saved["depths"]
    return replace(
        landmarks,
        points=np.array(saved["points"]),
        depths=None if depths is None else np.array(depths),
    )
