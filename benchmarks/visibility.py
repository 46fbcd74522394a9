"""Which landmarks are told as hidden: those of drawn heads and of recordings, with boards that pass before the face.

`OMP_NUM_THREADS=1 python benchmarks/visibility.py RENDERED RECORDINGS`, with RENDERED the folder of the rendered
sequences and RECORDINGS one of videos in which nothing but the boards comes before the face. Where the landmarks are is
what the tracker finds without boards. Prints, as Markdown, of the landmarks that face the camera, how many of those
without a board before them are told as seen (a visibility above a half), of all, of the mouth and of the eyes, and how
many of those behind one as hidden; then how often landmarks are seen by what is told of them, on the recordings, and
the constants of `mien.tracking.realtime.uncertainty` that fit all these best.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from scipy.optimize import minimize
from shared.boards import boards
from shared.command_line import carry_out, parser_of, print_heads
from shared.inputs import videos_of
from shared.runs import prepare

from mien.arrays import Array, Mask
from mien.evaluation.datasets import load_dataset
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.initialization.detector import first_with_a_face
from mien.initialization.landmarks import LANDMARK_NAMES, Landmarks
from mien.tracking.realtime import RealtimeTracker, uncertainty
from mien.tracking.realtime import tracker as realtime_tracker
from mien.video import open_video

N = len(LANDMARK_NAMES)
RUNS, FRAMES = 3, 350
"""Runs of every video with boards; frames of a recording."""
INSIDE, BESIDE = 0.04, 0.06
"""Widths of the face that a landmark lies within a board's edge, or beside it: those between are half hidden."""
FAR_OFF = 0.1
"""Widths of the face by which the landmarks may be wrong in the median: beyond, they are not where they should be."""
HIDDEN_COUNT = 0.3
"""How much all hidden landmarks of a video count beside those that are seen."""
EYES = np.array(["eye" in name and "brow" not in name for name in LANDMARK_NAMES])


@dataclass(frozen=True)
class Seen:
    """What is told of landmarks (k,), those that face the camera: logarithm of the squared distance, agreement,
    visibility, whether it is the mouth's, index; and whether a board is before them."""

    distance: Array
    agreement: Array
    visibility: Array
    mouth: Mask
    index: Array
    covered: Mask


def track(frames: list[Frame], landmarks: Landmarks, camera: Camera) -> dict[int, tuple[Array, Array]]:
    """By frame in which the face is not lost: where the landmarks are (26, 2), and what is told of each (26, 5):
    logarithm of the squared distance, agreement, visibility, whether it is the mouth's, and faces the camera."""
    noted: list[Array] = []

    def visibility(d2: Array, facing: Mask, agreement: Array, mouth: Mask) -> Array:
        value = uncertainty.visibility(d2, facing, agreement, mouth)
        noted.append(np.column_stack([np.log(np.maximum(d2, 1.0)), agreement, value, mouth, facing])[:N])
        return value

    out = {}
    with patch.object(realtime_tracker, "visibility", visibility):
        tracker = RealtimeTracker()
        for k, frame in enumerate(frames):
            estimate = tracker.track(frame) if k else tracker.initialize(frame, landmarks, camera)
            if estimate.landmarks is not None:
                out[k] = estimate.landmarks.image, noted[-1]
    return out


def seen_with_boards(frames: list[Frame], landmarks: Landmarks, camera: Camera, rng: np.random.Generator) -> Seen:
    """What is told of the landmarks of a video, as it is and with boards."""
    plain = track(frames, landmarks, camera)
    known = np.maximum.accumulate([k * (k in plain) for k in range(len(frames))])  # a face that is lost stays there
    places = np.stack([plain[k][0] for k in known])
    width = float(np.ptp(places[0, :, 0]))
    rows = []
    for with_boards in [False] + [True] * RUNS:
        shown, within = list(frames), np.full((len(frames), N), -np.inf)
        for board in boards(places, rng) if with_boards else ():
            for k in range(board.begin, board.end):
                shown[k] = board.paint(frames[k])
                half = np.array(board.picture.shape[1::-1]) / 2
                centre = board.centre + (k - board.begin) * board.velocity
                within[k] = (half - np.abs(places[k] - centre)).min(axis=1) / width
        for k, (place, told) in (track(shown, landmarks, camera) if with_boards else plain).items():
            off = np.median(np.linalg.norm(place - places[k], axis=1))
            if k and k in plain and off < FAR_OFF * width:
                clear = (within[k] > INSIDE) | (within[k] < -BESIDE)
                of = clear & (told[:, 4] > 0) & (plain[k][1][:, 4] > 0)
                rows.append(np.column_stack([told[of, :4], np.flatnonzero(of), within[k, of] > 0]))
    distance, agreement, visibility, mouth, index, covered = np.concatenate(rows).T
    return Seen(distance, agreement, visibility, mouth > 0, index.astype(int), covered > 0)


def videos(rendered: Path, recordings: Path) -> Iterator[tuple[str, list[Frame], Landmarks, Camera]]:
    """Name, frames from the first face on, its landmarks and the camera of everything."""
    sequences, paths = load_dataset("rendered", rendered), videos_of(recordings)
    for sequence in sequences:
        run = prepare(sequence)
        yield f"rendered: {sequence.kind}", run.frames, run.landmarks, sequence.camera
    for path in paths:
        read = iter(open_video(path))
        found = first_with_a_face(read)
        if found is not None:
            first, faces = found
            frames = [Frame(f.pixels, k, f.time) for k, f in enumerate(chain([first], islice(read, FRAMES - 1)))]
            yield path.stem, frames, faces[0], Camera.unknown(first.width, first.height)


def share(told: Array, of: Mask) -> str:
    return f"{told[of].mean():.3f}" if of.any() else ""


def row(name: str, parts: list[Seen]) -> str:
    visibility, mouth, index, covered = (
        np.concatenate([getattr(p, k) for p in parts]) for k in ("visibility", "mouth", "index", "covered")
    )
    told, seen = visibility > 0.5, ~covered
    cells = [share(told, seen & of) for of in (index >= 0, mouth, EYES[index])]
    return f"| {name} | {seen.sum()} | {' | '.join(cells)} | {covered.sum()} | {share(~told, covered)} |"


def best_fit(parts: list[Seen]) -> Array:
    """Bias, weights of distance and agreement, and what is added for the mouth, that make these most probable, every
    video counting alike."""
    X = np.concatenate([np.column_stack([np.ones_like(p.distance), p.distance, p.agreement, p.mouth]) for p in parts])
    seen = ~np.concatenate([p.covered for p in parts])
    weight = np.concatenate([
        np.where(p.covered, HIDDEN_COUNT / max(p.covered.sum(), 1), 1 / max((~p.covered).sum(), 1)) for p in parts
    ])  # fmt: skip
    weight /= weight.sum()

    def surprise(w: Array) -> tuple[float, Any]:
        p = 1 / (1 + np.exp(-np.clip(X @ w, -30, 30)))
        return -float(weight @ np.log(np.where(seen, p, 1 - p))), -X.T @ (weight * (seen - p))

    return np.asarray(minimize(surprise, [20.0, -4.0, 3.0, 1.0], jac=True, method="BFGS").x)


def main() -> None:
    parser = parser_of(__doc__, "rendered", "recordings")
    arguments = parser.parse_args()
    rng = np.random.default_rng(0)
    found: dict[str, list[Seen]] = {}
    for name, *video in videos(arguments.rendered, arguments.recordings):
        found.setdefault(name, []).append(seen_with_boards(*video, rng))
    print_heads("", "not covered", "told as seen", "mouth", "eyes", "covered", "told as hidden")
    for name, parts in found.items():
        print(row(name, parts))
    recorded = [part for name, parts in found.items() if not name.startswith("rendered") for part in parts]
    print(row("recordings, all", recorded))
    told, covered = (np.concatenate([getattr(p, k) for p in recorded]) for k in ("visibility", "covered"))
    print()
    print_heads("visibility", "landmarks", "seen")
    for low in np.arange(0, 1, 0.1):
        of = (told >= low) & (told < low + 0.1 + (low > 0.85))
        print(f"| {low:.1f} to {low + 0.1:.1f} | {of.sum()} | {share(~covered, of)} |")
    fitted = best_fit([part for parts in found.values() for part in parts])
    print("\nbest fit: " + ", ".join(f"{value:.2f}" for value in fitted))


if __name__ == "__main__":
    carry_out(main)
