"""Settings: frozen, validated, saved beside every result. The paper's values are `PaperSettings()`."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class Settings(BaseModel):
    """A frozen set of settings; an unknown or impossible value is refused with its name."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class DescriptorSettings(Settings):
    """Where and how descriptors are read: in a crop in which the face has a fixed size.

    pixels_per_unit: size of a CANDIDE unit in the crop, in pixels; cell: side of one of SIFT's 4x4 cells in
    pixels of the crop; blur: standard deviation in pixels of a Gaussian applied first.
    """

    kernel: Literal["mien", "opencv"] = "mien"
    pixels_per_unit: float = Field(64.0, gt=0)
    cell: int = Field(6, ge=1)
    blur: float = Field(1.0, ge=0)


class PaperSettings(Settings):
    """The method of the paper as printed; where it gives no value, the measured default of docs/method.md."""

    preset: Literal["paper"] = "paper"
    descriptor: DescriptorSettings = DescriptorSettings()
    view_step_deg: float = Field(10.0, gt=0)
    view_limit_deg: float = Field(30.0, gt=0)
    eigenvalue_floor: float = Field(1e-3, gt=0, description="least eigenvalue of a descriptor's covariance")
    forgetting: float = Field(0.02, ge=0, lt=1, description="alpha of Eq. (7) and (8)")
    innovation: Literal["sum", "mean"] = Field(
        "sum", description="Eq. (8): the squared norm as printed (sum), or divided by 128 (mean)"
    )
    prior_rotation_deg: float = Field(4.0, gt=0, description="Psi of Eq. (4): degrees a frame")
    prior_translation: float = Field(0.15, gt=0, description="Psi: CANDIDE units a frame, across the view")
    prior_depth: float = Field(0.3, gt=0, description="Psi: CANDIDE units a frame, along the view")
    prior_animation: float = Field(0.15, gt=0, description="Psi: animation units a frame")
    simplex_spread: float = Field(0.5, gt=0, description="initial simplex, in standard deviations of the prior")
    simplex_evaluations: int = Field(500, ge=13)
    seed: int = 0
