"""Track all faces in a video, one after the other, each as if it were alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

from mien.errors import MienError, noted_warnings, require, warn, warnings_noted
from mien.faces.sightings import Sighting, appearances_in, detections_in, sighting_of
from mien.faces.tracked import LEAST_SECONDS, FaceBoxes, TrackedFace, is_known, unknown_part, without_other_faces
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.output.destination import Destination, write_in_any_case
from mien.output.track import Track
from mien.pipeline.drawing import mesh_of
from mien.pipeline.passes import Pass, run_passes
from mien.pipeline.track import Progress, check_faces, check_mesh, check_passes, reporter
from mien.registry import DEFAULT_PRESET, create_tracker, file_of
from mien.start.first_frame import Start, prepare
from mien.start.footage import Footage
from mien.start.search import DETECTION_INTERVAL, EASIER_TO_FIND
from mien.threads import one_blas_thread
from mien.tracking.state import Estimate
from mien.video import Source, open_video


@one_blas_thread()
@warnings_noted()
def track_faces(
    video: Source,
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
    """Track up to `faces` faces of a video file, a folder of images or a list of frames, in order of appearance, the
    largest first of those that appear together.

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
    check_passes(passes, tracker, preset, footage.video)
    check_mesh(files.gltf, tracker, preset)
    name = footage.video.name
    check_faces(faces)
    faces = int(faces)
    for face_id in range(1, faces):
        files.of_face(face_id).check(inputs)
    require(footage.repeatable, f"{name} can be read only once; several faces need a file or a list of frames")
    with closing(footage):
        detections = list(detections_in(footage))
        require(any(detections), f"{name}: no face was found in it; {EASIER_TO_FIND}")
        together = max(map(len, detections))
        if together > faces:
            warn(f"{name}: {together} faces are seen at the same time; --faces {together} tracks all of them")
        run = _Run(footage, preset, passes, at_once, files, faces, min(faces, together), progress)
        found = run.track_all(appearances_in(detections))
        require(bool(found), f"{name}: nothing that looks like a face could be tracked for a second; check the video")
        found = [replace(face, track=without_other_faces(face, found)) for face in found]
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
        unknown = unknown_part(appearance, found)
        prepared = _prepare(unknown[0], self.footage, self.at_once) if unknown else None
        starts = (prepared, prepared.instead) if prepared else ()
        begin = next((start for start in starts if start and not is_known(sighting_of(start.landmarks), found)), None)
        if begin is None:
            return None
        face_id, tracker = len(found), create_tracker(self.preset)
        files = replace(self.files.of_face(face_id), overlay=None)
        report = self.reporter(face_id + 1)
        first = Pass(begin, self.preset, tracker, files, report, self.passes, face_id=face_id)
        return _track_face(first, found, apart=len(unknown) < len(appearance))


def _prepare(seen: Sighting, footage: Footage, at_once: bool) -> Start | None:
    """The start of tracking a detected face, from one detection interval earlier on; None if a closer look does not
    find it."""
    x, y = seen.centre.tolist()
    with closing(footage.since(seen.time)) as rest:
        try:
            begin = prepare(rest, at_once=at_once, face=(x, y))
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
        since=before if footage.start is None else max(before, footage.start),
        reported=0,
        face=None,
        instead=begin.instead and _within(begin.instead, footage),
    )


def _track_face(first: Pass, others: Sequence[TrackedFace], apart: bool) -> TrackedFace | None:
    """Track a face and write its files; None, without files, if other tracks have it in all but a few frames. apart:
    part of its appearance is another track's, which then has it in more than a few frames if it is the same face."""
    begin, face = first.begin, None  # as the last pass has tracked it
    incomplete = {"complete": False, "stopped": "the other faces are not tracked yet"}
    for result, tracker in run_passes(first):
        track = replace(result, metadata={**result.metadata, **incomplete})
        tracked = TrackedFace(track, FaceBoxes(track), tracker, begin.camera)
        own = len(track) - without_other_faces(tracked, others).lost
        shared = len(track) - track.lost - own
        few = min(LEAST_SECONDS * begin.footage.video.fps, 0.5 * len(track))
        if own < few or (apart and shared > few):
            if face is not None:
                first.files.remove()
            return None
        face = tracked
        write_in_any_case(first.files, track)
    return face


def _draw(
    path: Path, frames: Iterator[Frame], faces: Sequence[TrackedFace], report: Callable[[Estimate], None]
) -> None:
    """Write the overlay video with all faces, each with its number."""
    from mien.output.overlay import FaceOverlay, draw
    from mien.output.overlay_video import OverlayWriter

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
    files.warn_if_stale(len(found))
    summary = {"complete": True, "stopped": None, "faces": len(found), "faces_wanted": wanted}
    warnings = {"warnings": noted_warnings()}
    tracks = [replace(face.track, metadata={**face.track.metadata, **summary, **warnings}) for face in found]
    for face_id, track in reversed(list(enumerate(tracks))):  # if the first is complete, all are
        files.of_face(face_id).write(track)
    return tracks
