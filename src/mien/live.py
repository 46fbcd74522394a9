"""Estimates while they are made: for programs that react to a face.

for frame, estimate in mien.stream(0):
    print(estimate.time, estimate.euler)
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from numbers import Real
from pathlib import Path

from mien.errors import interruption, require
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.pipeline import DEFAULT_PRESET, warn_of_a_turned_face
from mien.registry import checked, create_tracker
from mien.start import Footage, Patience, not_yet
from mien.tracking.state import Estimate, Tracker
from mien.video import Source, open_video

_DOUBTED = 0.1
"""Confidence below which this is hardly the face that was learned; of a lost one it is 0."""


def stream(
    video: Source,
    *,
    preset: str = DEFAULT_PRESET,
    camera: Camera | str | Path | None = None,
    focal_px: float | None = None,
    fov_deg: float | None = None,
    anew_after: float = math.inf,
) -> Iterator[tuple[Frame, Estimate]]:
    """Every frame of a camera (its number), a video file or a folder of images, or of an iterable of `mien.Frame`, with
    its estimate, as soon as it is there.

    preset, camera, focal_px, fov_deg: as of `mien.track`. The face is learned in the first frame that shows one that
    looks into the camera; after three seconds of waiting for that, as it is.
    anew_after: seconds after which a face that is lost, or looks like somebody else's, is given up, and whatever face
    is seen then is learned in its place; its first estimate has the status INITIALIZED.

    Raises MienError for bad input.
    """
    patient = isinstance(anew_after, Real) and anew_after >= 0
    require(patient, f"anew_after is {anew_after!r}; give a number of seconds")
    create_tracker(preset)  # what is wrong with the arguments is told now and not when the first frame is asked for
    return _stoppable(_stream(Footage(open_video(video), camera, focal_px, fov_deg), preset, anew_after))


def _stoppable(estimates: Iterator[tuple[Frame, Estimate]]) -> Iterator[tuple[Frame, Estimate]]:
    """The estimates; stopped within a compiled function, they end with a KeyboardInterrupt as anywhere else."""
    try:
        yield from estimates
    except SystemError as error:
        if isinstance(interruption(error), KeyboardInterrupt):
            raise KeyboardInterrupt from None
        raise


def _stream(footage: Footage, preset: str, anew_after: float) -> Iterator[tuple[Frame, Estimate]]:
    patience: Patience | None = None
    tracker: Tracker | None = None
    seen, doubted = 0.0, False
    for frame in footage.video:
        if patience is None:
            patience = Patience(footage.camera_of(frame))
        faces = patience(frame) if tracker is None or (doubted and frame.time - seen > anew_after) else []
        if faces:
            tracker = create_tracker(preset)
            estimate = checked(tracker.initialize(frame, faces[0], patience.camera), tracker, frame)
            patience = Patience(patience.camera)
            warn_of_a_turned_face(estimate, footage.video.name)
        else:
            estimate = checked(tracker.track(frame), tracker, frame) if tracker else not_yet(frame)
        doubted = estimate.confidence <= _DOUBTED
        if not doubted:
            seen, patience.met = frame.time, None
        yield frame, estimate
