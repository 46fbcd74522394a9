"""Run commands in separate processes, a given number at a time, each with a time limit.

A process forked from one that has already imported all modules starts seconds sooner than a new one.
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
from threading import Thread

from mien.errors import require

POLL_SECONDS = 0.02
GRACE_SECONDS = 5.0
"""How long a process that is asked to terminate has to save its results."""
REASON_PREFIX = "reason: "
"""Marks the line in which a process says why it failed; libraries may print more lines after it."""

Progress = Callable[[int, int, str], None]
"""Called with the number of finished jobs, the number of all jobs, and the name of the last job started."""


@dataclass(frozen=True)
class Command:
    """A command line, its display name, and variables added to its environment. watching: whether it calls
    `end_with_caller`, for which its standard input is held open."""

    name: str
    arguments: Sequence[str]
    environment: Mapping[str, str] = field(default_factory=dict)
    watching: bool = False


@dataclass(frozen=True)
class Call:
    """A function, `module:name`, to call in a separate process: its display name, arguments, and variables added to its
    environment.

    imported: the module to import before forking, by default the function's own. The first call that is forked decides
    which module, and in which environment, is imported for all.
    """

    name: str
    function: str
    arguments: Sequence[str]
    environment: Mapping[str, str] = field(default_factory=dict)
    imported: str = ""

    @property
    def command(self) -> Command:
        """The equivalent command line, for a new process."""
        module, _, function = self.function.partition(":")
        code = (
            f"import sys; from {__name__} import end_with_caller; end_with_caller(); "
            f"from {module} import {function}; {function}(*sys.argv[1:])"
        )
        return Command(self.name, (sys.executable, "-c", code, *self.arguments), self.environment, watching=True)


def end_with_caller() -> None:
    """Let this process end once its standard input does, which the process that wants its result holds open."""
    _end_after(lambda: os.read(0, 1))


def _end_after(wait: Callable[[], object]) -> None:
    """Terminate this process once `wait` returns, which waits for the end of the one that wants its result: killed,
    that can stop nobody, and this would write over the files of a later run."""

    def watch() -> None:
        wait()
        os.kill(os.getpid(), signal.SIGTERM)

    Thread(target=watch, daemon=True).start()


def available_processors() -> int:
    """Number of processors available to this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def can_fork() -> bool:
    """Whether forking is safe; on macOS, libraries that are already imported may not survive it."""
    return sys.platform == "linux"


@dataclass(frozen=True)
class Ended:
    """A command that has ended: its index among the commands, why it failed ("" on success), and the lines that it
    printed."""

    index: int
    reason: str
    output: tuple[str, ...]


def run_commands(
    commands: Sequence[Command | Call],
    jobs: int,
    time_limit: float = inf,
    started: Callable[[str], None] = lambda name: None,
    forked: bool = False,
) -> Iterator[Ended]:
    """Run commands, `jobs` at a time, and yield each when it has ended.

    time_limit: seconds per command; forked: whether calls may be forked, where the system allows it, from a process
    that has imported their module; forked processes import the main module of this one again. The reason for a failure
    is the last line that the process printed, the signal that ended it, or the time limit. If the iteration is
    abandoned, processes that are still running are asked to terminate.
    """
    require(jobs >= 1, f"the number of jobs must be at least 1, not {jobs}")
    require(time_limit > 0, f"the time limit must be positive, not {time_limit:g} seconds")
    waiting = deque(enumerate(commands))
    running: dict[int, _Process] = {}
    try:
        while waiting or running:
            while waiting and len(running) < jobs:
                index, command = waiting.popleft()
                running[index] = _Process(command, forked and can_fork())
                started(command.name)
            reasons = {index: reason for index, p in running.items() if (reason := p.reason(time_limit)) is not None}
            ended = [Ended(index, reason, running[index].output_lines()) for index, reason in reasons.items()]
            for index in reasons:
                running.pop(index).close()
            yield from ended
            if not ended:
                time.sleep(POLL_SECONDS)
    finally:
        for process in running.values():
            process.interrupt()
        for process in running.values():
            process.close(GRACE_SECONDS)


class _Forked:
    """A call in a forked process, with the interface of `subprocess.Popen`."""

    def __init__(self, call: Call, output: str) -> None:
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload([call.imported or call.function.partition(":")[0]])
        self._process = context.Process(target=_run_call, args=(call, output), daemon=False)
        with _extended_environment(call.environment):
            _start_fork_server()
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


def _start_fork_server() -> None:
    """Start the server that forks processes, deaf to Ctrl-C, to which it would answer with a traceback while it
    imports. What it forks is deaf as well at first."""
    from multiprocessing import forkserver, resource_tracker  # not at the top: the first does not exist on Windows

    resource_tracker.ensure_running()  # it undoes the mask when it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _extended_environment(environment: Mapping[str, str]) -> Iterator[None]:
    """Add variables to the environment of this process for the block; processes that it starts inherit them."""
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


def _run_call(call: Call, output: str) -> None:
    """Run a call in this forked process, as the leader of a new session, with stdout and stderr appended to a file."""
    os.setsid()
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    caller = multiprocessing.parent_process()
    assert caller is not None, "it has been forked"
    _end_after(caller.join)
    try:
        file = os.open(output, os.O_WRONLY | os.O_APPEND)
    except FileNotFoundError:  # the parent was stopped before this process started
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
                with suppress(OSError):  # the path of its socket may be too long
                    self._process = _Forked(command, self._output.name)
                    return
            command = command.command
        self._process = subprocess.Popen(
            list(command.arguments),
            stdin=subprocess.PIPE if command.watching else subprocess.DEVNULL,
            stdout=self._output,
            stderr=subprocess.STDOUT,
            env={**os.environ, "PYTHONUNBUFFERED": "1", **command.environment},  # what was printed last is last
            start_new_session=True,
        )

    def reason(self, time_limit: float) -> str | None:
        """None while the process runs, "" after success, else why it failed."""
        status = self._process.poll()
        if status is None:
            if time.monotonic() - self._start < time_limit:
                return None
            return f"no end within {time_limit:g} s; stopped"
        if status == 0:
            return ""
        if status < 0:
            names = {number.value: number.name for number in signal.Signals}
            return f"the process crashed ({names.get(-status, f'signal {-status}')})"
        return self._failure_message() or f"the process ended with status {status}"

    def output_lines(self) -> tuple[str, ...]:
        """The lines that the process has printed so far, stripped and without empty ones."""
        self._output.seek(0)
        lines = self._output.read().decode(errors="replace").split("\n")
        return tuple(line.strip() for line in lines if line.strip())

    def interrupt(self) -> None:
        """Ask the process to terminate."""
        if self._process.poll() is None:
            self._process.terminate()

    def close(self, grace: float = 0.0) -> None:
        """Wait `grace` seconds for the process to end by itself, then kill it and the processes that it started."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(grace)
        if self._process.poll() is None:
            with suppress(AttributeError, ProcessLookupError):  # no killpg on this system, or not yet a group leader
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.kill()
            self._process.wait()
        if isinstance(self._process, subprocess.Popen) and self._process.stdin:
            self._process.stdin.close()
        self._output.close()

    def _failure_message(self) -> str:
        """The last line marked as the reason, or else the last line printed."""
        lines = self.output_lines()
        reasons = [line.removeprefix(REASON_PREFIX) for line in lines if line.startswith(REASON_PREFIX)]
        return next(reversed(reasons or lines), "")
