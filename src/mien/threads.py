"""Threads of linear algebra: one, so that numbers do not depend on the machine's processors.

The sums of BLAS are rounded differently by several threads. For matrices as small as these they take longer, too.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from threading import Lock
from typing import Any


class _Limit:
    """The limit of the whole process, from the first of those that want it to the last, in whichever thread they are:
    each of them undoing what it did would leave the process with one thread for good where they overlap."""

    def __init__(self) -> None:
        self.lock, self.users, self.undo = Lock(), 0, ExitStack()
        self.libraries: list[Any] = []

    def enter(self) -> None:
        from threadpoolctl import ThreadpoolController

        with self.lock:
            self.users += 1
            blas = ThreadpoolController().select(user_api="blas")  # also what was loaded since the last time
            self.libraries = blas.lib_controllers
            if any(library["num_threads"] > 1 for library in blas.info()):
                self.undo.enter_context(blas.limit(limits=1))

    def leave(self) -> None:
        with self.lock:
            self.users -= 1
            if self.users == 0:
                for library in self.libraries:
                    if hasattr(library, "clear_controlling_thread"):  # else only the thread that came first may undo it
                        library.clear_controlling_thread(force=True)
                self.undo.close()


_LIMIT = _Limit()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let BLAS use one thread within this context, or in a function that this decorates."""
    _LIMIT.enter()
    try:
        yield
    finally:
        _LIMIT.leave()
