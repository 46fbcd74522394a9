"""A shorter first run: kernels are compiled at installation, or else by two processes.

Compiled kernels are cached on disk. Where an installation could not compile them, most of the wait is for
`kernels.solve`, whose compilation needs nothing of the video: a background process begins with it, while this one
detects and learns the face. Then they share what is left. Where that fails, every kernel is compiled here when it is
first called.
"""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import weakref
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numba import typeof
from numpy.typing import NDArray

from mien.appearance import crop, descriptors, face_camera, rendering, surface
from mien.compiled import is_cached
from mien.tracking.realtime import (
    adaptation,
    covers,
    definite,
    eyes,
    kernels,
    level,
    look_covariance,
    misplacement,
    motion,
    order,
    patch_history,
    person,
    pose_geometry,
    prior,
    shape,
    skin,
    skin_search,
    solution,
    uncertainty,
    veiled,
)
from mien.tracking.realtime.kernels import AppearanceArrays, PriorArrays
from mien.tracking.realtime.motion import Template
from mien.tracking.realtime.posterior import PosePosterior

_PATIENCE_S = 120
_PROGRAM = "from mien.tracking.realtime import first_run; first_run.compile_in_background()"


def _array(dimensions: int, entry: type = np.float64) -> NDArray[Any]:
    """An example of an argument: kernels are compiled for the type of its entries and the number of its dimensions."""
    return np.zeros((1,) * dimensions, entry)


def _single(dimensions: int) -> NDArray[Any]:
    return _array(dimensions, np.float32)


_POSE = _array(2), _array(1), _array(1)
_PERSON = _array(2), _array(3)
_VIEW = _array(2), _array(2)
_STRETCH = _array(2), _array(2)
_SKIN = _array(2), _array(1), 0, 0, 0.0
_PRIOR = PriorArrays(_POSE, _array(2), _array(1), _array(1))
_APPEARANCE = AppearanceArrays(
    coefficients=_single(3), offset=_single(2), U=_single(3), gain=_single(2), learned=1, inverse_floor=_single(1),
    trust=_single(1), limit=_array(1), variance=_array(2),
)  # fmt: skip
_SAMPLING = (1, 0.0, 0.0, 0.0)
_PROBLEM = PosePosterior(
    _single(3), _SAMPLING, _PERSON, _APPEARANCE, _array(1), _array(1), _PRIOR, _VIEW, _STRETCH
).plain
_TEMPLATE = Template(_single(2), _array(1), _single(3), _array(3), _array(3))
_PATCHES = (_single(2), _array(1), _array(1))
_SEEN = _array(1, np.bool_)
_CLOSING = (0.0, 0.0)

Kernel = tuple[Any, tuple[Any, ...]]
"""A kernel, and examples of what tracking calls it with."""
POLYNOMIAL: Kernel = kernels.polynomial, (0.0, 0.0, _array(1))
SOLVE: Kernel = kernels.solve, (_POSE, _PROBLEM, 1, 0.0, kernels.workspace(1))
_KERNELS: tuple[Kernel, ...] = (
    (descriptors.describe_into, (_single(3), _array(2), _SAMPLING, _single(2), _single(3), _STRETCH)),
    POLYNOMIAL,
    (pose_geometry.sight_of, (_array(1), _array(2), _array(1))),
    SOLVE,
    (motion.align,
     (_single(2), _PERSON, _array(3), tuple(_TEMPLATE), _array(1), tuple(_PRIOR), _VIEW, 0.0, 0.0, 1, 0.0)),
    (shape.shape_information, (*(_array(k) for k in (3, 3, 2, 1, 2)), (_array(1), _array(1)))),
    (shape._add, tuple(_array(k) for k in (2, 2, 2, 1, 1))),
    (level._trust, (_single(3), (_array(1), _array(1)), _array(1), 0.0)),
    (definite.inverse, (_array(2),)),
    (motion._of_measured_step, (_array(2), 0.0, _array(2), _array(2), _array(1), 0.0, _array(1))),
    (uncertainty._total_covariance, (0.0, _array(2), 0.0, 0.0, _array(2), _array(1))),
    (uncertainty.focal_covariance, (_array(1), _array(1), 0.0)),
    (uncertainty._of_model, (_array(2), _array(1), _array(2), _array(1), _array(1), 0.0, 0.0)),
    (level._nearest, (_array(1), 0.0)),
    (look_covariance._learn,
     (_single(3), (_single(3), _single(2), _single(1)), _single(2), _SEEN, 0.0, 0.0, _array(1), 0.0, 0.0, 1)),
    (person._learn_distances, (_array(1), _array(1), _SEEN, _array(1), 0.0, (0.0, 0.0))),
    (misplacement.learn_misplacement, (_array(2), _array(1), _array(3), _array(2), _SEEN, _array(1), 0.0)),
    (person._spread, (_array(2), _array(1), _array(1), _SEEN)),
    (prior.student_information, (*[_array(1)] * 3, 0.0, 0.0)),
    (misplacement.misplacement_variance, (_array(2), 0.0, _array(3), _array(1), _array(1), 0.0)),
    (adaptation._offset, (_array(1), 0.0, _single(2), _single(2))),
    (adaptation._share, (_array(1), 0.0, _single(2))),
    (adaptation._neighbours, (_array(1), 0.0)),
    (adaptation._mean_of, (_single(1), _SEEN)),
    (order.median, (_array(1),)),
    (solution._judge, (_array(1), _array(1), 0.0, _SEEN, _array(1), 0.0, 1)),
    (covers._updated, ((_SEEN, _SEEN), _array(1), _SEEN, _array(1), (_SEEN, _SEEN, _array(2, np.bool_)), 1)),
    (uncertainty.visibility, (_array(1), _SEEN, _array(1), _SEEN)),
    (face_camera._homographies, (_array(1), _array(2), 0.0, 0.0, 0.0, 1)),
    (crop._bounds, (_array(2), 1, 1, 1)),
    (crop.is_blank, (_single(2),)),
    (patch_history._follow, (_array(1), _array(1))),
    (pose_geometry.in_camera, (_PERSON, _POSE)),
    (pose_geometry.project, (_PERSON, _POSE, _VIEW)),
    (pose_geometry.step_back, (_POSE, _array(1))),
    (pose_geometry.step_between, (*_POSE, *_POSE)),
    (pose_geometry.reported_landmarks, (_PERSON, _array(2), _POSE, _array(2, np.int64), _CLOSING, _array(1))),
    (patch_history._agreement, (_PATCHES, _PATCHES, _array(1), _array(1))),
    (eyes._closing_moments, (_array(2), 0.0)),
    (eyes._gram_matrix, (_single(2), _single(3), _SEEN)),
    (veiled._veiled, (_single(2), _PERSON, _POSE, _VIEW, (_SEEN, _array(1), 0.0), 0.0, 0.0, 0.0)),
    (skin._look, (_single(2), _PERSON, _SKIN, _POSE, 0.0, _VIEW, _single(1))),
    (skin._likeness, (_single(2), _PERSON, _SKIN, _POSE, _array(1), _VIEW, _single(1))),
    (skin._sliding_likeness, (_single(2), _PERSON, (_SKIN, _SKIN), _POSE, _VIEW, _single(3), (1, 1))),
    (skin_search._variance_along, (_array(2), _array(2), _array(2))),
    (skin_search._add_skin,
     ((*[_array(1)] * 3, 0.0, 0.0, 0.0, 0.0), _array(1), 0.0, _array(1), _array(2), _array(1))),
    (definite.solve_positive, (_array(2), _array(1))),
    (motion.center, (_single(1),)),
    (motion.extract_patches, (_single(2), _PERSON, _array(3), _POSE, _VIEW)),
    (crop._resample, (_array(2, np.uint8), _array(2), (0, 0), 1, _single(2))),
)  # fmt: skip
"""What a frame needs. The other process compiles from the beginning: what the solver shares with the learning of the
face, the solver, and what shares kernels with that. This one, once it has learned the face, compiles from the end, and
they meet in the middle, at kernels that compile quickly, as both may compile the same one there."""
_LEARNING: tuple[Kernel, ...] = (
    (surface._nearest, (_array(2), _array(2, np.int64), _array(1), _array(2))),
    (rendering._rasterize,
     (_array(2), _array(1), _array(2, np.int64), _single(3), _array(2), _array(1), _single(3), _single(3), _single(2))),
    (descriptors._orientation_maps, (_single(2), 0.0, _single(1), _single(2), _single(1), _single(2))),
    (pose_geometry.facing_camera, (*[_array(2)] * 3, _array(1), 1, 1, 0.0)),
)  # fmt: skip
"""What learning a face needs beside those."""


def compile_all() -> None:
    """Compile all kernels that are not on disk, as when mien is installed."""
    background = BackgroundCompilation()
    _compile_missing(_LEARNING)
    background.finish()
    _compile_missing(_KERNELS)


def compile_in_background() -> None:
    """The work of the background process."""
    _compile_missing(_KERNELS)


def _compile_missing(ordered: Iterable[Kernel]) -> None:
    """Compile kernels that are not on disk, without collecting garbage, which would take a tenth of the time."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        for kernel in ordered:
            if not is_cached(kernel[0]):
                _compile(kernel)
    finally:
        if collecting:
            gc.enable()


def load_cached() -> None:
    """Load the kernels that are cached on disk and not loaded yet. They take 3 ms each; loaded where they are first
    called, some would hold up a video that is tracked as it comes."""
    for kernel in _KERNELS:
        if getattr(kernel[0], "signatures", None) == [] and is_cached(kernel[0]):  # none with NUMBA_DISABLE_JIT
            _compile(kernel)


class BackgroundCompilation:
    """Compilation of what takes longest in another process, which begins with this object, unless the kernels are
    cached. That process ends with this object, or with this process. Also where there is one processor only: what a
    process has compiled itself differs, by rounding, from what it would load."""

    def __init__(self) -> None:
        self.helper = None if is_cached(kernels.solve) else _start()
        if self.helper is not None:
            weakref.finalize(self, _stop, self.helper)  # also at the end of the interpreter

    def finish(self) -> None:
        """Compile what the background process has not come to, and wait for it."""
        if self.helper is None:
            return
        _compile_missing(reversed(_KERNELS[_KERNELS.index(SOLVE) + 1 :]))
        with suppress(subprocess.TimeoutExpired):
            self.helper.wait(_PATIENCE_S)
        _stop(self.helper)
        self.helper = None


def _compile(kernel: Kernel) -> None:
    """Compile a kernel for the types that tracking calls it with, or load it from disk."""
    function, examples = kernel
    function.compile(_signature(examples))


def _signature(examples: tuple[Any, ...]) -> tuple[Any, ...]:
    return tuple(typeof(example) for example in examples)


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
