"""How far off the translation is, and how much of it the tracker's own intervals hold, as a Markdown table.

`OMP_NUM_THREADS=1 python benchmarks/translation.py PATH`, with PATH a folder of rendered sequences; landmarks from the
detector. What a track cannot know is fitted to the truth first, once for a sequence: the unit of length, and which
point of the true head is its origin; by least squares, each coordinate weighed by the tracker's own deviation, since
depth is known ten times less well than the rest. Errors are root mean squares in tenths of a unit of the truth, about
millimetres, at a distance of about a metre; the shares those of the errors inside the 90 per cent intervals.
"""

from __future__ import annotations

import numpy as np
from shared.command_line import carry_out, parser_of, print_heads
from shared.inputs import truth_of
from shared.runs import Run, prepare, track

from mien.arrays import Array
from mien.evaluation.datasets import load_dataset
from mien.evaluation.metrics import ANGLE_LEVEL, coverage
from mien.tracking.realtime import RealtimeTracker


def errors(run: Run, truth: Array) -> tuple[Array, Array]:
    """Errors of the translation (m, 3) in units of the truth (n, 3), and their deviations as the tracker gives them,
    in the frames that are not lost."""
    assert run.truth.rotations is not None
    t, R, sd, true = [], [], [], []
    for estimate, R_true, of_truth in zip(track(RealtimeTracker(), run), run.truth.rotations, truth, strict=True):
        if estimate.translation is None or estimate.covariance is None:
            continue
        t.append(estimate.translation)
        R.append(R_true)
        sd.append(np.sqrt(np.diag(estimate.covariance)[3:6]))
        true.append(of_truth)
    # scale * t + R origin = truth, with the true R: the origins lie 10 cm apart, by which an error of R would count
    A = np.concatenate([np.reshape(t, (-1, 1)), np.reshape(R, (-1, 3))], axis=1)
    weight = 1 / np.ravel(sd)
    fitted = np.linalg.lstsq(A * weight[:, None], np.ravel(true) * weight, rcond=None)[0]
    return (np.ravel(true) - A @ fitted).reshape(-1, 3), fitted[0] * np.array(sd)


def main() -> None:
    parser = parser_of(__doc__, "path")
    path = parser.parse_args().path
    every: dict[str, list[tuple[Array, Array]]] = {}
    for sequence in load_dataset("rendered", path):
        truth = truth_of(path, sequence.name)["t"]
        every.setdefault(sequence.kind, []).append(errors(prepare(sequence), truth))
    columns = ("", "x, mm", "y, mm", "z, mm", "in 90 %", "of x, y, z")
    print_heads(*columns)
    for kind, of_kind in every.items():
        error, sd = (np.concatenate(column) for column in zip(*of_kind, strict=True))
        off = " | ".join(f"{10 * rms:.1f}" for rms in np.sqrt((error**2).mean(axis=0)))
        inside = [100 * coverage(error[:, k], sd[:, k], ANGLE_LEVEL) for k in range(3)]
        shares = ", ".join(f"{share:.0f}" for share in inside)
        print(f"| {kind} | {off} | {np.mean(inside):.0f} | {shares} |")


if __name__ == "__main__":
    carry_out(main)
