"""Landmarks that somebody has marked in the first frame: the errors that follow, as a Markdown table.

`OMP_NUM_THREADS=1 python benchmarks/marked.py PATH`, with PATH a folder of rendered sequences. The true 68 points,
which have no depths, are marked exactly, and with an error of one pixel in each coordinate; tracking begins with the
marks alone, with the marks completed by a detector, as `mien track --landmarks` does, and with what a detector finds.
Protocol `rebased`, means over the sequences of a kind, degrees.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from shared.command_line import carry_out, parser_of
from shared.runs import prepare, print_tables, score

from mien.evaluation.datasets import load_dataset
from mien.evaluation.scores import Score
from mien.evaluation.tables import by_kind, calibration
from mien.initialization.marked import completed
from mien.tracking.realtime import RealtimeTracker

ERRORS_PX = (0.0, 1.0)


def main() -> None:
    arguments = parser_of(__doc__, "path").parse_args()
    rng, scores = np.random.default_rng(0), list[Score]()
    for sequence in load_dataset("rendered", arguments.path):
        run = prepare(sequence)
        first = run.frames[0]
        begun = {"detected": run.landmarks}
        for error in ERRORS_PX:
            marks = run.truth.first_landmarks(str(sequence.source))
            marks = replace(marks, points=marks.points + rng.normal(0, error, marks.points.shape))
            camera = sequence.camera_for(first.width, first.height)
            begun[f"marks alone, {error:g} px"] = marks
            begun[f"marks completed, {error:g} px"] = completed(first, marks, camera)
        for name, landmarks in begun.items():
            scores.append(score(RealtimeTracker, replace(run, landmarks=landmarks), name))
    print_tables(scores, (by_kind, calibration))


if __name__ == "__main__":
    carry_out(main)
