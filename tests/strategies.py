"""Random states for the property tests (hypothesis)."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

from mien.appearance.views import rotation
from mien.arrays import Array
from mien.candide.model import TRACKED_UNITS
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING, exp, matrix_from_euler


def vectors(low: float, high: float, size: int = 3) -> SearchStrategy[Array]:
    """(size,) vectors with entries in [low, high]."""
    entries = st.lists(st.floats(low, high, allow_subnormal=False), min_size=size, max_size=size)
    return entries.map(np.array)


def unit_vectors() -> SearchStrategy[Array]:
    """(3,) vectors of length one."""
    return vectors(-1, 1).filter(lambda v: np.linalg.norm(v) > 0.1).map(lambda v: v / np.linalg.norm(v))


@st.composite
def rotation_vectors(draw: st.DrawFn, max_angle: float = np.pi - 1e-3) -> Array:
    """(3,) rotation vectors with an angle in [0, max_angle] radians, the very small ones included."""
    angle = draw(st.one_of(st.floats(0, max_angle), st.floats(0, 1e-5)))
    return angle * draw(unit_vectors())


def rotations(max_angle: float = np.pi - 1e-3) -> SearchStrategy[Array]:
    """(3, 3) rotation matrices."""
    return rotation_vectors(max_angle).map(exp)


def euler_angles(limit_deg: float = 80.0) -> SearchStrategy[Array]:
    """(3,) angles in radians, each within the limit."""
    return vectors(-limit_deg, limit_deg).map(np.radians)


def head_rotations(limit_deg: float = 45.0) -> SearchStrategy[Array]:
    """(3, 3) rotations head -> camera of a face that looks about into the camera."""
    return euler_angles(limit_deg).map(lambda angles: matrix_from_euler(angles) @ FACING)


def head_translations() -> SearchStrategy[Array]:
    """(3,) translations head -> camera in CANDIDE units, the face well in front of the camera."""
    return st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(5, 12)).map(np.array)


def animations(limit: float = 1.0) -> SearchStrategy[Array]:
    """(6,) animation parameters."""
    return vectors(-limit, limit, size=len(TRACKED_UNITS))


def cameras() -> SearchStrategy[Camera]:
    """Cameras of images of about 320x240 pixels."""
    return st.builds(Camera, st.floats(200, 800), st.floats(150, 170), st.floats(110, 130))


def random_pose(seed: int) -> tuple[Array, Array, Array]:
    """R, t and animation of a face before the camera, turned by up to 23 degrees each way."""
    rng = np.random.default_rng(seed)
    return rotation(*rng.uniform(-0.4, 0.4, 3)), np.array([0.05, 0.02, 4.0]), rng.uniform(-0.3, 0.5, 6)


def random_person(seed: int, n: int = 8) -> tuple[Array, Array]:
    """Neutral landmarks (n, 3) and animation units (6, n, 3)."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-0.6, 0.6, (n, 3)), rng.normal(0, 0.1, (6, n, 3))


def stepped(R: Array, t: Array, a: Array, step: Array) -> tuple[Array, Array, Array]:
    """A pose after a step (12,), by definition."""
    return exp(step[:3]) @ R, t + step[3:6], a + step[6:]
