"""Every tracker by name: the presets, the trackers of Table 1, the peers. Loaded when asked for."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import TYPE_CHECKING

from mien.errors import MienError, require
from mien.frame import Frame
from mien.tracking.state import Estimate, Tracker

if TYPE_CHECKING:
    from mien.config import Settings

TRACKERS: Mapping[str, str] = MappingProxyType(
    {
        "realtime": "mien.tracking.realtime:RealtimeTracker",
        "paper": "mien.tracking.tracker:PaperTracker",
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


SETTINGS: Mapping[str, str] = MappingProxyType({"realtime": "RealtimeSettings", "paper": "PaperSettings"})
"""The settings in `mien.config` of the trackers that take a file of them."""


def create_tracker(name: str) -> Tracker:
    """A new tracker: NAME with its default settings, `realtime:FILE` or `paper:FILE` with those of a JSON file,
    `openface:FILE`, or MODULE:CLASS of your own.

    Raises MienError with the known names for an unknown one, and for settings that are not right.
    """
    require(isinstance(name, str), f"a tracker is given by its name, not by {name!r}")
    known = name.partition(":")[0]
    module, _, cls = TRACKERS.get(known, name).partition(":")
    found = _module(module) if cls else None
    require(
        found is not None,
        f"unknown tracker {name!r}; the trackers are {', '.join(TRACKERS)}, or MODULE:CLASS of your own",
    )
    tracker = getattr(found, cls, None)
    require(callable(tracker), f"{name}: the module {module} has no class {cls}")
    assert tracker is not None
    argument = argument_of(name)
    made: Tracker = tracker() if argument is None else tracker(argument)
    missing = [method for method in ("initialize", "track") if not callable(getattr(made, method, None))]
    require(not missing, f"{name} has no method {' and no '.join(missing)}; see mien.Tracker")
    return made


def checked(returned: object, tracker: Tracker, frame: Frame) -> Estimate:
    """What a tracker has returned for a frame. Raises MienError where it is no estimate, as one of your own may do."""
    if not isinstance(returned, Estimate):
        cls = type(tracker)
        raise MienError(
            f"{cls.__module__}:{cls.__qualname__} returned {type(returned).__name__} for frame {frame.index}; its "
            "initialize and track must return a mien.Estimate, where there is no face Estimate.lost(frame, reason)"
        )
    return returned


def file_of(name: str) -> Path | None:
    """The file, or folder, that a tracker is to read, of its name; None where there is none."""
    known, _, argument = name.partition(":")
    return Path(argument) if argument and known in TRACKERS else None


def code_of(name: str) -> Path | None:
    """The file of a tracker of your own, MODULE:CLASS; None for those of mien."""
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
    """What a tracker takes for its file: the settings in it, or its name; None where there is none."""
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
    """Python finds the modules of the folder in which it runs, as with `python -c`."""
    sys.path.insert(0, "")
    try:
        yield
    finally:
        sys.path.remove("")


def _module(module: str) -> ModuleType | None:
    """The module of a tracker; None if it is not one of mien's and does not exist."""
    try:
        with _here():
            return import_module(module)
    except ModuleNotFoundError as error:
        if f"{module}.".startswith(f"{error.name}.") and not module.startswith("mien."):
            return None
        raise
