"""Trackers of a test's own in the pipeline."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from mien.pipeline import passes, track


def use_tracker(monkeypatch: pytest.MonkeyPatch, create: Callable[[str], Any]) -> None:
    """Let the pipeline create its trackers by this function of the preset."""
    for module in (track, passes):
        monkeypatch.setattr(module, "create_tracker", create)
