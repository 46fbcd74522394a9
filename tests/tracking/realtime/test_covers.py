"""What lies on the face is told from how strange the landmarks look, and where."""

from __future__ import annotations

import numpy as np
import pytest

from mien.arrays import Array, Mask
from mien.config.realtime import VisibilitySettings
from mien.tracking.realtime.covers import Covers

ALL = np.ones(10, dtype=bool)
IN_A_ROW = np.stack([0.2 * np.arange(10.0), np.zeros(10), np.zeros(10)], axis=1)
CAME, STAYED = np.full(10, 0.4), np.full(10, 0.98)
"""Agreements of patches that something has come before, and of others."""
HALF = np.array([300.0] * 5 + [3.0] * 5)
"""Squared distances of a row whose first half is covered."""


def _covers(eyes: Mask = ~ALL, mouth: Mask = ~ALL) -> Covers:
    return Covers(IN_A_ROW, eyes, mouth, VisibilitySettings())


def _after(*frames: Array) -> list[int]:
    covers = _covers()
    for d2 in frames:
        covers.update(d2, ALL, CAME)
    return list(np.flatnonzero(covers.covered))


def test_what_looks_strange_is_covered() -> None:
    assert _after(HALF) == [0, 1, 2, 3, 4]


def test_a_little_strange_is_covered_only_beside_what_is_covered() -> None:
    edge = HALF.copy()
    edge[[5, 9]] = 40.0
    assert _after(edge) == [0, 1, 2, 3, 4, 5]


def test_a_few_strange_landmarks_are_none_that_something_covers() -> None:
    d2 = np.full(10, 3.0)
    d2[:3] = 300.0
    assert _after(d2) == []


def test_a_face_that_looks_strange_as_a_whole_is_not_covered() -> None:
    """A quarter of its landmarks is needed to say how strange it looks."""
    assert _after(np.linspace(80.0, 300.0, 10)) == []


def test_what_becomes_strange_gradually_is_an_expression() -> None:
    covers = _covers()
    covers.update(HALF, ALL, STAYED)
    assert not covers.covered.any()
    covers.update(HALF, ALL, CAME)
    covers.update(HALF, ALL, STAYED)
    assert covers.covered.any(), "what covers it stays"


def test_what_was_covered_stays_so_until_it_looks_like_the_face() -> None:
    nearly = np.where(HALF > 100, 60.0, 3.0)
    assert _after(nearly) == []
    assert _after(HALF, nearly) == [0, 1, 2, 3, 4]
    assert _after(HALF, np.where(HALF > 100, 20.0, 3.0)) == []


def test_what_has_turned_away_stays_covered() -> None:
    """It is not seen to be free."""
    covers, facing = _covers(), ALL.copy()
    covers.update(HALF, ALL, CAME)
    facing[0] = False
    covers.update(HALF, facing, CAME)
    assert list(np.flatnonzero(covers.covered)) == [0, 1, 2, 3, 4]


def test_what_something_came_before_is_learned_once_it_looks_like_the_face() -> None:
    covers, strange = _covers(), np.full(10, 60.0)
    strange[5:] = 3.0
    covers.update(strange, ALL, STAYED)
    assert covers.learnable.all(), "it has become strange gradually"
    covers.update(strange, ALL, CAME)
    covers.update(strange, ALL, STAYED)
    assert list(np.flatnonzero(~covers.learnable)) == [0, 1, 2, 3, 4]
    assert not covers.covered.any()
    covers.update(np.full(10, 3.0), ALL, STAYED)
    assert covers.learnable.all()


def test_eyes_alone_are_not_covered() -> None:
    """They blink."""
    covers = _covers(HALF > 100)
    covers.update(HALF, ALL, CAME)
    assert not covers.covered.any()


@pytest.mark.parametrize(
    ("of_the_mouth", "covered"), [([0, 1, 2, 3, 4], []), ([0, 1, 2], []), ([0, 1], [0, 1, 2, 3, 4])]
)
def test_a_mouth_is_covered_only_if_enough_else_is(of_the_mouth: list[int], covered: list[int]) -> None:
    """It may have opened."""
    covers = _covers(mouth=np.isin(np.arange(10), of_the_mouth))
    covers.update(HALF, ALL, CAME)
    assert list(np.flatnonzero(covers.covered)) == covered


@pytest.mark.parametrize(("is_open", "covered"), [(True, []), (False, [0, 1, 2, 3, 4])])
def test_what_lies_beside_an_open_mouth_may_look_strange(is_open: bool, covered: list[int]) -> None:
    covers = _covers(mouth=np.isin(np.arange(10), [0, 1]))
    covers.update(HALF, ALL, CAME, is_open)
    assert list(np.flatnonzero(covers.covered)) == covered


def test_what_lies_elsewhere_is_covered_also_while_the_mouth_is_open() -> None:
    covers = _covers(mouth=np.isin(np.arange(10), [8, 9]))
    covers.update(HALF, ALL, CAME, True)
    assert list(np.flatnonzero(covers.covered)) == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("facing", [ALL, ~ALL])
def test_a_lost_face_is_not_covered(facing: Mask) -> None:
    covers = _covers()
    covers.update(HALF, ALL, CAME)
    covers.forget()
    assert not covers.covered.any()
    covers.update(np.full(10, 3.0), facing, CAME)
    assert not covers.covered.any()
