"""The whole of it on one page: video -> first frame -> landmarks -> tracker -> Track -> files.

track = mien.track("video.mp4", save="out.csv", overlay="out.mp4")
track.to_pandas()
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np
from pydantic import BaseModel

from mien._version import __version__
from mien.candide.model import Candide
from mien.errors import MienError, interruption, require, warn
from mien.files import checksum, require_writable, size_of
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import Array
from mien.initialization.fit import FirstFrame, fit_first_frame, turned_deg
from mien.initialization.landmark_files import write_landmarks
from mien.initialization.landmarks import Landmarks, Point
from mien.output.destination import Destination
from mien.output.track import Recorder, Track
from mien.output.window import Window, require_screen
from mien.registry import checked, create_tracker, file_of
from mien.start import TURNED_DEG, Footage, Start, asked, prepare
from mien.tracking.axes import HeadAxes
from mien.tracking.state import Estimate, Status, Tracker
from mien.video import Source, Video, backwards, open_video

if TYPE_CHECKING:
    from mien.output.overlay import Mesh

DEFAULT_PRESET = "realtime"
_GONE_SECONDS = 10.0
"""How long a face must be lost before the first frame for what is still earlier to be left alone."""

Progress = Callable[[Estimate, int | None], None]
"""Called after every frame with its estimate and the number of frames to expect, None where unknown."""


@runtime_checkable
class FittedTracker(Protocol):
    """A tracker that fits CANDIDE to the first frame, which its files and pictures then show."""

    fit: FirstFrame

    def mesh(self, estimate: Estimate) -> Array | None: ...


@runtime_checkable
class RepeatableTracker(Protocol):
    """A tracker that can begin again, with what it has learned."""

    def again(self) -> Tracker: ...


@runtime_checkable
class AxesTracker(Protocol):
    """A tracker that finds the axes of the head better while it tracks it."""

    axes: HeadAxes


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
    """Track the face of a video file, a folder of images, a camera (its number) or an iterable of `mien.Frame`.

    preset: a name in `mien.registry`. landmarks: of the first frame, or their file; detected when not given.
    camera: or its JSON file, or focal_px, or fov_deg (horizontal); 60 degrees with nothing known. start, end:
    seconds. at_once: learn the face in the first frame that shows it, and not, of a file, in the one that shows it best
    of the ten seconds after it looks into the camera, of a camera, where it first does. face: a point of the image, in
    pixels, at which the face is that is tracked; the largest, where none is given. passes: 2 tracks a file twice,
    the second time with the shape of the face that the first has taught: more accurate, half as fast. save: where
    NAME.csv, NAME.json and NAME.parquet go; overlay: an `.mp4`; plot: a `.png`; show: in a window, while it is tracked.

    When it is stopped (Ctrl-C, the window closed, an error), what was tracked is written to `save` and `plot` before
    the exception goes on; `complete` in NAME.json is then false. Stopped in the second pass, the files are those of
    the first. Raises MienError for bad input.
    """
    tracker = create_tracker(preset)
    files = Destination.checked(save, overlay, plot, inputs=(video, landmarks, camera, file_of(preset)))
    if show:
        require_screen()
    footage = Footage(open_video(video), camera, focal_px, fov_deg, start, end)
    count = footage.frame_count
    total = None if count is None else passes * count

    def tell(estimate: Estimate) -> None:
        if progress is not None:
            progress(estimate, total)

    check_passes(passes, footage.video, tracker, preset)
    begin = prepare(footage, landmarks, at_once, face, tell)
    for result, _ in tracked(Pass(begin, preset, tracker, show=show), passes, files, tell):
        files.write(result)
    files.warn_of_more(1)
    return result


@dataclass(frozen=True)
class Pass:
    """One pass of a tracker over its frames: the first, or one with what the pass before has learned. face_id: which
    face of the video it is."""

    begin: Start
    preset: str
    tracker: Tracker
    turn: int = 1
    show: bool = False
    face_id: int = 0


def tracked(
    first: Pass, passes: int, files: Destination, tell: Callable[[Estimate], None]
) -> Iterator[tuple[Track, Tracker]]:
    """The track after each pass, of which only the last is drawn, and the tracker that has learned from all of it."""
    this = first
    for turn in range(1, passes + 1):
        if turn > 1 and isinstance(this.tracker, RepeatableTracker):
            begin = replace(this.begin, frames=this.begin.footage.frames(), told=0)
            this = replace(this, begin=begin, tracker=this.tracker.again(), turn=turn)
        result, tracker = _one_pass(this, files, tell, last=turn == passes)
        yield result, tracker
        this = replace(this, tracker=tracker)


def _one_pass(this: Pass, files: Destination, tell: Callable[[Estimate], None], last: bool) -> tuple[Track, Tracker]:
    """The track of one pass, of which only the last is drawn, and the tracker that has learned from all of it; where it
    is stopped, what it has is written, unless a whole pass already is."""
    begin, tracker = this.begin, this.tracker
    earlier: dict[int, Estimate] = {}
    with Recorder(files.table, this.face_id) as recorder:
        try:
            for estimate in run_back(tracker, begin):
                earlier[estimate.index] = estimate
                if estimate.index >= begin.told:
                    tell(estimate)
            tracker = _next_tracker(this) if earlier else tracker
            with drawing(files.overlay if last else None, this) as draw:
                for frame, estimate in run(tracker, begin, earlier):
                    recorder.add(estimate)
                    draw(frame, estimate, this.tracker if frame.index in earlier else tracker)
                    if estimate.status is Status.INITIALIZED and this.turn == 1:
                        warn_of_a_turned_face(estimate, begin.footage.video.name)
                    if frame.index >= begin.told and frame.index not in earlier:
                        tell(estimate)
        except BaseException as raised:
            error = interruption(raised)
            if not recorder.count:
                for index in sorted(earlier):
                    recorder.add(earlier[index])
            if this.turn > 1 and files.table is not None:
                warn(f"stopped in the second pass; {files.table} holds the first")
            elif recorder.count and files.table is not None:
                with suppress(MienError):  # what stopped it matters more than that its rows cannot be written
                    stopped = f"{type(error).__name__}: {error}".removesuffix(": ")
                    files.write(_told(recorder, tracker, metadata(this, recorder, stopped)))
                    warn(f"stopped after {recorder.count} frames, which are in {files.table}")
            if error is raised:
                raise
            raise error from None
        return _told(recorder, tracker, metadata(this, recorder)), tracker


def _told(recorder: Recorder, tracker: Tracker, values: Mapping[str, Any]) -> Track:
    """What was recorded, its rotations turned to what a tracker knows of the head's axes by now."""
    track = recorder.track(values)
    return track.turned(tracker.axes.tell_anew()) if isinstance(tracker, AxesTracker) else track


def _next_tracker(this: Pass) -> Tracker:
    """One that begins again, with what this pass has taught so far, where the tracker can."""
    return this.tracker.again() if isinstance(this.tracker, RepeatableTracker) else create_tracker(this.preset)


def warn_of_a_turned_face(first: Estimate, name: str) -> None:
    """What the first frame shows is all that is known of a face, and a turned face shows half of it."""
    if first.rotation is None or first.translation is None:
        return
    turned = turned_deg(first.rotation, first.translation)
    if turned > TURNED_DEG:
        warn(
            f"{name}: the face is turned by {turned:.0f} degrees at {first.time:.2f} s, where tracking begins, and all "
            "angles will be less certain; with --start choose a time at which it looks into the camera"
        )


def check_passes(passes: int, video: Video, tracker: Tracker, preset: str) -> None:
    """Raise MienError for passes that cannot be had."""
    require(isinstance(passes, int) and passes in (1, 2), f"{passes!r} passes over a video; give 1 or 2")
    if passes > 1:
        require(video.path is not None, f"{video.name} shows every frame once; more than one pass needs a file")
        require(isinstance(tracker, RepeatableTracker), f"{preset} learns nothing that a second pass could begin with")


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
    """Write the landmarks of the frame in which tracking begins, and a picture of the mesh that is fitted to them; give
    the fit."""
    from mien.output.overlay import draw_mesh, save_png

    require(Path(plot).suffix.lower() == ".png", f"{plot}: the picture is a PNG; choose a name that ends in .png")
    for path in (Path(output), Path(plot)):
        require(path.resolve() != Path(str(video)).resolve(), f"{path} is the video; choose another name")
        require_writable(path)
    begin = prepare(Footage(open_video(video), camera, focal_px, fov_deg, start), landmarks, at_once, face)
    fit = fit_first_frame(begin.landmarks, begin.camera, Candide.default().with_whole_brows())
    _, points, _ = begin.landmarks.correspondences()
    vertices = fit.model.pose(fit.vertices(), fit.R, fit.t)
    write_landmarks(output, begin.landmarks)
    save_png(Path(plot), draw_mesh(begin.first, vertices, fit.model.triangles, begin.camera, points))
    return fit


def run_back(tracker: Tracker, begin: Start) -> Iterator[Estimate]:
    """Estimates of what comes before the first frame, from there backwards, until the face is lost for good."""
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
    """Each frame with its estimate; before the first, by index, from those that `run_back` gave."""
    for frame in begin.frames:
        if frame.index < begin.first.index:
            yield frame, earlier.get(frame.index) or Estimate.lost(frame, "tracking begins later")
        elif frame.index == begin.first.index:
            yield frame, checked(tracker.initialize(frame, begin.landmarks, begin.camera), tracker, frame)
        else:
            yield frame, checked(tracker.track(frame), tracker, frame)


@contextmanager
def drawing(path: Path | None, this: Pass) -> Iterator[Callable[[Frame, Estimate, Tracker], None]]:
    """A function that draws an estimate of a tracker on its frame, into the video `path` and on the screen where they
    are wanted."""
    if path is None and not this.show:
        yield lambda frame, estimate, tracker: None
        return
    from mien.output.overlay import OverlayWriter, Shown, draw

    with ExitStack() as opened:
        writer = opened.enter_context(OverlayWriter(path)) if path else None
        window = opened.enter_context(Window(this.begin.footage.video.name)) if this.show else None

        def drawn(frame: Frame, estimate: Estimate, tracker: Tracker) -> None:
            picture = draw(frame, [Shown(estimate, mesh_of(tracker, estimate))], this.begin.camera)
            if writer:
                writer.write(picture, frame.time)
            if window:
                window.show(picture)

        yield drawn


def mesh_of(tracker: Tracker, estimate: Estimate) -> Mesh | None:
    """The face model at an estimate of a tracker, where it has one."""
    from mien.output.overlay import Mesh

    if not isinstance(tracker, FittedTracker):
        return None
    vertices = tracker.mesh(estimate)
    return None if vertices is None else Mesh(vertices, tracker.fit.model.triangles)


def settings_of(tracker: Tracker) -> dict[str, Any]:
    """A tracker's settings as plain values, none where it has none."""
    own = getattr(tracker, "settings", None)
    return dict(own.model_dump(mode="json")) if isinstance(own, BaseModel) else {}


def metadata(this: Pass, recorder: Recorder, stopped: str | None = None) -> Mapping[str, Any]:
    """What is needed to get the same numbers again: the content of NAME.json."""
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
            "width": begin.first.width,
            "height": begin.first.height,
            "fps": video.fps,
        },
        "preset": this.preset,
        "passes": this.turn,
        "face_id": this.face_id,
        "asked": asked(begin.footage, begin.at_once, begin.face),
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
    return values
