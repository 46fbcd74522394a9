"""How Numba compiles the inner loops: when mien is installed (`hatch_build.py`), else on the first call of each, cached
on disk. On such a first run a second process compiles the largest (`tracking/realtime/first_run.py`).

Numba compiles a kernel anew when its own file has changed. It contains the code of kernels and the constants of other
files, so here it is compiled anew when any of these has.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from hashlib import sha256
from itertools import chain
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, TypeVar

import numba

from mien.errors import warn

F = TypeVar("F", bound=Callable[..., Any])

_OPTIONS: dict[str, Any] = {
    "cache": True,
    "fastmath": {"contract", "reassoc", "arcp", "nsz", "nnan"},  # infinite values occur
    "error_model": "numpy",  # division by zero gives inf; raising an exception would cost a branch per division
    "no_cfunc_wrapper": True,  # never called from C
}


_PACKAGES = ("appearance", "candide", "geometry", "tracking")
"""Where kernels are, and what is compiled into them."""


@cache
def _source_stamp() -> str:
    """Digest of all source of mien that kernels are compiled from, and of how they are."""
    digest, root = sha256(Path(__file__).read_bytes()), Path(__file__).parent
    for file in sorted(chain.from_iterable((root / package).rglob("*.py") for package in _PACKAGES)):
        digest.update(file.read_bytes())
    return digest.hexdigest()


def _own_source(file: Path) -> bytes:
    """The source of a kernel that is not mien's, as of a benchmark; nothing for those in the digest."""
    return b"" if Path(__file__).parent in file.parents or not file.is_file() else file.read_bytes()


def is_cached(compiled: Any) -> bool:
    """Whether a kernel is on disk as its source is now, for this processor; True where nothing can be kept there."""
    index = _index_of(compiled)
    try:
        return index is None or compiled.targetctx.codegen().magic_tuple() in {key[1] for key in index._load_index()}
    except (OSError, EOFError, UnpicklingError):
        return False


def _index_of(compiled: Any) -> Any:
    """Numba's index of what is on disk of a kernel, which knows the stamp of the source; None where nothing is kept."""
    return getattr(getattr(compiled, "_cache", None), "_cache_file", None)


@cache
def _warn_without_cache() -> None:
    warn(
        "compiled code cannot be written to its folder, so every start takes as long as the first; "
        "set NUMBA_CACHE_DIR to one that has space and can be written"
    )


def _keep_where_possible(compiled: Any) -> None:
    """Let a kernel that cannot be written to its folder, as on a full disk, be compiled anew at every start."""
    cache = getattr(compiled, "_cache", None)
    if cache is None:  # as with NUMBA_DISABLE_JIT
        return
    save = cache.save_overload

    def save_or_warn(*overload: Any) -> None:
        try:
            save(*overload)
        except OSError:
            _warn_without_cache()

    cache.save_overload = save_or_warn


def kernel(**options: Any) -> Callable[[F], F]:
    """Decorator that compiles a function of arrays and numbers; options override the defaults for `numba.njit`."""

    def decorate(function: F) -> F:
        try:
            compiled: F = numba.njit(**_OPTIONS | options)(function)
        except RuntimeError:  # neither the package's folder nor the user's can be written
            _warn_without_cache()
            compiled = numba.njit(**_OPTIONS | options | {"cache": False})(function)
        _keep_where_possible(compiled)
        index = _index_of(compiled)
        if index is not None:
            index._source_stamp = _source_stamp(), _own_source(Path(function.__code__.co_filename))
        return compiled

    return decorate
