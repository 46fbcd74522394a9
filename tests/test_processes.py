"""Calls in processes of their own, forked ones and new ones; commands have their test beside those that run them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mien import processes
from mien.processes import Call, Ended, can_fork, run_commands


def _python(code: str) -> Call:
    return Call(code, "builtins:exec", (code,))


def _run(*codes: str, forked: bool, time_limit: float = 60.0) -> list[Ended]:
    ended = run_commands([_python(code) for code in codes], 2, time_limit, forked=forked)
    return sorted(ended, key=lambda one: one.index)


@pytest.mark.parametrize("forked", [False, True])
def test_what_becomes_of_a_call(forked: bool) -> None:
    ended = _run(
        "pass",
        "print('mien: turned', flush=True); import sys; print('reason: too late', file=sys.stderr); sys.exit(2)",
        "raise SystemExit(3)",
        "raise ValueError('alas')",
        "import os; os.abort()",
        forked=forked,
    )
    reasons = [one.reason for one in ended]
    assert reasons[:3] == ["", "too late", "the process ended with status 3"]
    assert reasons[3] == "ValueError: alas"
    assert reasons[4] == "the process crashed (SIGABRT)"
    assert ended[1].output == ("mien: turned", "reason: too late")


@pytest.mark.parametrize("forked", [False, True])
def test_each_call_has_a_process_and_a_session_of_its_own(forked: bool) -> None:
    ended = _run(*["import os; print(os.getpid(), os.getsid(0), os.getppid())"] * 2, forked=forked)
    first, second = (tuple(map(int, one.output[0].split())) for one in ended)
    assert first[0] == first[1] != second[0] == second[1]
    assert first[2] == second[2]
    assert (first[2] == os.getpid()) != (forked and can_fork())


@pytest.mark.parametrize("forked", [False, True])
def test_a_call_has_variables_of_its_own(forked: bool) -> None:
    code = "import os; print(os.environ['THREADS_OF_A_CALL'])"
    calls = [Call(number, "builtins:exec", (code,), {"THREADS_OF_A_CALL": number}) for number in "12"]
    ended = run_commands(calls, 1, forked=forked)
    assert [one.output for one in ended] == [("1",), ("2",)]
    assert "THREADS_OF_A_CALL" not in os.environ


def test_where_none_can_be_forked_a_new_one_does(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(call: Call, output: str) -> None:
        raise OSError("AF_UNIX path too long")

    monkeypatch.setattr(processes, "_Forked", refused)
    assert _run("print('here')", forked=True)[0].output == ("here",)


@pytest.mark.parametrize("forked", [False, True])
def test_a_call_that_does_not_end_is_stopped(forked: bool, tmp_path: Path) -> None:
    slow = "import os, pathlib, time; pathlib.Path({!r}).write_text(str(os.getpid())); time.sleep(600)"
    one, other = (tmp_path / name for name in ("one", "other"))
    assert _run(slow.format(str(one)), time_limit=1.5, forked=forked)[0].reason == "no end within 1.5 s; stopped"
    running = run_commands([_python(slow.format(str(other))), _python("pass")], 2, forked=forked)
    next(running)
    while not (other.exists() and other.read_text()):
        time.sleep(0.01)
    running.close()
    for file in (one, other):
        with pytest.raises(ProcessLookupError):
            os.kill(int(file.read_text()), 0)


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs a signal that cannot be caught")
@pytest.mark.parametrize("forked", [False, True])
def test_a_call_ends_with_the_process_that_wants_its_result(forked: bool, tmp_path: Path) -> None:
    """Killed, that can stop nobody; a call that went on would write over what a later run has written."""
    number = tmp_path / "number"
    slow = f"import os, pathlib, time; pathlib.Path({str(number)!r}).write_text(str(os.getpid())); time.sleep(600)"
    code = f"from mien.processes import Call, run_commands; call = Call('slow', 'builtins:exec', ({slow!r},)); "
    caller = subprocess.Popen([sys.executable, "-c", f"{code}list(run_commands([call], 1, forked={forked}))"])
    while not (number.exists() and number.read_text()):
        assert caller.poll() is None
        time.sleep(0.01)
    caller.kill()
    caller.wait()
    until = time.monotonic() + 10
    while _runs(int(number.read_text())):
        assert time.monotonic() < until
        time.sleep(0.01)


def _runs(process: int) -> bool:
    """Whether there is such a process that has not ended; one without a parent may be left as a zombie."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    stat = Path(f"/proc/{process}/stat")
    return not (stat.exists() and stat.read_text().rpartition(")")[2].split()[0] == "Z")


@pytest.mark.parametrize("forked", [False, True])
def test_a_call_can_be_interrupted(forked: bool) -> None:
    (ended,) = _run(
        "import signal; print(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []))", forked=forked
    )
    assert ended.output == ("False",)


STARTING = """
import signal
from mien.processes import Call, run_commands
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored by what a shell runs in the background
try:
    list(run_commands([Call("slow", "slow_to_import:run", ())], 1, forked=True))
except KeyboardInterrupt:
    print("stopped")
"""
SLOW_TO_IMPORT = """
import pathlib, time
pathlib.Path({!r}).touch()
while not pathlib.Path({!r}).exists():
    time.sleep(0.01)
def run(): pass
"""


@pytest.mark.skipif(not can_fork(), reason="needs a server of forked processes")
def test_an_interruption_while_the_first_process_starts_is_no_traceback(tmp_path: Path) -> None:
    begun, told = tmp_path / "begun", tmp_path / "told"
    (tmp_path / "slow_to_import.py").write_text(SLOW_TO_IMPORT.format(str(begun), str(told)))
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    program = subprocess.Popen(
        [sys.executable, "-c", STARTING], env=environment, start_new_session=True, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    while not begun.exists():
        time.sleep(0.01)
    os.killpg(program.pid, signal.SIGINT)
    told.touch()
    assert program.communicate(timeout=60) == ("stopped\n", "")
