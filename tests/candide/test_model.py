"""CANDIDE-3: its counts, its units, its surfaces, and Eq. (1) by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given

from mien.arrays import Array
from mien.candide.model import TRACKED_UNITS, Candide, mm_per_unit, with_eyes_closed
from mien.errors import MienError
from mien.geometry.rotation import FACING
from mien.initialization.landmarks import LANDMARK_VERTICES
from strategies import animations, head_rotations, head_translations

MODEL = Candide.default()


def _normals(model: Candide) -> Array:
    a, b, c = (model.mean[model.triangles[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def test_models_are_told_apart() -> None:
    assert {MODEL: "default", Candide.default(168): "closed"}[MODEL] == "default"
    assert Candide.default(168) != MODEL
    assert Candide.default(184) is MODEL


def test_counts_of_the_report() -> None:
    assert MODEL.mean.shape == (113, 3)
    assert MODEL.triangles.shape == (184, 3)
    assert MODEL.shape_units.shape == (38, 113, 3)
    assert MODEL.animation_units.shape == (len(MODEL.animation_unit_names), 113, 3)


def test_the_variant_has_168_surfaces_and_no_iris() -> None:
    model = Candide.default(168)
    assert model.triangles.shape == (168, 3)
    assert not np.isin(model.triangles, range(67, 75)).any()


@pytest.mark.parametrize("surfaces", [184, 168])
def test_the_model_that_trackers_have_cannot_be_written_to(surfaces: int) -> None:
    """As by a program that wants its triangles counted from one, or its vertices in millimetres."""
    model = Candide.default(surfaces)
    for array in (model.vertices(), model.triangles, model.shape_units, model.animation_units):
        with pytest.raises(ValueError, match="read-only"):
            array += 1


def test_other_variants_are_refused() -> None:
    with pytest.raises(MienError, match="184 or 168"):
        Candide.default(100)


@pytest.mark.parametrize("surfaces", [184, 168])
def test_surfaces_are_distinct_and_face_outwards(surfaces: int) -> None:
    model = Candide.default(surfaces)
    assert len({tuple(sorted(t)) for t in model.triangles.tolist()}) == surfaces
    assert all(len(set(t)) == 3 for t in model.triangles.tolist())
    assert (_normals(model)[:, 2] >= 0).all()


def test_unused_vertices_belong_to_no_surface() -> None:
    unused = {i for i, name in enumerate(MODEL.vertex_names) if name == "unused"}
    assert unused.isdisjoint(MODEL.triangles.ravel().tolist())


def test_landmarks_belong_to_the_surface() -> None:
    assert len(LANDMARK_VERTICES) == 26
    assert set(LANDMARK_VERTICES.values()) <= set(MODEL.triangles.ravel().tolist())


def test_closed_eyes_meet_where_the_unit_of_the_model_closes_them() -> None:
    """Across and up and down; the unit also lifts the lids out of the face, over the eyeball."""
    closed = with_eyes_closed(MODEL.mean, 1.0)
    unit = MODEL.animation_units[MODEL.animation_unit_names.index("eyes_closed")]
    lids = np.flatnonzero(np.abs(unit).max(axis=1))
    np.testing.assert_allclose(closed[lids, :2], (MODEL.mean + unit)[lids, :2], atol=1e-3)
    for upper, lower in ((21, 22), (54, 55)):
        np.testing.assert_allclose(closed[upper], closed[lower], atol=1e-12)
    moved = np.abs(closed - MODEL.mean).max(axis=1) > 0
    assert set(np.flatnonzero(moved)) <= {*lids, *range(67, 75)}


def test_half_closed_eyes_are_half_way() -> None:
    open_, half, closed = (with_eyes_closed(MODEL.mean, share) for share in (0.0, 0.5, 1.0))
    np.testing.assert_array_equal(open_, MODEL.mean)
    np.testing.assert_allclose(half, 0.5 * (open_ + closed), atol=1e-12)


def test_eq_1_by_hand() -> None:
    """The top of the skull with half a unit of head height, then facing a camera, scaled and moved."""
    sigma = np.zeros(len(MODEL.shape_unit_names))
    sigma[MODEL.shape_unit_names.index("head_height")] = 0.5
    alpha = np.zeros(len(MODEL.animation_unit_names))
    alpha[MODEL.animation_unit_names.index("jaw_drop")] = 1
    g = MODEL.vertices(sigma, alpha)
    np.testing.assert_allclose(g[0], [0, 1.061 + 0.5 * 0.2, -0.371])
    posed = MODEL.pose(g, FACING, np.array([1.0, 2, 10]), s=2)
    np.testing.assert_allclose(posed[0], [0 + 1, -2 * 1.161 + 2, 2 * 0.371 + 10])
    chin = MODEL.vertex_names.index("chin_boss")
    assert g[chin, 1] < MODEL.mean[chin, 1]


@given(animations(), animations())
def test_animation_is_linear(a: Array, b: Array) -> None:
    model = MODEL.with_tracked_units()
    moved = model.vertices(alpha=a) + model.vertices(alpha=b) - model.mean
    np.testing.assert_allclose(model.vertices(alpha=a + b), moved, atol=1e-12)


@given(head_rotations(), head_translations())
def test_pose_keeps_distances(R: Array, t: Array) -> None:
    posed = MODEL.pose(MODEL.mean, R, t)
    before = np.linalg.norm(np.diff(MODEL.mean, axis=0), axis=1)
    np.testing.assert_allclose(np.linalg.norm(np.diff(posed, axis=0), axis=1), before, atol=1e-9)


def test_tracked_units_in_their_order() -> None:
    model = MODEL.with_tracked_units()
    assert model.animation_unit_names == TRACKED_UNITS
    jaw = MODEL.animation_units[MODEL.animation_unit_names.index("jaw_drop")]
    np.testing.assert_array_equal(model.animation_units[1], jaw)


def test_a_whole_brow_is_its_two_halves() -> None:
    whole = MODEL.with_whole_brows()
    inner, outer = (MODEL.animation_unit_names.index(name) for name in ("inner_brow_raiser", "outer_brow_raiser"))
    alpha, both = np.zeros((2, len(MODEL.animation_unit_names)))
    alpha[outer], both[[inner, outer]] = 0.7, 0.7
    np.testing.assert_allclose(whole.vertices(alpha=alpha), MODEL.vertices(alpha=both), atol=1e-12)
    without = MODEL.with_tracked_units()  # has no inner half
    assert without.with_whole_brows() is without


def test_a_model_without_a_tracked_unit_is_refused() -> None:
    names, units = MODEL.animation_unit_names[1:], MODEL.animation_units[1:]
    with pytest.raises(MienError, match=r"no animation unit \['upper_lip_raiser'\]"):
        replace(MODEL, animation_unit_names=names, animation_units=units).with_tracked_units()


@pytest.mark.parametrize("unit", TRACKED_UNITS)
def test_units_move_both_sides_alike(unit: str) -> None:
    """CANDIDE is symmetric: the mirrored set of displaced vertices is the set itself."""
    moved = MODEL.animation_units[MODEL.animation_unit_names.index(unit)]
    rows = np.flatnonzero(np.abs(moved).max(axis=1) > 0)
    points = MODEL.mean[rows]
    mirror = np.array([np.argmin(np.linalg.norm(points - p * [-1, 1, 1], axis=1)) for p in points])
    np.testing.assert_allclose(points[mirror], points * [-1, 1, 1], atol=0.02)
    np.testing.assert_allclose(moved[rows][mirror], moved[rows] * [-1, 1, 1], atol=0.02)


def test_millimetres() -> None:
    scale = mm_per_unit(MODEL.mean)
    assert mm_per_unit(2 * MODEL.mean) == pytest.approx(scale / 2)
    left, right = (MODEL.mean[list(iris)].mean(axis=0) for iris in ((67, 68, 71, 72), (69, 70, 73, 74)))
    assert scale * np.linalg.norm(left - right) == pytest.approx(63)
    assert 100 < scale < 200  # a face is about 20 cm high, and one unit about half of that
