"""Commands in processes of their own, so many at a time, each with a time limit."""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import IO

from mien.errors import require

POLL_SECONDS = 0.02
SENTENCE = "reason: "
"""What a process prints before the sentence that says why it failed; libraries may print after it."""


@dataclass(frozen=True)
class Command:
    """A command line, what to call it, and variables added to its environment."""

    name: str
    arguments: Sequence[str]
    environment: Mapping[str, str] = field(default_factory=dict)


def run_commands(
    commands: Sequence[Command], jobs: int, time_limit: float, started: Callable[[str], None] = lambda name: None
) -> Iterator[tuple[int, str]]:
    """Run commands, `jobs` at a time; yield the place of each that has ended, and why it failed ("" if not).

    time_limit: seconds that each may take. The reason is the last line that the process printed, the signal
    that ended it, or the time limit. Processes that still run when the iteration is given up are ended with
    it.
    """
    require(jobs >= 1, f"the number of jobs must be at least 1, not {jobs}")
    require(time_limit > 0, f"the time limit must be positive, not {time_limit:g} seconds")
    waiting = deque(enumerate(commands))
    running: dict[int, _Process] = {}
    try:
        while waiting or running:
            while waiting and len(running) < jobs:
                place, command = waiting.popleft()
                running[place] = _Process(command)
                started(command.name)
            ended = {place: reason for place, p in running.items() if (reason := p.reason(time_limit)) is not None}
            for place in ended:
                running.pop(place).close()
            yield from ended.items()
            if not ended:
                time.sleep(POLL_SECONDS)
    finally:
        for process in running.values():
            process.close()


class _Process:
    """A process whose output goes to a file."""

    def __init__(self, command: Command) -> None:
        self._output: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115
        self._start = time.monotonic()
        self._process = subprocess.Popen(
            list(command.arguments),
            stdin=subprocess.DEVNULL,
            stdout=self._output,
            stderr=subprocess.STDOUT,
            env={**os.environ, **command.environment},
            start_new_session=True,
        )

    def reason(self, time_limit: float) -> str | None:
        """None while it runs, "" when it has succeeded, else why it failed."""
        status = self._process.poll()
        if status is None:
            if time.monotonic() - self._start < time_limit:
                return None
            return f"no end within {time_limit:g} s; stopped"
        if status == 0:
            return ""
        if status < 0:
            return f"the process crashed ({signal.Signals(-status).name})"
        return self._last_line() or f"the process ended with status {status}"

    def close(self) -> None:
        """End the process and those that it started."""
        if self._process.poll() is None:
            if hasattr(os, "killpg"):
                os.killpg(self._process.pid, signal.SIGKILL)
            else:
                self._process.kill()
            self._process.wait()
        self._output.close()

    def _last_line(self) -> str:
        self._output.seek(0)
        lines = self._output.read().decode(errors="replace").split("\n")
        said = [line.strip() for line in lines if line.strip()]
        sentences = [line.removeprefix(SENTENCE) for line in said if line.startswith(SENTENCE)]
        return next(reversed(sentences or said), "")
