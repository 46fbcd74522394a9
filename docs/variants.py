"""Trackers with a part switched off or changed, for the experiments of `docs/baselines.md` and `docs/method.md`.

`PYTHONPATH=docs mien evaluate rendered PATH/rendered --trackers variants:XiaoWithoutReregistration -o DIR`
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from mien.baselines.la_cascia import LaCasciaTracker, warping_templates
from mien.baselines.morency import MorencyTracker
from mien.baselines.surface import Pose
from mien.baselines.view import View
from mien.baselines.xiao import XiaoTracker
from mien.config import PaperSettings
from mien.tracking.paper import PaperTracker


class LaCasciaWithoutIllumination(LaCasciaTracker):
    """Warping templates alone."""

    def __init__(self) -> None:
        super().__init__(use_illumination=False)


class LaCasciaRenewedTemplates(LaCasciaTracker):
    """Warping templates of every frame, at the pose of the frame before, instead of those of the first frame."""

    def _matched(self, view: View, start: Pose) -> Pose | None:
        warping = warping_templates(self.head.surface, view, start)
        self.levels = [replace(u, warping=B) for u, B in zip(self.levels, warping, strict=True)]
        return super()._matched(view, start)


class XiaoWithoutReregistration(XiaoTracker):
    """The dynamic template alone."""

    def __init__(self) -> None:
        super().__init__(reregister=False)


class FrameToFrame(MorencyTracker):
    """GAVAM without keyframes and without the first frame: every frame against the one before."""

    def __init__(self) -> None:
        super().__init__(keyframes=False)


def _paper(**settings: Any) -> Callable[[], PaperTracker]:
    """The preset `paper` with these settings instead of those that the tables of `docs/method.md` start from."""
    base = {"innovation": "mean", "forgetting": 0.02, "eigenvalue_floor": 1e-3, "simplex_evaluations": 500}
    return partial(PaperTracker, PaperSettings.model_validate({**base, "descriptor": {"cell": 6}, **settings}))


PaperPrinted = _paper(innovation="sum")
PaperSlow = _paper(innovation="sum", forgetting=0.002)
PaperPerDimension = _paper()
PaperPerDimensionFast = _paper(forgetting=0.1)
PaperFloor = _paper(eigenvalue_floor=3e-3)
PaperCell5 = _paper(descriptor={"cell": 5})
PaperCell8 = _paper(descriptor={"cell": 8})
PaperEvaluations = _paper(simplex_evaluations=800)
