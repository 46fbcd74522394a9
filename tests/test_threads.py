"""One thread of linear algebra, for as long as anybody wants it."""

from __future__ import annotations

from collections.abc import Iterator
from threading import Barrier, Thread

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from mien.threads import one_blas_thread


def _threads() -> list[int]:
    return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]


@pytest.fixture
def several() -> Iterator[list[int]]:
    """The numbers of threads outside, of which some are not one."""
    with threadpool_limits(2, user_api="blas"):
        before = _threads()
        if set(before) == {1}:
            pytest.skip("this BLAS has one thread")
        yield before


def test_one_within_another(several: list[int]) -> None:
    with one_blas_thread():
        assert set(_threads()) == {1}
        with one_blas_thread():
            assert set(_threads()) == {1}
        assert set(_threads()) == {1}
    assert _threads() == several


def test_those_of_two_threads_overlap(several: list[int]) -> None:
    """The first to begin ends first: the other keeps its one thread, and leaves what was there before."""
    begun, ended = Barrier(2), Barrier(2)
    within: list[list[int]] = []

    def second() -> None:
        with one_blas_thread():
            begun.wait()
            ended.wait()
            within.append(_threads())

    other = Thread(target=second)
    with one_blas_thread():
        other.start()
        begun.wait()
    ended.wait()
    other.join()
    assert set(within[0]) == {1}
    assert _threads() == several
