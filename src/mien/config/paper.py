"""Settings of the paper's tracker."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mien.config.settings import DescriptorSettings, Settings


class PaperSettings(Settings):
    """The method of the paper as printed; values that it does not give are the measured defaults of docs/method.md."""

    preset: Literal["paper"] = "paper"
    descriptor: DescriptorSettings = DescriptorSettings(cell=5)
    view_step_deg: float = Field(10.0, gt=0, description="angle between neighbouring rendered views, degrees")
    view_limit_deg: float = Field(30.0, gt=0, description="largest tilt, pan and roll of the rendered views")
    eigenvalue_floor: float = Field(1e-3, gt=0, description="smallest eigenvalue of a descriptor's covariance")
    forgetting: float = Field(0.002, ge=0, lt=1, description="alpha of Eq. (7) and (8)")
    innovation: Literal["sum", "mean"] = Field(
        "sum", description="Eq. (8): the squared norm as printed (sum), or divided by 128 (mean)"
    )
    prior_rotation_deg: float = Field(4.0, gt=0, description="Psi of Eq. (4): degrees per frame")
    prior_translation: float = Field(0.15, gt=0, description="Psi: CANDIDE units per frame, across the view")
    prior_depth: float = Field(0.3, gt=0, description="Psi: CANDIDE units per frame, along the view")
    prior_animation: float = Field(0.15, gt=0, description="Psi: animation units per frame")
    simplex_spread: float = Field(0.5, gt=0, description="initial simplex, in standard deviations of the prior")
    simplex_evaluations: int = Field(500, ge=13, description="maximum number of evaluations of the energy")
    seed: int = Field(0, description="random seed of the initial simplex")
