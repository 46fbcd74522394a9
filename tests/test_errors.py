"""What a user is meant to see, and what ends a run."""

from __future__ import annotations

from itertools import pairwise

import pytest

from mien.errors import interruption


def _chained(*errors: BaseException) -> BaseException:
    for error, cause in pairwise(errors):
        error.__cause__ = cause
    return errors[0]


@pytest.mark.parametrize("between", [0, 1, 3])
def test_an_interruption_is_found_however_deep_it_lies(between: int) -> None:
    """A compiled function that is stopped raises a SystemError, and what called it another one."""
    stop = KeyboardInterrupt()
    assert interruption(_chained(*[SystemError() for _ in range(between)], stop)) is stop


def test_other_errors_are_themselves() -> None:
    error = _chained(SystemError(), ValueError())
    assert interruption(error) is error
