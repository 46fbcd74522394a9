"""What tracking starts with: the first frame, its landmarks, and the frames before and after it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np

from mien.errors import MienError, require, warn
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.initialization.fit import fit_first_frame, turned_deg
from mien.initialization.landmark_files import read_landmarks
from mien.initialization.landmarks import Landmarks, Point, is_same_place, place_of
from mien.initialization.marked import completed
from mien.initialization.straight import straightened
from mien.start.footage import Footage
from mien.start.live_search import Patience
from mien.start.looks import COVERED, COVERED_WITHIN_DEG, TURNED_DEG
from mien.start.search import BACK_SECONDS, best_look, find_face
from mien.tracking.abilities import GraphicsTracker
from mien.tracking.state import Estimate, Tracker
from mien.video import Video

CONFIDENT = 0.5
"""Confidence above which a track has the face that it began with."""

_ROUGH = 0.03
"""Root mean square distance of landmarks from the fitted face, in sizes of the face, from which one is probably wrong:
of detected ones, averaged over copies of the frame, it is 0.008 at most, with one corner of the mouth a quarter of the
face off 0.04."""


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
            landmarks=_rounded_as_saved(
                replace(sightings[-1], source=self.landmarks.source, graphics=self.landmarks.graphics)
            ),
            since=max(self.since, frame.time - BACK_SECONDS),
            sightings=tuple(sightings),
            instead=replace(self, frames=self.footage.frames()),
        )

    def completed(self) -> Start:
        """The start with landmarks that were marked by hand completed by a detector, see `marked.completed`."""
        return replace(self, landmarks=_rounded_as_saved(completed(self.first, self.landmarks, self.camera)))

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
    show: Callable[[Frame, Estimate], None] = lambda frame, estimate: None,
) -> Start:
    """Find the first frame and its landmarks: the frame of the given landmarks, else the first frame with a face or,
    unless `at_once`, a later one from which the face is learned better.

    Of several faces, takes the largest or the one at the point `face`. Calls `report` and `show` for each frame before
    the first detection. Raises MienError for bad input.
    """
    face = face if face is None else as_point(face)
    frames = footage.frames()
    earliest = next(frames)
    opening = _Opening(footage, footage.camera_of(earliest), earliest, chain([earliest], frames), at_once, face)
    if face is not None:
        require(landmarks is None, "landmarks are given, which already say where the face is; omit its point")
        require_inside(face, earliest)
    if landmarks is None:
        begin = _begin_with_a_face(opening, report, show)
    else:
        begin = _begin_with_landmarks(opening, landmarks, report)
    if footage.repeatable and begin.first is not earliest:  # they are read again
        frames.close()
    return begin


@dataclass(frozen=True)
class _Opening:
    """What is known before the face is. camera: for frames of the size of `earliest`, the first one; frames: all of
    them, once; at_once, face: as passed to `prepare`."""

    footage: Footage
    camera: Camera
    earliest: Frame
    frames: Iterator[Frame]
    at_once: bool
    face: Point | None

    def start(self, first: Frame, landmarks: Landmarks, passed: Sequence[Estimate], reported: int = 0) -> Start:
        """The start with one of the frames, the last that was taken from them. Raises MienError for bad landmarks."""
        landmarks.check(first.width, first.height)
        later = self.footage.repeatable and first is not self.earliest
        return Start(
            footage=self.footage,
            first=first,
            frames=self.footage.frames() if later else chain([first], self.frames),
            landmarks=_rounded_as_saved(landmarks),
            camera=self.camera,
            since=max(self.earliest.time, first.time - BACK_SECONDS) if later else first.time,
            reported=reported,
            at_once=self.at_once,
            face=self.face,
            passed=tuple(passed),
        )


def _begin_with_a_face(
    opening: _Opening, report: Callable[[Estimate], None], show: Callable[[Frame, Estimate], None]
) -> Start:
    """The start with the first frame that shows a face, or with a better one."""
    footage, camera = opening.footage, opening.camera
    passed = list[Estimate]()
    patience = None if footage.repeatable or opening.at_once else Patience(camera, opening.face)

    def without_face(frame: Frame) -> None:
        estimate = before_start(frame, patience)
        show(frame, estimate)
        report(estimate)
        if not footage.repeatable:
            passed.append(estimate)

    first, landmarks = find_face(opening.frames, footage.video, without_face, patience, opening.face)
    if opening.at_once or not footage.repeatable:
        return opening.start(first, straightened(first, landmarks, camera), passed, reported=first.index)
    best, sightings, graphics = best_look(first, landmarks, camera, footage)
    straight = straightened(first, replace(landmarks, graphics=graphics), camera)
    begin = opening.start(first, straight, passed, reported=first.index)
    if best is first:
        return begin
    return begin.moved_to(best, [*sightings[:-1], straightened(best, sightings[-1], camera)])


def _begin_with_landmarks(
    opening: _Opening, landmarks: Landmarks | str | Path, report: Callable[[Estimate], None]
) -> Start:
    """The start with the frame to which given landmarks belong."""
    if not isinstance(landmarks, Landmarks):
        earliest = opening.earliest
        landmarks = read_landmarks(landmarks, earliest.index, earliest.time, (earliest.width, earliest.height))
    first, skipped, later = _frame_of(landmarks, opening.frames, opening.footage.video)
    passed = [] if opening.footage.repeatable else skipped
    landmarks = replace(landmarks, frame_index=first.index)
    begin = replace(opening, frames=later).start(first, landmarks, passed)
    _check_fit(landmarks, opening.camera)
    for estimate in passed:
        report(estimate)
    return begin


def _check_fit(landmarks: Landmarks, camera: Camera) -> None:
    """Warn if landmarks fit a face only roughly. Raises MienError if they do not at all."""
    fit = fit_first_frame(landmarks, camera)
    if fit.residual_px > _ROUGH * landmarks.size:
        farthest = landmarks.point_names[int(fit.distances_px.argmax())]
        warn(
            f"{landmarks.source}: the landmarks fit a face only to {fit.residual_px:.1f} pixels; point {farthest} may "
            "be wrong: mien landmarks with --landmarks draws them with the fitted mesh"
        )


def as_point(face: Point) -> Point:
    """A point as plain numbers. Raises MienError if it is none."""
    try:
        valid = np.shape(face) == (2,) and bool(np.isfinite(face).all())
    except (TypeError, ValueError):  # something in it is no number
        valid = False
    require(valid, f"face is {face!r}; give a point in the image as two pixel coordinates")
    return float(face[0]), float(face[1])


def require_inside(face: Point, frame: Frame) -> None:
    """Raise MienError for a point that lies outside the image of a frame."""
    x, y = face
    inside = 0 <= x < frame.width and 0 <= y < frame.height
    size = f"{frame.width}x{frame.height} pixels"
    require(inside, f"the face at {x:g}, {y:g} lies outside the image of {size}; give a point on it, in pixels")


def _frame_of(
    landmarks: Landmarks, frames: Iterator[Frame], source: Video
) -> tuple[Frame, list[Estimate], Iterator[Frame]]:
    """The frame to which landmarks belong, the one nearest in time, estimates for those before it, and the frames after
    it. If they belong to a time before all frames, it is the first, with a warning."""
    skipped = list[Estimate]()
    before, reached = None, None
    for frame in frames:
        if frame.time >= landmarks.time:
            reached = frame
            break
        skipped.append(before_landmarks(frame))
        before = frame
    since = math.inf if before is None else landmarks.time - before.time
    until = 0.5 / source.fps if reached is None else reached.time - landmarks.time
    if before is not None and since < until:
        later = frames if reached is None else chain([reached], frames)
        return before, skipped[:-1], later
    if reached is None:
        raise MienError(f"{landmarks.source} belongs to {landmarks.time:.2f} s, where {source.name} has no frame")
    if until > 1.5 / source.fps:
        warn(
            f"{landmarks.source} belongs to {landmarks.time:.2f} s and tracking begins at {reached.time:.2f} s; "
            f"a start at {round(landmarks.time, 6)} s begins where it belongs"
        )
    return reached, skipped, frames


def _rounded_as_saved(landmarks: Landmarks) -> Landmarks:
    """The landmarks rounded as in a saved file, so that a run from that file is identical."""
    saved = landmarks.to_dict()
    return replace(landmarks, points=saved["points"], depths=saved["depths"], marked=saved["marked"])


def before_start(frame: Frame, patience: Patience | None = None) -> Estimate:
    """The estimate for a frame before tracking starts: lost. patience: that of a search that may have seen a face."""
    waiting = patience is not None and patience.first_detection is not None
    return Estimate.lost(frame, "waiting for the face to look into the camera" if waiting else "no face was seen yet")


def before_landmarks(frame: Frame) -> Estimate:
    """The estimate for a frame before the one whose face is learned, down to which it was not followed: lost."""
    return Estimate.lost(frame, "tracking begins later")


def warn_of_first_frame(
    first: Estimate, landmarks: Landmarks, video: Video, tracker: Tracker, face_id: int = 0
) -> None:
    """Warn if the face is turned away in the first frame, from which its appearance and shape are learned, or partly
    covered, there or throughout. face_id: index of the face in the video."""
    if first.rotation is None or first.translation is None:
        return
    remedy = "begin" if video.path is None else "use --start to begin"
    face = f"face {face_id}" if face_id else "the face"
    if landmarks.graphics is not None:
        known = isinstance(tracker, GraphicsTracker)
        then = "they are painted over, and what they hide is not tracked" if known else "this tracker takes them for it"
        warn(f"{video.name}: graphics, such as a logo, or a hard shadow stand still before {face}; {then}")
    turned = turned_deg(first.rotation, first.translation)
    if turned > TURNED_DEG:
        warn(
            f"{video.name}: {face} is turned by {turned:.0f} degrees at {first.time:.2f} s, where tracking begins, "
            f"and all angles will be less certain; {remedy} where it looks into the camera"
        )
    elif turned < COVERED_WITHIN_DEG and (landmarks.disagreement or 0.0) > COVERED:
        warn(
            f"{video.name}: something seems to cover a part of {face} at {first.time:.2f} s, where tracking begins, "
            f"and will be taken for it, or it is dark, blurred or noisy there; {remedy} where all of it is seen well"
        )
