"""The overlay of one face while it is tracked: in a video, and on the screen."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from mien.frame import Frame
from mien.output.window import Window
from mien.start.first_frame import Start
from mien.tracking.abilities import FittedTracker
from mien.tracking.state import Estimate, Tracker

if TYPE_CHECKING:
    from mien.output.overlay import Mesh


@contextmanager
def drawing(
    begin: Start, path: Path | None, window: Window | None
) -> Iterator[Callable[[Frame, Estimate, Tracker], None]]:
    """A function that draws a tracker's estimate on its frame: into a video file, and in a window, if there are any."""
    if path is None and window is None:
        yield lambda frame, estimate, tracker: None
        return
    from mien.output.overlay import FaceOverlay, draw
    from mien.output.overlay_video import OverlayWriter

    begins = begin.passed[0].time if begin.passed else None
    with OverlayWriter(path, begins) if path else nullcontext() as writer:

        def draw_estimate(frame: Frame, estimate: Estimate, tracker: Tracker) -> None:
            picture = draw(frame, [FaceOverlay(estimate, mesh_of(tracker, estimate))], begin.camera)
            if writer:
                writer.write(picture, frame.time)
            if window:
                window.show(picture)

        yield draw_estimate


def mesh_of(tracker: Tracker, estimate: Estimate) -> Mesh | None:
    """The face mesh of a tracker at an estimate, None if it has no face model or the face is lost."""
    from mien.output.overlay import Mesh

    if not isinstance(tracker, FittedTracker):
        return None
    vertices = tracker.mesh(estimate)
    return None if vertices is None else Mesh(vertices, tracker.fit.model.triangles)
