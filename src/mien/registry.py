"""Every tracker by name: the presets, the trackers of Table 1, the peers. Loaded when asked for."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType, ModuleType

from mien.errors import require
from mien.tracking.state import Tracker

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


def create_tracker(name: str) -> Tracker:
    """A new tracker with its default settings: NAME, NAME:ARGUMENT (`openface:FILE`), or MODULE:CLASS of your own.

    Raises MienError with the known names for an unknown one.
    """
    known, _, argument = name.partition(":")
    module, _, cls = TRACKERS.get(known, name).partition(":")
    tracker = getattr(_module(module, name), cls, None) if cls else None
    require(
        tracker is not None,
        f"unknown tracker {name!r}; the trackers are {', '.join(TRACKERS)}, or MODULE:CLASS of your own",
    )
    assert tracker is not None
    made: Tracker = tracker(argument) if argument and known in TRACKERS else tracker()
    return made


def _module(module: str, name: str) -> ModuleType | None:
    """The module of a tracker; None if it is not one of mien's and does not exist."""
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if f"{module}.".startswith(f"{error.name}.") and not module.startswith("mien."):
            return None
        raise
