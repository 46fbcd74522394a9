"""What a user is meant to see, and what ends a run."""

from __future__ import annotations

import warnings
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
import pytest

import mien
from mien.errors import MienError, MienWarning, interruption, noted_warnings, warn, warnings_noted


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


@pytest.mark.filterwarnings("ignore::mien.errors.MienWarning")
def test_what_is_warned_of_is_noted_once_by_who_asks_for_it() -> None:
    """Each thread for itself, as each may track a video."""

    @warnings_noted()
    def noted(*sentences: str) -> list[str]:
        for sentence in sentences:
            warn(sentence)
        return noted_warnings()

    with warnings_noted():
        warn("blurred")
        with ThreadPoolExecutor(1) as other:
            assert other.submit(noted, "turned", "dark", "turned").result() == ["turned", "dark"]
            other.submit(warn, "elsewhere").result()
        assert noted("covered") == ["covered"]
        assert noted_warnings() == ["blurred"]
    assert noted_warnings() == []
    with warnings_noted(), warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(MienWarning):
            warn("blurred")
        assert noted_warnings() == ["blurred"]


def test_a_warning_names_the_line_that_called_mien() -> None:
    """However deep in mien, in a generator or a decorated function, it is issued."""
    repeated = [mien.Frame(np.zeros((8, 8), np.uint8)) for _ in range(2)]
    with pytest.warns(MienWarning, match="comes after") as streamed:
        list(mien.stream(repeated))
    with pytest.warns(MienWarning, match="comes after") as tracked, pytest.raises(MienError, match="no face"):
        mien.track(repeated)
    assert {warning.filename for warning in [*streamed, *tracked]} == {__file__}
