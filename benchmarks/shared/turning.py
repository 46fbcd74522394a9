"""Heads that turn on the spot, from one angle to the next, and wander meanwhile."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from mien.arrays import Array
from mien.geometry.rotation import matrix_from_euler

FRAMES, BEFORE, STAYS = 199, 20, 27
ASIDE = ((5, 50), (0, 0), (-8, -48), (8, 35), (0, 65), (0, 0))
"""Tilt and pan of the head, one after the other; half of the people turn to the other side first."""
WANDER = (((2.5, 41), (1.5, 23)), ((4.0, 53), (2.0, 29)), ((2.5, 61),))
"""Of tilt, pan and roll: amplitudes in degrees and periods in frames."""


def motion(steps: Iterable[int], rng: np.random.Generator, turns: Iterable[tuple[int, int]] = ASIDE) -> Array:
    """(FRAMES, 3) tilt, pan and roll in degrees, through turns of tilt and pan."""
    frame, side = np.arange(FRAMES), rng.choice([-1, 1])
    angles, at, now = np.zeros((FRAMES, 3)), BEFORE, np.zeros(3)
    for (tilt, pan), step in zip(turns, steps, strict=True):
        share = np.clip((frame - at) / step, 0, 1)[:, None]
        then = np.array([tilt, side * pan, 0.0])
        angles += (then - now) * share**2 * (3 - 2 * share)
        now, at = then, at + step + STAYS
    for axis, waves in enumerate(WANDER):
        wave = sum(size * np.sin(2 * np.pi * (frame / period + rng.uniform())) for size, period in waves)
        angles[:, axis] += wave - wave[0]
    return angles


def turning(truth: dict[str, Array], angles_deg: Array) -> dict[str, Array]:
    """The rotations and translations of a truth whose head turns on the spot instead, by (FRAMES, 3) tilt, pan and
    roll."""
    R = np.stack([matrix_from_euler(turn) for turn in np.radians(angles_deg)])
    return {"R": R, "t": np.tile(truth["t"][0], (len(R), 1))}
