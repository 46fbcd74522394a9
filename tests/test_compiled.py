"""Kernels where nothing can be cached, and those of other packages."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import pytest

from mien import compiled
from mien.errors import MienWarning


def test_without_a_folder_that_can_be_written_kernels_are_compiled_all_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    njit = numba.njit

    def without_cache(*functions: Any, **options: Any) -> Any:
        if options.get("cache"):
            raise RuntimeError("cannot cache function: no locator available")
        return njit(*functions, **options)  # without options Numba decorates its own

    monkeypatch.setattr(numba, "njit", without_cache)
    compiled._warn_without_cache.cache_clear()
    with pytest.warns(MienWarning, match="set NUMBA_CACHE_DIR"):

        @compiled.kernel()
        def double(x: float) -> float:
            return 2 * x

    assert double(4.0) == 8.0


def _run(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """A module of one's own that is run in a folder, with the kernels that were cached there."""
    (folder / "own.py").write_text(code)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder / "cache")}
    command = [sys.executable, "own.py"]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False, cwd=folder)


def test_a_kernel_outside_mien_is_compiled_anew_when_it_has_changed(tmp_path: Path) -> None:
    """One of a benchmark, or of a tracker of one's own."""
    text = "from mien.compiled import kernel\n\n@kernel()\ndef added(x):\n    return x + 1\n\nprint(added(1))\n"
    for code, printed in ((text, "2"), (text, "2"), (text.replace("+ 1", "+ 5"), "6")):
        done = _run(code, tmp_path)
        assert done.stdout.strip() == printed, done.stderr


def test_where_the_disk_is_full_kernels_are_compiled_all_the_same(tmp_path: Path) -> None:
    code = """
import errno
from numba.core.caching import IndexDataCacheFile
from mien.compiled import kernel

def full(*_):
    raise OSError(errno.ENOSPC, "No space left on device")

IndexDataCacheFile.save = full

@kernel()
def added(x):
    return x + 1

print(added(1))
"""
    done = _run(code, tmp_path)
    assert done.stdout.strip() == "2", done.stderr
    assert "set NUMBA_CACHE_DIR" in done.stderr


def test_the_process_that_is_forked_warns_as_the_command_line_does() -> None:
    code = """
import numba

njit = numba.njit

def without_cache(**options):
    if options["cache"]:
        raise RuntimeError("cannot cache function: no locator available")
    return njit(**options)

numba.njit = without_cache
numba.core.dispatcher.Dispatcher.compile = lambda *_: exit()
import mien.worker
"""
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stderr.startswith("mien: compiled code cannot be written"), done.stderr
    assert "MienWarning" not in done.stderr
