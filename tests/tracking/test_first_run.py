"""The first run: what is compiled beside it is what tracking then calls, and what goes wrong there harms nothing."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from mien.tracking import first_run
from mien.tracking.realtime import RealtimeTracker

FIRST_RUN = """
from mien.tracking import first_run, kernels
from mien.tracking.realtime import RealtimeTracker
from small_motion import run, small_motion

assert not first_run._is_cached()
estimates = run(RealtimeTracker(), small_motion())
assert all(e.status.success for e in estimates)
assert first_run._is_cached()
for kernel, arguments in (*first_run._IN_BACKGROUND, *first_run._IN_FOREGROUND):
    assert kernel.signatures == [arguments], kernel
print(kernels.solve.stats.cache_misses.total(), "compiled here")
"""


@pytest.mark.skipif(first_run.available_processors() < 2, reason="one processor compiles everything itself")
def test_the_solver_comes_from_the_other_process(tmp_path: Path) -> None:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-c", FIRST_RUN], env=environment, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "0 compiled here"


def test_a_file_that_was_written_anew_as_it_was_is_asked_about_once(tmp_path: Path) -> None:
    """As by an installation of the same version: Numba goes by what is in it."""
    script = """
import os
from mien.tracking import first_run, kernels

first_run._compile(first_run.POLYNOMIAL)
first_run._IN_BACKGROUND = (first_run.POLYNOMIAL,)
first_run.SOLVE = first_run.POLYNOMIAL
later = os.stat(kernels.__file__).st_mtime
for index in first_run._indices():
    os.utime(index, (later - 1, later - 1))
print(first_run._is_cached())
first_run.compile_in_background()
print(first_run._is_cached())
"""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["False", "True"], done.stderr


@pytest.fixture
def first_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(first_run, "_is_cached", lambda: False)
    monkeypatch.setattr(first_run, "available_processors", lambda: 2)


@pytest.mark.usefixtures("first_time")
@pytest.mark.parametrize("executable", ["", "/nowhere/python"])
def test_without_another_python_nothing_is_lost(executable: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", executable)
    compiled = first_run.BackgroundCompilation()
    assert compiled.helper is None
    compiled.finish()


@pytest.mark.usefixtures("first_time")
def test_the_other_process_ends_with_its_tracker(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(first_run, "_PROGRAM", "import time; time.sleep(60)")
    tracker = RealtimeTracker()
    helper = tracker.compilation.helper
    assert helper is not None
    assert helper.poll() is None
    del tracker
    assert helper.poll() is not None


def test_the_other_process_ends_with_this_one() -> None:
    script = """
from mien.tracking import first_run, kernels

first_run._PROGRAM = "import time; time.sleep(60)"
first_run._is_cached = lambda: False
first_run.available_processors = lambda: 2
compiled = first_run.BackgroundCompilation()
print(compiled.helper.pid)
raise KeyboardInterrupt
"""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=False)
    assert "KeyboardInterrupt" in done.stderr
    with pytest.raises(ProcessLookupError):
        os.kill(int(done.stdout), 0)
