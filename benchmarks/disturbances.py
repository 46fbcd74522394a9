"""How far a track of real recordings moves when the recordings are made worse, as a Markdown table.

`OMP_NUM_THREADS=1 python benchmarks/disturbances.py RECORDINGS [--tracker NAME]`, with RECORDINGS a folder of videos.
There is no truth: a row compares the track of the disturbed video with the same tracker's track of the video as it is,
protocol `rebased`, mean of the three angles, degrees, in frames that both tracks have. `lost` and `confidence below a
half` count frames; `refused` are videos whose first frame has no face, or one that is too small.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice

import cv2
import numpy as np
from shared.command_line import carry_out, parser_of, print_heads
from shared.inputs import videos_of

from mien.arrays import Pixels
from mien.errors import MienError, require
from mien.evaluation.datasets.sequence import Truth
from mien.evaluation.protocols import Protocol, compare
from mien.evaluation.results import TrackTable
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.initialization.detector import detect
from mien.registry import create_tracker
from mien.video import open_video

FRAMES = 500
Disturbance = Callable[[list[Pixels]], list[Pixels]]


def each(change: Callable[[Pixels], Pixels]) -> Disturbance:
    """The same change of every frame."""
    return lambda frames: [change(frame) for frame in frames]


def scaled(factor: float) -> Disturbance:
    how = cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC
    return each(lambda p: np.asarray(cv2.resize(p, None, fx=factor, fy=factor, interpolation=how), dtype=np.uint8))


def compressed(pixels: Pixels) -> Pixels:
    coded = cv2.imencode(".jpg", pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 10])[1]
    return np.ascontiguousarray(cv2.imdecode(coded, cv2.IMREAD_COLOR)[..., ::-1], dtype=np.uint8)


def noisy(frames: list[Pixels]) -> list[Pixels]:
    rng = np.random.default_rng(0)
    return [np.clip(p + rng.normal(0, 20, p.shape), 0, 255).astype(np.uint8) for p in frames]


def flickering(frames: list[Pixels]) -> list[Pixels]:
    gammas = 1 + 0.6 * np.sin(np.arange(len(frames)) / 8)
    return [(255 * (p / 255) ** gamma).astype(np.uint8) for p, gamma in zip(frames, gammas, strict=True)]


def grey(pixels: Pixels) -> Pixels:
    return np.repeat(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)[:, :, None], 3, axis=2).astype(np.uint8)


def blurred(pixels: Pixels) -> Pixels:
    return np.asarray(cv2.GaussianBlur(pixels, (0, 0), max(pixels.shape) / 200), dtype=np.uint8)


def smeared(frames: list[Pixels]) -> list[Pixels]:
    """Three frames in one, as with a long exposure."""
    return [np.mean(frames[max(i - 2, 0) : i + 1], axis=0).astype(np.uint8) for i in range(len(frames))]


def turned(angle: float) -> Disturbance:
    def turn(pixels: Pixels) -> Pixels:
        height, width = pixels.shape[:2]
        A = cv2.getRotationMatrix2D((width / 2, height / 2), angle, 1.0)
        return np.asarray(cv2.warpAffine(pixels, A, (width, height)), dtype=np.uint8)

    return each(turn)


def behind_a_board(frames: list[Pixels]) -> list[Pixels]:
    """A board, a sixth of the image wide, passes in 40 of every 120 frames."""
    out = [p.copy() for p in frames]
    for i, pixels in enumerate(out):
        width = pixels.shape[1]
        if 30 <= i % 120 < 70:
            x = width * (i % 120 - 30) // 40
            pixels[:, max(x - width // 12, 0) : x + width // 12] = (90, 120, 60)
    return out


def blacked_out(frames: list[Pixels]) -> list[Pixels]:
    return [np.zeros_like(p) if 40 <= i % 100 < 50 else p for i, p in enumerate(frames)]


DISTURBANCES: dict[str, Disturbance] = {
    "half size": scaled(0.5),
    "a quarter": scaled(0.25),
    "double size": scaled(2.0),
    "JPEG of quality 10": each(compressed),
    "noise of 20 grey values": noisy,
    "gamma from 0.4 to 1.6 and back": flickering,
    "grey": each(grey),
    "out of focus": each(blurred),
    "three frames smeared into one": smeared,
    "turned by 20 degrees": turned(20),
    "turned by 45 degrees": turned(45),
    "a board passes": behind_a_board,
    "black for 10 frames in 100": blacked_out,
}
STEPS = {"every third frame alone": 3, "every fifth": 5}


def track(name: str, pixels: list[Pixels]) -> TrackTable | None:
    """The track of these frames; None where there is no face to begin with."""
    frames = [Frame(np.ascontiguousarray(p), i, i / 30) for i, p in enumerate(pixels)]
    faces, tracker = detect(frames[0]), create_tracker(name)
    if not faces:
        return None
    try:
        first = tracker.initialize(frames[0], faces[0], Camera.unknown(frames[0].width, frames[0].height))
    except MienError:
        return None
    return TrackTable.from_estimates([first, *(tracker.track(frame) for frame in frames[1:])])


def row(name: str, clean: list[TrackTable], disturbed: list[TrackTable | None], step: int) -> str:
    """What one disturbance does to all videos."""
    moved, lost, unsure, refused = [], 0, 0, 0
    for whole, other in zip(clean, disturbed, strict=True):
        if other is None:
            refused += 1
            continue
        truth = Truth(other.frames, rotations=whole.rotation[::step])
        compared = compare(Protocol.REBASED, truth, other.rotation)
        known = compared.known & ~compared.lost
        moved.append(np.abs(compared.error_deg[known]).mean(axis=1))
        lost += int((~known).sum())
        unsure += int((other.confidence[known] < 0.5).sum())
    if not moved:
        return f"| {name} | | | | {lost} | {unsure} | {refused} |"
    cells = (np.mean([m.mean() for m in moved]), max(m.mean() for m in moved), np.percentile(np.concatenate(moved), 95))
    figures = " | ".join(f"{cell:.2f}" for cell in cells)
    return f"| {name} | {figures} | {lost} | {unsure} | {refused} |"


def main() -> None:
    parser = parser_of(__doc__, "path")
    parser.add_argument("--tracker", default="realtime")
    arguments = parser.parse_args()
    paths = videos_of(arguments.path)
    videos = [[frame.pixels for frame in islice(open_video(path), FRAMES)] for path in paths]
    clean = [track(arguments.tracker, pixels) for pixels in videos]
    known = [t for t in clean if t is not None]
    faceless = [str(path) for path, t in zip(paths, clean, strict=True) if t is None]
    require(not faceless, f"{', '.join(faceless)}: no face in the first frame; leave such videos out")
    print_heads("", "mean", "of the worst video", "95 %", "lost", "confidence below a half", "refused")
    for name, disturb in DISTURBANCES.items():
        print(row(name, known, [track(arguments.tracker, disturb(pixels)) for pixels in videos], 1), flush=True)
    for name, step in STEPS.items():
        print(row(name, known, [track(arguments.tracker, pixels[::step]) for pixels in videos], step), flush=True)


if __name__ == "__main__":
    carry_out(main)
