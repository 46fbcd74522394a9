"""Compiles the tracker when mien is installed, so that its first run starts as fast as every later one.

What Numba has compiled for this processor goes into the wheel, beside the source. With another processor, Python or
Numba, that is not taken, and the first run compiles (`mien/tracking/realtime/first_run.py`): as it does where nothing
could be compiled here.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from hashlib import sha256
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

_IMPORTED = ("numba", "numpy", "opencv", "pydantic", "scipy")
"""What the modules with kernels import."""
_PROGRAM = "from mien.tracking.realtime import first_run; first_run.compile_all()"
_ELSEWHERE = ("NUMBA_CACHE_DIR", "NUMBA_DISABLE_JIT")
"""With these nothing would be compiled into the package."""
_PATIENCE_S = 600


class CompiledKernels(BuildHookInterface[Any]):
    """Adds compiled kernels to a wheel; those of an editable installation are compiled where its source is."""

    def dependencies(self) -> list[str]:
        """What compiling needs, in the versions that mien takes."""
        return [d for d in self.metadata.core.dependencies if d.startswith(_IMPORTED)]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile before the wheel is made; without success, it is made of Python alone."""
        source = Path(self.root, "src")
        try:
            folder = source if version == "editable" else self._copy_of(source)
            _compile(folder)
        except (OSError, subprocess.SubprocessError) as error:
            self.app.display_warning(f"mien will be compiled on its first run, as it could not be here: {error}")
            return
        if version != "editable":
            compiled = [file for ending in ("nbi", "nbc") for file in folder.rglob(f"*.{ending}")]
            build_data["force_include"].update({str(file): file.relative_to(folder).as_posix() for file in compiled})
            build_data.update(pure_python=False, infer_tag=True)

    def _copy_of(self, source: Path) -> Path:
        """A copy of the source with nothing compiled but what was from the same source; earlier ones are removed."""
        digest = sha256()
        for file in sorted(source.rglob("*.py")):
            digest.update(file.read_bytes())
        copy = Path(self.root, "build", f"kernels-{digest.hexdigest()[:16]}")
        for earlier in set(copy.parent.glob("kernels-*")) - {copy}:
            shutil.rmtree(earlier)
        shutil.copytree(source, copy, ignore=shutil.ignore_patterns("__pycache__"), dirs_exist_ok=True)
        return copy


def _compile(folder: Path) -> None:
    """Compile all kernels of the mien in a folder, into it."""
    environment = {key: value for key, value in os.environ.items() if key not in _ELSEWHERE}
    environment["PYTHONPATH"] = os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])
    command = [sys.executable, "-c", _PROGRAM]
    subprocess.run(command, env=environment, check=True, timeout=_PATIENCE_S, stdout=sys.stderr)
