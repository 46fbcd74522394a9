"""Ten minutes of a rendered sequence, played forwards and backwards: does the track end where it began?

`OMP_NUM_THREADS=1 python benchmarks/long_run.py PATH SEQUENCE`, with PATH the folder of the rendered sequences. Prints
one row of a Markdown table. Errors in degrees: the rotation from the first estimate at each return to the first frame,
and the mean of the three mean absolute errors (protocol `rebased`) over the first and the last time there and back.
"""

from __future__ import annotations

import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import chain, cycle, islice
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from shared.command_line import carry_out, parser_of, print_heads

from mien.arrays import Array
from mien.errors import require
from mien.evaluation.datasets import load_dataset
from mien.evaluation.datasets.sequence import Sequence, Truth
from mien.evaluation.metrics import mean_absolute_error
from mien.evaluation.protocols import Protocol, compare
from mien.evaluation.run import peak_memory_mb
from mien.frame import Frame
from mien.initialization.detector import detect
from mien.initialization.landmarks import Landmarks
from mien.tracking.realtime import RealtimeTracker
from mien.video import open_video

FPS = 30
MINUTES = (0, 1, 5, 10)


def there_and_back(count: int, frames: int) -> list[int]:
    """Numbers of so many frames when `count` of them are played forwards and backwards."""
    return list(islice(cycle(chain(range(count), range(count - 2, 0, -1))), frames))


def first_landmarks(video: Path) -> Landmarks:
    """The face of the first frame."""
    return detect(next(iter(open_video(video))))[0]


@dataclass(frozen=True)
class LongRun:
    """Rotations (n, 3, 3) of a run, NaN where lost; peak memory in MB after the first period and at the end."""

    rotations: Array
    frames_per_second: float
    memory_mb: tuple[float, float]


def run(sequence: Sequence, frames: list[Frame], order: list[int], period: int) -> LongRun:
    """Track the frames with these numbers, one after the other."""
    first = frames[0]
    with ProcessPoolExecutor(1, get_context("spawn")) as elsewhere:  # the detector's memory is not the tracker's
        landmarks = elsewhere.submit(first_landmarks, sequence.video).result()
    tracker = RealtimeTracker()
    rotations = np.full((len(order), 3, 3), np.nan)
    rotations[0] = tracker.initialize(first, landmarks, sequence.camera_for(first.width, first.height)).rotation
    seconds, memory = 0.0, 0.0
    for index, number in enumerate(order[1:], 1):
        frame = Frame(frames[number].pixels, index, index / FPS)
        start = time.process_time()
        estimate = tracker.track(frame)
        seconds += time.process_time() - start
        if estimate.rotation is not None:
            rotations[index] = estimate.rotation
        if index == period:
            memory = peak_memory_mb()
    return LongRun(rotations, (len(order) - 1) / seconds, (memory, peak_memory_mb()))


def main() -> None:
    parser = parser_of(__doc__, "path")
    parser.add_argument("sequence")
    arguments = parser.parse_args()
    sequences = {s.name: s for s in load_dataset("rendered", arguments.path)}
    known = ", ".join(sequences)
    require(arguments.sequence in sequences, f"{arguments.path} has no sequence {arguments.sequence}; it has {known}")
    sequence = sequences[arguments.sequence]
    frames = list(open_video(sequence.video))
    period = 2 * len(frames) - 2
    # The first return to the first frame, and the first after each of these minutes.
    returns = [max(1, -(-60 * FPS * minutes // period)) * period for minutes in MINUTES]
    order = there_and_back(len(frames), returns[-1] + 1)
    long = run(sequence, frames, order, period)

    truth = sequence.read_truth(len(frames)).rotations
    assert truth is not None
    c = compare(Protocol.REBASED, Truth(len(order), rotations=truth[order]), long.rotations)
    counted = np.ones(period, bool)
    means = [mean_absolute_error(part, counted).mean() for part in (c.error_deg[:period], c.error_deg[-period:])]
    columns = ("drift", "mean, first period", "mean, last period", "lost", "MB, first period", "MB, end")
    print_heads("", *(f"return at {i / FPS:.0f} s" for i in returns), *columns, "frames per CPU second")
    print(
        f"| {sequence.name} | {' | '.join(f'{c.rotation_error_deg[i]:.2f}' for i in returns)} "
        f"| {c.rotation_error_deg[returns[-1]] - c.rotation_error_deg[returns[0]]:+.2f} "
        f"| {means[0]:.2f} | {means[1]:.2f} | {c.lost.sum()} "
        f"| {long.memory_mb[0]:.0f} | {long.memory_mb[1]:.0f} | {long.frames_per_second:.0f} |"
    )


if __name__ == "__main__":
    carry_out(main)
