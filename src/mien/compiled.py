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
from numba.core.caching import CompileResultCacheImpl, FunctionCache

from mien.errors import warn

F = TypeVar("F", bound=Callable[..., Any])

_OPTIONS: dict[str, Any] = {
    "cache": True,
    "fastmath": {"contract", "reassoc", "arcp", "nsz", "nnan"},  # infinite values occur
    "error_model": "numpy",  # division by zero gives inf; raising an exception would cost a branch per division
    "no_cfunc_wrapper": True,  # never called from C
}


_PACKAGES = ("appearance", "candide", "geometry", "initialization", "tracking")
"""Where kernels are, and what is compiled into them: also the numbers of landmarks."""


@cache
def _source_stamp() -> str:
    """Digest of all source of mien that kernels are compiled from, and of how they are."""
    digest, root = sha256(Path(__file__).read_bytes()), Path(__file__).parent
    for file in sorted(chain.from_iterable((root / package).rglob("*.py") for package in _PACKAGES)):
        digest.update(file.read_bytes())
    return digest.hexdigest()


def _stamp(file: Path) -> tuple[str, bytes]:
    """Of all that a kernel is compiled from: mien's digest, and the file where that is another's, as a benchmark's."""
    own = b"" if Path(__file__).parent in file.parents or not file.is_file() else file.read_bytes()
    return _source_stamp(), own


def _folder_beside(file: str) -> str:
    """The folder in which Numba keeps the kernels of a file where it can write there."""
    return str(Path(file).parent / "__pycache__")


class _Beside:
    """For Numba, which reads what `pip` has compiled beside the source only if it can write there, too: that folder."""

    def __init__(self, function: Callable[..., Any], file: str) -> None:
        self._py_file, self._line = file, function.__code__.co_firstlineno

    @classmethod
    def from_function(cls, function: Callable[..., Any], file: str) -> _Beside:
        return cls(function, file)

    def ensure_cache_path(self) -> None:
        """Before a kernel is written there, which fails by itself where it cannot be."""

    def get_cache_path(self) -> str:
        return _folder_beside(self._py_file)

    def get_source_stamp(self) -> tuple[str, bytes]:
        return _stamp(Path(self._py_file))

    def get_disambiguator(self) -> str:
        return str(self._line)


class _KeptBeside(CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = (_Beside,)


class _Installed(FunctionCache):  # type: ignore[misc]
    """What is beside the source of a kernel, whether that folder can be written or not."""

    _impl_class = _KeptBeside


def is_cached(compiled: Any) -> bool:
    """Whether a kernel is on disk as its source is now, for this processor; True where nothing can be kept there."""
    cache = getattr(compiled, "_cache", None)
    if cache is None or isinstance(cache, _Installed):
        return True
    processor = compiled.targetctx.codegen().magic_tuple()
    return any(processor in _processors(kept) for kept in (cache, getattr(cache, "installed", None)) if kept)


def _processors(cache: Any) -> set[Any]:
    """For which a cache has a kernel as its source is now."""
    try:
        return {key[1] for key in cache._cache_file._load_index()}
    except (OSError, EOFError, UnpicklingError):
        return set()


@cache
def _warn_without_cache() -> None:
    warn(
        "compiled code cannot be written to its folder, so every start takes as long as the first; "
        "set NUMBA_CACHE_DIR to one that has space and can be written"
    )


def _keep_where_possible(cache: Any) -> None:
    """Let a kernel that cannot be written to its folder, as on a full disk, be compiled anew at every start."""
    save = cache.save_overload

    def save_or_warn(*overload: Any) -> None:
        try:
            save(*overload)
        except OSError:
            _warn_without_cache()

    cache.save_overload = save_or_warn


def _load_installed_too(cache: Any, function: Callable[..., Any]) -> None:
    """Where Numba keeps a kernel elsewhere, as it cannot write beside the source, let it also load what is there."""
    if numba.config.CACHE_DIR or cache.cache_path == _folder_beside(function.__code__.co_filename):
        return
    load, cache.installed = cache.load_overload, _Installed(function)
    cache.load_overload = lambda *overload: load(*overload) or cache.installed.load_overload(*overload)


def kernel(**options: Any) -> Callable[[F], F]:
    """Decorator that compiles a function of arrays and numbers; options override the defaults for `numba.njit`."""

    def decorate(function: F) -> F:
        try:
            compiled: Any = numba.njit(**_OPTIONS | options)(function)
        except RuntimeError:  # neither the package's folder nor the user's can be written
            compiled = numba.njit(**_OPTIONS | options | {"cache": False})(function)
            compiled._cache = _Installed(function)
        cache = getattr(compiled, "_cache", None)  # none with NUMBA_DISABLE_JIT
        if cache is not None:
            cache._cache_file._source_stamp = _stamp(Path(function.__code__.co_filename))
            _keep_where_possible(cache)
            _load_installed_too(cache, function)
        return compiled  # type: ignore[no-any-return]

    return decorate
