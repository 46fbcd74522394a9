"""The first run made shorter: what tracking compiles is compiled by two processes.

Kernels are kept on disk once they are compiled. The first time most of the waiting is for `kernels.solve`, and nothing
has to be known of the video to compile it: a process of its own does so, while this one finds and learns the face and
compiles the rest. Where that fails, everything is compiled here when it is called, as without it.
"""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import weakref
from contextlib import suppress
from pathlib import Path
from typing import Any

from numba import types

from mien.appearance import crop, descriptors
from mien.tracking import definite, eyes, kernels, learning, motion, patch_history, person, shape, uncertainty

_SOURCE = Path(kernels.__file__)
_PATIENCE_S = 120
_PROGRAM = "from mien.tracking import first_run; first_run.compile_beside()"


def _array(dimensions: int, entry: Any = types.float64) -> Any:
    return types.Array(entry, dimensions, "C")


def _single(dimensions: int) -> Any:
    return _array(dimensions, types.float32)


_POSE = (_array(2), _array(1), _array(1))
_PERSON = types.Tuple((_array(2), _array(3)))
_VIEW = types.Tuple((_array(1), _array(2), _array(1), _array(2)))
_PRIOR = types.Tuple((*_POSE, _array(2), _array(1), _array(1)))
_APPEARANCE = types.Tuple((_single(3), _single(2), _single(3), _single(2), _single(1), _array(1), _array(2)))
_READING = types.Tuple((types.int64, *[types.float64] * 3))
_SEEN = _array(1, types.boolean)
_POINT = types.UniTuple(types.float64, 2)
_ROOM = types.Tuple((_single(3), *(_array(k) for k in (4, 3, 2, 4, 2, 3, 2))))
_PATCHES = types.Tuple((_single(2), _array(1), _array(1)))
_TEMPLATE = types.Tuple((_single(2), _array(1), _single(3), _array(3), _array(3)))

Kernel = tuple[Any, tuple[Any, ...]]
DESCRIBE: Kernel = descriptors._describe, (_single(3), _array(2), _READING, _single(2), _single(3))
POLYNOMIAL: Kernel = kernels.polynomial, (types.float64, types.float64, _array(1))
SOLVE: Kernel = (
    kernels.solve,
    (*_POSE, _single(3), _READING, _PERSON, _APPEARANCE, _array(1), _array(1), _PRIOR, _VIEW,
     types.int64, types.float64, _ROOM),
)  # fmt: skip
RESAMPLE: Kernel = crop._resample, (_array(2, types.uint8), _POINT, _POINT, _single(2))
PRODUCTS: Kernel = eyes._products, (_single(2), _single(3), _SEEN)
PLACE: Kernel = eyes._place, (_array(2), types.float64)
TAKE_PATCHES: Kernel = motion.take_patches, (_single(2), _PERSON, _array(3), types.Tuple(_POSE), _VIEW)
ALIGN: Kernel = (
    motion.align,
    (_single(2), _PERSON, _array(3), _TEMPLATE, _array(1), _PRIOR, _VIEW, types.float64, types.int64, types.float64),
)
POSED: Kernel = kernels.posed, (_PERSON, *_POSE)
MISPLACED: Kernel = kernels.misplaced, (_array(2), _array(3), _array(1))
MISPLACEMENT: Kernel = kernels.misplacement, (_array(3), _array(2), types.float64)
FIRM: Kernel = kernels.firm, (*[_array(1)] * 3, types.float64)
SHAPE: Kernel = shape.shape_information, tuple(_array(k) for k in (3, 3, 2, 1, 2, 1))
AGREEMENT: Kernel = patch_history._agreement, (_PATCHES, _PATCHES, _array(1), _array(1))
NEAREST: Kernel = learning._nearest, (_array(1), types.float64)
BETWEEN: Kernel = learning._between, (_single(3), _array(2), _array(1))
INVERSE: Kernel = definite._inverse, (_array(2),)
TOLD: Kernel = kernels.told, (_PERSON, _array(2), *_POSE, _array(2, types.int64), _POINT, _array(1))
FOLLOW: Kernel = person._follow, (_array(2), types.int64, _array(1), _SEEN, types.float64, types.float64)
ADDED: Kernel = uncertainty._added, (types.float64, _array(2), types.float64, _array(2))
OF_TURN: Kernel = uncertainty._of_turn_and_axes, (*[_array(2)] * 2, *[_array(1)] * 2, types.float64)
"""Kernels, and the types of what tracking calls them with."""

_BESIDE = DESCRIBE, POLYNOMIAL, SOLVE, SHAPE, INVERSE, NEAREST, BETWEEN
"""What the other process compiles: first of what the solver calls that with which the face is learned meanwhile."""
_HERE = (
    RESAMPLE, TAKE_PATCHES, ALIGN, PRODUCTS, PLACE, OF_TURN, AGREEMENT, POSED, MISPLACED, MISPLACEMENT, FIRM,
    TOLD, FOLLOW, ADDED,
)  # fmt: skip
"""What this process compiles meanwhile, once it has learned the face; the remaining kernels compile quickly."""


def compile_beside() -> None:
    """What the other process does."""
    gc.disable()  # a tenth of its time, for a process that ends soon
    for kernel in _BESIDE:
        _compile(kernel)
    with suppress(OSError):  # of a file that was written anew as it was, Numba keeps what it has
        for index in _indices() or ():
            index.touch()


def read_kept() -> None:
    """Read from disk what was compiled before; nothing where there is nothing."""
    if _is_kept():
        for kernel in (*_BESIDE, *_HERE):
            _compile(kernel)


class CompiledBeside:
    """What takes longest, compiled in another process from now on, unless it is on disk already or there is but one
    processor. That process ends with this object, or with this process."""

    def __init__(self) -> None:
        self.helper = None if _is_kept() or _processors() < 2 else _start()
        if self.helper is not None:
            weakref.finalize(self, _stop, self.helper)  # also at the end of the interpreter

    def finish(self) -> None:
        """Compile here what else a frame needs, and wait for the other process."""
        if self.helper is None:
            return
        for kernel in _HERE:
            _compile(kernel)
        with suppress(subprocess.TimeoutExpired):
            self.helper.wait(_PATIENCE_S)
        _stop(self.helper)
        self.helper = None


def _compile(kernel: Kernel) -> None:
    """Compile a kernel for what tracking calls it with, or read it from disk."""
    function, arguments = kernel
    function.compile(arguments)


def _is_kept() -> bool:
    """Whether `kernels.solve` was compiled before, later than its file was written; True where nothing is kept."""
    kept = _indices()
    return kept is None or any(index.stat().st_mtime > _SOURCE.stat().st_mtime for index in kept)


def _indices() -> list[Path] | None:
    """What Numba has written of `kernels.solve`, of this version of it or others; None where nothing is kept."""
    solve, _ = SOLVE
    folder = solve.stats.cache_path
    return None if folder is None else list(Path(folder).glob(f"{_SOURCE.stem}.{solve.__name__}-*.nbi"))


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _stop(helper: subprocess.Popen[bytes]) -> None:
    if helper.poll() is None:
        helper.kill()
        helper.wait()


def _start() -> subprocess.Popen[bytes] | None:
    """A Python that compiles and finds its modules where this one does; None where there is none."""
    if not sys.executable or getattr(sys, "frozen", False):
        return None
    path = os.pathsep.join(str(Path(p).resolve()) for p in sys.path)
    with suppress(OSError):
        return subprocess.Popen(
            [sys.executable, "-c", _PROGRAM],
            env=os.environ | {"PYTHONPATH": path, "PYTHONSAFEPATH": "1"},
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
    return None
