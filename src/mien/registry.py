"""Every tracker by name: the presets, the trackers of Table 1, the peers. Loaded when asked for."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType

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
    }
)


def create_tracker(name: str) -> Tracker:
    """A new tracker with its default settings. Raises MienError with the known names for an unknown one."""
    require(name in TRACKERS, f"unknown tracker {name!r}; the trackers are {', '.join(TRACKERS)}")
    module, cls = TRACKERS[name].split(":")
    tracker: Tracker = getattr(import_module(module), cls)()
    return tracker
