"""Everybody in a video: one face after the other, each tracked as if it were alone.

Nobody is recognised. All of the video is looked through for faces, twice a second. What is seen look after look in
about the same place is one appearance; the first appearance in which no track has a face is the next to be tracked,
from there both ways through the whole video, as the face may appear again. A tracker that has lost its face may find
another's: where two tracks have the same face, the less certain one has none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from mien.errors import MienError, require, warn
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import Array
from mien.initialization.landmarks import Landmarks, place_of
from mien.output.destination import Destination
from mien.output.track import Track
from mien.pipeline import DEFAULT_PRESET, Pass, Progress, check_passes, mesh_of, tracked
from mien.registry import create_tracker, file_of
from mien.start import LOOK_EVERY, Footage, Start, frames_to_look_at, prepare
from mien.tracking.state import Estimate, Mask, Tracker
from mien.video import open_video

_SAME_PLACE, _SAME_SIZE = 0.5, 1.6
"""Distance of two faces' centres, in sizes of the face, and factor of their sizes, below which they are the same."""
_GAP_SECONDS = 2.0
"""How long a face may not be seen and still be the same at its place."""
_KNOWN = 0.5
"""Confidence above which a track has the face that it began with."""
_LEAST_SECONDS = 1.0
"""How long a face must be tracked where no other track has it."""


@dataclass(frozen=True)
class Sighting:
    """A face that was seen in a frame: its index and seconds; centre (2,) and larger side in pixels; and how many other
    shots there were before: after a cut, who is at the same place is not the same."""

    index: int
    time: float
    centre: Array
    size: float
    cuts: int = 0

    def is_at(self, other: Sighting) -> bool:
        """Whether it is about as large as another, and where that is."""
        return bool(is_same_place(self.centre, np.array(self.size), other.centre, np.array(other.size)))

    def follows(self, before: Sighting) -> bool:
        """Whether this is the same face, seen a little earlier."""
        return 0 < self.time - before.time < _GAP_SECONDS and self.cuts == before.cuts and self.is_at(before)


@dataclass(frozen=True)
class Followed:
    """A face: its track, where it was, and the tracker and the camera by which it is drawn."""

    track: Track
    places: Places
    tracker: Tracker
    camera: Camera


class Places:
    """Where a track has its face in each frame, centre (n, 2) and size (n,), NaN where it is lost, and with what
    confidence (n,)."""

    def __init__(self, track: Track) -> None:
        points = track.landmarks
        require(points is not None, "this preset gives no landmarks, by which several faces are told from each other")
        assert points is not None
        self.index, self.confidence = track.index, track.confidence
        low, high = points.min(axis=1), points.max(axis=1)
        self.centre, self.size = 0.5 * (low + high), (high - low).max(axis=1)

    def has(self, seen: Sighting) -> bool:
        """Whether the track is sure to have the face that was seen there."""
        row = int(np.searchsorted(self.index, seen.index))  # images that cannot be read leave gaps
        here = replace(seen, centre=self.centre[row], size=float(self.size[row]))
        return bool(self.confidence[row] > _KNOWN) and here.is_at(seen)

    def taken_by(self, other: Places) -> Mask:
        """The frames (n,) in which another track has the same face, and is more certain of it."""
        there = is_same_place(self.centre, self.size, other.centre, other.size)
        return np.asarray(there & (other.confidence > self.confidence))


def is_same_place(centre: Array, size: Array, other_centre: Array, other_size: Array) -> Mask:
    """Whether faces (..., 2), (...) are about as large as others, and where these are."""
    apart = np.linalg.norm(centre - other_centre, axis=-1)
    alike = np.maximum(size, other_size) < _SAME_SIZE * np.minimum(size, other_size)
    return np.asarray(alike & (apart < _SAME_PLACE * size))


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
    at_once: bool = False,
    passes: int = 1,
    progress: Progress | None = None,
    save: str | Path | None = None,
    overlay: str | Path | None = None,
    plot: str | Path | None = None,
) -> list[Track]:
    """Track the faces of a video file or a folder of images, so many at most, in the order in which they appear, of
    those that appear together the largest first.

    The rest is as of `mien.track`, but that the first face has NAME.csv and its plot, the second NAME.face1.csv, and so
    on; `overlay` shows all of them. NAME.json says how many there are; until the last is done, that it is not complete.
    Each track has a row for every frame, and no face where a track that is more certain has it.

    Raises MienError for bad input, and where no face is found.
    """
    tracker = create_tracker(preset)
    inputs = (video, camera, file_of(preset))
    files = Destination.checked(save, overlay, plot, inputs)
    footage = Footage(open_video(video), camera, focal_px, fov_deg, start, end)
    check_passes(passes, footage.video, tracker, preset)
    name, count = footage.video.name, footage.frame_count
    require(isinstance(faces, int) and faces >= 1, f"{faces!r} faces to track; give 1 or more")
    require(footage.video.path is not None, f"{name} shows every frame once; several faces need a file")
    looks = list(_looks(footage))
    require(any(looks), f"{name}: no face was found in it; enlarge or brighten the video")
    together = min(faces, max(map(len, looks)))

    def tell(tracks: int, estimate: Estimate) -> None:
        if progress is not None:
            rounds = passes * max(together, tracks) + (overlay is not None)
            progress(estimate, None if count is None else count * rounds)

    found: list[Followed] = []
    for sightings in _appearances(looks):
        if len(found) == faces or _is_known(sightings, found):
            continue
        begin = _begin(sightings[0], footage, at_once)
        if begin is not None and not _is_known([_seen(begin.landmarks)], found):
            first = Pass(begin, preset, create_tracker(preset), face_id=len(found))
            of_face = replace(files.of_face(len(found)), overlay=None)
            of_face.check(inputs)
            followed = _follow(first, passes, found, of_face, partial(tell, len(found) + 1))
            found += [followed] if followed else []
    found = [replace(face, track=_apart(face, found)) for face in found]
    require(bool(found), f"{name}: what looks like a face in it cannot be tracked for a second")
    if files.overlay is not None:
        _draw(files.overlay, footage.frames(), found, partial(tell, len(found)))
    of_all = {"complete": True, "stopped": None, "faces": len(found), "faces_wanted": faces}
    tracks = [replace(face.track, metadata={**face.track.metadata, **of_all}) for face in found]
    for face_id, track in reversed(list(enumerate(tracks))):  # where the first is complete, all are
        files.of_face(face_id).write(track)
    files.warn_of_more(len(tracks))
    return tracks


def _looks(footage: Footage) -> Iterator[list[Sighting]]:
    """The faces that are seen, twice a second, the largest first."""
    from mien.initialization.detector import everybody

    for cuts, frame in frames_to_look_at(footage):
        yield [replace(_seen(face), cuts=cuts) for face in everybody(frame)]


def _seen(face: Landmarks) -> Sighting:
    """A face that was detected, as what of it is tracked."""
    return Sighting(face.frame_index, face.time, *place_of(face.correspondences()[1]))


def _appearances(looks: Sequence[list[Sighting]]) -> list[list[Sighting]]:
    """The sightings of each face that was seen look after look, in about the same place."""
    found: list[list[Sighting]] = []
    for look in looks:
        for seen in look:
            same = next((one for one in found if seen.follows(one[-1])), None)
            if same is None:
                found.append([seen])
            else:
                same.append(seen)
    # A single look may see a face where there is none.
    return [one for one in found if len(one) > 1 or len(looks) == 1]


def _is_known(sightings: Sequence[Sighting], faces: Sequence[Followed]) -> bool:
    """Whether a track has a face in any of its sightings."""
    return any(face.places.has(seen) for face in faces for seen in sightings)


def _begin(seen: Sighting, footage: Footage, at_once: bool) -> Start | None:
    """What tracking a face begins with that was seen, from the look before that on; None where a closer look does not
    find it."""
    x, y = seen.centre.tolist()
    try:
        begin = prepare(replace(footage, start=seen.time), at_once=at_once, face=(x, y))
    except MienError as error:
        warn(f"{error}; it is left out")
        return None
    before = begin.since - LOOK_EVERY - 1 / footage.video.fps
    since = max(before, footage.start or 0.0)
    return replace(begin, footage=footage, frames=footage.frames(), since=since, told=0, face=None)


def _follow(
    first: Pass,
    passes: int,
    others: Sequence[Followed],
    files: Destination,
    tell: Callable[[Estimate], None],
) -> Followed | None:
    """Track a face and write its files; None, and no files, where hardly a frame shows it that no other track has."""
    begin, followed = first.begin, None
    waiting = {"complete": False, "stopped": "the other faces are not tracked yet"}
    for result, tracker in tracked(first, passes, files, tell):
        track = replace(result, metadata={**result.metadata, **waiting})
        followed = Followed(track, Places(track), tracker, begin.camera)
        alone = len(track) - _apart(followed, others).lost
        if alone < min(_LEAST_SECONDS * begin.footage.video.fps, 0.5 * len(track)):
            return None
        files.write(track)
    return followed


def _apart(face: Followed, all_faces: Sequence[Followed]) -> Track:
    """The track of a face without the frames in which it has another's."""
    reasons: list[str | None] = [None] * len(face.track)
    for other in all_faces:
        if other is not face:
            for k in np.flatnonzero(face.places.taken_by(other.places)):
                reasons[k] = f"face {other.track.metadata['face_id']} is here"
    return face.track.without(reasons)


def _draw(path: Path, frames: Iterator[Frame], faces: Sequence[Followed], tell: Callable[[Estimate], None]) -> None:
    """The video with all its faces, each with its number."""
    from mien.output.overlay import OverlayWriter, Shown, draw

    with OverlayWriter(path) as writer:
        for frame, *estimates in zip(frames, *(face.track.estimates() for face in faces), strict=False):
            shown = [
                Shown(estimate, mesh_of(face.tracker, estimate), str(face_id))
                for face_id, (face, estimate) in enumerate(zip(faces, estimates, strict=True))
                if estimate.status.success
            ]
            writer.write(draw(frame, shown, faces[0].camera), frame.time)
            tell(estimates[0])
