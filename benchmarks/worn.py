"""Dark glasses and masks that are worn where the face is learned, and slide on it; as a Markdown table.

`OMP_NUM_THREADS=1 python benchmarks/worn.py PATH`, with PATH a folder of rendered sequences that have landmarks.
Everything is painted on the face from the first frame on. Columns: sequences in which it is recognised; error in the
protocol `rebased`, mean of the three angles, degrees; share of these errors in the 90 per cent intervals, of `realtime`
only; lost frames; and the frames, in thousandths, that are off by more than five degrees at a confidence above a half.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace

import cv2
import numpy as np
from shared.command_line import carry_out, parser_of, print_heads
from shared.runs import TRACKERS, Run, cells_of, landmarks_of, prepare, scored, track, wrong_share

from mien.arrays import Array, Pixels
from mien.config import RealtimeSettings
from mien.config.realtime import VisibilitySettings
from mien.errors import require
from mien.evaluation.datasets import load_dataset
from mien.evaluation.scores import Score
from mien.frame import Frame
from mien.initialization.detector import detect
from mien.tracking.realtime import RealtimeTracker

EYES, RIGHT_CORNER, LEFT_CORNER = (slice(36, 42), slice(42, 48)), 36, 45
BRIDGE, NOSE, CHIN, JAW = 27, 28, 8, slice(2, 15)
CHEEKS = (3, 6), (13, 10)
"""Landmarks of iBUG: the eyes and their outer corners; bridge of the nose, nose below it, chin, and the outline of the
face below the eyes; and of this, on either side, the places between which pleats end."""
LENS, CLOTH, PLEAT = (15, 15, 20), (150, 185, 205), (120, 148, 164)
SLIDES: dict[str, Callable[[int], float]] = {
    "still": lambda k: 0.0,
    "to and fro": lambda k: 0.03 * np.sin(k / 4),
    "slips": lambda k: 0.12 * min(k / 120, 1.0),
}
"""How far down it is in a frame, in distances of the outer corners of the eyes, which are some 9 centimetres apart."""
_BITS = 4
"""Bits of a pixel's fraction in the coordinates that OpenCV draws."""
Painter = Callable[[Pixels, Array, Array], Pixels]
"""An image with something worn before a face with landmarks (68, 2), moved by (2,)."""


def glasses(pixels: Pixels, points: Array, slid: Array) -> Pixels:
    """Dark lenses with a bridge."""
    centres = [points[eye].mean(axis=0) + slid for eye in EYES]
    between = centres[1] - centres[0]
    angle, size = float(np.degrees(np.arctan2(*between[::-1]))), float(np.linalg.norm(between))
    shown = pixels.copy()
    for centre in centres:
        _ellipse(shown, centre, 0.42 * size, 0.32 * size, angle)
    inner = [_fixed(centres[0] + share * between) for share in (0.35, 0.65)]
    cv2.line(shown, *inner, LENS, 2, cv2.LINE_AA, _BITS)
    return shown


def mask(pixels: Pixels, points: Array, slid: Array) -> Pixels:
    """A surgical mask with pleats."""
    outline = slid + np.vstack([points[NOSE], points[JAW]])
    shown = pixels.copy()
    cv2.fillPoly(shown, [np.round(outline * 2**_BITS).astype(np.int32)], CLOTH, cv2.LINE_AA, _BITS)
    for share in (0.4, 0.6, 0.8):
        ends = [_fixed(slid + (1 - share) * points[upper] + share * points[lower]) for upper, lower in CHEEKS]
        cv2.line(shown, *ends, PLEAT, 1, cv2.LINE_AA, _BITS)
    return shown


def _fixed(point: Array) -> tuple[int, int]:
    x, y = np.round(point * 2**_BITS).astype(int).tolist()
    return x, y


def _ellipse(pixels: Pixels, centre: Array, across: float, down: float, angle: float) -> None:
    axes = _fixed(np.array([across, down]))
    cv2.ellipse(pixels, _fixed(centre), axes, angle, 0, 360, LENS, -1, cv2.LINE_AA, _BITS)


WORN: dict[str, Painter] = {"dark glasses": glasses, "a mask": mask}


def behind(run: Run, paint: Painter, slide: Callable[[int], float]) -> Run:
    """The run with something worn before the face, which slides, and the landmarks that are found behind it. Raises
    MienError where there are none."""
    frames = []
    for k, (frame, points) in enumerate(zip(run.frames, landmarks_of(run), strict=True)):
        apart = np.linalg.norm(points[LEFT_CORNER] - points[RIGHT_CORNER])
        down = (points[CHIN] - points[BRIDGE]) / np.linalg.norm(points[CHIN] - points[BRIDGE])
        frames.append(Frame(paint(frame.pixels, points, slide(k) * apart * down), frame.index, frame.time))
    faces = detect(frames[0])
    require(bool(faces), f"{run.sequence.video}: no face was found behind what is worn; leave the sequence out")
    return replace(run, frames=frames, landmarks=faces[0])


def rows(run: Run) -> Iterator[tuple[str, str, bool, Score, float]]:
    """What is worn and how it slides, tracker, whether it is recognised, score and share of believed wrong frames."""
    never = RealtimeSettings(visibility=VisibilitySettings(least_eye_contrast=0, eye_glare=99, least_mouth_contrast=0))
    trackers = {**TRACKERS, "taken for the face": lambda: RealtimeTracker(never)}
    for worn, paint in WORN.items():
        for slides, slide in SLIDES.items():
            shown = behind(run, paint, slide)
            for name, new in trackers.items():
                tracker = new()
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    estimates = track(tracker, shown)
                told = isinstance(tracker, RealtimeTracker) and bool(tracker.person.worn.any())
                yield f"{worn}, {slides}", name, told, scored(estimates, shown, name), wrong_share(estimates, shown)


def main() -> None:
    parser = parser_of(__doc__, "path")
    made = [row for s in load_dataset("rendered", parser.parse_args().path) for row in rows(prepare(s))]
    print_heads("worn", "tracker", "recognised", "error", "90 %", "lost", "believed and wrong")
    for name, tracker in dict.fromkeys(row[:2] for row in made):
        told, scores, wrong = zip(*[row[2:] for row in made if row[:2] == (name, tracker)], strict=True)
        ours = tracker != "MediaPipe"
        known = f"{sum(told)} of {len(told)}" if ours else ""
        print(f"| {name} | {tracker} | {known} | {cells_of(scores, wrong, ours)} |")


if __name__ == "__main__":
    carry_out(main)
