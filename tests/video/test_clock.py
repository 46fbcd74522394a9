"""Times that increase."""

from __future__ import annotations

import numpy as np
import pytest

from mien.errors import MienWarning
from mien.video.clock import Clock


def test_no_two_frames_have_the_time_of_one_in_a_table() -> None:
    """A time that is counted on is that of the next frame but for a rounding error."""
    clock = Clock("x.avi")
    times = [clock.time_of(stated, 1 / 30) for stated in (2 / 30, 2 / 30, 3 / 30 + 1e-9, 4 / 30 + 1e-9, 9 / 30)]
    np.testing.assert_allclose(times, np.array([2, 3, 4, 5, 9]) / 30)


def test_frames_that_a_table_tells_apart_keep_their_times() -> None:
    clock, stated = Clock("x.mkv"), [0.0, 1e-6, 0.001, 0.0012, 5.0]
    assert [clock.time_of(time, 1 / 30) for time in stated] == stated


@pytest.mark.parametrize("wrong", [range(50, 51), range(50, 53), range(50, 80)])
def test_times_go_on_as_before_a_jump_back_once_they_do(wrong: range) -> None:
    """After a single wrong time stamp, or as long as a clock was set back; of all such jumps one is warned of."""
    clock, true = Clock("the frames"), np.arange(200) / 30
    stated = true.copy()
    stated[wrong] -= 1000.0
    stated[100 + np.array(wrong)] -= 500.0
    with pytest.warns(MienWarning, match="time jumps back from .*; later times are shifted") as warned:
        times = [clock.time_of(time, 1 / 30) for time in stated]
    np.testing.assert_allclose(times, true)
    assert len(warned) == 1


def test_times_of_files_that_were_joined_stay_shifted() -> None:
    clock = Clock("x.ts")
    with pytest.warns(MienWarning, match="time jumps back"):
        times = [clock.time_of(time, 0.04) for time in [*np.arange(50) * 0.04, *np.arange(200) * 0.04]]
    np.testing.assert_allclose(times, np.arange(250) * 0.04)
