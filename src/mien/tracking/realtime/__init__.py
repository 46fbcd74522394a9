"""The preset `realtime`: what goes beyond section 3.2 of the paper. `tracker` is the whole of it."""

from mien.tracking.realtime.tracker import RealtimeTracker

__all__ = ["RealtimeTracker"]
