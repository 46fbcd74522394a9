"""Threads of linear algebra: one, so that numbers do not depend on the machine's processors.

The sums of BLAS are rounded differently by several threads. For matrices as small as these they take longer, too.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let BLAS use one thread within this context, or in a function that this decorates."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, user_api="blas"):
        yield
