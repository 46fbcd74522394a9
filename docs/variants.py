"""Trackers of Table 1 with a part switched off or changed, for the experiments of `docs/baselines.md`.

`PYTHONPATH=docs mien evaluate rendered PATH --trackers variants:XiaoWithoutReregistration -o DIR`
"""

from __future__ import annotations

from dataclasses import replace

from mien.baselines.la_cascia import LaCasciaTracker, warping_templates
from mien.baselines.morency import MorencyTracker
from mien.baselines.surface import Pose, look
from mien.baselines.xiao import XiaoTracker
from mien.video import Frame


class LaCasciaWithoutIllumination(LaCasciaTracker):
    """Warping templates alone."""

    def __init__(self) -> None:
        super().__init__(use_illumination=False)


class LaCasciaRenewedTemplates(LaCasciaTracker):
    """Warping templates of every frame, at the pose of the frame before, instead of those of the first frame."""

    def _registered(self, frame: Frame, start: Pose) -> Pose | None:
        view = look(frame, start, self.head.camera)
        if view is not None:
            warping = warping_templates(self.head.surface, view, start)
            self.levels = [replace(u, warping=B) for u, B in zip(self.levels, warping, strict=True)]
        return super()._registered(frame, start)


class XiaoWithoutReregistration(XiaoTracker):
    """The dynamic template alone."""

    def __init__(self) -> None:
        super().__init__(reregister=False)


class FrameToFrame(MorencyTracker):
    """GAVAM without keyframes and without the first frame: every frame against the one before."""

    def __init__(self) -> None:
        super().__init__(keyframes=False)
