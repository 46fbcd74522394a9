"""The times of frames, which increase whatever their source states."""

from __future__ import annotations

import math

from mien.errors import warn

_DECIMALS = 6
"""Two frames have different times if tables, which have so many decimals of a second, tell them apart."""
_JUMP_S = 1.0
"""A backward step in time larger than this means that files were joined, or that a clock was set; a smaller one is a
single wrong time stamp."""


class Clock:
    """Makes time stamps increase: a wrong one is replaced by the end of the frame before, and after a jump back all
    later ones are shifted, with a warning, until they go on as before it."""

    def __init__(self, name: str, begin: float = 0.0) -> None:
        """name: of the source; begin: seconds, the time of a first frame without one."""
        self.name, self.until = name, begin
        self.time = -math.inf
        self.offset = self.offset_before = 0.0  # added to what is stated after the last jump back, and before it
        self.has_jumped = False
        self.stated = -math.inf  # of the last frame, with the offset
        self.missing, self.missing_from = 0.0, math.nan  # seconds without a frame, and where the first of them are

    def time_of(self, stated: float | None, duration: float) -> float:
        """The time in seconds of the next frame. stated: None, or not finite, if it is not; duration: seconds."""
        stamp = self.until if stated is None or not math.isfinite(stated) else self._shifted(stated)
        if stamp < self.stated - _JUMP_S:
            if not self.has_jumped:
                warn(f"{self.name}: time jumps back from {self.time:.2f} to {stamp:.2f} s; later times are shifted")
            self.has_jumped = True
            self.offset_before = self.offset
            self.offset += self.until - stamp
            stamp = self.until
        self.stated = stamp
        if math.isfinite(self.time) and stamp - self.until > 0.5 * duration:
            self.missing_from = self.missing_from if self.missing else self.until
            self.missing += stamp - self.until
        later = round(stamp, _DECIMALS) > round(self.time, _DECIMALS)
        self.time = stamp if later else self.until
        self.until = self.time + duration
        return self.time

    def _shifted(self, stated: float) -> float:
        """What is stated, with the offset. That of the last jump is taken back where the time goes on as before it: the
        time stamps between were wrong, or the clock that was set back has been set right."""
        before, after = stated + self.offset_before, stated + self.offset
        if abs(before - self.until) < min(abs(after - self.until), _JUMP_S):
            self.offset = self.offset_before
        return stated + self.offset
