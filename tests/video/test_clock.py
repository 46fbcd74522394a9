"""Times that increase."""

from __future__ import annotations

import numpy as np

from mien.video.clock import Clock


def test_no_two_frames_have_the_time_of_one_in_a_table() -> None:
    """A time that is counted on is that of the next frame but for a rounding error."""
    clock = Clock("x.avi")
    times = [clock.time_of(stated, 1 / 30) for stated in (2 / 30, 2 / 30, 3 / 30 + 1e-9, 4 / 30 + 1e-9, 9 / 30)]
    np.testing.assert_allclose(times, np.array([2, 3, 4, 5, 9]) / 30)


def test_frames_that_a_table_tells_apart_keep_their_times() -> None:
    clock, stated = Clock("x.mkv"), [0.0, 1e-6, 0.001, 0.0012, 5.0]
    assert [clock.time_of(time, 1 / 30) for time in stated] == stated
