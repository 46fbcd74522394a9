"""The whole pipeline on one page: video -> first frame -> landmarks -> tracker -> Track -> files.

track = mien.track("video.mp4", save="out.csv", overlay="out.mp4")
track.to_pandas()
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np
from pydantic import BaseModel

from mien._version import __version__
from mien.arrays import Array
from mien.candide.model import TRACKED_UNITS, Candide
from mien.errors import MienError, interruption, require, warn
from mien.files import checksum, real_path, require_writable, size_of
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.initialization.fit import FirstFrame, fit_first_frame, turned_deg
from mien.initialization.landmark_files import write_landmarks
from mien.initialization.landmarks import Landmarks, Point
from mien.output.destination import Destination
from mien.output.track import Recorder, Track
from mien.output.window import Window, require_screen
from mien.registry import checked, create_tracker, file_of
from mien.start.first_frame import Start, before_landmarks, before_start, prepare
from mien.start.footage import Footage, requested_options
from mien.start.search import TURNED_DEG
from mien.threads import one_blas_thread
from mien.tracking.state import Estimate, Status, Tracker
from mien.video import Source, Video, backwards, open_video, refuse_among_images

if TYPE_CHECKING:
    from mien.output.overlay import Mesh

DEFAULT_PRESET = "realtime"
_GONE_SECONDS = 10.0
"""Backward tracking stops once the face has been lost for this long."""

Progress = Callable[[Estimate, int | None], None]
"""Called after every frame with its estimate and the expected number of frames, None if unknown."""


@runtime_checkable
class FittedTracker(Protocol):
    """A tracker that fits CANDIDE to the first frame, so that files can store the fit and overlays show its mesh."""

    fit: FirstFrame

    def mesh(self, estimate: Estimate) -> Array | None: ...


@runtime_checkable
class ShapeTracker(Protocol):
    """A tracker that learns the depths of the landmarks while it tracks."""

    def landmark_depths(self, R: Array, t: Array, animation: Array, closed: float) -> Array: ...


@runtime_checkable
class RepeatableTracker(Protocol):
    """A tracker that can start again with what it has learned."""

    def again(self) -> Tracker: ...


@one_blas_thread()
def track(
    video: Source,
    *,
    preset: str = DEFAULT_PRESET,
    landmarks: Landmarks | str | Path | None = None,
    camera: Camera | str | Path | None = None,
    focal_px: float | None = None,
    fov_deg: float | None = None,
    start: float | None = None,
    end: float | None = None,
    at_once: bool = False,
    face: Point | None = None,
    passes: int = 1,
    progress: Progress | None = None,
    save: str | Path | None = None,
    overlay: str | Path | None = None,
    plot: str | Path | None = None,
    show: bool = False,
) -> Track:
    """Track the face of a video file, a folder of images, a camera (its number) or an iterable of `mien.Frame`; a list
    of frames is read like a file.

    preset: a name in `mien.registry`. landmarks: of the first frame, or their file; detected by default. camera: a
    camera or its JSON file; or focal_px; or fov_deg (horizontal); by default 60 degrees along the longer side. start,
    end: seconds. at_once: learn the face from the first frame that shows it; by default, from the best frame within ten
    seconds of its looking into the camera (file), or from the first in which it does (live camera). face: a point of
    the image, in pixels, on the face to track; by default the largest face. passes: 2 tracks a file twice, the second
    time with the face shape learned in the first: more accurate, half as fast. save: path of NAME.csv, with NAME.json
    and NAME.parquet beside it; overlay: an `.mp4`; plot: a `.png`; show: display the overlay in a window while
    tracking.

    If tracking is interrupted (Ctrl-C, window closed, error), the frames tracked so far are written to `save`, and with
    it to `plot`, before the exception propagates, and `complete` in NAME.json is false. If that happens in the second
    pass, the files are those of the first. Raises MienError for bad input.
    """
    tracker = create_tracker(preset)
    footage = Footage(open_video(video), camera, focal_px, fov_deg, start, end)
    files = Destination.checked(save, overlay, plot, inputs=(video, landmarks, camera, file_of(preset)))
    if show:
        require_screen()
    check_passes(passes, footage.video, tracker, preset)
    report = reporter(progress, footage, passes)
    with Window(footage.video.name) if show else nullcontext() as window:
        begin = prepare(footage, landmarks, at_once, face, report, partial(_show_waiting, window, footage))
        for result, _ in run_passes(Pass(begin, preset, tracker, files, report, passes, window=window)):
            files.write(result)
    files.warn_if_stale(1)
    return result


def reporter(progress: Progress | None, footage: Footage, rounds: int) -> Callable[[Estimate], None]:
    """A function that reports an estimate as progress. rounds: how often each frame of the footage is reported."""
    count = footage.frame_count
    total = None if count is None else rounds * count
    return lambda estimate: None if progress is None else progress(estimate, total)


def _show_waiting(window: Window | None, footage: Footage, frame: Frame) -> None:
    """Show a frame in which no face was seen yet, if there is a window."""
    if window is not None:
        from mien.output.overlay import FaceOverlay, draw

        window.show(draw(frame, [FaceOverlay(before_start(frame))], footage.camera_of(frame)))


@dataclass(frozen=True)
class Pass:
    """One pass of a tracker over its frames. files: where the result goes; report: called for each estimate; passes:
    their number, of which the last is drawn; number: 1, or more for a pass that starts with what the previous one has
    learned; window: shows the overlay; face_id: index of the face in the video."""

    begin: Start
    preset: str
    tracker: Tracker
    files: Destination
    report: Callable[[Estimate], None]
    passes: int = 1
    number: int = 1
    window: Window | None = None
    face_id: int = 0


def run_passes(first: Pass) -> Iterator[tuple[Track, Tracker]]:
    """Run all passes; yield the track of each, and the tracker with what it has learned. Only the last is drawn."""
    this = first
    for number in range(1, first.passes + 1):
        if number > 1 and isinstance(this.tracker, RepeatableTracker):
            begin = replace(this.begin, frames=this.begin.footage.frames(), reported=0)
            this = replace(this, begin=begin, tracker=this.tracker.again(), number=number)
        result, this = _run_pass(this)
        yield result, this.tracker


def _run_pass(this: Pass) -> tuple[Track, Pass]:
    """Run one pass; return its track, and the pass with the start that it had and the tracker with what it has learned.

    If interrupted in the first pass, write the frames tracked so far.
    """
    tracker = this.tracker
    earlier: dict[int, Estimate] = {}  # of the frames before the first, until they are recorded
    with Recorder(this.files.table, this.face_id) as recorder:
        try:
            for estimate in this.begin.passed:
                recorder.add(estimate)
            for estimate in run_back(tracker, this.begin):
                earlier[estimate.index] = estimate
                if estimate.index >= this.begin.reported:
                    this.report(estimate)
            if this.number == 1 and this.begin.instead is not None and this.begin.has_strayed(earlier):
                this = _begun_anew(this, replace(this.begin.instead, reported=max(earlier) + 1))
                tracker = this.tracker
                earlier.clear()  # they are another person's
                earlier.update((estimate.index, estimate) for estimate in run_back(tracker, this.begin))
            tracker = _next_tracker(this) if earlier else tracker
            _run_forward(this, tracker, earlier, recorder)
        except BaseException as raised:
            error = interruption(raised)
            for index in sorted(earlier):
                recorder.add(earlier[index])
            _write_stopped(this, tracker, recorder, error)
            if error is raised:
                raise
            raise error from None
        return _track_of(this, tracker, recorder), replace(this, tracker=tracker)


def _begun_anew(this: Pass, begin: Start) -> Pass:
    """The pass with another start, and a tracker that has learned nothing; warns that faces pass each other."""
    anew = replace(this, begin=begin, tracker=create_tracker(this.preset))
    warn(
        f"{begin.footage.video.name}: faces pass each other after {begin.first.time:.2f} s, where the one that is "
        "tracked is learned"
    )
    return anew


def _next_tracker(this: Pass) -> Tracker:
    """A tracker for the forward run, with what was learned so far if the tracker supports that."""
    return this.tracker.again() if isinstance(this.tracker, RepeatableTracker) else create_tracker(this.preset)


def _run_forward(this: Pass, tracker: Tracker, earlier: dict[int, Estimate], recorder: Recorder) -> None:
    """Record, draw and report all frames in their order.

    earlier: what the tracker of the pass has estimated before the first frame, by index; each is removed once it is
    recorded. tracker: tracks the first frame and all after it.
    """
    with drawing(this) as draw:
        for frame, estimate in run(tracker, this.begin, earlier):
            recorder.add(estimate)
            is_earlier = earlier.pop(frame.index, None) is not None
            draw(frame, estimate, this.tracker if is_earlier else tracker)
            if estimate.status is Status.INITIALIZED and this.number == 1:
                warn_if_turned(estimate, this.begin.footage.video, this.face_id)
            if frame.index >= this.begin.reported and not is_earlier:
                this.report(estimate)


def _write_stopped(this: Pass, tracker: Tracker, recorder: Recorder, error: BaseException) -> None:
    """Write the frames that were tracked before this error, except in a second pass; the files hold the first."""
    table = this.files.table
    if this.number > 1 and table is not None:
        warn(f"stopped in the second pass; {table} holds the first")
    elif recorder.count and table is not None:
        with suppress(MienError):  # the original error matters more than a failure to write the rows
            stopped = f"{type(error).__name__}: {error}".removesuffix(": ")
            this.files.write(_track_of(this, tracker, recorder, stopped))
            warn(f"stopped after {recorder.count} frames, which are in {table}")


def _track_of(this: Pass, tracker: Tracker, recorder: Recorder, stopped: str | None = None) -> Track:
    """The recorded track, with its rotations in the head axes, and its landmarks in space with the shape, as the
    tracker finally knows them."""
    track = recorder.track(metadata(this, recorder, stopped))
    report_anew = getattr(getattr(tracker, "axes", None), "report_anew", None)
    track = track.turned(report_anew()) if callable(report_anew) else track
    return track.with_depths(_final_depths(tracker, track, recorder)) if isinstance(tracker, ShapeTracker) else track


def _final_depths(tracker: ShapeTracker, track: Track, recorder: Recorder) -> Array:
    """Depths (n, m) in millimetres of the landmarks of a track by the final shape, NaN where the face is lost."""
    depths = np.full((len(track), len(recorder.landmark_names)), np.nan)
    if track.translation_mm is None or track.animation is None:
        return depths
    t, closed = track.translation_mm / recorder.mm_per_unit, track.eyes_closed
    closed = np.zeros(len(track)) if closed is None else np.nan_to_num(closed)
    for k, R in enumerate(recorder.model_rotations):
        if not np.isnan(R).any():
            depths[k] = tracker.landmark_depths(R, t[k], track.animation[k], float(closed[k]))
    return depths * recorder.mm_per_unit


def warn_if_turned(first: Estimate, video: Video, face_id: int = 0) -> None:
    """Warn if the face is turned away in the first frame, from which its appearance and shape are learned. face_id:
    index of the face in the video."""
    if first.rotation is None or first.translation is None:
        return
    turned = turned_deg(first.rotation, first.translation)
    if turned > TURNED_DEG:
        remedy = "begin" if video.path is None else "use --start to begin"
        face = f"face {face_id}" if face_id else "the face"
        warn(
            f"{video.name}: {face} is turned by {turned:.0f} degrees at {first.time:.2f} s, where tracking begins, "
            f"and all angles will be less certain; {remedy} where it looks into the camera"
        )


def check_passes(passes: int, video: Video, tracker: Tracker, preset: str) -> None:
    """Raise MienError for a number of passes that the video or the tracker does not allow."""
    require(isinstance(passes, int) and passes in (1, 2), f"passes is {passes!r}; give 1 or 2")
    if passes > 1:
        require(video.repeatable, f"{video.name} can be read only once; a second pass needs a file or a list of frames")
        require(isinstance(tracker, RepeatableTracker), f"{preset} learns nothing that a second pass could use; give 1")


@one_blas_thread()
def write_first_frame(
    video: str | Path | int,
    output: str | Path,
    plot: str | Path,
    *,
    landmarks: Landmarks | str | Path | None = None,
    camera: Camera | str | Path | None = None,
    focal_px: float | None = None,
    fov_deg: float | None = None,
    start: float | None = None,
    at_once: bool = False,
    face: Point | None = None,
) -> FirstFrame:
    """Write the landmarks of the first frame, and a picture of the mesh fitted to them; return the fit."""
    from mien.output.overlay import draw_mesh, save_png

    require(Path(plot).suffix.lower() == ".png", f"{plot}: the picture is a PNG; choose a name that ends in .png")
    for path in (Path(output), Path(plot)):
        require(real_path(path) != real_path(Path(str(video))), f"{path} is the video; choose another name")
        refuse_among_images(path, Path(str(video)))
        require_writable(path)
    begin = prepare(Footage(open_video(video), camera, focal_px, fov_deg, start), landmarks, at_once, face)
    fit = fit_first_frame(begin.landmarks, begin.camera, Candide.default().with_whole_brows())
    _, points, _ = begin.landmarks.correspondences()
    vertices = fit.model.pose(fit.vertices(), fit.R, fit.t)
    write_landmarks(output, begin.landmarks)
    save_png(Path(plot), draw_mesh(begin.first, vertices, fit.model.triangles, begin.camera, points))
    return fit


def run_back(tracker: Tracker, begin: Start) -> Iterator[Estimate]:
    """Track backwards from the first frame until the face is lost for good; yields the estimates in that order."""
    if begin.since < begin.first.time:
        seen = begin.first.time
        checked(tracker.initialize(begin.first, begin.landmarks, begin.camera), tracker, begin.first)
        for frame in backwards(begin.footage.video, begin.since, begin.first.index):
            estimate = checked(tracker.track(frame), tracker, frame)
            yield estimate
            if estimate.status.success:
                seen = frame.time
            elif seen - frame.time > _GONE_SECONDS:
                return


def run(
    tracker: Tracker, begin: Start, earlier: Mapping[int, Estimate] = MappingProxyType({})
) -> Iterator[tuple[Frame, Estimate]]:
    """Track forwards; yields each frame with its estimate, before the first that of `run_back` by index."""
    for frame in begin.frames:
        if frame.index < begin.first.index:
            yield frame, earlier.get(frame.index) or before_landmarks(frame)
        elif frame.index == begin.first.index:
            yield frame, checked(tracker.initialize(frame, begin.landmarks, begin.camera), tracker, frame)
        else:
            yield frame, checked(tracker.track(frame), tracker, frame)


@contextmanager
def drawing(this: Pass) -> Iterator[Callable[[Frame, Estimate, Tracker], None]]:
    """A function that draws a tracker's estimate on its frame: into a video, in the last pass, and on the screen, if
    wanted."""
    path = this.files.overlay if this.number == this.passes else None
    if path is None and this.window is None:
        yield lambda frame, estimate, tracker: None
        return
    from mien.output.overlay import FaceOverlay, OverlayWriter, draw

    begins = this.begin.passed[0].time if this.begin.passed else None
    with OverlayWriter(path, begins) if path else nullcontext() as writer:

        def draw_estimate(frame: Frame, estimate: Estimate, tracker: Tracker) -> None:
            picture = draw(frame, [FaceOverlay(estimate, mesh_of(tracker, estimate))], this.begin.camera)
            if writer:
                writer.write(picture, frame.time)
            if this.window:
                this.window.show(picture)

        yield draw_estimate


def mesh_of(tracker: Tracker, estimate: Estimate) -> Mesh | None:
    """The face mesh of a tracker at an estimate, None if it has no face model or the face is lost."""
    from mien.output.overlay import Mesh

    if not isinstance(tracker, FittedTracker):
        return None
    vertices = tracker.mesh(estimate)
    return None if vertices is None else Mesh(vertices, tracker.fit.model.triangles)


def _mesh_at_rest(tracker: FittedTracker) -> dict[str, Any]:
    """What `Track.mesh` needs: in millimetres and the axes of the head, as they are known now, the vertices (V, 3) at
    rest, and of each animation unit the displacements (m, 3) of those of the vertices that it moves."""
    fit = tracker.fit
    turn = getattr(getattr(tracker, "axes", None), "turn", np.eye(3)) * fit.mm_per_unit
    units = {}
    for name, displacements in zip(TRACKED_UNITS, fit.model.animation_units, strict=True):
        moved = np.flatnonzero(np.abs(displacements).max(axis=1) > 0)
        units[name] = {"moved": moved.tolist(), "by": np.round(displacements[moved] @ turn, 2).tolist()}
    return {"vertices": np.round(fit.shape @ turn, 2).tolist(), "units": units}


def settings_of(tracker: Tracker) -> dict[str, Any]:
    """The settings of a tracker as plain values; empty if it has none."""
    own = getattr(tracker, "settings", None)
    return dict(own.model_dump(mode="json")) if isinstance(own, BaseModel) else {}


def metadata(this: Pass, recorder: Recorder, stopped: str | None = None) -> Mapping[str, Any]:
    """The content of NAME.json: everything needed to reproduce the track."""
    begin, tracker, video = this.begin, this.tracker, this.begin.footage.video
    values: dict[str, Any] = {
        "mien": __version__,
        "complete": stopped is None,
        "stopped": stopped,
        "frames": recorder.count,
        "video": {
            "name": video.name,
            "sha256": None if video.path is None else checksum(video.path),
            "bytes": None if video.path is None else size_of(video.path),
            "inode": None if video.path is None else video.path.stat().st_ino,
            "width": begin.first.width,
            "height": begin.first.height,
            "fps": video.fps,
        },
        "preset": this.preset,
        "passes": this.number,
        "face_id": this.face_id,
        "asked": requested_options(begin.footage, begin.at_once, begin.face),
        "camera": asdict(begin.camera),
        "landmarks": begin.landmarks.to_dict() | {"source": begin.landmarks.source},
        "landmark_names": list(recorder.landmark_names),
        "mm_per_unit": recorder.mm_per_unit,
    }
    settings = settings_of(tracker)
    if settings:
        values["settings"] = settings
    if isinstance(tracker, FittedTracker):
        names = tracker.fit.model.shape_unit_names
        values["shape_units"] = dict(zip(names, (np.round(tracker.fit.sigma, 6) + 0.0).tolist(), strict=True))
        values["fit_residual_px"] = round(tracker.fit.residual_px, 4)
        values["mesh"] = _mesh_at_rest(tracker)
    return values
