"""Estimates as they are computed, for programs that react to a face.

for frame, estimate in mien.stream(0):
    print(estimate.time, estimate.euler)
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from numbers import Real
from pathlib import Path

from mien.errors import MienError, interruption, require
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.initialization.landmarks import Point
from mien.initialization.straight import straightened
from mien.pipeline.run import tracked
from mien.registry import DEFAULT_PRESET, called, checked, create_tracker
from mien.start.first_frame import as_point, before_start, require_inside, warn_of_first_frame
from mien.start.footage import Footage
from mien.start.live_search import Patience
from mien.tracking.state import Estimate, Tracker
from mien.video import Source, open_video

_DOUBTFUL = 0.1
"""Confidence up to which the tracked face is hardly the one that was learned; it is 0 for a lost face."""


def stream(
    video: Source,
    *,
    preset: str = DEFAULT_PRESET,
    camera: Camera | str | Path | None = None,
    focal_px: float | None = None,
    fov_deg: float | None = None,
    fps: float | None = None,
    face: Point | None = None,
    anew_after: float = math.inf,
) -> Generator[tuple[Frame, Estimate], None, None]:
    """Yield every frame of a camera (its number), a video file, a folder of images or an iterable of `mien.Frame` with
    its estimate, as soon as it is available.

    preset, camera, focal_px, fov_deg, fps: as for `mien.track`. The face is learned from the first frame in which it
    looks into the camera or, after three seconds of waiting, as it is. face: a point of the image, in pixels, where the
    face must be that is learned, as of one of two people; by default the largest.
    anew_after: seconds after which a face that is lost, or looks like someone else's, is given up and any face then in
    view is learned instead; its first estimate has the status INITIALIZED. What it returns has a `close`, which frees
    the camera, as the end of the loop does.

    Raises MienError for bad input, and if the first face cannot be learned, as with a wrong focal length; where a later
    one cannot, it is lost, with the reason.
    """
    valid = isinstance(anew_after, Real) and anew_after >= 0
    require(valid, f"anew_after is {anew_after!r}; give a number of seconds")
    face = face if face is None else as_point(face)
    first = create_tracker(preset)  # report bad arguments now, not when the first frame is requested
    footage = Footage(open_video(video, fps), camera, focal_px, fov_deg, fps=fps)
    return _interruptible(_stream(footage, preset, first, face, anew_after))


def _interruptible(estimates: Iterator[tuple[Frame, Estimate]]) -> Generator[tuple[Frame, Estimate], None, None]:
    """The estimates; raises KeyboardInterrupt even if interrupted inside a compiled function."""
    try:
        yield from estimates
    except SystemError as error:
        if isinstance(interruption(error), KeyboardInterrupt):
            raise KeyboardInterrupt from None
        raise


def _stream(
    footage: Footage, preset: str, first: Tracker | None, face: Point | None, anew_after: float
) -> Iterator[tuple[Frame, Estimate]]:
    """first: the tracker of the first face; every later one is created."""
    patience: Patience | None = None
    tracker: Tracker | None = None
    seen, doubtful = 0.0, False  # when the face was last seen without doubt, and whether the last frame leaves any
    for frame in footage.video:
        if patience is None:
            if face is not None:
                require_inside(face, frame)
            patience = Patience(footage.camera_of(frame), face)
        faces = patience(frame) if tracker is None or (doubtful and frame.time - seen > anew_after) else []
        if faces:
            learned, face_seen = first or create_tracker(preset), straightened(frame, faces[0], patience.camera)
            with called(learned):
                try:
                    estimate = learned.initialize(frame, face_seen, patience.camera)
                except MienError as error:
                    if first is not None:
                        raise
                    estimate = Estimate.lost(frame, f"the face in view cannot be learned: {error}")
                else:
                    estimate = checked(estimate, learned, frame)
                    tracker, first, seen = learned, None, frame.time
                    warn_of_first_frame(estimate, face_seen, footage.video, tracker)
            patience = patience.anew()
        else:
            estimate = tracked(tracker, frame) if tracker else before_start(frame, patience)
        doubtful = estimate.confidence <= _DOUBTFUL
        if not doubtful:
            seen, patience.first_detection = frame.time, None
        yield frame, estimate
