"""How the inner loops are compiled: at the first call, kept on disk, and no more of them than is called. The largest is
compiled by a second process the first time (`tracking/first_run.py`).

What is kept is made again when its own file changes, but not when a file changes from which it calls a kernel: whoever
edits `tracking/kernels.py` touches `tracking/motion.py` as well, or tries an old one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

F = TypeVar("F", bound=Callable[..., Any])

_OPTIONS: dict[str, Any] = {
    "cache": True,
    "fastmath": {"contract", "reassoc", "arcp", "nsz", "ninf", "nnan"},
    "error_model": "numpy",  # a division by zero is infinite and no exception, for which each would need a branch
    "no_cfunc_wrapper": True,  # nothing calls them from C
}


def kernel(**options: Any) -> Callable[[F], F]:
    """Decorator of a function of arrays and numbers; options: of `numba.njit`, in place of the usual ones."""

    def decorate(function: F) -> F:
        compiled: F = numba.njit(**_OPTIONS | options)(function)
        return compiled

    return decorate
