"""What is rendered of the first frame's face."""

from __future__ import annotations

from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np

from mien.appearance.views import rotation
from mien.arrays import Array
from mien.config import RealtimeSettings
from mien.tracking.realtime import learning

MIRROR = np.diag([-1.0, 1.0, 1.0])


def test_a_face_is_changed_as_its_mirror_image_is() -> None:
    """Half of the views are the mirror images of the others: with the same eyes, and lit from the other side."""
    drawn: list[tuple[Array, str, Array | None]] = []

    def describe(R: Array, texture: str, light: Array | None = None) -> tuple[Array, None]:
        drawn.append((R, texture, light))
        return np.zeros((1, 128), np.float32), None

    mirrored = {"still": "still", "half": "half", "shut": "shut", "left": "right", "right": "left"}
    renderer: Any = SimpleNamespace(
        posed=lambda R: R, describe=describe, normals=np.eye(3), texture="still", moved_eyes=list(mirrored)[1:],
        face=SimpleNamespace(noise=0.0, points=np.zeros((1, 3))),
    )  # fmt: skip
    tilts, pans = np.radians([-20.0, -5, 5, 20]), np.radians([-40.0, -25, -10, 10, 25, 40])
    views: Any = SimpleNamespace(tilts=tilts, pans=pans, seen=np.zeros((4, 6, 1, 128), np.float32))
    learning._render_changes(renderer, views, RealtimeSettings())
    known = [rotation(tilt, pan, 0.0) for tilt, pan in product(tilts, pans)]
    assert all(texture != "still" or light is not None for _, texture, light in drawn)  # nothing else is drawn again
    assert {texture for _, texture, _ in drawn} == set(mirrored)
    for R, texture, light in drawn:
        assert any(np.allclose(R, view) for view in known)
        others = [
            other for other in drawn if np.allclose(other[0], MIRROR @ R @ MIRROR) and other[1] == mirrored[texture]
        ]
        assert others
        if light is not None:  # of what faces right as of what faces left in the other, and up and forwards as there
            (_, _, other_light), *_ = others
            assert other_light is not None
            np.testing.assert_allclose(np.log(other_light), MIRROR @ np.log(light), atol=1e-9)


def test_lights_come_from_all_sides_in_all_strengths() -> None:
    lights = learning.spread_lights(40, 0.45)
    assert np.all(lights[:, 2] == 0)
    strength = np.hypot(lights[:, 0], lights[:, 1])
    assert strength.max() <= 0.45
    np.testing.assert_allclose(np.sort(strength), np.linspace(0, 0.45, 40), atol=0.03)
    np.testing.assert_allclose(np.cov(lights[:, :2].T), 0.45**2 / 6 * np.eye(2), atol=0.003)
    np.testing.assert_allclose(lights.mean(axis=0), 0, atol=0.02)
