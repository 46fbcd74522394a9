"""OpenCV's log, which would say on the terminal in its own words what mien says in a sentence."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock
from typing import Any

import cv2

_LOGGING = Lock()
"""The level of the log is one for all threads: each would restore what another has set."""


@contextmanager
def opencv_silenced() -> Iterator[None]:
    """Discard what OpenCV logs meanwhile."""
    log: Any = getattr(cv2.utils, "logging", cv2)  # OpenCV 5, else OpenCV 4
    with _LOGGING:
        level = log.getLogLevel()
        log.setLogLevel(0)
        try:
            yield
        finally:
            log.setLogLevel(level)
