"""The first run: what is compiled beside it is what tracking then calls, and what goes wrong there harms nothing."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import mien
from mien.tracking.realtime import RealtimeTracker, first_run

FIRST_RUN = """
from mien.compiled import is_cached
from mien.tracking.realtime import first_run, kernels
from mien.tracking.realtime import RealtimeTracker
from small_motion import run, small_motion

assert not is_cached(kernels.solve)
tracker = RealtimeTracker()
estimates = run(tracker, small_motion())
assert all(e.status.success for e in estimates)
last = estimates[-1]
tracker.landmark_depths(last.model_rotation, last.translation, last.animation, 0.0)
assert is_cached(kernels.solve)
for kernel, examples in first_run._LEARNING + first_run._KERNELS:
    assert kernel.signatures == [first_run._signature(examples)], kernel
print(kernels.solve.stats.cache_misses.total(), "compiled here")
"""


def test_the_solver_comes_from_the_other_process(tmp_path: Path) -> None:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-c", FIRST_RUN], env=environment, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "0 compiled here"


IN_TIME = """
import numpy as np
from long_motion import sequence
from mien.frame import Frame
from mien.tracking.realtime import first_run
from small_motion import begun

first_run.compile_all()
first, *later = sequence().frames
tracker = begun(first)
before = {kernel: list(kernel.signatures) for kernel, _ in first_run._LEARNING + first_run._KERNELS}
for frame in later:
    assert tracker.track(frame).status.success
blank = Frame(np.zeros_like(first.pixels), len(later) + 1)
assert not tracker.track(blank).status.success
assert tracker.track(later[-1]).status.success
assert before[first_run.kernels.solve]
print([kernel.__name__ for kernel, known in before.items() if kernel.signatures != known])
"""


def test_no_kernel_is_loaded_while_a_face_is_tracked() -> None:
    """It would hold up a video that is tracked as it comes."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", IN_TIME]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[]"


KNOWN = """
from mien.compiled import is_cached
from mien.tracking.realtime.first_run import POLYNOMIAL, _compile

kernel, _ = POLYNOMIAL
print(is_cached(kernel))
_compile(POLYNOMIAL)
print(is_cached(kernel))
"""


def _known(**environment: str) -> list[str]:
    """Whether a kernel is known, before and after it is compiled."""
    command = [sys.executable, "-c", KNOWN]
    done = subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.mark.parametrize("name", ["tracking/realtime/pose_geometry.py", "initialization/landmarks.py"])
def test_a_kernel_is_compiled_anew_when_what_it_calls_has_changed(name: str, tmp_path: Path) -> None:
    """Or what its constants come from. As by an upgrade; not because a file was written again as it was."""
    package = tmp_path / "mien"
    shutil.copytree(Path(mien.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    environment = {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}
    called = package / name
    assert _known(**environment) == ["False", "True"]
    called.write_text(called.read_text(encoding="utf-8"), encoding="utf-8")
    assert _known(**environment) == ["True", "True"]
    called.write_text(called.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    assert _known(**environment) == ["False", "True"]


def test_a_kernel_is_compiled_anew_for_another_processor(tmp_path: Path) -> None:
    """As where machines share a folder, or a wheel was made elsewhere."""
    here = {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path)}
    elsewhere = here | {"NUMBA_CPU_NAME": "generic"}
    assert _known(**elsewhere) == ["False", "True"]
    assert _known(**here) == ["False", "True"]
    assert _known(**elsewhere) == _known(**here) == ["True", "True"]


@pytest.fixture
def first_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(first_run, "is_cached", lambda kernel: False)


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
from mien.tracking.realtime import first_run, kernels

first_run._PROGRAM = "import time; time.sleep(60)"
first_run.is_cached = lambda kernel: False
compiled = first_run.BackgroundCompilation()
print(compiled.helper.pid)
raise KeyboardInterrupt
"""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=False)
    assert "KeyboardInterrupt" in done.stderr
    with pytest.raises(ProcessLookupError):
        os.kill(int(done.stdout), 0)
