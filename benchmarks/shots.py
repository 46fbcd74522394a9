"""A film of shots, each of another person in about the same place: is everybody found, and taken for nobody else?

`OMP_NUM_THREADS=1 python benchmarks/shots.py PATH`, with PATH that of the rendered sequences, or of others in their
layout. Of every person the first sequence of the kind `uniform` goes on from shot to shot, 45 frames each, in turn.
`mien.track_faces` may find twice as many faces as there are people. Prints of every person in how many frames it is,
which face has most of them and how many, how many frames of others that face has, both with a confidence above a half,
and the angle in degrees from the truth, the head's axes aligned, beside that of the same frames without the shots
between.
"""

from __future__ import annotations

import tempfile
import warnings
from pathlib import Path

import numpy as np
from shared.command_line import carry_out, parser_of, print_heads
from shared.filming import write_film
from shared.recordings import apart_deg, rotations

import mien
from mien.arrays import Pixels
from mien.errors import MienWarning, require
from mien.evaluation.datasets import load_dataset
from mien.evaluation.datasets.rendered import CAMERA
from mien.evaluation.datasets.sequence import Sequence
from mien.video import open_video

SHOT = 45
"""Frames."""
SURE = 0.5


def firsts(path: Path, kind: str) -> dict[str, Sequence]:
    """The first sequence of a kind of each person. Raises MienError where there is none."""
    found: dict[str, Sequence] = {}
    sequences = load_dataset("rendered", path)
    for sequence in sequences:
        if sequence.kind == kind:
            found.setdefault(sequence.name.rsplit("_", 1)[0], sequence)
    kinds = ", ".join(sorted({sequence.kind for sequence in sequences}))
    require(bool(found), f"{path} holds no sequence of the kind {kind}; give another with --kind: {kinds}")
    return found


def film(people: dict[str, list[Pixels]]) -> tuple[list[Pixels], list[tuple[str, int]]]:
    """The pictures of the shots, and of each whose it is and its index among that person's."""
    count = min(len(pictures) for pictures in people.values()) // SHOT * SHOT
    whose = [
        (name, k) for begin in range(0, count, SHOT) for name in people for k in range(begin, min(begin + SHOT, count))
    ]
    return [people[name][k] for name, k in whose], whose


def main() -> None:
    parser = parser_of(__doc__, "path")
    parser.add_argument("--kind", default="uniform")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore", MienWarning)
    sequences = firsts(arguments.path, arguments.kind)
    people = {name: [frame.pixels for frame in open_video(sequences[name].video)] for name in sequences}
    pictures, whose = film(people)
    with tempfile.TemporaryDirectory() as folder:
        write_film(Path(folder) / "shots.avi", pictures)
        for name, of_one in people.items():
            write_film(Path(folder) / f"{name}.avi", of_one[: len(pictures) // len(people)])
        tracks = mien.track_faces(Path(folder) / "shots.avi", 2 * len(people), camera=CAMERA)
        print(f"{len(pictures) // SHOT} shots of {len(people)} people: {len(tracks)} faces")
        print_heads("person", "frames", "face", "has of them", "of others'", "degrees", "alone")
        for name in people:
            own = np.array([whom == name for whom, _ in whose])
            sure = [track.confidence > SURE for track in tracks]
            face = int(np.argmax([np.count_nonzero(there & own) for there in sure]))
            of_own, of_others = (np.count_nonzero(sure[face] & whom) for whom in (own, ~own))
            alone = mien.track(Path(folder) / f"{name}.avi", camera=CAMERA)
            true = sequences[name].read_truth(len(people[name])).rotations
            assert true is not None
            seen = rotations(tracks[face])[own], rotations(alone)
            errors = (f"{np.nanmean(apart_deg(true[: own.sum()], R)):.2f}" for R in seen)
            cells = (name, own.sum(), face, of_own, of_others, *errors)
            print(f"| {' | '.join(map(str, cells))} |", flush=True)


if __name__ == "__main__":
    carry_out(main)
