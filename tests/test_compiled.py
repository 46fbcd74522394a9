"""Kernels where nothing can be cached."""

from __future__ import annotations

from typing import Any

import numba
import pytest

from mien import compiled
from mien.errors import MienWarning


def test_without_a_folder_that_can_be_written_kernels_are_compiled_all_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    njit = numba.njit

    def without_cache(**options: Any) -> Any:
        if options["cache"]:
            raise RuntimeError("cannot cache function: no locator available")
        return njit(**options)

    monkeypatch.setattr(numba, "njit", without_cache)
    compiled._warn_without_cache.cache_clear()
    with pytest.warns(MienWarning, match="set NUMBA_CACHE_DIR"):

        @compiled.kernel()
        def double(x: float) -> float:
            return 2 * x

    assert double(4.0) == 8.0
