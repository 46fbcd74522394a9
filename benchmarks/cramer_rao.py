"""The error of the real-time tracker beside the Cramér-Rao bound, on a rendered portrait with known image noise.

`OMP_NUM_THREADS=1 python benchmarks/cramer_rao.py`. Needs no data: the demo's motion of the portrait, drawn with
Gaussian noise, eight times with noise of its own. The bound of a frame is the inverse of the Fisher information of its
twelve state entries in the pixels of the face, everything else (shape, texture, light, background) known exactly.
Prints a Markdown table in degrees about the camera's axes. Errors are those of the rotation since the first frame.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from shared.command_line import carry_out, parser_of, print_heads
from shared.runs import rotations_of

from mien.arrays import Array, Mask, Pixels
from mien.demo import NOISE_SD, demo_states
from mien.evaluation.metrics import jitter_deg, root_mean_square
from mien.evaluation.protocols import Protocol, relative
from mien.geometry.rotation import exp, log
from mien.synthetic import Portrait, make_sequence, pictures, portrait
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.state import pack, unpack

FRAMES, REALISATIONS = 100, 8
STEPS = np.repeat([np.radians(0.25), 0.005, 0.02], [3, 3, 6])
"""Of the central differences: rotation vector, translation in CANDIDE units, animation."""
VARIANCE = NOISE_SD**2 + 1 / 12
"""Of a grey value: noise and rounding."""
GREY = np.array([0.299, 0.587, 0.114])


def derivatives(face: Portrait, states: Array) -> Iterator[Array]:
    """For each state (12,) the derivative (12, pixels of the face, 3) of the picture without noise."""
    moved = np.array([_moved(b, sign * step) for b in states for step in np.diag(STEPS) for sign in (1, -1)])
    drawn = pictures(face, moved)
    for b in states:
        mask = face_mask(face, b)
        yield np.array([(next(drawn)[mask] - next(drawn)[mask]) / (2 * h) for h in STEPS], dtype=float)


def _moved(b: Array, step: Array) -> Array:
    R, t, animation = unpack(b)
    return pack(exp(step[:3]) @ R, t + step[3:6], animation + step[6:])


def face_mask(face: Portrait, b: Array) -> Mask:
    """(H, W) where the model's mesh lies in a picture."""
    R, t, animation = unpack(b)
    points = face.camera.project(face.fit.vertices(animation) @ R.T + t)[0]
    mask: Pixels = np.zeros(face.frame.pixels.shape[:2], np.uint8)
    cv2.fillConvexPoly(mask, cv2.convexHull(np.round(points).astype(np.int32)), (1,))
    return mask.astype(bool)


def bounds_deg(face: Portrait, states: Array) -> Array:
    """Standard deviations (4, n, 3) of the rotation: pose unknown, pose and animation unknown; the same in grey."""
    out = np.empty((4, len(states), 3))
    for i, D in enumerate(derivatives(face, states)):
        colour, grey = D.reshape(len(STEPS), -1), D @ GREY
        for k, (J, variance) in enumerate(((colour, VARIANCE), (grey, VARIANCE * GREY @ GREY))):
            information = J @ J.T / variance
            for j, unknown in enumerate((6, 12)):
                covariance = np.linalg.inv(information[:unknown, :unknown])
                out[2 * k + j, i] = np.degrees(np.sqrt(np.diag(covariance)[:3]))
    return out


def errors_deg(face: Portrait, states: Array, noise_sd: float, seed: int = 0) -> Array:
    """Rotation vectors (n, 3) in degrees that turn the truth since the first frame into the estimate."""
    sequence = make_sequence(face, states, noise_sd=noise_sd, seed=seed)
    tracker = RealtimeTracker()
    first = tracker.initialize(sequence.frames[0], face.landmarks, face.camera)
    estimates = [first, *(tracker.track(frame) for frame in sequence.frames[1:])]
    found, true = (relative(Protocol.SENSOR, R) for R in (rotations_of(estimates), sequence.R))
    turns = found @ np.swapaxes(true, 1, 2)
    return np.degrees([log(turn) for turn in turns])


def main() -> None:
    parser_of(__doc__).parse_args()
    face = portrait()
    states = demo_states(face, FRAMES)
    bounds = np.sqrt((bounds_deg(face, states)[:, 1:] ** 2).mean(axis=1))
    errors = np.array([errors_deg(face, states, NOISE_SD, seed) for seed in range(REALISATIONS)])
    lost = ~np.isfinite(errors).all(axis=2)
    jitter = np.mean([jitter_deg(e, gone) for e, gone in zip(errors, lost, strict=True)], axis=0) / np.sqrt(6)
    seen = errors[:, 1:]
    rms, rms_without = (
        np.array([root_mean_square(e[..., k]) for k in range(3)]) for e in (seen, errors_deg(face, states, 0.0)[1:])
    )
    spread = np.sqrt(np.nanmean(np.nanvar(seen, axis=0, ddof=1), axis=0))
    rows = {
        "bound, pose unknown": bounds[0],
        "bound, pose and animation unknown": bounds[1],
        "the same from the grey picture alone": bounds[3],
        "error (RMS)": rms,
        "error (RMS) on the pictures without noise": rms_without,
        "spread of the error between realisations of the noise": spread,
        "jitter (second difference over the square root of 6)": jitter,
    }
    print_heads("", "tilt", "pan", "roll", "all", "ratio to the bound")
    bound = np.sqrt((bounds[1] ** 2).mean())
    for name, values in rows.items():
        mean = np.sqrt((values**2).mean())
        print(f"| {name} | {' | '.join(f'{v:.4f}' for v in (*values, mean))} | {mean / bound:.1f} |")
    print(f"\n{FRAMES} frames, {REALISATIONS} realisations, {lost.sum()} lost")


if __name__ == "__main__":
    carry_out(main)
