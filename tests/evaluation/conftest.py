"""The trackers of `evaluation.tiny` are found by the processes that an evaluation starts."""

from __future__ import annotations

import os
import sys

import pytest

from evaluation import tiny


@pytest.fixture(autouse=True)
def _trackers_can_be_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tiny.ROOT), *sys.path]))
