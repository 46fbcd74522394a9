"""How Numba compiles the inner loops: on the first call of each, cached on disk. On the first run a second process
compiles the largest (`tracking/first_run.py`).

The cache of a kernel is invalidated when its own file changes, but not when the file of a kernel that it calls does:
after editing `tracking/kernels.py`, touch `tracking/motion.py` as well, or it will run the old code.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar

import numba

from mien.errors import warn

F = TypeVar("F", bound=Callable[..., Any])

_OPTIONS: dict[str, Any] = {
    "cache": True,
    "fastmath": {"contract", "reassoc", "arcp", "nsz", "ninf", "nnan"},
    "error_model": "numpy",  # division by zero gives inf; raising an exception would cost a branch per division
    "no_cfunc_wrapper": True,  # never called from C
}


@cache
def _warn_without_cache() -> None:
    warn(
        "no folder for compiled code can be written, so every start takes as long as the first; "
        "set NUMBA_CACHE_DIR to one that can"
    )


def kernel(**options: Any) -> Callable[[F], F]:
    """Decorator that compiles a function of arrays and numbers; options override the defaults for `numba.njit`."""

    def decorate(function: F) -> F:
        try:
            compiled: F = numba.njit(**_OPTIONS | options)(function)
        except RuntimeError:  # neither the package's folder nor the user's can be written
            _warn_without_cache()
            compiled = numba.njit(**_OPTIONS | options | {"cache": False})(function)
        return compiled

    return decorate
