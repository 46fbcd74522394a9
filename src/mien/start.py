"""What tracking begins with: the camera, and a frame with its landmarks.

In a file tracking begins in the frame in which the face is best learned, of those from the first face to ten seconds
after it first looks into the camera, and goes both ways from there; with a camera, in the first frame in which the face
looks into it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from itertools import chain, islice, takewhile
from numbers import Real
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from mien.errors import MienError, require, warn
from mien.frame import Frame
from mien.geometry.camera import DEFAULT_FOV_DEG, Camera
from mien.geometry.rotation import Array
from mien.initialization.fit import FirstFrame, fit_first_frame, turned_deg
from mien.initialization.landmark_files import read_landmarks
from mien.initialization.landmarks import Landmarks, Point
from mien.initialization.looks import detail, expected_errors, rotation_of
from mien.tracking.scene import numbered_by_shot
from mien.tracking.state import Estimate
from mien.video import Video, decoded_again, expected_count, select

_LOOK_SECONDS = 10.0
"""How long a face that looks into the camera is looked at for the frame from which it is best learned."""
_SEARCH_SECONDS = 60.0
"""How long a face that does not look into the camera is looked at until it does."""
_BACK_SECONDS = _LOOK_SECONDS + _SEARCH_SECONDS
"""How far tracking goes back at most."""
LOOK_EVERY = 0.5
"""Seconds between two looks."""
_LEAST_GAIN = 0.12
"""What a later frame must gain: so much of the error of a track that begins at rest."""
TURNED_DEG = 15.0
"""Turn of the face where tracking begins beyond which errors are twice as large (docs/benchmark.md)."""
_PATIENCE = 3.0
"""Seconds that a camera waits for a face to look into it."""
_WIDEST_DEG = 150.0
"""Horizontal field of view beyond which no lens draws as a pinhole does."""


@dataclass(frozen=True)
class Footage:
    """What of a video is tracked, and what is known of its camera.

    camera: or its JSON file, or focal_px, or fov_deg (horizontal); 60 degrees with nothing known. start, end: seconds;
    what is at `end` is left out.
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
            require(number, f"{name} is {value!r}; give a number, or leave it out")
        given = [v for v in (self.camera, self.focal_px, self.fov_deg) if v is not None]
        require(
            len(given) <= 1, "the camera is given in more than one way; give a file, a focal length or a field of view"
        )
        if self.camera is not None and not isinstance(self.camera, Camera):
            read_camera(self.camera)  # what is wrong with it is told now, and not at the first frame

    def frames(self) -> Iterator[Frame]:
        """Its frames, decoded from the beginning; see `select`."""
        return select(self.video, self.start, self.end)

    @property
    def frame_count(self) -> int | None:
        """How many frames to expect, None where nothing says so."""
        return expected_count(self.video, self.start, self.end)

    def camera_of(self, frame: Frame) -> Camera:
        """The camera, of which a frame says how large its images are. Raises MienError where it sees too much."""
        if self.focal_px is not None:
            camera = Camera.centred(self.focal_px, frame.width, frame.height)
        elif self.camera is None:
            fov_deg = DEFAULT_FOV_DEG if self.fov_deg is None else self.fov_deg
            camera = Camera.from_fov(frame.width, frame.height, fov_deg)
        else:
            camera = self.camera if isinstance(self.camera, Camera) else read_camera(self.camera)
        widest = 0.5 * frame.width / math.tan(math.radians(_WIDEST_DEG) / 2)
        require(
            camera.focal_px >= widest,
            f"a focal length of {camera.focal_px:g} pixels sees more than {_WIDEST_DEG:g} degrees of a width of "
            f"{frame.width}; mien tracks what a lens without distortion shows",
        )
        if not (0 <= camera.cx <= frame.width and 0 <= camera.cy <= frame.height):
            warn(
                f"the optical axis of the camera, at {camera.cx:g}, {camera.cy:g}, lies outside the image of "
                f"{frame.width}x{frame.height} pixels; for a video that was scaled, scale focal_px, cx and cy alike"
            )
        return camera


class Asked(Protocol):
    """What `Footage` and `mien batch` are asked for alike."""

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


def asked(of: Asked, at_once: bool, face: Point | None = None) -> dict[str, Any]:
    """What is asked for beside the tracker, in the plain values of NAME.json."""
    camera = asdict(of.camera) if isinstance(of.camera, Camera) else of.camera and str(of.camera)
    numbers = {"focal_px": of.focal_px, "fov_deg": of.fov_deg, "start": of.start, "end": of.end}
    plain = {name: value if value is None else float(value) for name, value in numbers.items()}
    return {"camera": camera, **plain, "at_once": at_once, "face": face and list(face)}


@dataclass(frozen=True)
class Start:
    """All that tracking begins with. first: the frame that the landmarks belong to; frames: all that have a row, the
    first among them; since: seconds, from where on the frames before it are tracked, backwards; told: index of the
    first frame that progress has not heard of, when a face was looked for; at_once, face: as asked of `prepare`."""

    footage: Footage
    first: Frame
    frames: Iterator[Frame]
    landmarks: Landmarks
    camera: Camera
    since: float
    told: int = 0
    at_once: bool = False
    face: Point | None = None


def prepare(
    footage: Footage,
    landmarks: Landmarks | str | Path | None = None,
    at_once: bool = False,
    face: Point | None = None,
    tell: Callable[[Estimate], None] = lambda estimate: None,
) -> Start:
    """Find the face: where landmarks are given, in their frame; else in the first frame that shows one, and `tell`
    hears of those before it, or, unless `at_once`, in a later one from which it is better learned. Of several faces the
    largest, or the one at the point `face`. Raises MienError for bad input."""
    point = face is None or (np.shape(face) == (2,) and bool(np.isfinite(face).all()))
    require(point, f"face is {face!r}; give a point of the image, two numbers of pixels")
    source, frames = footage.video, footage.frames()
    earliest = next(frames)
    camera = footage.camera_of(earliest)
    again = source.path is not None  # a camera shows every frame once: what came before the face is gone
    told = 0
    if face is not None:
        require(landmarks is None, "landmarks are given, which say already where the face is; leave out --face")
        inside = 0 <= face[0] < earliest.width and 0 <= face[1] < earliest.height
        size = f"{earliest.width}x{earliest.height}"
        require(inside, f"--face {face[0]:g} {face[1]:g} lies outside the image of {size} pixels")
    if landmarks is None:
        search = chain([earliest], frames)
        patience = None if again or at_once else Patience(camera, face)
        first, landmarks = find_face(search, source.name, lambda frame: tell(not_yet(frame)), patience, face)
        told = first.index
        if again and not at_once:
            first, landmarks = best_look(first, landmarks, camera, footage)
    else:
        if not isinstance(landmarks, Landmarks):
            landmarks = read_landmarks(landmarks, earliest.index, earliest.time)
        first = _frame_of(landmarks, chain([earliest], frames), source)
    landmarks.check(first.width, first.height)
    later = again and first is not earliest
    frames = footage.frames() if later else chain([first], frames)
    since = max(earliest.time, first.time - _BACK_SECONDS) if later else first.time
    return Start(footage, first, frames, _as_written(landmarks), camera, since, told, at_once, face)


def not_yet(frame: Frame) -> Estimate:
    """What there is to say of a frame before tracking begins."""
    return Estimate.lost(frame, "no face was seen yet")


def frames_to_look_at(footage: Footage) -> Iterator[tuple[int, Frame]]:
    """A frame every half second, from the first on, each with how many cuts there were before it."""
    step = max(1, round(LOOK_EVERY * footage.video.fps))
    return islice(numbered_by_shot(footage.frames()), None, None, step)


def best_look(first: Frame, landmarks: Landmarks, camera: Camera, footage: Footage) -> tuple[Frame, Landmarks]:
    """The frame from which a face is best learned, and its landmarks there: this one, or one of those that follow until
    there is a cut, after which another face may be at the same place."""
    from mien.initialization.detector import follow, refine

    uncut = takewhile(lambda shot: shot[0] == 0, frames_to_look_at(replace(footage, start=first.time)))
    later = (frame for _, frame in islice(uncut, 1, None))
    fit = fit_first_frame(landmarks, camera)
    looks, details, facing = [landmarks], [detail(first, landmarks)], _into_camera(fit.R, fit.t)
    until = first.time + (_LOOK_SECONDS if facing else _SEARCH_SECONDS)
    in_time = takewhile(lambda frame: frame.time < until, later)
    for frame, face in follow(landmarks, in_time):
        looks.append(face)
        details.append(detail(frame, face))
        if not facing and _into_camera(rotation_of(face, landmarks, camera, fit.R), fit.t):
            facing, until = True, face.time + _LOOK_SECONDS
    errors = expected_errors(looks, details, camera, fit.R, fit.t)
    best = looks[int(np.argmin(errors))]
    if errors[0] - errors.min() < _LEAST_GAIN:
        return first, landmarks
    frame = decoded_again(footage.video, first, best.frame_index, best.time)
    refined = refine(frame, best)
    return (first, landmarks) if refined is None else (frame, replace(refined, source=landmarks.source))


def _into_camera(R: Array, t: Array) -> bool:
    """Whether a face at a pose, R (3, 3) and t (3,), is turned so little that it is well learned."""
    return turned_deg(R, t) <= TURNED_DEG


def _frame_of(landmarks: Landmarks, frames: Iterator[Frame], source: Video) -> Frame:
    """The frame that landmarks belong to, or the first where they belong to an earlier one, with a warning."""
    first = next((frame for frame in frames if frame.time > landmarks.time - 0.5 / source.fps), None)
    if first is None:
        raise MienError(f"{landmarks.source} belongs to {landmarks.time:.2f} s, where {source.name} has no frame")
    if first.time - landmarks.time > 1.5 / source.fps:
        warn(
            f"{landmarks.source} belongs to {landmarks.time:.2f} s and tracking begins at {first.time:.2f} s; "
            f"--start {landmarks.time:.2f} begins where it belongs"
        )
    return first


class Patience:
    """What looks for the face of a camera, which shows every frame once, so that there is no better one to go back to:
    it waits a while for the face to look into the camera."""

    def __init__(self, camera: Camera, at: Point | None = None) -> None:
        """at: pixels; only a face there is waited for."""
        self.camera, self.at = camera, at
        self.met: tuple[Landmarks, FirstFrame] | None = None  # the face when it came, and where it looked

    def __call__(self, frame: Frame) -> list[Landmarks]:
        """The faces of a frame, the largest first, if it is one to begin with."""
        from mien.initialization.detector import detect, look

        faces = look(frame, self.at)
        if not faces:
            self.met = None
            return []
        first, fit = self.met = self.met or (faces[0], fit_first_frame(faces[0], self.camera))
        waited = frame.time - first.time
        if waited < _PATIENCE and not _into_camera(rotation_of(faces[0], first, self.camera, fit.R), fit.t):
            return []
        return detect(frame, self.at)


def find_face(
    frames: Iterable[Frame],
    name: str,
    without_face: Callable[[Frame], None],
    patience: Patience | None = None,
    at: Point | None = None,
) -> tuple[Frame, Landmarks]:
    """The first frame with a face, or the first with which patience would begin, and the largest face that is there, or
    the one at a point; `without_face` is called with those before it. Raises MienError if there is none; warns where it
    is not the first of the frames, or has several faces."""
    from mien.initialization.detector import first_with_a_face

    times: list[float] = []

    def noted() -> Iterator[Frame]:
        for frame in frames:
            times.append(frame.time)
            yield frame
            without_face(frame)

    if patience is None:
        found = first_with_a_face(noted(), at)
    else:
        found = next(((frame, faces) for frame in noted() if (faces := patience(frame))), None)
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


def read_camera(path: str | Path) -> Camera:
    """The camera in a JSON {"focal_px": .., "cx": .., "cy": ..}, or in NAME.json of an earlier track."""
    require(isinstance(path, (str, Path)), f"the camera is {type(path)}; give mien.Camera or the name of a JSON file")
    path = Path(path)
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        values = values.get("camera", values)
        return Camera(*(float(values[name]) for name in ("focal_px", "cx", "cy")))
    except MienError as error:
        raise MienError(f"{path}: {error}") from error
    except OSError as error:
        raise MienError(f"{path} cannot be read ({error.strerror}); check the name") from error
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise MienError(f'{path} needs {{"focal_px": .., "cx": .., "cy": ..}} in pixels ({error})') from error


def _as_written(landmarks: Landmarks) -> Landmarks:
    """The landmarks with the decimals that they have in a file, so that a run from that file is the same run."""
    written = landmarks.to_dict()
    depths = written["depths"]
    return replace(
        landmarks,
        points=np.array(written["points"]),
        depths=None if depths is None else np.array(depths),
    )
