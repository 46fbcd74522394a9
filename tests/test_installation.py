"""What an installation does: kernels are compiled into the wheel, and where they cannot be, it is made without."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest

CHECKOUT = Path(__file__).parents[1]
READ_ONLY = """
import os
import tempfile

def refused(*_, dir=None, open_=tempfile.TemporaryFile, **__):  # with which Numba tries a folder
    if dir.startswith(os.environ["READ_ONLY"]):
        raise PermissionError("read-only file system")
    return open_(dir=dir)

tempfile.TemporaryFile = refused
"""
FIRST_RUN = """
import sys

import mien
from mien.tracking.realtime import RealtimeTracker
from small_motion import run, small_motion

run(RealtimeTracker(), small_motion())
modules = [module for name, module in sys.modules.items() if name.startswith("mien")]
kernels = {id(k): k for module in modules for k in vars(module).values() if hasattr(k, "stats")}.values()
print(mien.__file__)
print(sum(k.stats.cache_hits.total() for k in kernels) > 30, [k.__name__ for k in kernels if k.stats.cache_misses])
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A copy of what a wheel is made of."""
    copy = tmp_path / "checkout"
    shutil.copytree(CHECKOUT / "src", copy / "src", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "hatch_build.py", "README.md", "LICENSE", "NOTICE"):
        shutil.copy(CHECKOUT / name, copy)
    return copy


def _wheel(checkout: Path) -> tuple[Path, str]:
    """The wheel that is made, and what the build says."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel"]
    done = subprocess.run(command, cwd=checkout, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    (wheel,) = (checkout / "dist").iterdir()
    return wheel, done.stdout + done.stderr


def test_nothing_is_compiled_on_the_first_run(checkout: Path, tmp_path: Path) -> None:
    wheel, _ = _wheel(checkout)
    assert not wheel.name.endswith("none-any.whl")
    ZipFile(wheel).extractall(tmp_path / "site")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path / "site"), *sys.path])}
    environment |= {"XDG_CACHE_HOME": str(tmp_path / "home" / "cache")}
    environment.pop("NUMBA_CACHE_DIR", None)
    for read_only in ("nothing", "site", ""):  # that of nobody, of somebody who has a home, and of a container
        done = subprocess.run(
            [sys.executable, "-c", READ_ONLY + FIRST_RUN],
            env=environment | {"READ_ONLY": str(tmp_path / read_only)},
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert done.stdout.splitlines() == [str(tmp_path / "site" / "mien" / "__init__.py"), "True []"]
        assert "NUMBA_CACHE_DIR" not in done.stderr


def test_where_nothing_can_be_compiled_the_wheel_is_of_python_alone(checkout: Path) -> None:
    with (checkout / "src" / "mien" / "tracking" / "realtime" / "first_run.py").open("a", encoding="utf-8") as file:
        file.write("\nraise OSError('no compiler')\n")
    wheel, said = _wheel(checkout)
    assert wheel.name.endswith("none-any.whl")
    assert not [name for name in ZipFile(wheel).namelist() if name.endswith((".nbi", ".nbc"))]
    assert "compiled on its first run" in said
