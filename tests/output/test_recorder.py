"""The estimates of a running track, and what is left of them by an interrupt."""

from __future__ import annotations

import sys
from types import FrameType
from typing import Any

import numpy as np
import pytest

from mien.frame import Frame
from mien.output import recorder
from mien.output.recorder import Recorder
from mien.tracking.state import Estimate, Status

COUNT = 6


def _estimate(k: int) -> Estimate:
    frame = Frame(np.zeros((4, 4), np.uint8), k, k / 25)
    return Estimate(frame.index, frame.time, Status.TRACKED, np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 10.0 + k]))


def _add_until(call: int, recorder: Recorder, estimate: Estimate) -> bool:
    """Add an estimate, interrupted after this call of a built-in function; whether there is such a one."""
    counted = 0

    def profile(frame: FrameType, event: str, argument: Any) -> None:
        nonlocal counted
        if event == "c_return" and frame.f_code in (Recorder.add.__code__, Recorder._flush.__code__):
            counted += 1
            if counted == call:
                sys.setprofile(None)
                raise KeyboardInterrupt

    before = sys.getprofile()
    sys.setprofile(profile)
    try:
        recorder.add(estimate)
    except KeyboardInterrupt:
        return True
    finally:
        sys.setprofile(before)
    return False


@pytest.mark.parametrize("number", [1, 3])
def test_a_row_that_is_interrupted_is_there_once(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where it is the last of a batch: who goes on after the last index has all rows, and a rotation for each."""
    monkeypatch.setattr(recorder, "BATCH", 4)
    call, there = 0, True
    while there:
        call += 1
        with Recorder() as rows:
            for k in range(number):
                rows.add(_estimate(k))
            there = _add_until(call, rows, _estimate(number))
            for k in range(rows.last_index + 1, COUNT):
                rows.add(_estimate(k))
            assert rows.count == COUNT
            assert rows.table().column("frame").to_pylist() == list(range(COUNT))
            assert rows.model_rotations.shape == (COUNT, 3, 3)
    assert call > 1
