"""Real recordings: how the animation units move beside what they move in MediaPipe's landmarks.

`OMP_NUM_THREADS=1 python benchmarks/expressions.py PATH`, with PATH a folder of videos. MediaPipe's points of every
frame, with their depths, are laid over those of the first by the points that no expression moves; the gap of the lips,
the width of the mouth, how low its corners hang below the nose, how near the upper lip is to that, and how high brows
stand above the eyes are distances there, over that of the eyes' outer corners. Prints, as Markdown, the correlation of
each with its unit, the standard deviation of the distance, in per cent, and the mean over the recordings, weighed by
that.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from shared.command_line import carry_out, print_heads
from shared.mesh import EYES, laid_over, mesh
from shared.recordings import asked, seen_by_mediapipe

import mien
from mien.arrays import Array
from mien.errors import MienWarning
from mien.evaluation.metrics import correlation

UNITS = (
    "jaw_drop",
    "lip_stretcher",
    "lip_corner_depressor",
    "upper_lip_raiser",
    "brow_lowerer",
    "outer_brow_raiser",
)


def distances(points: Array) -> Array:
    """(6,) what the units move, signed as they are; points (468, 3) with y down."""
    down = points[:, 1]
    eyes = down[EYES].mean()
    return np.array([
        np.linalg.norm(points[13] - points[14]),
        np.linalg.norm(points[61] - points[291]),
        down[[61, 291]].mean() - down[2],
        down[2] - down[0],
        down[[55, 285]].mean() - eyes,
        eyes - down[[63, 70, 293, 300]].mean(),
    ])  # fmt: skip


def distances_of_frames(path: Path, seconds: float) -> dict[int, Array]:
    """By frame in which there is a face: the distances (6,)."""
    meshes = {k: mesh(face) for k, face in seen_by_mediapipe(path, seconds) if face.depths is not None}
    if not meshes:
        return {}
    start = next(iter(meshes.values()))
    eyes = float(np.linalg.norm(start[EYES[0]] - start[EYES[3]]))
    return {k: distances(laid_over(mesh, start)) / eyes for k, mesh in meshes.items()}


def compared(path: Path, seconds: float) -> tuple[Array, Array]:
    """Of each unit: the correlation (6,) with its distance, and the standard deviation (6,) of that."""
    seen = distances_of_frames(path, seconds)
    table = mien.track(path, at_once=True, end=seconds).to_pandas().set_index("frame")
    both = [k for k in seen if k in table.index and table.success[k]]
    moved = np.array([seen[k] for k in both])
    units = table.loc[both, list(UNITS)].to_numpy()
    pairs = zip(units.T, moved.T, strict=True)
    return np.array([correlation(unit, distance) for unit, distance in pairs]), moved.std(axis=0)


def main() -> None:
    paths, seconds = asked(__doc__)
    warnings.simplefilter("ignore", MienWarning)
    print_heads("recording", *UNITS)
    rows = []
    for path in paths:
        rows.append(compared(path, seconds))
        cells = (f"{r:.2f} ({100 * sd:.1f})" for r, sd in zip(*rows[-1], strict=True))
        print(f"| {path.stem} | {' | '.join(cells)} |", flush=True)
    r, sd = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
    mean = (np.nan_to_num(r) * sd).sum(axis=0) / sd.sum(axis=0)
    print(f"| mean, weighed | {' | '.join(f'{value:.2f}' for value in mean)} |")


if __name__ == "__main__":
    carry_out(main)
