"""How Numba compiles the inner loops: on the first call of each, cached on disk. On the first run a second process
compiles the largest (`tracking/first_run.py`).

The cache of a kernel is invalidated when its own file changes, but not when the file of a kernel that it calls does:
after editing `tracking/kernels.py`, touch `tracking/motion.py` as well, or it will run the old code.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

F = TypeVar("F", bound=Callable[..., Any])

_OPTIONS: dict[str, Any] = {
    "cache": True,
    "fastmath": {"contract", "reassoc", "arcp", "nsz", "ninf", "nnan"},
    "error_model": "numpy",  # division by zero gives inf; raising an exception would cost a branch per division
    "no_cfunc_wrapper": True,  # never called from C
}


def kernel(**options: Any) -> Callable[[F], F]:
    """Decorator that compiles a function of arrays and numbers; options override the defaults for `numba.njit`."""

    def decorate(function: F) -> F:
        compiled: F = numba.njit(**_OPTIONS | options)(function)
        return compiled

    return decorate
