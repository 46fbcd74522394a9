"""Values in order: kernels for medians and other quantiles of a few numbers, which NumPy would take longer to call."""

from __future__ import annotations

from typing import Any

import numpy as np

from mien.compiled import kernel


@kernel()
def insert(value: float, ordered: Any, count: int) -> None:
    """Insert a value among the first `count` entries of an ordered array, which has room for it."""
    k = count
    while k > 0 and ordered[k - 1] > value:
        ordered[k] = ordered[k - 1]
        k -= 1
    ordered[k] = value


@kernel(fastmath={"contract"})
def median(values: Any) -> float:
    """Median of values (n,), the upper one where two are in the middle; infinite without any."""
    ordered = np.empty(values.size)
    for i in range(values.size):
        insert(values[i], ordered, i)
    return float(ordered[values.size // 2]) if values.size else np.inf
