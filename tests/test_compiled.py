"""Kernels where nothing can be cached, and those of other packages."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest


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


NO_SPACE = """
import errno
from numba.core.caching import IndexDataCacheFile

def full(*_):
    raise OSError(errno.ENOSPC, "No space left on device")

IndexDataCacheFile.save = full
"""
NO_FOLDER = """
import tempfile

def read_only(*_, **__):
    raise PermissionError("read-only file system")

tempfile.TemporaryFile = read_only  # with which Numba tries a folder
"""


@pytest.mark.parametrize("failing", [NO_SPACE, NO_FOLDER + NO_SPACE], ids=["full disk", "read-only"])
def test_where_nothing_can_be_written_kernels_are_compiled_all_the_same(failing: str, tmp_path: Path) -> None:
    code = f"""
{failing}
from mien.compiled import kernel

@kernel()
def added(x):
    return x + 1

print(added(1))
"""
    done = _run(code, tmp_path)
    assert done.stdout.strip() == "2", done.stderr
    assert "set NUMBA_CACHE_DIR" in done.stderr


def test_the_process_that_is_forked_warns_as_the_command_line_does() -> None:
    code = f"""
{NO_FOLDER}
import numba
from mien import compiled

def without_cache(*_):
    compiled._warn_without_cache()
    exit()

numba.core.dispatcher.Dispatcher.compile = without_cache
import mien.worker
"""
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stderr.startswith("mien: compiled code cannot be written"), done.stderr
    assert "MienWarning" not in done.stderr
