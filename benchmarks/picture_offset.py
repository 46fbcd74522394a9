"""Where the pictures of a data set lie beside its own truth, as a Markdown table.

`python benchmarks/picture_offset.py PATH`, with PATH a folder of rendered sequences; those in which the face speaks or
is hidden are left out. Patches around the detected landmarks are followed in the pictures alone: each is warped
affinely from the first frame to every other (G. Evangelidis and E. Psarakis, Parametric image alignment using enhanced
correlation coefficient maximization, PAMI 2008, OpenCV's). Then the points of a rigid head in the true motion, seen by
the true camera, are put through what was followed: where each lies in the head is free, and by how much the pictures
lie beside them, the same everywhere. A point turns with the head, an offset does not.
"""

from __future__ import annotations

import cv2
import numpy as np
from shared.command_line import carry_out, parser_of, print_heads
from shared.inputs import truth_of
from shared.runs import Run, prepare

from mien.arrays import Array
from mien.errors import require
from mien.evaluation.datasets import load_dataset
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING
from mien.initialization.fit import fit_first_frame
from mien.initialization.landmarks import VERTICES

KINDS = ("uniform", "light", "wide")
HALF = 7
"""Half of a patch's side in pixels, without its middle."""
SIDE = 2 * HALF + 1
STEP = 0.02
"""Of the head's size: how far beside a point its neighbours are that say how its patch is turned."""
ALIKE, FORESHORTENED = 0.97, 0.6
"""Correlation above which a patch is believed, and share of its first area below which it is not looked at."""
LEAST = 25
"""Frames in which a patch has to be found."""
ROUNDS = 15
CRITERIA = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 60, 1e-5)


class Head:
    """A rigid head in the true motion: R (frames, 3, 3), t (frames, 3); points X (n, 3) about its landmarks."""

    def __init__(self, run: Run) -> None:
        truth = truth_of(run.sequence.video.parent, run.sequence.name)
        self.camera: Camera = run.sequence.camera
        self.R, self.t = FACING @ truth["R"], truth["t"]
        fit = fit_first_frame(run.landmarks, self.camera)
        X = fit.vertices()[VERTICES] @ fit.R.T + fit.t
        self.X = (X * self.t[0, 2] / fit.t[2] - self.t[0]) @ self.R[0]

    def seen(self, X: Array) -> Array:
        """Image points (frames, n, 2) of points X (n, 3)."""
        return self.camera.project(np.einsum("kij,nj->kni", self.R, X) + self.t[:, None])[0]


def followed(run: Run, head: Head) -> Array:
    """Where the middle of the patch about each point is found: (frames, n, 2), NaN where it is not. The true motion
    says where to begin."""
    size = STEP * np.ptp(head.X, axis=0).max()
    expected = head.seen(head.X)
    tangents = np.stack([(head.seen(head.X + size * axis) - expected) / size for axis in np.eye(3)[:2]], axis=-1)
    pictures = [frame.gray.astype(np.float32) for frame in run.frames]
    found = np.full(expected.shape, np.nan)
    for i, (x, y) in enumerate(np.round(expected[0]).astype(int) - HALF):
        patch, first = pictures[0][y : y + SIDE, x : x + SIDE], np.linalg.inv(tangents[0, i])
        if patch.shape != (SIDE, SIDE):
            continue
        for k, picture in enumerate(pictures):
            linear = tangents[k, i] @ first
            if np.linalg.det(linear) < FORESHORTENED:
                continue
            warp = np.column_stack([linear, expected[k, i] + linear @ ([x, y] - expected[0, i])]).astype(np.float32)
            try:
                alike, warp = cv2.findTransformECC(patch, picture, warp, cv2.MOTION_AFFINE, CRITERIA, None, 1)
            except cv2.error:  # it does not converge
                continue
            if alike > ALIKE:
                found[k, i] = warp @ [HALF, HALF, 1]
    return found


def offset_of(head: Head, found: Array) -> tuple[Array, Array]:
    """Offset (2,) in pixels at which the head comes nearest to what was found (frames, n, 2), and its information
    (2, 2): Gauss-Newton with the points eliminated; what lies further off than usual loses its weight."""
    often = np.isfinite(found[..., 0]).sum(axis=0) > LEAST
    found, X, offset = found[:, often], head.X[often], np.zeros(2)
    frame, point = np.nonzero(np.isfinite(found[..., 0]))
    for _ in range(ROUNDS):
        off = found[frame, point] - head.seen(X)[frame, point] - offset
        J = head.camera.J_pixel_point(np.einsum("kij,kj->ki", head.R[frame], X[point]) + head.t[frame]) @ head.R[frame]
        distance = np.linalg.norm(off, axis=1)
        w = 1 / (1 + (distance / (3 * np.median(distance))) ** 2) ** 2
        information, gradient = w.sum() * np.eye(2), w @ off
        own = []
        for i in range(len(X)):
            of = point == i
            H, both = np.einsum("k,kia,kib->ab", w[of], J[of], J[of]), np.einsum("k,kia->ai", w[of], J[of])
            g = np.einsum("k,kia,ki->a", w[of], J[of], off[of])
            inverse = np.linalg.inv(H + 1e-9 * np.eye(3))
            information -= both.T @ inverse @ both
            gradient -= both.T @ inverse @ g
            own.append((inverse, both, g))
        step = np.linalg.solve(information, gradient)
        X, offset = X + [inverse @ (g - both @ step) for inverse, both, g in own], offset + step
    return offset, information * 2 * w.sum() / (w @ distance**2)


def main() -> None:
    parser = parser_of(__doc__, "path")
    path = parser.parse_args().path
    sequences = [sequence for sequence in load_dataset("rendered", path) if sequence.kind in KINDS]
    require(bool(sequences), f"{path} holds no sequence of a kind that is looked at: {', '.join(KINDS)}")
    offsets, weights = [], []
    print_heads("sequence", "x", "y")
    for sequence in sequences:
        run = prepare(sequence)
        head = Head(run)
        offset, information = offset_of(head, followed(run, head))
        offsets.append(offset)
        weights.append(information)
        print(f"| {sequence.name} | {offset[0]:.2f} | {offset[1]:.2f} |", flush=True)
    covariance = np.linalg.inv(np.sum(weights, axis=0))
    mean = covariance @ np.einsum("kij,kj->i", weights, offsets)
    # Sequences differ by more than the noise of their patches, and say so themselves.
    spread = np.mean([(o - mean) @ weight @ (o - mean) / 2 for o, weight in zip(offsets, weights, strict=True)])
    x, y = (f"{m:.2f} ± {e:.2f}" for m, e in zip(mean, np.sqrt(spread * np.diag(covariance)), strict=True))
    print(f"| all, by their information | {x} | {y} |")


if __name__ == "__main__":
    carry_out(main)
