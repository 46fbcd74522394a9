"""The kinds of NumPy arrays in signatures; docstrings give their shapes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]
Integers = NDArray[np.int64]
Pixels = NDArray[np.uint8]
Mask = NDArray[np.bool_]
