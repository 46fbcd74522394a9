"""The passes of a tracker over the frames of one face, each of them kept if it is interrupted."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from mien.arrays import Array
from mien.errors import MienError, MienWarning, interruption, warn
from mien.output.destination import Destination
from mien.output.recorder import Recorder
from mien.output.track import Track
from mien.output.window import Window
from mien.pipeline.drawing import drawing
from mien.pipeline.metadata import metadata
from mien.pipeline.run import run, run_back
from mien.registry import create_tracker
from mien.start.first_frame import Start, warn_of_first_frame
from mien.tracking.abilities import RepeatableTracker, ShapeTracker, axes_of
from mien.tracking.state import Estimate, Status, Tracker


@dataclass(frozen=True)
class Pass:
    """One pass of a tracker over its frames. files: where the result goes; report: called for each estimate; passes:
    their number, of which the last has the overlay video; number: 1, or more for a pass that starts with what the
    previous one has learned; window: shows the overlay of each; face_id: index of the face in the video."""

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
    """Run all passes; yield the track of each, and the tracker with what it has learned."""
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
    onwards = this
    earlier: dict[int, Estimate] = {}  # of the frames before the first, until they are recorded
    with Recorder(this.files.table, this.face_id) as recorder:
        try:
            for estimate in this.begin.passed:
                recorder.add(estimate)
            _run_back(this, earlier)
            if this.number == 1 and this.begin.instead is not None and this.begin.has_strayed(earlier):
                this = _begun_anew(this, replace(this.begin.instead, reported=max(earlier) + 1))
                earlier.clear()  # they are another person's
                _run_back(this, earlier)
            onwards = replace(this, tracker=_next_tracker(this)) if earlier else this
            _run_forward(onwards, this.tracker, earlier, recorder)
            return _track_of(onwards, recorder), onwards
        except BaseException as raised:
            error = interruption(raised)
            # Until it has tracked a frame, the tracker of the way forwards knows no face.
            learned = onwards if recorder.last_index >= this.begin.first.index else this
            drawn = recorder.count > 0 and isinstance(error, KeyboardInterrupt)  # else its overlay is discarded
            for index in sorted(index for index in earlier if index > recorder.last_index):
                recorder.add(earlier[index])
            # The original error matters more than a failure to write the rows, or than a warning that is made an error.
            with suppress(MienError, MienWarning):
                _write_stopped(learned, recorder, error, drawn)
            if error is raised:
                raise
            raise error from None


def _run_back(this: Pass, earlier: dict[int, Estimate]) -> None:
    """Track and report the frames before the first, into `earlier`, by index."""
    for estimate in run_back(this.tracker, this.begin):
        earlier[estimate.index] = estimate
        if estimate.index >= this.begin.reported:
            this.report(estimate)


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


def _run_forward(onwards: Pass, back: Tracker, earlier: dict[int, Estimate], recorder: Recorder) -> None:
    """Record, draw and report all frames in their order.

    earlier: what the tracker `back` has estimated before the first frame, by index; each is removed once it is
    recorded. The tracker of the pass tracks the first frame and all after it.
    """
    begin, files = onwards.begin, onwards.files
    with drawing(begin, files.overlay if onwards.number == onwards.passes else None, onwards.window) as draw:
        for frame, estimate in run(onwards.tracker, begin, earlier):
            recorder.add(estimate)
            is_earlier = earlier.pop(frame.index, None) is not None
            draw(frame, estimate, back if is_earlier else onwards.tracker)
            if estimate.status is Status.INITIALIZED and onwards.number == 1:
                warn_of_first_frame(estimate, begin.landmarks, begin.footage.video, onwards.tracker, onwards.face_id)
            if frame.index >= begin.reported and not is_earlier:
                onwards.report(estimate)


def _write_stopped(learned: Pass, recorder: Recorder, error: BaseException, drawn: bool) -> None:
    """Write the frames that were tracked before this error, except in a second pass; the files hold the first. drawn:
    whether the overlay, if one is wanted and this is the last pass, holds some of them."""
    table = learned.files.table
    if learned.number > 1 and table is not None:
        overlay = learned.files.overlay if drawn else None
        ends = "" if overlay is None else f", and {overlay} ends where it was stopped"
        warn(f"stopped in the second pass; {table} holds the first{ends}")
    elif recorder.count and table is not None:
        stopped = f"{type(error).__name__}: {error}".removesuffix(": ")
        track = _track_of(learned, recorder, stopped)
        has_overlay = drawn and learned.number == learned.passes  # else there is none that NAME.json could name
        files = learned.files if has_overlay else replace(learned.files, overlay=None)
        files.write_table(track)
        with suppress(MienWarning):  # made an error, it must not keep the plot from being written
            warn(f"stopped after {recorder.count} frames, which are in {table}")
        try:
            learned.files.write_drawn(track)
        except MienError as refused:  # as there may be no head yet
            warn(str(refused))


def _track_of(learned: Pass, recorder: Recorder, stopped: str | None = None) -> Track:
    """The recorded track, with its rotations in the head axes, and its landmarks in space with the shape, as the
    tracker finally knows them."""
    tracker, axes = learned.tracker, axes_of(learned.tracker)
    known = metadata(learned.begin, learned.preset, tracker, recorder, learned.number, learned.face_id, stopped)
    track = Track(recorder.table(), known)
    if isinstance(tracker, ShapeTracker):
        track = track.with_depths(_final_depths(tracker, track, recorder))
    if axes is None:
        return track
    recorder.turn = axes.report_anew() @ recorder.turn  # kept, as it is told only once and this may be interrupted
    return track.turned(recorder.turn)


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
