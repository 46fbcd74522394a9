"""Commands in processes of their own, so many at a time, each with a time limit.

A process that is forked from one which has imported all modules begins seconds sooner than a new one.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from importlib import import_module
from math import inf

from mien.errors import require

POLL_SECONDS = 0.02
GRACE_SECONDS = 5.0
"""What a process has to write what it has when it is asked to end."""
SENTENCE = "reason: "
"""What a process prints before the sentence that says why it failed; libraries may print after it."""

Progress = Callable[[int, int, str], None]
"""Called with the number of jobs that are done, of jobs, and the name of what was started last."""


@dataclass(frozen=True)
class Command:
    """A command line, what to call it, and variables added to its environment."""

    name: str
    arguments: Sequence[str]
    environment: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Call:
    """A function, `module:name`, that is called with arguments in a process of its own, what to call that, and
    variables added to its environment.

    imported: the module that is imported before processes are forked, the function's own unless given. It is that of
    the first call that is forked, and was imported in that one's environment.
    """

    name: str
    function: str
    arguments: Sequence[str]
    environment: Mapping[str, str] = field(default_factory=dict)
    imported: str = ""

    @property
    def command(self) -> Command:
        """The same in a new process."""
        module, _, function = self.function.partition(":")
        code = f"import sys; from {module} import {function}; {function}(*sys.argv[1:])"
        return Command(self.name, (sys.executable, "-c", code, *self.arguments), self.environment)


def can_fork() -> bool:
    """Whether there can be forked processes; on macOS a library that was imported before may not bear it."""
    return sys.platform == "linux"


@dataclass(frozen=True)
class Ended:
    """A command that has ended: its place among the commands, why it failed ("" if it did not), and the lines that it
    printed."""

    place: int
    reason: str
    said: tuple[str, ...]


def run_commands(
    commands: Sequence[Command | Call],
    jobs: int,
    time_limit: float = inf,
    started: Callable[[str], None] = lambda name: None,
    forked: bool = False,
) -> Iterator[Ended]:
    """Run commands, `jobs` at a time, and yield each when it has ended.

    time_limit: seconds that each may take; forked: whether processes of calls may be forked, where there can be such,
    from one that has imported their module; they import this one's main module again. The reason is the last line that
    the process printed, the signal that ended it, or the time limit. Processes that still run when the iteration is
    given up are asked to end.
    """
    require(jobs >= 1, f"the number of jobs must be at least 1, not {jobs}")
    require(time_limit > 0, f"the time limit must be positive, not {time_limit:g} seconds")
    waiting = deque(enumerate(commands))
    running: dict[int, _Process] = {}
    try:
        while waiting or running:
            while waiting and len(running) < jobs:
                place, command = waiting.popleft()
                running[place] = _Process(command, forked and can_fork())
                started(command.name)
            reasons = {place: reason for place, p in running.items() if (reason := p.reason(time_limit)) is not None}
            ended = [Ended(place, reason, running[place].said()) for place, reason in reasons.items()]
            for place in reasons:
                running.pop(place).close()
            yield from ended
            if not ended:
                time.sleep(POLL_SECONDS)
    finally:
        for process in running.values():
            process.interrupt()
        for process in running.values():
            process.close(GRACE_SECONDS)


@contextmanager
def progress_bar(looking: str, quiet: bool) -> Iterator[Progress]:
    """A bar on stderr with the name of what was started last; `looking`: what it says before there is something."""
    if quiet:
        yield lambda done, total, name: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as RichProgress

    columns = (BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), TextColumn("{task.description}"))
    console = Console(stderr=True)
    with RichProgress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task(looking, total=None)

        def show(done: int, total: int, name: str) -> None:
            bar.update(task, completed=done, total=total, description=name)

        yield show


class _Forked:
    """A call in a process that is forked, as a `subprocess.Popen`."""

    def __init__(self, call: Call, output: str) -> None:
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload([call.imported or call.function.partition(":")[0]])
        self._process = context.Process(target=_called, args=(call, output), daemon=False)
        with _added(call.environment):
            self._process.start()
        assert self._process.pid is not None, "it has started"
        self.pid = self._process.pid

    def poll(self) -> int | None:
        return self._process.exitcode

    def wait(self, timeout: float | None = None) -> None:
        self._process.join(timeout)

    def terminate(self) -> None:
        self._process.terminate()

    def kill(self) -> None:
        self._process.kill()


@contextmanager
def _added(environment: Mapping[str, str]) -> Iterator[None]:
    """Variables added to this process's environment, which those that it starts meanwhile inherit."""
    before = {name: os.environ.get(name) for name in environment}
    os.environ.update(environment)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _called(call: Call, output: str) -> None:
    """Make a call in this process, the first of a session, with all that it writes going to a file."""
    os.setsid()
    try:
        file = os.open(output, os.O_WRONLY | os.O_APPEND)
    except FileNotFoundError:  # whoever wanted this was stopped before it began
        return
    for stream in (1, 2):
        os.dup2(file, stream)
    os.close(file)
    os.environ.update(call.environment)
    module, _, function = call.function.partition(":")
    getattr(import_module(module), function)(*call.arguments)


class _Process:
    """A process whose output goes to a file."""

    def __init__(self, command: Command | Call, forked: bool) -> None:
        self._output = tempfile.NamedTemporaryFile()  # noqa: SIM115
        self._start = time.monotonic()
        self._process: subprocess.Popen[bytes] | _Forked
        if isinstance(command, Call):
            if forked:
                with suppress(OSError):  # where the name of the folder for its socket is too long
                    self._process = _Forked(command, self._output.name)
                    return
            command = command.command
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
        return self._sentence() or f"the process ended with status {status}"

    def said(self) -> tuple[str, ...]:
        """The lines that it has printed so far."""
        self._output.seek(0)
        lines = self._output.read().decode(errors="replace").split("\n")
        return tuple(line.strip() for line in lines if line.strip())

    def interrupt(self) -> None:
        """Ask the process to end."""
        if self._process.poll() is None:
            self._process.terminate()

    def close(self, grace: float = 0.0) -> None:
        """End the process and those that it started, `grace` seconds from now if it has not ended by itself."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(grace)
        if self._process.poll() is None:
            with suppress(AttributeError, ProcessLookupError):  # not of every system, or not yet the first of its group
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.kill()
            self._process.wait()
        self._output.close()

    def _sentence(self) -> str:
        """The last line that was printed, or the last that says why it failed."""
        said = self.said()
        sentences = [line.removeprefix(SENTENCE) for line in said if line.startswith(SENTENCE)]
        return next(reversed(sentences or said), "")
