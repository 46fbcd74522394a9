"""A face of which something covers a part and moves with it, as a hand, a mask or a phone; as a Markdown table.

`OMP_NUM_THREADS=1 python benchmarks/covers.py PATH`, with PATH a folder of rendered sequences that have landmarks. From
frame 10 on a plain and a patterned board covers a part of the face. Columns: error in the protocol `rebased`, mean of
the three angles, degrees; share of these errors in the 90 per cent intervals, of `realtime` only; lost frames; and the
frames, in thousandths, that are off by more than five degrees at a confidence above a half.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import cv2
import numpy as np
from shared.command_line import carry_out, parser_of
from shared.runs import Run, judged, landmarks_of, prepare, print_judged
from skimage import data

from mien.arrays import Array, Pixels
from mien.evaluation.datasets import load_dataset
from mien.evaluation.scores import Score
from mien.frame import Frame

BEGIN = 10
PLAIN, PATTERN = np.full((200, 200, 3), (150, 120, 100), np.uint8), data.coffee()[100:300, 200:400]
BRIDGE, BASE, CHIN, RIGHT, LEFT, RIGHT_EYE = 27, 33, 8, 0, 16, slice(36, 42)
"""Landmarks of iBUG: bridge and base of the nose, chin, where the face ends to its right and left, and an eye."""
RIGHT_CHEEK = (3, 48)
Part = Callable[[Array, Array, Array], Array]
"""A polygon (k, 2) from landmarks (68, 2), and the vectors (2,) down and across the face."""


def half(side: int) -> Part:
    """One half of the face, up to the line of the nose."""

    def part(points: Array, down: Array, across: Array) -> Array:
        top, bottom = points[BRIDGE] - down, points[CHIN] + 0.5 * down
        return np.array([top, bottom, bottom + side * across, top + side * across])

    return part


def lower(points: Array, down: Array, across: Array) -> Array:
    """Mouth and chin."""
    left, right = points[BASE] - across, points[BASE] + across
    return np.array([left, right, right + down, left + down])


def eye(points: Array, down: Array, across: Array) -> Array:
    """One eye and its brow."""
    return ellipse(points[RIGHT_EYE].mean(axis=0), 0.28 * down, 0.3 * across)


def cheek(points: Array, down: Array, across: Array) -> Array:
    """One cheek."""
    return ellipse(points[list(RIGHT_CHEEK)].mean(axis=0), 0.4 * down, 0.28 * across)


def ellipse(centre: Array, down: Array, across: Array) -> Array:
    """An ellipse with two radii (2,)."""
    angles = np.linspace(0, 2 * np.pi, 40)[:, None]
    return np.asarray(centre + np.cos(angles) * across + np.sin(angles) * down)


COVERS: dict[str, tuple[Part, ...]] = {
    "one half": (half(-1), half(1)), "mouth and chin": (lower,), "an eye": (eye,), "a cheek": (cheek,)
}  # fmt: skip


def behind(run: Run, part: Part, picture: Pixels) -> Run:
    """The run with a board, on which a picture is painted, before a part of the face."""
    frames = [
        frame if k < BEGIN else _covered(frame, points, part, picture)
        for k, (frame, points) in enumerate(zip(run.frames, landmarks_of(run), strict=True))
    ]
    return replace(run, frames=frames)


def _covered(frame: Frame, points: Array, part: Part, picture: Pixels) -> Frame:
    down, across = points[CHIN] - points[BRIDGE], points[LEFT] - points[RIGHT]
    outline, area = part(points, down, across), np.zeros((frame.height, frame.width), np.uint8)
    cv2.fillPoly(area, [np.round(16 * outline).astype(np.int32)], 255, cv2.LINE_AA, 4)
    known = np.array([[100, 100], [100, 160], [180, 100]], np.float32)
    there = np.array([points[BRIDGE], points[CHIN], points[BRIDGE] + across], np.float32)
    size = (frame.width, frame.height)
    board = cv2.warpAffine(picture, cv2.getAffineTransform(known, there), size, borderMode=cv2.BORDER_REFLECT)
    share = area[:, :, None] / 255
    return Frame(np.round((1 - share) * frame.pixels + share * board).astype(np.uint8), frame.index, frame.time)


def rows(run: Run) -> Iterator[tuple[tuple[str, ...], Score, float]]:
    """Cover and tracker, score and share of believed wrong frames, of a sequence without a cover and with each."""
    for name, shown in _with_covers(run):
        for tracker, score, wrong in judged(shown):
            yield (name, tracker), score, wrong


def _with_covers(run: Run) -> Iterator[tuple[str, Run]]:
    yield "nothing", run
    for name, parts in COVERS.items():
        for part in parts:
            for picture in (PLAIN, PATTERN):
                yield name, behind(run, part, picture)


def main() -> None:
    parser = parser_of(__doc__, "path")
    made = [row for s in load_dataset("rendered", parser.parse_args().path) for row in rows(prepare(s))]
    print_judged(("covered", "tracker"), made)


if __name__ == "__main__":
    carry_out(main)
