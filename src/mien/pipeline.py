"""The whole of it on one page: video -> first frame -> landmarks -> tracker -> Track -> files.

track = mien.track("video.mp4", save="out.csv", overlay="out.mp4")
track.to_pandas()
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from mien._version import __version__
from mien.config import Settings
from mien.errors import MienError, require, warn
from mien.files import checksum, require_writable
from mien.geometry.camera import DEFAULT_FOV_DEG, Camera
from mien.geometry.rotation import Array
from mien.initialization.fit import FirstFrame, fit_first_frame
from mien.initialization.landmark_files import read_landmarks, write_landmarks
from mien.initialization.landmarks import Landmarks
from mien.output.destination import Destination
from mien.output.track import Recorder, Track
from mien.registry import create_tracker
from mien.tracking.state import Estimate, Status, Tracker
from mien.video import Frame, Video, expected_count, open_video, select

DEFAULT_PRESET = "realtime"
TURNED_DEG = 15.0
"""Turn of the face in the first frame beyond which errors are twice as large (docs/benchmark.md)."""

Progress = Callable[[Estimate, int | None], None]
"""Called after every frame with its estimate and the number of frames to expect, None where unknown."""


@runtime_checkable
class FittedTracker(Protocol):
    """A tracker that fits CANDIDE to the first frame, which its files and pictures then show."""

    settings: Settings
    fit: FirstFrame

    def mesh(self, estimate: Estimate) -> Array | None: ...


@runtime_checkable
class RepeatableTracker(Protocol):
    """A tracker that can begin again, with what it has learned."""

    def again(self) -> Tracker: ...


@dataclass(frozen=True)
class Start:
    """All that tracking begins with. first: the frame that the landmarks belong to; frames: those that are tracked, the
    first among them, and before it those that come before there is a face; told: index of the first of them that
    progress has not heard of, when a face was looked for."""

    video: Video
    first: Frame
    frames: Iterator[Frame]
    landmarks: Landmarks
    camera: Camera
    told: int = 0


def track(
    video: str | Path | int,
    *,
    preset: str = DEFAULT_PRESET,
    landmarks: Landmarks | str | Path | None = None,
    camera: Camera | str | Path | None = None,
    focal_px: float | None = None,
    fov_deg: float | None = None,
    start: float | None = None,
    end: float | None = None,
    passes: int = 1,
    progress: Progress | None = None,
    save: str | Path | None = None,
    overlay: str | Path | None = None,
    plot: str | Path | None = None,
) -> Track:
    """Track the face of a video file, a folder of images or a camera (its number).

    preset: a name in `mien.registry`. landmarks: of the first frame, or their file; detected when not given.
    camera: or its JSON file, or focal_px, or fov_deg (horizontal); 60 degrees with nothing known. start, end:
    seconds. passes: 2 tracks a file twice, from the start with the shape of the face that the first time has taught:
    more accurate, half as fast. save: where NAME.csv, NAME.json and NAME.parquet go; overlay: an `.mp4`; plot: a
    `.png`.

    When it is stopped (Ctrl-C, an error), what was tracked is written to `save` and `plot` before the
    exception goes on; `complete` in NAME.json is then false. Stopped in the second pass, the files are those of the
    first. Raises MienError for bad input.
    """
    tracker = create_tracker(preset)
    files = Destination.checked(save, overlay, plot, inputs=(video, landmarks, camera))
    source = open_video(video)
    count = expected_count(source, start, end)
    total = None if count is None else passes * count

    def tell(estimate: Estimate) -> None:
        if progress is not None:
            progress(estimate, total)

    begin = prepare(source, landmarks, camera, focal_px, fov_deg, start, end, tell)
    _check_passes(passes, source, tracker, preset)
    for turn in range(1, passes + 1):
        if turn > 1 and isinstance(tracker, RepeatableTracker):
            tracker = tracker.again()
            begin = replace(begin, frames=select(source, start, end), told=0)
        result = _one_pass(Pass(begin, preset, tracker, turn), files, tell, last=turn == passes)
        files.write(result)
    return result


@dataclass(frozen=True)
class Pass:
    """One pass of a tracker over its frames: the first, or one with what the pass before has learned."""

    begin: Start
    preset: str
    tracker: Tracker
    turn: int


def _one_pass(this: Pass, files: Destination, tell: Callable[[Estimate], None], last: bool) -> Track:
    """The track of one pass, of which only the last is drawn; where it is stopped, what it has is written, unless a
    whole pass already is."""
    with Recorder(files.table) as recorder:
        try:
            with drawing(files.overlay if last else None, this.tracker, this.begin.camera) as draw:
                for frame, estimate in run(this.tracker, this.begin):
                    recorder.add(estimate)
                    draw(frame, estimate)
                    if estimate.status is Status.INITIALIZED and this.turn == 1:
                        _warn_of_a_turned_face(estimate, this.begin.video.name)
                    if frame.index >= this.begin.told:
                        tell(estimate)
        except BaseException as error:
            if this.turn > 1 and files.table is not None:
                warn(f"stopped in the second pass; {files.table} holds the first")
            elif recorder.count and files.table is not None:
                with suppress(MienError):  # what stopped it matters more than that its rows cannot be written
                    stopped = f"{type(error).__name__}: {error}".removesuffix(": ")
                    files.write(recorder.track(metadata(this, recorder, stopped)))
                    warn(f"stopped after {recorder.count} frames, which are in {files.table}")
            raise
        return recorder.track(metadata(this, recorder))


def _warn_of_a_turned_face(first: Estimate, name: str) -> None:
    """What the first frame shows is all that is known of a face, and a turned face shows half of it."""
    if first.rotation is None or first.translation is None:
        return
    towards = -first.translation / np.linalg.norm(first.translation)
    turned = float(np.degrees(np.arccos(np.clip(first.rotation[:, 2] @ towards, -1, 1))))
    if turned > TURNED_DEG:
        warn(
            f"{name}: the face is turned by {turned:.0f} degrees at {first.time:.2f} s, where tracking begins, and all "
            "angles will be less certain; with --start choose a time at which it looks into the camera"
        )


def _check_passes(passes: int, video: Video, tracker: Tracker, preset: str) -> None:
    """Raise MienError for passes that cannot be had."""
    require(passes in (1, 2), f"{passes} passes over a video; give 1 or 2")
    if passes > 1:
        require(video.path is not None, f"{video.name} shows every frame once; more than one pass needs a file")
        require(isinstance(tracker, RepeatableTracker), f"{preset} learns nothing that a second pass could begin with")


def prepare(
    source: Video,
    landmarks: Landmarks | str | Path | None = None,
    camera: Camera | str | Path | None = None,
    focal_px: float | None = None,
    fov_deg: float | None = None,
    start: float | None = None,
    end: float | None = None,
    tell: Callable[[Estimate], None] = lambda estimate: None,
) -> Start:
    """Choose the camera, find the face: where no landmarks are given, in the first frame that shows one, and `tell`
    hears of those that show none; where they belong to a later frame, there. Raises MienError for bad input."""
    frames = select(source, start, end)
    earliest = next(frames)
    chosen = choose_camera(earliest, camera, focal_px, fov_deg)
    told = 0
    if landmarks is None:
        search = chain([earliest], frames)
        first, landmarks = find_face(search, source.name, without_face=lambda frame: tell(_not_yet(frame)))
        told = first.index
    else:
        if not isinstance(landmarks, Landmarks):
            landmarks = read_landmarks(landmarks, earliest.index, earliest.time)
        first = _frame_of(landmarks, chain([earliest], frames), source)
    landmarks.check(first.width, first.height)
    # A camera shows every frame once: what came before the face is gone.
    seen_again = first is not earliest and source.path is not None
    frames = select(source, start, end) if seen_again else chain([first], frames)
    return Start(source, first, frames, _as_written(landmarks), chosen, told)


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
) -> FirstFrame:
    """Write the landmarks of the first frame, and a picture of the mesh that is fitted to them; give the fit."""
    from mien.output.overlay import draw_mesh, save_png

    require(Path(plot).suffix.lower() == ".png", f"{plot}: the picture is a PNG; choose a name that ends in .png")
    for path in (Path(output), Path(plot)):
        require(path.resolve() != Path(str(video)).resolve(), f"{path} is the video; choose another name")
        require_writable(path)
    begin = prepare(open_video(video), landmarks, camera, focal_px, fov_deg, start)
    fit = fit_first_frame(begin.landmarks, begin.camera)
    _, points, _ = begin.landmarks.correspondences()
    vertices = fit.model.pose(fit.vertices(), fit.R, fit.t)
    write_landmarks(output, begin.landmarks)
    save_png(Path(plot), draw_mesh(begin.first, vertices, fit.model.triangles, begin.camera, points))
    return fit


def run(tracker: Tracker, begin: Start) -> Iterator[tuple[Frame, Estimate]]:
    """Each frame with its estimate; before the first that has landmarks the face is not there yet."""
    for frame in begin.frames:
        if frame.index < begin.first.index:
            yield frame, _not_yet(frame)
        elif frame.index == begin.first.index:
            yield frame, tracker.initialize(frame, begin.landmarks, begin.camera)
        else:
            yield frame, tracker.track(frame)


def _not_yet(frame: Frame) -> Estimate:
    return Estimate.lost(frame, "no face was seen yet")


def find_face(frames: Iterable[Frame], name: str, without_face: Callable[[Frame], None]) -> tuple[Frame, Landmarks]:
    """The first frame with a face, and the largest that is there; `without_face` is called with those before it. Raises
    MienError if there is none; warns where it is not the first of the frames, or has several faces."""
    from mien.initialization.detector import first_with_a_face

    times: list[float] = []

    def noted() -> Iterator[Frame]:
        for frame in frames:
            times.append(frame.time)
            yield frame
            without_face(frame)

    found = first_with_a_face(noted())
    if found is None:
        raise MienError(
            f"{name}: no face was found in its {len(times)} frames from {times[0]:.2f} s to {times[-1]:.2f} s; "
            "annotate one and pass --landmarks, or enlarge or brighten the video"
        )
    first, faces = found
    if len(times) > 1:
        warn(f"{name}: a face is first found at {first.time:.2f} s; the frames before have no pose")
    if len(faces) > 1:
        warn(f"{name}: {len(faces)} faces in the frame at {first.time:.2f} s; the largest is tracked")
    return first, replace(faces[0], source=f"{name}, detected face")


def choose_camera(
    frame: Frame,
    camera: Camera | str | Path | None = None,
    focal_px: float | None = None,
    fov_deg: float | None = None,
) -> Camera:
    """The camera that is given in one of three ways, else one with a field of view of 60 degrees."""
    given = [v for v in (camera, focal_px, fov_deg) if v is not None]
    require(len(given) <= 1, "the camera is given in more than one way; give a file, a focal length or a field of view")
    if isinstance(camera, Camera):
        return camera
    if camera is not None:
        return read_camera(Path(camera))
    if focal_px is not None:
        return Camera.centred(focal_px, frame.width, frame.height)
    return Camera.from_fov(frame.width, frame.height, DEFAULT_FOV_DEG if fov_deg is None else fov_deg)


def read_camera(path: Path) -> Camera:
    """The camera in a JSON {"focal_px": .., "cx": .., "cy": ..}, or in NAME.json of an earlier track."""
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


@contextmanager
def drawing(path: Path | None, tracker: Tracker, camera: Camera) -> Iterator[Callable[[Frame, Estimate], None]]:
    """A function that draws an estimate on its frame into the video `path`, or does nothing without one."""
    if path is None:
        yield lambda frame, estimate: None
        return
    from mien.output.overlay import Mesh, OverlayWriter, draw

    def mesh(estimate: Estimate) -> Mesh | None:
        if not isinstance(tracker, FittedTracker):
            return None
        vertices = tracker.mesh(estimate)
        return None if vertices is None else Mesh(vertices, tracker.fit.model.triangles)

    with OverlayWriter(path) as writer:
        yield lambda frame, estimate: writer.write(draw(frame, estimate, mesh(estimate), camera), frame.time)


def metadata(this: Pass, recorder: Recorder, stopped: str | None = None) -> Mapping[str, Any]:
    """What is needed to get the same numbers again: the content of NAME.json."""
    begin, tracker, path = this.begin, this.tracker, this.begin.video.path
    values: dict[str, Any] = {
        "mien": __version__,
        "complete": stopped is None,
        "stopped": stopped,
        "frames": recorder.count,
        "video": {
            "name": begin.video.name,
            "sha256": None if path is None else checksum(path),
            "width": begin.first.width,
            "height": begin.first.height,
            "fps": begin.video.fps,
        },
        "preset": this.preset,
        "passes": this.turn,
        "camera": asdict(begin.camera),
        "landmarks": begin.landmarks.to_dict() | {"source": begin.landmarks.source},
        "landmark_names": list(recorder.landmark_names),
    }
    if isinstance(tracker, FittedTracker):
        names = tracker.fit.model.shape_unit_names
        values["settings"] = tracker.settings.model_dump(mode="json")
        values["shape_units"] = dict(zip(names, (np.round(tracker.fit.sigma, 6) + 0.0).tolist(), strict=True))
        values["fit_residual_px"] = round(tracker.fit.residual_px, 4)
        values["mm_per_unit"] = tracker.fit.mm_per_unit
    return values


def _as_written(landmarks: Landmarks) -> Landmarks:
    """The landmarks with the decimals that they have in a file, so that a run from that file is the same run."""
    written = landmarks.to_dict()
    depths = written["depths"]
    return replace(
        landmarks,
        points=np.array(written["points"]),
        depths=None if depths is None else np.array(depths),
    )
