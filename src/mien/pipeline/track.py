"""`mien.track`: from a video to a `Track`, and its files.

track = mien.track("video.mp4", save="out.csv", overlay="out.mp4")
track.to_pandas()
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing, nullcontext
from functools import partial
from numbers import Integral
from pathlib import Path

from mien.errors import require, warnings_noted
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.initialization.landmarks import Landmarks, Point
from mien.output.destination import Destination, write_in_any_case
from mien.output.track import Track
from mien.output.window import Window, require_screen
from mien.pipeline.passes import Pass, run_passes
from mien.registry import DEFAULT_PRESET, create_tracker, file_of
from mien.start.first_frame import prepare
from mien.start.footage import Footage
from mien.threads import one_blas_thread
from mien.tracking.abilities import RepeatableTracker
from mien.tracking.state import Estimate, Tracker
from mien.video import Source, Video, open_video

_MOST_FACES = 1000

Progress = Callable[[Estimate, int | None], None]
"""Called after every frame with its estimate and the expected number of frames, None if unknown."""


@one_blas_thread()
@warnings_noted()
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
    fps: float | None = None,
    at_once: bool = False,
    face: Point | None = None,
    passes: int = 1,
    progress: Progress | None = None,
    save: str | Path | None = None,
    overlay: str | Path | None = None,
    plot: str | Path | None = None,
    gltf: str | Path | None = None,
    show: bool = False,
) -> Track:
    """Track the face of a video file, a folder of images, a camera (its number) or an iterable of `mien.Frame`; a list
    of frames is read like a file.

    preset: a name in `mien.registry`, `realtime:FILE` with settings, or your own MODULE:CLASS. landmarks: of the first
    frame, or their file; detected by default. camera: a camera or its JSON file; or focal_px; or fov_deg (horizontal);
    by default 60 degrees along the longer side. start, end: seconds. fps: frames per second of a folder of images, by
    default 25. at_once: learn the face from the first frame that shows it; by default, from the best frame within ten
    seconds of its looking into the camera (file), or from the first in which it does (live camera). face: a point of
    the image, in pixels, on the face to track; by default the largest face. passes: 2 tracks a file twice, the second
    time with the face shape learned in the first: more accurate, half as fast. save: path of NAME.csv, with NAME.json
    and NAME.parquet beside it; overlay: an `.mp4`; plot: a `.png`, `.pdf` or `.svg`; gltf: a `.glb`, as of
    `Track.save_gltf`; show: display the overlay in a window while tracking.

    If tracking is interrupted (Ctrl-C, window closed, error), the frames tracked so far are written to `save`, and with
    it to `plot` and `gltf`, before the exception propagates, and `complete` in NAME.json is false. If that happens in
    the second pass, the files are those of the first. Raises MienError for bad input.
    """
    tracker = create_tracker(preset)
    footage = Footage(open_video(video, fps), camera, focal_px, fov_deg, start, end, fps)
    files = Destination.checked(save, overlay, plot, gltf, inputs=(video, landmarks, camera, file_of(preset)))
    if show:
        require_screen()
    check_passes(passes, tracker, preset, footage.video)
    check_mesh(files.gltf, tracker, preset)
    report = reporter(progress, footage, passes)
    with closing(footage), Window(footage.video.name) if show else nullcontext() as window:
        begin = prepare(footage, landmarks, at_once, face, report, partial(_show_waiting, window))
        begin = begin if landmarks is None else begin.completed()
        files.warn_if_stale(1)
        for result, _ in run_passes(Pass(begin, preset, tracker, files, report, passes, window=window)):
            write_in_any_case(files, result)
    return result


def reporter(progress: Progress | None, footage: Footage, rounds: int) -> Callable[[Estimate], None]:
    """A function that reports an estimate as progress. rounds: how often each frame of the footage is reported."""
    count = footage.frame_count
    total = None if count is None else rounds * count
    return lambda estimate: None if progress is None else progress(estimate, total)


def _show_waiting(window: Window | None, frame: Frame, estimate: Estimate) -> None:
    """Show a frame before the first detection, and why there is none, if there is a window."""
    if window is not None:
        from mien.output.overlay import FaceOverlay, draw

        window.show(draw(frame, [FaceOverlay(estimate)], Camera.unknown(frame.width, frame.height)))


def check_passes(passes: int, tracker: Tracker, preset: str, video: Video | None = None) -> None:
    """Raise MienError for a number of passes that the tracker or, if it is known, the video does not allow."""
    require(isinstance(passes, Integral) and passes in (1, 2), f"passes is {passes!r}; give 1 or 2")
    if passes > 1:
        if video is not None:
            again = video.repeatable
            require(again, f"{video.name} can be read only once; a second pass needs a file or a list of frames")
        require(isinstance(tracker, RepeatableTracker), f"{preset} learns nothing that a second pass could use; give 1")


def check_faces(faces: int) -> None:
    """Raise MienError for a number of faces that cannot be tracked, or that no video shows."""
    possible = isinstance(faces, Integral) and 1 <= faces <= _MOST_FACES
    require(possible, f"{faces!r} faces to track; give a number from 1 to {_MOST_FACES}")


def check_mesh(head: Path | str | None, tracker: Tracker, preset: str) -> None:
    """Raise MienError if a moving head is wanted, and the tracker, which has seen no frame yet, has no mesh. head: its
    path, or the option that asks for it."""
    can = hasattr(tracker, "mesh")  # it is a `FittedTracker` only once it has its `fit`
    require(head is None or can, f"{preset} fits no face model and has no head for {head}; omit that")
