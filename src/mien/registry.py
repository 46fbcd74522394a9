"""All trackers by name: the presets, the trackers of Table 1, and other software. Imported on demand."""

from __future__ import annotations

import math
import reprlib
import sys
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from importlib import import_module
from importlib.util import find_spec
from inspect import signature
from numbers import Real
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import TYPE_CHECKING

import numpy as np

from mien.candide.model import TRACKED_UNITS
from mien.errors import MienError, require
from mien.files import user_path
from mien.frame import Frame
from mien.geometry.rotation import is_rotation
from mien.tracking.state import STATE_NAMES, Closing, Estimate, Status, TrackedLandmarks, Tracker

if TYPE_CHECKING:
    from mien.config import Settings

TRACKERS: Mapping[str, str] = MappingProxyType(
    {
        "realtime": "mien.tracking.realtime:RealtimeTracker",
        "paper": "mien.tracking.paper:PaperTracker",
        "mediapipe": "mien.baselines.mediapipe:MediaPipeTracker",
        "la-cascia-2000": "mien.baselines.la_cascia:LaCasciaTracker",
        "xiao-2003": "mien.baselines.xiao:XiaoTracker",
        "chen-2006": "mien.baselines.chen:ChenTracker",
        "morency-2008": "mien.baselines.morency:MorencyTracker",
        "lefevre-2009": "mien.baselines.lefevre:LefevreTracker",
        "saragih-2011": "mien.baselines.saragih:SaragihTracker",
        "tran-2013": "mien.baselines.tran2013:Tran2013Tracker",
        "openface": "mien.baselines.openface:OpenFaceTracker",
    }
)
DEFAULT_PRESET = "realtime"

SETTINGS: Mapping[str, str] = MappingProxyType({"realtime": "RealtimeSettings", "paper": "PaperSettings"})
"""The class in `mien.config` for the settings of each tracker that accepts a settings file."""

_SHAPES: Mapping[str, tuple[int, ...]] = MappingProxyType(
    {"translation": (3,), "animation": (len(TRACKED_UNITS),), "covariance": (len(STATE_NAMES),) * 2}
)
"""The shapes of what an `Estimate` may have."""


def create_tracker(name: str) -> Tracker:
    """Create a tracker: NAME with default settings, `realtime:FILE` or `paper:FILE` with the settings of a JSON file,
    `openface:FILE`, or your own MODULE:CLASS.

    Raises MienError for an unknown name, listing the known ones, and for invalid settings.
    """
    require(isinstance(name, str), f"a tracker is given by its name, not by {name!r}")
    known, colon, file = name.partition(":")
    require(not colon or bool(file), f"{name} names no file after the colon; give one, or {known} alone")
    module, _, cls = TRACKERS.get(known, name).partition(":")
    with _no_exit(name):
        found = _module(module) if cls and module and not module.startswith(".") else None
    require(found is not None, unknown_tracker(name))
    tracker = getattr(found, cls, None)
    require(callable(tracker), f"{name}: the module {module} has no class {cls}")
    assert tracker is not None
    argument = argument_of(name)
    arguments = () if argument is None else (argument,)
    try:
        with suppress(ValueError):  # some classes tell nothing of their arguments
            signature(tracker).bind(*arguments)
    except TypeError as error:
        raise MienError(f"{name} cannot be created ({error}); it must need no arguments") from error
    with _no_exit(name):
        made: Tracker = tracker(*arguments)
    missing = [method for method in ("initialize", "track") if not callable(getattr(made, method, None))]
    require(not missing, f"{name} has no method {' and no '.join(missing)}; see mien.Tracker")
    return made


def unknown_tracker(name: str) -> str:
    """What an error says of an unknown tracker: the names that there are."""
    with_settings = " or ".join(f"{known}:FILE" for known in SETTINGS)
    return (
        f"unknown tracker {name!r}; the trackers are {', '.join(TRACKERS)}, {with_settings} with the settings of a "
        "file, or MODULE:CLASS of your own"
    )


def checked(returned: object, tracker: Tracker, frame: Frame) -> Estimate:
    """What a tracker returned for a frame. Raises MienError if it is not the Estimate of that frame; your own tracker
    may be wrong."""
    cls = type(tracker)
    if isinstance(returned, Estimate) and returned.index == frame.index:
        wrong = None if cls.__module__.startswith("mien.") else _fault(returned)
        require(wrong is None, f"{_name_of(cls)} returned for frame {frame.index} {wrong}; see mien.Estimate")
        return returned
    what = f"the estimate of frame {returned.index}" if isinstance(returned, Estimate) else type(returned).__name__
    raise MienError(
        f"{_name_of(cls)} returned {what} for frame {frame.index}; its initialize and track must "
        "return a mien.Estimate with the frame's index, or Estimate.lost(frame, reason) if there is no face"
    )


def called(tracker: Tracker) -> AbstractContextManager[None]:
    """A context in which a tracker is called. Raises MienError if that ends the process, as `sys.exit` would."""
    return _no_exit(_name_of(type(tracker)))


@contextmanager
def _no_exit(name: str) -> Iterator[None]:
    try:
        yield
    except SystemExit as error:
        raise MienError(
            f"{name} called sys.exit({error.code!r}); a tracker must not end the process, but raise an error"
        ) from error


def _name_of(cls: type) -> str:
    return f"{cls.__module__}:{cls.__qualname__}"


def _fault(estimate: Estimate) -> str | None:
    """What of an estimate is not as `Estimate` says; None if all is."""
    if not isinstance(estimate.status, Status):
        return f"the status {estimate.status!r}, which is no mien.Status"
    if not (isinstance(estimate.confidence, Real) and 0 <= estimate.confidence <= 1):
        return f"the confidence {estimate.confidence!r}, which is not between 0 and 1"
    if not (isinstance(estimate.time, Real) and math.isfinite(estimate.time)):
        return f"the time {estimate.time!r}, which is not that of the frame"
    if not (isinstance(estimate.mm_per_unit, Real) and 0 < estimate.mm_per_unit < math.inf):
        return f"{estimate.mm_per_unit!r} millimetres per unit, which is no positive number"
    if not isinstance(estimate.reason, str):
        return f"the reason {estimate.reason!r}, which is no text"
    if not all(R is None or is_rotation(R) for R in (estimate.rotation, estimate.model_rotation)):
        return "something that is not a rotation matrix (3, 3)"
    if estimate.rotation is not None and estimate.status is Status.LOST:
        return "a rotation that belongs to a lost frame"
    for name, shape in _SHAPES.items():
        values = getattr(estimate, name)
        if values is not None and not (_is_array(values, shape) and np.isfinite(values).all()):
            return f"no array {shape} of finite numbers as {name}, but {_found(values, shape)}"
    if estimate.covariance is not None and np.diag(estimate.covariance).min() < 0:
        return f"a covariance with the negative variance {np.diag(estimate.covariance).min():g}"
    if not (estimate.closing is None or _is_closing(estimate.closing)):
        return f"the closing {reprlib.repr(estimate.closing)}, which is no mien.Closing of finite numbers"
    return None if estimate.landmarks is None else _fault_of_landmarks(estimate.landmarks)


def _fault_of_landmarks(landmarks: object) -> str | None:
    """What of landmarks is not as `TrackedLandmarks` says; None if all is."""
    if not isinstance(landmarks, TrackedLandmarks):
        return f"the landmarks {reprlib.repr(landmarks)}, which are no mien.TrackedLandmarks"
    n = len(landmarks.names)
    if not all(isinstance(name, str) for name in landmarks.names):
        return f"landmarks with the names {reprlib.repr(tuple(landmarks.names))}, which are not all text"
    for name, shape in (("image", (n, 2)), ("camera", (n, 3)), ("visibility", (n,))):
        values = getattr(landmarks, name)
        if not _is_array(values, shape) and (values is not None or name == "image"):
            return f"{n} landmarks whose {name} is no array {shape}, but {_found(values, shape)}"
    return None


def _is_closing(value: object) -> bool:
    """Whether this is how far the eyes have closed."""
    return isinstance(value, Closing) and all(isinstance(v, Real) and math.isfinite(v) for v in (value.share, value.sd))


def _is_array(values: object, shape: tuple[int, ...]) -> bool:
    """Whether this is an array of this shape, of numbers."""
    return isinstance(values, np.ndarray) and values.shape == shape and values.dtype.kind in "iuf"


def _found(values: object, shape: tuple[int, ...]) -> str:
    """What is there instead of an array of this shape."""
    if isinstance(values, np.ndarray) and values.shape != shape:
        return f"one {values.shape}"
    return reprlib.repr(values)


def file_of(name: str) -> Path | None:
    """The file or folder in the name of a tracker, NAME:FILE; None if there is none."""
    known, _, argument = name.partition(":")
    return user_path(argument) if argument and known in TRACKERS else None


def code_of(name: str) -> Path | None:
    """The source file of your own tracker, MODULE:CLASS; None for the trackers of mien."""
    module, _, cls = name.partition(":")
    if module in TRACKERS or not cls:
        return None
    try:
        with _here():
            found = find_spec(module)
    except (ImportError, ValueError):
        return None
    return Path(found.origin) if found and found.origin and Path(found.origin).is_file() else None


def argument_of(name: str) -> Settings | str | None:
    """The argument of a tracker named NAME:FILE: the settings in the file, or its path; None without a file."""
    file = file_of(name)
    if file is None:
        return None
    known = name.partition(":")[0]
    require(known in SETTINGS or known == "openface", f"{known} reads no file; give its name alone")
    if known not in SETTINGS:
        return str(file)
    config = import_module("mien.config")
    settings: Settings = config.read_settings(file, getattr(config, SETTINGS[known]))
    return settings


@contextmanager
def _here() -> Iterator[None]:
    """Let Python import modules from the current folder, as with `python -c`."""
    sys.path.insert(0, "")
    try:
        yield
    finally:
        sys.path.remove("")


def _module(module: str) -> ModuleType | None:
    """Import the module of a tracker; None if it does not exist and is not part of mien."""
    try:
        with _here():
            return import_module(module)
    except ModuleNotFoundError as error:
        if f"{module}.".startswith(f"{error.name}.") and not module.startswith("mien."):
            return None
        raise
