"""Lenses that bend straight lines, with and without their calibration; as a Markdown table.

`OMP_NUM_THREADS=1 python benchmarks/bent.py PATH`, with PATH a folder of rendered sequences. The camera has turned, so
that the face is at the side of the image, and its lens draws the corners of the image nearer to the middle, by a share
of their distance. Columns: error in the protocol `rebased`, mean of the three angles, degrees; share of these errors in
the 90 per cent intervals, of `realtime` only; lost frames; and the frames, in thousandths, that are off by more than
five degrees at a confidence above a half.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
from beside import turned
from shared.command_line import carry_out, parser_of
from shared.runs import Run, judged, print_judged

from mien.arrays import Float32
from mien.evaluation.datasets import load_dataset
from mien.evaluation.datasets.sequence import Sequence
from mien.evaluation.scores import Score
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import matrix_from_euler
from mien.initialization.detector import detect
from mien.initialization.straight import straightened
from mien.lens import Lens
from mien.video import open_video

TURN_DEG = 10.0
SHARES = (0.0, 0.03, 0.08, 0.16, 0.31)
"""By which corners move."""


def lens_of(camera: Camera, share: float) -> Lens:
    """A lens in the middle of whose image the principal point is, with one coefficient."""
    corner = np.hypot(camera.cx, camera.cy) / camera.focal_px
    return Lens(tuple(map(tuple, camera.matrix.tolist())), (-share / corner**2, 0.0, 0.0, 0.0))


def bent(frame: Frame, lens: Lens) -> Frame:
    """A frame as a camera with such a lens would have taken it."""
    places = _places(lens, frame.width, frame.height)
    pixels = cv2.remap(frame.pixels, *places, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return Frame(np.asarray(pixels, np.uint8), frame.index, frame.time)


@cache
def _places(lens: Lens, width: int, height: int) -> tuple[Float32, Float32]:
    """Columns and rows (H, W) of the straight image that the pixels of the lens's image show."""
    K, coefficients = np.array(lens.camera_matrix), np.array(lens.dist_coeffs)
    pixels = np.stack(np.meshgrid(np.arange(float(width)), np.arange(float(height))), axis=-1).reshape(-1, 1, 2)
    precise = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-9)
    straight = cv2.undistortImagePoints(pixels, K, coefficients, None, precise)
    columns, rows = straight.reshape(height, width, 2).astype(np.float32).transpose(2, 0, 1)
    return columns, rows


def runs(sequence: Sequence) -> Iterator[tuple[str, str, Run]]:
    """How far corners move, whether the lens is known, and what a tracker then sees of a sequence."""
    frames = list(open_video(sequence.video))
    camera = sequence.camera_for(frames[0].width, frames[0].height)
    R, truth = matrix_from_euler(np.radians([0.0, TURN_DEG, 0.0])), sequence.read_truth(len(frames))
    assert truth.rotations is not None, "a rendered sequence has rotations"
    truth = replace(truth, rotations=R @ truth.rotations, angles_deg=None, landmarks=None)
    aside = [turned(frame, camera, R, (0, 0)) for frame in frames]
    for share in SHARES:
        lens = lens_of(camera, share)
        seen = [bent(frame, lens) for frame in aside]
        known = [Frame(lens.straighten(frame.pixels), frame.index, frame.time) for frame in seen]
        for calibrated, shown in (("no", seen), ("yes", known)):
            marks = straightened(shown[0], detect(shown[0])[0], camera)
            yield f"{100 * share:.0f} %", calibrated, Run(sequence, shown, truth, marks)


def rows(sequence: Sequence) -> Iterator[tuple[tuple[str, ...], Score, float]]:
    """Share, whether the lens is known, and tracker; score and share of believed wrong frames of each run."""
    for share, calibrated, run in runs(sequence):
        for tracker, score, wrong in judged(run):
            yield (share, calibrated, tracker), score, wrong


def main() -> None:
    parser = parser_of(__doc__, "path")
    made = [row for sequence in load_dataset("rendered", parser.parse_args().path) for row in rows(sequence)]
    print_judged(("corners move by", "lens is known", "tracker"), made)


if __name__ == "__main__":
    carry_out(main)
