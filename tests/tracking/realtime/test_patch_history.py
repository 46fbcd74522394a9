"""How well patches agree with themselves over the last frames, on patches of random pixels."""

from __future__ import annotations

import numpy as np
import pytest

from mien.arrays import Array
from mien.tracking.realtime.patch_history import PatchHistory

N, PIXELS = 30, 49
rng = np.random.default_rng(0)
FACE, OTHER = rng.normal(0, 40, (2, N, PIXELS))
SEEN = np.ones(N)


def add(history: PatchHistory, patches: Array, weight: Array = SEEN, time: float = 0.0) -> tuple[float, float]:
    values = (patches - patches.mean(axis=1, keepdims=True)).astype(np.float32)
    return history.add(values, np.linalg.norm(values, axis=1).astype(np.float64), weight.copy(), time)


def test_what_came_before_the_face_has_to_stay_as_long_again() -> None:
    history = PatchHistory(SEEN)
    for _ in range(60):
        add(history, FACE)
    assert history.agreement.min() > 0.9
    add(history, OTHER)
    assert history.agreement.max() < 0.7
    for _ in range(20):
        add(history, FACE)
    assert history.agreement.max() < 0.9


def test_a_picture_that_dissolves_into_another_is_the_same_from_frame_to_frame_and_not_after_a_while() -> None:
    history = PatchHistory(SEEN)
    shares = np.clip(np.arange(50) / 20 - 1, 0, 1)
    agreements = [add(history, (1 - share) * FACE + share * OTHER) for share in shares]
    last, later = np.array(agreements[1:]).T
    assert last.min() > 0.9
    assert later[:20].min() > 0.99
    assert later.min() < 0.6
    assert later[-1] > 0.95  # the other picture, which stays


@pytest.mark.parametrize("fps", [30, 120, 240])
@pytest.mark.parametrize("backwards", [False, True])
def test_it_takes_as_long_to_notice_that_at_any_frame_rate(fps: int, backwards: bool) -> None:
    """A dissolve of a second, forwards or backwards in time."""
    history = PatchHistory(SEEN)
    times = np.arange(0, 3, 1 / fps)
    shares = np.clip(times - 1, 0, 1)
    later = [
        add(history, (1 - share) * FACE + share * OTHER, time=-time if backwards else time)[1]
        for time, share in zip(times.tolist(), shares, strict=True)
    ]
    assert min(later[1:fps]) > 0.99
    assert min(later[1:]) == pytest.approx(0.73, abs=0.03)


def test_a_face_that_was_covered_matches_what_was_kept_once() -> None:
    """However long something else was there; and once, so that a later doubt is another one."""
    history = PatchHistory(SEEN)

    def matches(*looks: Array) -> list[bool]:
        found = []
        for look in looks:
            add(history, look)
            found.append(history.matches_kept(0.85))
        return found

    assert matches(*[FACE] * 13) == [False] * 13  # nothing is kept
    assert matches(OTHER) == [False]
    history.keep()
    assert matches(*[OTHER] * 40, 0.5 * FACE + 0.5 * OTHER) == [False] * 41
    assert matches(FACE, FACE) == [True, False]


def test_a_face_that_matched_is_not_compared_with_what_covered_it() -> None:
    history = PatchHistory(SEEN)
    for _ in range(13):
        add(history, FACE)
    add(history, OTHER)
    history.keep()
    for _ in range(30):
        add(history, OTHER)
    add(history, FACE)
    assert history.matches_kept(0.85)
    for _ in range(20):
        assert min(add(history, FACE)) > 0.9


def test_what_is_dropped_is_not_matched() -> None:
    history = PatchHistory(SEEN)
    add(history, FACE)
    history.keep()
    history.keep(wanted=False)
    add(history, FACE)
    assert not history.matches_kept(0.85)


def test_where_everything_looks_strange_all_that_is_seen_is_compared() -> None:
    """Small weights say that patches can be seen, no more."""
    history = PatchHistory(SEEN)
    found = [add(history, FACE, 0.01 * SEEN) for _ in range(2)]
    np.testing.assert_allclose(found, [(0, 0), (1, 1)], atol=1e-4)
    hidden = add(history, FACE, 0 * SEEN)
    np.testing.assert_allclose(hidden, (1, 1), atol=1e-4)  # they were seen before
    assert add(history, FACE, 0 * SEEN)[0] == 0


def test_patches_that_are_disregarded_do_not_count_in_the_next_frame() -> None:
    history = PatchHistory(SEEN)
    half = np.arange(N) % 2 == 0
    add(history, FACE)
    history.disregard(half)
    assert add(history, np.where(half[:, None], OTHER, FACE))[0] > 0.99


def test_patches_that_are_alike_on_all_faces_do_not_say_whose_this_is() -> None:
    """Two thirds of them stay as they are, the others change."""
    alike = np.arange(N) % 3 > 0
    found = []
    for distinctive in (1.0 - alike, SEEN):
        history = PatchHistory(distinctive)
        add(history, FACE)
        found.append(add(history, np.where(alike[:, None], FACE, OTHER))[0])
    assert found[0] < 0.5
    assert found[1] > 0.99
