"""A face behind graphics that stand still: a logo, letters, a bar before the eyes, a time code; as a Markdown table.

`OMP_NUM_THREADS=1 python benchmarks/graphics.py PATH`, with PATH a folder of rendered sequences. The graphics are drawn
where the face is in the first frame. `realtime` is run with what is found of them and without, `mediapipe` beside it.
Columns: sequences in which graphics are found; error in the protocol `rebased`, mean of the three angles, degrees; lost
frames; and the frames, in thousandths, that are off by more than five degrees at a confidence above a half.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from shared.command_line import carry_out, parser_of, print_heads
from shared.runs import Run, prepare, scored, track, wrong_share

from mien.arrays import Array, Pixels
from mien.errors import require
from mien.evaluation.datasets import load_dataset
from mien.evaluation.scores import Score, pooled_errors
from mien.frame import Frame
from mien.initialization.detector import detect
from mien.initialization.landmarks import place_of
from mien.registry import create_tracker
from mien.start.footage import Footage
from mien.start.search import best_look
from mien.video import open_video

_FONT = cv2.FONT_HERSHEY_SIMPLEX
Drawing = Callable[[Pixels, Array, float, float], None]


def logo(pixels: Pixels, centre: Array, size: float, time: float) -> None:
    """A ring on the cheek."""
    at = (int(centre[0] - 0.22 * size), int(centre[1] + 0.2 * size))
    cv2.circle(pixels, at, int(0.18 * size), (30, 60, 200), -1, cv2.LINE_AA)
    cv2.circle(pixels, at, int(0.11 * size), (250, 250, 250), -1, cv2.LINE_AA)


def letters(pixels: Pixels, centre: Array, size: float, time: float) -> None:
    """A word across the face, wider than it."""
    scale, thickness = size / 70, max(round(size / 35), 1)
    (width, height), _ = cv2.getTextSize("STOCK", _FONT, scale, thickness)
    at = (int(centre[0] - width / 2), int(centre[1] + height / 2))
    cv2.putText(pixels, "STOCK", at, _FONT, scale, (255, 255, 255), thickness, cv2.LINE_AA)


def bar(pixels: Pixels, centre: Array, size: float, time: float) -> None:
    """A black bar before the eyes."""
    (x, y), half = centre.astype(int), int(0.5 * size)
    pixels[y - int(0.37 * size) : y - int(0.17 * size), max(x - half, 0) : x + half] = 0


def time_code(pixels: Pixels, centre: Array, size: float, time: float) -> None:
    """A dark box over a part of the mouth and the chin, with digits that change."""
    x, y = int(centre[0] - 0.6 * size), int(centre[1] + 0.24 * size)
    pixels[y : y + int(0.2 * size), max(x, 0) : x + int(0.7 * size)] = 20
    at = (x + 3, y + int(0.15 * size))
    cv2.putText(pixels, f"{time:06.2f}", at, _FONT, size / 190, (255, 255, 255), 1, cv2.LINE_AA)


GRAPHICS: dict[str, tuple[Drawing, float]] = {
    "logo": (logo, 1.0),
    "logo, half transparent": (logo, 0.5),
    "letters, 0.6 opaque": (letters, 0.6),
    "letters, 0.3 opaque": (letters, 0.3),
    "bar before the eyes": (bar, 1.0),
    "time code": (time_code, 1.0),
}
"""By name, what is drawn and how opaque it is."""


@dataclass(frozen=True)
class Row:
    """What a tracker makes of one sequence. wrong: share of the frames that are believed and wrong."""

    graphics: str
    tracker: str
    score: Score
    wrong: float
    found: bool = False


def behind(run: Run, draw: Drawing, opacity: float) -> Run:
    """The run with graphics before the face, and its landmarks as they are detected there."""
    centre, size = place_of(run.landmarks.points)
    frames = []
    for frame in run.frames:
        over = frame.pixels.copy()
        draw(over, centre, size, frame.time)
        mixed = np.asarray(cv2.addWeighted(over, opacity, frame.pixels, 1 - opacity, 0), np.uint8)
        frames.append(Frame(mixed, frame.index, frame.time))
    faces = detect(frames[0])
    require(bool(faces), f"{run.sequence.video}: no face was found behind the graphics; leave the sequence out")
    return replace(run, frames=frames, landmarks=faces[0])


def rows(run: Run) -> Iterator[Row]:
    """What the trackers make of a sequence without graphics and with each of them."""
    yield _row("none", "realtime", run)
    yield _row("none", "mediapipe", run)
    for name, (draw, opacity) in GRAPHICS.items():
        hidden = behind(run, draw, opacity)
        camera = run.sequence.camera_for(run.frames[0].width, run.frames[0].height)
        footage = Footage(open_video(hidden.frames), camera)
        graphics = best_look(hidden.frames[0], hidden.landmarks, camera, footage)[2]
        painted = replace(hidden, landmarks=replace(hidden.landmarks, graphics=graphics))
        yield replace(_row(name, "realtime", painted), found=graphics is not None)
        yield _row(name, "realtime, graphics left", hidden)
        yield _row(name, "mediapipe", hidden)


def _row(graphics: str, tracker: str, run: Run) -> Row:
    estimates = track(create_tracker(tracker.split(",")[0]), run)
    return Row(graphics, tracker, scored(estimates, run), wrong_share(estimates, run))


def main() -> None:
    parser = parser_of(__doc__, "path")
    made = [row for s in load_dataset("rendered", parser.parse_args().path) for row in rows(prepare(s))]
    print_heads("graphics", "tracker", "found", "error", "lost", "believed and wrong")
    for graphics, tracker in dict.fromkeys((row.graphics, row.tracker) for row in made):
        of = [row for row in made if (row.graphics, row.tracker) == (graphics, tracker)]
        found = f"{sum(row.found for row in of)} of {len(of)}" if tracker == "realtime" else ""
        error, lost = pooled_errors([row.score for row in of]).mean(), sum(row.score.lost for row in of)
        wrong = 1000 * np.mean([row.wrong for row in of])
        print(f"| {graphics} | {tracker} | {found} | {error:.2f} | {lost} | {wrong:.0f} |")


if __name__ == "__main__":
    carry_out(main)
