"""A shorter first run: two processes compile the kernels.

Compiled kernels are cached on disk. The first time, most of the wait is for `kernels.solve`, whose compilation needs
nothing of the video: a background process compiles it, while this one detects and learns the face and compiles the
rest. Where that fails, every kernel is compiled here when it is first called.
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
from mien.compiled import is_cached
from mien.processes import available_processors
from mien.tracking import (
    definite,
    eyes,
    kernels,
    level,
    motion,
    patch_history,
    person,
    pose_geometry,
    shape,
    uncertainty,
)

_PATIENCE_S = 120
_PROGRAM = "from mien.tracking import first_run; first_run.compile_in_background()"


def _array(dimensions: int, entry: Any = types.float64) -> Any:
    return types.Array(entry, dimensions, "C")


def _single(dimensions: int) -> Any:
    return _array(dimensions, types.float32)


_POSE = (_array(2), _array(1), _array(1))
_PERSON = types.Tuple((_array(2), _array(3)))
_VIEW = types.Tuple((_array(1), _array(2), _array(1), _array(2)))
_PRIOR = types.Tuple((*_POSE, _array(2), _array(1), _array(1)))
_APPEARANCE = types.Tuple((_single(3), _single(2), _single(3), _single(2), _single(1), _array(1), _array(2)))
_SAMPLING = types.Tuple((types.int64, *[types.float64] * 3))
_SEEN = _array(1, types.boolean)
_POINT = types.UniTuple(types.float64, 2)
_WORKSPACE = types.Tuple((_single(3), *(_array(k) for k in (4, 3, 2, 4, 2, 3, 2))))
_PATCHES = types.Tuple((_single(2), _array(1), _array(1)))
_TEMPLATE = types.Tuple((_single(2), _array(1), _single(3), _array(3), _array(3)))

Kernel = tuple[Any, tuple[Any, ...]]
"""A kernel, and the types of what tracking calls it with."""
POLYNOMIAL: Kernel = kernels.polynomial, (types.float64, types.float64, _array(1))
SOLVE: Kernel = (
    kernels.solve,
    (*_POSE, _single(3), _SAMPLING, _PERSON, _APPEARANCE, _array(1), _array(1), _PRIOR, _VIEW,
     types.int64, types.float64, _WORKSPACE),
)  # fmt: skip
_IN_BACKGROUND: tuple[Kernel, ...] = (
    (descriptors._describe, (_single(3), _array(2), _SAMPLING, _single(2), _single(3))),
    POLYNOMIAL,
    SOLVE,
    (shape.shape_information, tuple(_array(k) for k in (3, 3, 2, 1, 2, 1))),
    (definite._inverse, (_array(2),)),
    (level._nearest, (_array(1), types.float64)),
    (level._bilinear_lookup, (_single(3), _array(2), _array(1))),
)
"""What the other process compiles, first what the solver shares with the learning of the face."""
_IN_FOREGROUND: tuple[Kernel, ...] = (
    (crop._resample, (_array(2, types.uint8), _POINT, _POINT, _single(2))),
    (motion.extract_patches, (_single(2), _PERSON, _array(3), types.Tuple(_POSE), _VIEW)),
    (motion.align,
     (_single(2), _PERSON, _array(3), _TEMPLATE, _array(1), _PRIOR, _VIEW, types.float64, _array(1), types.int64,
      types.float64)),
    (eyes._gram_matrix, (_single(2), _single(3), _SEEN)),
    (eyes._closing_moments, (_array(2), types.float64)),
    (uncertainty._of_relief_and_axes, (*[_array(2)] * 2, *[_array(1)] * 2, types.float64)),
    (patch_history._agreement, (_PATCHES, _PATCHES, _array(1), _array(1))),
    (pose_geometry.in_camera, (_PERSON, *_POSE)),
    (kernels.misplacement_variance, (_array(2), _array(3), _array(1))),
    (kernels.squared_misplacement, (_array(3), _array(2), types.float64)),
    (kernels.student_information, (*[_array(1)] * 3, types.float64)),
    (pose_geometry.reported_landmarks, (_PERSON, _array(2), *_POSE, _array(2, types.int64), _POINT, _array(1))),
    (person._update_average, (_array(2), types.int64, _array(1), _SEEN, types.float64, types.float64)),
    (uncertainty._total_covariance, (types.float64, _array(2), types.float64, _array(2), _array(1))),
)  # fmt: skip
"""What this process compiles meanwhile, once it has learned the face; the remaining kernels compile quickly."""


def compile_in_background() -> None:
    """The work of the background process."""
    gc.disable()  # it would take a tenth of the time of a process that ends soon
    for kernel in _IN_BACKGROUND:
        _compile(kernel)


def load_cached() -> None:
    """Load the kernels that are cached on disk, if they are."""
    if is_cached(kernels.solve):
        for kernel in (*_IN_BACKGROUND, *_IN_FOREGROUND):
            _compile(kernel)


class BackgroundCompilation:
    """Compilation of what takes longest in another process, which begins with this object, unless the kernels are
    cached or there is one processor only. That process ends with this object, or with this process."""

    def __init__(self) -> None:
        self.helper = None if is_cached(kernels.solve) or available_processors() < 2 else _start()
        if self.helper is not None:
            weakref.finalize(self, _stop, self.helper)  # also at the end of the interpreter

    def finish(self) -> None:
        """Compile the other kernels that a frame needs here, and wait for the background process."""
        if self.helper is None:
            return
        for kernel in _IN_FOREGROUND:
            _compile(kernel)
        with suppress(subprocess.TimeoutExpired):
            self.helper.wait(_PATIENCE_S)
        _stop(self.helper)
        self.helper = None


def _compile(kernel: Kernel) -> None:
    """Compile a kernel for the types that tracking calls it with, or load it from disk."""
    function, arguments = kernel
    function.compile(arguments)


def _stop(helper: subprocess.Popen[bytes]) -> None:
    if helper.poll() is None:
        helper.kill()
        helper.wait()


def _start() -> subprocess.Popen[bytes] | None:
    """A background Python that finds its modules where this one does; None where none can be started."""
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
