"""Track all faces in a video, one after the other, each as if it were alone.

There is no face recognition. Faces are detected twice a second throughout the video. Consecutive detections in about
the same place, or where a moving face goes on, are one appearance; the first appearance that no track covers, at least
for a second, is tracked next, from there to the end of the video, as the face may appear again. A tracker that has lost
its face may lock on to another one: where two tracks have the same face, the less confident one counts as lost.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from numbers import Integral
from pathlib import Path

import numpy as np

from mien.arrays import Array, Mask
from mien.errors import MienError, require, warn
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.initialization.landmarks import SAME_PLACE, Landmarks, is_same_place, place_of
from mien.output.destination import Destination
from mien.output.track import Track
from mien.pipeline.drawing import mesh_of
from mien.pipeline.passes import Pass, run_passes
from mien.pipeline.track import Progress, check_mesh, check_passes, reporter
from mien.registry import DEFAULT_PRESET, create_tracker, file_of
from mien.start.first_frame import CONFIDENT, Start, prepare
from mien.start.footage import Footage
from mien.start.search import DETECTION_INTERVAL, sampled_frames
from mien.threads import one_blas_thread
from mien.tracking.state import Estimate, Tracker
from mien.video import open_video

_FAR = 1.5
"""The distance for a second sighting, which shows how fast the face moves."""
_ELSEWHERE = 1e9
"""A distance in pixels beyond any in an image."""
_GAP_SECONDS = 2.0
"""Longest gap between detections at the same place that count as the same face."""
_LEAST_SECONDS = 1.0
"""Shortest time for which a track must have a face that no other track has."""


@dataclass(frozen=True)
class Sighting:
    """A face detected in a frame: index and time (seconds) of the frame, centre (2,) and larger side in pixels, and the
    number of cuts before the frame: after a cut, a face at the same place is a different one."""

    index: int
    time: float
    centre: Array
    size: float
    cuts: int = 0

    def is_at(self, other: Sighting, within: float = SAME_PLACE) -> bool:
        """Whether it has about the position and the size of another. within: sizes of the face."""
        return bool(is_same_place(self.centre, self.size, other.centre, other.size, within))

    def distance_after(self, before: Sequence[Sighting]) -> float:
        """Distance in pixels from where a face with these sightings, shortly before, was last, or would be if it went
        on; infinite if it is another face. A second sighting may be further away."""
        last = before[-1]
        if not 0 < self.time - last.time < _GAP_SECONDS or self.cuts != last.cuts:
            return math.inf
        places, within = [last], _FAR
        if len(before) > 1:
            velocity = (last.centre - before[-2].centre) / (last.time - before[-2].time)
            places.append(replace(last, centre=last.centre + velocity * (self.time - last.time)))
            within = SAME_PLACE
        distances = [np.linalg.norm(place.centre - self.centre) for place in places if self.is_at(place, within)]
        return float(min(distances, default=math.inf))


@dataclass(frozen=True)
class TrackedFace:
    """A face: its track, its box in each frame, and the tracker and the camera for drawing it."""

    track: Track
    boxes: FaceBoxes
    tracker: Tracker
    camera: Camera


class FaceBoxes:
    """Centre (n, 2) and larger side (n,) of the face of a track in each frame, in pixels, NaN where it is lost, and its
    confidence (n,)."""

    def __init__(self, track: Track) -> None:
        points = track.landmarks
        require(points is not None, "this preset gives no landmarks, which --faces needs; choose another preset")
        assert points is not None
        self.index, self.confidence = track.index, track.confidence
        low, high = points.min(axis=1), points.max(axis=1)
        self.centre, self.size = 0.5 * (low + high), (high - low).max(axis=1)

    def has(self, seen: Sighting) -> bool:
        """Whether the track has the detected face, with confidence."""
        row = int(np.searchsorted(self.index, seen.index))  # images that cannot be read leave gaps
        here = replace(seen, centre=self.centre[row], size=float(self.size[row]))
        return bool(self.confidence[row] > CONFIDENT) and here.is_at(seen)

    def taken_by(self, other: FaceBoxes, earlier: bool) -> Mask:
        """The frames (n,) in which another track, an earlier or a later one, has the same face with a higher
        confidence; the earlier one also with the same, as some trackers estimate none."""
        same = is_same_place(self.centre, self.size, other.centre, other.size)
        higher = other.confidence >= self.confidence if earlier else other.confidence > self.confidence
        return np.asarray(same & higher)


@one_blas_thread()
def track_faces(
    video: str | Path,
    faces: int,
    *,
    preset: str = DEFAULT_PRESET,
    camera: Camera | str | Path | None = None,
    focal_px: float | None = None,
    fov_deg: float | None = None,
    start: float | None = None,
    end: float | None = None,
    fps: float | None = None,
    at_once: bool = False,
    passes: int = 1,
    progress: Progress | None = None,
    save: str | Path | None = None,
    overlay: str | Path | None = None,
    plot: str | Path | None = None,
    gltf: str | Path | None = None,
) -> list[Track]:
    """Track up to `faces` faces of a video file or a folder of images, in order of appearance, the largest first of
    those that appear together.

    The other arguments are those of `mien.track`. The first face has NAME.csv, its plot and its head, the second
    NAME.face1.csv, and so on; `overlay` shows all of them. NAME.json states their number; until the last face is done,
    it is marked as incomplete. Each track has a row for every frame, lost where a more confident track has the same
    face.

    Raises MienError for bad input, or if no face is found.
    """
    inputs = (video, camera, file_of(preset))
    footage = Footage(open_video(video, fps), camera, focal_px, fov_deg, start, end, fps)
    files = Destination.checked(save, overlay, plot, gltf, inputs)
    tracker = create_tracker(preset)
    check_passes(passes, footage.video, tracker, preset)
    check_mesh(files, tracker, preset)
    name = footage.video.name
    require(isinstance(faces, Integral) and faces >= 1, f"{faces!r} faces to track; give 1 or more")
    faces = int(faces)
    for face_id in range(1, faces):
        files.of_face(face_id).check(inputs)
    require(footage.repeatable, f"{name} can be read only once; several faces need a file or a list of frames")
    detections = list(_detections(footage))
    require(any(detections), f"{name}: no face was found in it; enlarge or brighten the video")
    together = min(faces, max(map(len, detections)))
    run = _Run(footage, preset, passes, at_once, files, faces, together, progress)
    found = run.track_all(_appearances(detections))
    require(bool(found), f"{name}: nothing that looks like a face could be tracked for a second; check the video")
    found = [replace(face, track=_without_other_faces(face, found)) for face in found]
    if files.overlay is not None:
        _draw(files.overlay, footage.frames(), found, run.reporter(len(found)))
    return _write(found, faces, files)


@dataclass(frozen=True)
class _Run:
    """What the tracking of all faces of a video has in common. faces: how many are tracked at most; together: how many
    of these are seen at the same time."""

    footage: Footage
    preset: str
    passes: int
    at_once: bool
    files: Destination
    faces: int
    together: int
    progress: Progress | None

    def track_all(self, appearances: Sequence[Sequence[Sighting]]) -> list[TrackedFace]:
        """Track the faces of all appearances, one after the other, until there are enough. An appearance may be of
        several people: of those who pass each other, or follow each other in one place."""
        found: list[TrackedFace] = []
        for appearance in appearances:
            while len(found) < self.faces and (tracked := self._track(appearance, found)):
                found.append(tracked)
        return found

    def reporter(self, tracks: int) -> Callable[[Estimate], None]:
        """A function that reports progress, if there are to be this number of tracks, at least those seen together."""
        rounds = self.passes * max(self.together, tracks) + (self.files.overlay is not None)
        return reporter(self.progress, self.footage, rounds)

    def _track(self, appearance: Sequence[Sighting], found: Sequence[TrackedFace]) -> TrackedFace | None:
        """Track the face of an appearance from where no track that was found has it; None if there is nothing to
        track, or nothing that others do not have."""
        unknown = _unknown_part(appearance, found)
        prepared = _prepare(unknown[0], self.footage, self.at_once) if unknown else None
        starts = (prepared, prepared.instead) if prepared else ()
        begin = next((start for start in starts if start and not _is_known(_sighting(start.landmarks), found)), None)
        if begin is None:
            return None
        face_id, tracker = len(found), create_tracker(self.preset)
        files = replace(self.files.of_face(face_id), overlay=None)
        report = self.reporter(face_id + 1)
        first = Pass(begin, self.preset, tracker, files, report, self.passes, face_id=face_id)
        return _track_face(first, found, apart=len(unknown) < len(appearance))


def _detections(footage: Footage) -> Iterator[list[Sighting]]:
    """The detected faces, twice a second, the largest first."""
    from mien.initialization.detector import detect_all

    for cuts, frame in sampled_frames(footage):
        yield [replace(_sighting(face), cuts=cuts) for face in detect_all(frame)]


def _sighting(face: Landmarks) -> Sighting:
    """The sighting of a detected face, with the centre and size of its tracked landmarks."""
    return Sighting(face.frame_index, face.time, *place_of(face.correspondences()[1]))


def _appearances(detections: Sequence[list[Sighting]]) -> list[list[Sighting]]:
    """Group consecutive sightings in about the same place."""
    from scipy.optimize import linear_sum_assignment

    found: list[list[Sighting]] = []
    for sightings in detections:
        distance = np.array([[seen.distance_after(before) for before in found] for seen in sightings])
        distance = distance.reshape(len(sightings), len(found))
        pairs = zip(*linear_sum_assignment(np.minimum(distance, _ELSEWHERE)), strict=True)
        before = {i: found[j] for i, j in pairs if distance[i, j] < _ELSEWHERE}
        for i, seen in enumerate(sightings):
            if i in before:
                before[i].append(seen)
            else:
                found.append([seen])
    # A single detection may be a false positive, but in a video of short shots, or a damaged one, all are single.
    return [one for one in found if len(one) > 1] or found


def _unknown_part(appearance: Sequence[Sighting], faces: Sequence[TrackedFace]) -> list[Sighting]:
    """The part of an appearance in which no track has the face: all of it, the longest one of at least a second, where
    people have passed each other, or none."""
    runs: list[list[Sighting]] = [[]]
    for seen in appearance:
        if _is_known(seen, faces):
            runs.append([])
        else:
            runs[-1].append(seen)
    longest = max(runs, key=len)
    whole = len(longest) == len(appearance)
    lasts = bool(longest) and longest[-1].time - longest[0].time >= _LEAST_SECONDS
    return longest if whole or lasts else []


def _is_known(seen: Sighting, faces: Sequence[TrackedFace]) -> bool:
    """Whether a track has the face of a sighting."""
    return any(face.boxes.has(seen) for face in faces)


def _prepare(seen: Sighting, footage: Footage, at_once: bool) -> Start | None:
    """The start of tracking a detected face, from one detection interval earlier on; None if a closer look does not
    find it."""
    x, y = seen.centre.tolist()
    try:
        begin = prepare(replace(footage, start=seen.time), at_once=at_once, face=(x, y))
    except MienError as error:
        warn(f"{error}; it is skipped")
        return None
    return _within(begin, footage)


def _within(begin: Start, footage: Footage) -> Start:
    """A start in a part of the footage as one in all of it, from a detection interval earlier on."""
    before = begin.since - DETECTION_INTERVAL - 1 / footage.video.fps
    return replace(
        begin,
        footage=footage,
        frames=footage.frames(),
        since=max(before, footage.start or 0.0),
        reported=0,
        face=None,
        instead=begin.instead and _within(begin.instead, footage),
    )


def _track_face(first: Pass, others: Sequence[TrackedFace], apart: bool) -> TrackedFace | None:
    """Track a face and write its files; None, without files, if other tracks have it in all but a few frames. apart:
    part of its appearance is another track's, which then has it in more than a few frames if it is the same face."""
    begin, face = first.begin, None
    incomplete = {"complete": False, "stopped": "the other faces are not tracked yet"}
    for result, tracker in run_passes(first):
        track = replace(result, metadata={**result.metadata, **incomplete})
        face = TrackedFace(track, FaceBoxes(track), tracker, begin.camera)
        own = len(track) - _without_other_faces(face, others).lost
        shared = len(track) - track.lost - own
        few = min(_LEAST_SECONDS * begin.footage.video.fps, 0.5 * len(track))
        if own < few or (apart and shared > few):
            return None
        first.files.write(track)
    return face


def _without_other_faces(face: TrackedFace, all_faces: Sequence[TrackedFace]) -> Track:
    """The track of a face, lost in the frames in which it has the face of another track."""
    reasons: list[str | None] = [None] * len(face.track)
    earlier = True  # a face that is not yet among them comes after them all
    for other in all_faces:
        if other is face:
            earlier = False
            continue
        for k in np.flatnonzero(face.boxes.taken_by(other.boxes, earlier)):
            reasons[k] = f"face {other.track.metadata['face_id']} is here"
    return face.track.without(reasons)


def _draw(
    path: Path, frames: Iterator[Frame], faces: Sequence[TrackedFace], report: Callable[[Estimate], None]
) -> None:
    """Write the overlay video with all faces, each with its number."""
    from mien.output.overlay import FaceOverlay, OverlayWriter, draw

    with OverlayWriter(path) as writer:
        for frame, *estimates in zip(frames, *(face.track.estimates() for face in faces), strict=False):
            shown = [
                FaceOverlay(estimate, mesh_of(face.tracker, estimate), str(face_id))
                for face_id, (face, estimate) in enumerate(zip(faces, estimates, strict=True))
                if estimate.status.success
            ]
            writer.write(draw(frame, shown, faces[0].camera), frame.time)
            report(estimates[0])


def _write(found: Sequence[TrackedFace], wanted: int, files: Destination) -> list[Track]:
    """Write the final tracks of all faces and return them, each with their number."""
    summary = {"complete": True, "stopped": None, "faces": len(found), "faces_wanted": wanted}
    tracks = [replace(face.track, metadata={**face.track.metadata, **summary}) for face in found]
    for face_id, track in reversed(list(enumerate(tracks))):  # if the first is complete, all are
        files.of_face(face_id).write(track)
    files.warn_if_stale(len(tracks))
    return tracks
