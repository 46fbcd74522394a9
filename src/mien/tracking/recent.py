"""What the last frames showed, as far back as something is compared with itself."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Generic, TypeVar

Shown = TypeVar("Shown")
_MOST = 20
"""How many times the least number of frames is kept at most."""


class Recent(Generic[Shown]):
    """What each of the last frames showed, from the newest one on that is both so many frames and so many seconds old:
    a video has more frames in a second than another, and what changes slowly takes as long in both."""

    def __init__(self, frames: int, seconds: float) -> None:
        self.frames, self.seconds = frames, seconds
        self._shown: deque[tuple[float, Shown]] = deque(maxlen=_MOST * frames + 1)

    def __len__(self) -> int:
        return len(self._shown)

    def __getitem__(self, k: int) -> Shown:
        return self._shown[k][1]

    def __iter__(self) -> Iterator[Shown]:
        return (shown for _, shown in self._shown)

    def add(self, shown: Shown, time: float) -> None:
        """Add what the next frame shows, at a time in seconds, which may also go backwards. Frames without times count
        as if each took as long as it has to."""
        self._shown.append((time, shown))
        while len(self._shown) > self.frames + 1 and not 0 < abs(time - self._shown[1][0]) < self.seconds:
            self._shown.popleft()

    def restart(self, *kept: Shown) -> None:
        """Forget all but these, as if they were of the last moments."""
        time = self._shown[-1][0]
        self._shown.clear()
        self._shown.extend((time, shown) for shown in kept)
