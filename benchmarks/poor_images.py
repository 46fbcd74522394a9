"""Rendered heads out of focus, in noise, in the dark, and filmed by a camera that is not known: whether the standard
deviations and the confidence know of it. Tables of `mien report`.

`OMP_NUM_THREADS=1 python benchmarks/poor_images.py PATH`, with PATH a folder of rendered sequences. Protocol `rebased`,
landmarks from the detector in the images as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import cv2
import numpy as np
from shared.command_line import carry_out, parser_of
from shared.runs import Run, prepare, print_tables, score

from mien.arrays import Pixels
from mien.evaluation.datasets import load_dataset
from mien.evaluation.datasets.sequence import Sequence
from mien.evaluation.scores import Score
from mien.evaluation.tables import by_kind, calibration
from mien.frame import Frame
from mien.geometry.camera import UNKNOWN_LOG_SD
from mien.initialization.detector import detect
from mien.tracking.realtime import RealtimeTracker

Change = Callable[[Pixels, np.random.Generator], Pixels]


def blurred(sd: float) -> Change:
    """Out of focus: blurred by a standard deviation in pixels."""
    return lambda pixels, rng: np.asarray(cv2.GaussianBlur(pixels, (0, 0), sd), np.uint8)


def noisy(sd: float, light: float = 1.0) -> Change:
    """With a share of the light, and noise with a standard deviation in grey values."""
    return lambda pixels, rng: np.clip(light * pixels + rng.normal(0, sd, pixels.shape), 0, 255).astype(np.uint8)


IMAGES: Mapping[str, Change] = {
    "as they are": lambda pixels, rng: pixels,
    "blurred by 1 pixel": blurred(1.0),
    "1.5 pixels": blurred(1.5),
    "2.5 pixels": blurred(2.5),
    "noise of 10 grey values": noisy(10),
    "20": noisy(20),
    "6, at 0.15 of the light": noisy(6, 0.15),
}
FOCAL_SHARES = (0.55, 0.75, 1.35, 1.8)
"""Assumed focal lengths over the true one."""


def changed(run: Run, change: Change) -> Run | None:
    """A run whose images are changed; None where no face is found in the first one."""
    rng = np.random.default_rng(0)
    frames = [Frame(change(frame.pixels, rng), frame.index, frame.time) for frame in run.frames]
    found = detect(frames[0])
    return replace(run, frames=frames, landmarks=found[0]) if found else None


def with_assumed(run: Run, share: float) -> Run:
    """A run of which the camera is assumed."""
    true = run.sequence.camera_for(run.frames[0].width, run.frames[0].height)
    camera = replace(true, focal_px=share * true.focal_px, focal_log_sd=UNKNOWN_LOG_SD)
    return replace(run, sequence=replace(run.sequence, camera=camera))


def under_all(sequence: Sequence) -> Iterator[Score]:
    """What a new tracker makes of a sequence in each of these."""
    run = prepare(sequence)
    runs = {name: changed(run, change) for name, change in IMAGES.items()}
    runs |= {f"{share:g} of the focal length": with_assumed(run, share) for share in FOCAL_SHARES}
    for name, seen in runs.items():
        if seen is not None:
            yield score(RealtimeTracker, seen, name)


def main() -> None:
    parser = parser_of(__doc__, "path")
    sequences = load_dataset("rendered", parser.parse_args().path)
    print_tables((made for s in sequences for made in under_all(s)), (by_kind, calibration))


if __name__ == "__main__":
    carry_out(main)
