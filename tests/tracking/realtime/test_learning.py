"""What is rendered of the first frame's face."""

from __future__ import annotations

from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np

from mien.appearance.views import rotation
from mien.arrays import Array
from mien.tracking.realtime import learning

MIRROR = np.diag([-1.0, 1.0, 1.0])


def test_the_eyes_of_a_face_move_as_those_of_its_mirror_image() -> None:
    drawn: list[tuple[Array, str]] = []

    def describe(R: Array, texture: str) -> tuple[Array, None, None]:
        drawn.append((R, texture))
        return np.zeros((1, 128), np.float32), None, None

    mirrored = {"half": "half", "shut": "shut", "left": "right", "right": "left"}
    renderer: Any = SimpleNamespace(
        describe=describe, moved_eyes=list(mirrored),
        face=SimpleNamespace(noise=0.0, points=np.zeros((1, 3))),
    )  # fmt: skip
    tilts, pans = np.radians([-20.0, -5, 5, 20]), np.radians([-40.0, -25, -10, 10, 25, 40])
    seen = np.zeros((4, 6, 1, 128), np.float32)
    rotations = learning._rotations(tilts, pans)
    posed: Any = SimpleNamespace(of=lambda view: rotations[view])
    learning._render_changes(renderer, learning._Views(tilts, pans, seen, seen, seen), posed, seen)
    known = [rotation(tilt, pan, 0.0) for tilt, pan in product(tilts, pans)]
    assert {texture for _, texture in drawn} == set(mirrored)  # nothing else is drawn again
    for R, texture in drawn:
        assert any(np.allclose(R, view) for view in known)
        assert any(np.allclose(S, MIRROR @ R @ MIRROR) and other == mirrored[texture] for S, other in drawn)


def test_a_face_is_lit_as_its_mirror_image_is() -> None:
    """Each view is lit from the other side than its mirror image, and no two pairs alike."""
    lights = learning._mirrored_lights(4, 6, 0.45)
    np.testing.assert_array_equal(lights[:, ::-1], lights @ MIRROR)
    assert len(np.unique(lights.round(9).reshape(-1, 3), axis=0)) == 24


def test_lights_come_from_all_sides_in_all_strengths() -> None:
    lights = learning.spread_lights(40, 0.45)
    assert np.all(lights[:, 2] == 0)
    strength = np.hypot(lights[:, 0], lights[:, 1])
    assert strength.max() <= 0.45
    np.testing.assert_allclose(np.sort(strength), np.linspace(0, 0.45, 40), atol=0.03)
    np.testing.assert_allclose(np.cov(lights[:, :2].T), 0.45**2 / 6 * np.eye(2), atol=0.003)
    np.testing.assert_allclose(lights.mean(axis=0), 0, atol=0.02)
