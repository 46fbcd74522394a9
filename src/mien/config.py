"""Settings: frozen, validated, and saved with every result. The paper's values are `PaperSettings()`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, ValidationInfo, field_validator, model_validator

from mien.errors import MienError, require


class Settings(BaseModel):
    """A frozen set of settings; unknown names and invalid values are rejected by name."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _complete(cls, values: Any) -> Any:
        """Complete settings within these, of which only some are given, by those that are the default here."""
        if not isinstance(values, dict):
            return values
        own = {name: field.default for name, field in cls.model_fields.items() if isinstance(field.default, Settings)}
        given = {name: values[name] for name in own if isinstance(values.get(name), dict)}
        return values | {name: own[name].model_dump() | given[name] for name in given}


class DescriptorSettings(Settings):
    """How descriptors are computed, in a crop in which the face has a fixed size.

    pixels_per_unit: size of a CANDIDE unit in the crop, in pixels; cell: side of one of SIFT's 4x4 cells, in
    pixels of the crop; blur: standard deviation, in pixels, of a Gaussian applied first; root: 0 clips the entries as
    Lowe does, a positive value is added to them before their square root is taken (kernel `mien` only).
    """

    kernel: Literal["mien", "opencv"] = "mien"
    pixels_per_unit: float = Field(64.0, ge=8, le=1024)
    cell: int = Field(6, ge=1, le=256)
    blur: float = Field(1.0, ge=0)
    root: float = Field(0.0, ge=0)

    @property
    def reach(self) -> int:
        """How far the cells extend to each side of a point, in pixels of the crop."""
        return 2 * self.cell


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


class RealtimeSettings(Settings):
    """The tracker for practical use: gradient-based optimisation, pose-dependent appearance, learned shape, visibility.

    A relative distance or residual is divided by its expected value.
    """

    preset: Literal["realtime"] = "realtime"
    descriptor: DescriptorSettings = DescriptorSettings(pixels_per_unit=64.0, cell=4, blur=0.8, root=0.01)
    coarse: DescriptorSettings = DescriptorSettings(pixels_per_unit=32.0, cell=5, blur=0.8, root=0.01)
    view_limit_tilt_deg: float = Field(40.0, gt=0, lt=90, description="largest tilt of the rendered views")
    view_limit_pan_deg: float = Field(50.0, gt=0, lt=90, description="largest pan of the rendered views")
    view_crowding: float = Field(1.4, gt=0, description="spacing exponent: 1 is even, more is denser near frontal")
    turned_limit_pan_deg: float = Field(
        75.0, gt=0, lt=90, validate_default=True, description="largest pan of the views for faces beyond it"
    )
    views_per_angle: int = Field(10, ge=4, le=50, description="number of rendered tilts, and of rendered pans")
    light_contrast: float = Field(0.45, ge=0, description="side light in the rendered views: logarithm of its gain")
    eye_share: float = Field(0.2, ge=0, description="weight of moved eyes in the covariance, relative to all views")
    closing_share: float = Field(0.25, gt=0, description="eye closure above which the eye landmarks are ignored")
    rank: int = Field(20, ge=0, description="rank of the covariance above its floor")
    floor: float = Field(1e-3, gt=0, description="variance of a descriptor entry in every direction")
    iterations: int = Field(12, ge=1, description="maximum number of evaluations of the energy in one solve")
    tolerance: float = Field(0.7, gt=0, description="energy decrease below which the solver stops")
    crop_roll_deg: float = Field(
        4.0, gt=0, description="in-plane rotation of the crop from the face above which it is resampled"
    )
    crop_scale: float = Field(0.05, gt=0, description="relative difference in scale above which the crop is resampled")
    crop_shift: float = Field(
        0.07, gt=0, description="offset from the face, CANDIDE units, above which the crop is resampled"
    )
    robust_factor: float = Field(0.75, gt=0, description="relative distance at which a landmark's weight is a quarter")
    jaw_tolerance: float = Field(
        1.75, gt=0, description="`robust_factor` multiplier for lower lip and chin, which the jaw changes"
    )
    nose_tolerance: float = Field(1.4, gt=0, description="`robust_factor` multiplier for the nose, which is rigid")
    expected_distance: float = Field(25.0, gt=0, description="initial expected squared distance of a landmark")
    expectation_rate: float = Field(
        0.02, ge=0, lt=1, description="per-frame rate of the expected distance's moving average"
    )
    least_distance: float = Field(6.0, gt=0, description="lower bound of the expected distance")
    quality_rate: float = Field(
        0.02, ge=0, description="growth of the expected distance per frame, by how much worse a face looks than usual"
    )
    quality_turn_deg: float = Field(
        8.0, ge=0, description="turn from the first frame below which expected distances may grow"
    )
    retry_distance: float = Field(2.5, gt=0, description="relative distance above which a coarse search starts")
    retry_share: float = Field(
        0.8, ge=0, le=1, description="fraction of matching landmarks above which no coarse search is needed"
    )
    seen_distance: float = Field(
        100.0, gt=0, description="largest squared distance of a landmark that matches the face"
    )
    least_share: float = Field(
        0.25, ge=0, le=1, description="fraction of matching landmarks below which the face is lost"
    )
    recovered_share: float = Field(
        0.6, ge=0, le=1, description="fraction of matching landmarks that a proposed pose needs"
    )
    recovery_interval: int = Field(5, ge=1, description="frames between searches while the face is lost")
    recovery_patience: int = Field(30, ge=0, description="lost frames after which only one search in three is thorough")
    doubt_interval: int = Field(15, ge=1, description="frames between searches while the face is in doubt")
    jaw_retry_distance: float = Field(
        4.0, gt=0, description="relative distance of lower lip and chin above which other jaw positions are tried"
    )
    mouth_retry_distance: float = Field(
        1.0, gt=0, description="relative distance of the mouth above which it is tried at rest"
    )
    mouth_retry_share: float = Field(
        0.6,
        ge=0,
        description="fraction of its relative distance below which a mouth tried at rest stays there; 0: never",
    )
    mouth_retry_interval: int = Field(5, ge=2, description="frames between trials of the mouth at rest")
    mouth_retry_moved: float = Field(0.1, gt=0, description="animation above which the mouth is tried at rest")
    velocity: float = Field(0.5, ge=0, le=1, description="fraction of the last motion that is extrapolated")
    prior_rotation_deg: float = Field(10.0, gt=0, description="standard deviation of the change per frame: degrees")
    prior_translation: float = Field(
        0.3, gt=0, description="standard deviation of the change per frame: CANDIDE units across the view"
    )
    prior_depth: float = Field(
        0.07, gt=0, description="standard deviation of the change per frame: CANDIDE units along the view"
    )
    prior_animation: float = Field(
        0.06, gt=0, description="standard deviation of the change per frame: animation units except jaw_drop"
    )
    prior_jaw: float = Field(
        0.6,
        gt=0,
        description="standard deviation of the change per frame: jaw_drop, as a mouth opens within a few frames",
    )
    motion_grid: int = Field(
        7, ge=2, le=50, description="sampling points along each side of a patch whose motion is measured"
    )
    motion_patch: float = Field(
        0.2, gt=0, description="half the side of a patch whose motion is measured, CANDIDE units"
    )
    motion_corner: float = Field(
        0.08, gt=0, description="half the side of the patches at the mouth corners, close to skin that does not move"
    )
    motion_iterations: int = Field(8, ge=1, description="maximum number of iterations of the alignment")
    motion_tolerance: float = Field(3.0, gt=0, description="energy decrease below which the alignment stops")
    motion_robust_factor: float = Field(
        1.2, gt=0, description="relative residual at which the weight of a patch is a quarter"
    )
    motion_mouth_share: float = Field(
        0.4,
        gt=0,
        description="residual of a mouth's patch, as a fraction of its contrast, at which its weight is a quarter",
    )
    motion_noise: float = Field(
        100.0, gt=0, description="variance of the motion, relative to that of independent pixels"
    )
    motion_rotation_deg: float = Field(
        0.32, ge=0, description="systematic error of the measured motion, standard deviation per frame: degrees"
    )
    motion_translation: float = Field(0.0085, ge=0, description="systematic error of measured motion: CANDIDE units")
    motion_animation: float = Field(0.015, ge=0, description="systematic error of measured motion: animation units")
    motion_share: float = Field(0.35, ge=0, description="systematic error of measured motion, as a fraction of it")
    hold_share: float = Field(
        0.6, ge=0, le=1, description="fraction of matching landmarks below which the prediction is mixed in"
    )
    hold_rotation_deg: float = Field(4.0, gt=0, description="standard deviation of head motion per frame: degrees")
    hold_translation: float = Field(0.1, gt=0, description="standard deviation of head motion: CANDIDE units")
    hold_animation: float = Field(0.2, gt=0, description="standard deviation of facial motion: animation units")
    rest_animation: float = Field(
        0.7, gt=0, description="standard deviation of the brows' units about the first frame's"
    )
    rest_mouth: float = Field(4.0, gt=0, description="standard deviation of the mouth's units about the first frame's")
    rest_firmness: float = Field(
        22.0, ge=0, description="relative increase, at rest, of the inverse variance of the brows' units"
    )
    rest_mouth_firmness: float = Field(
        480.0, ge=0, description="relative increase, at rest, of the inverse variance of the mouth's units"
    )
    rest_jaw_firmness: float = Field(
        360.0, ge=0, description="relative increase, at rest, of the inverse variance of jaw_drop, which moves readily"
    )
    rest_within: float = Field(0.035, gt=0, description="animation at which half of the increase at rest remains")
    rest_turn_deg: float = Field(
        10.0, gt=0, description="rotation of the head at which variances about rest are halved"
    )
    hidden_cosine: float = Field(-0.1, description="cosine between normal and ray below which a landmark is hidden")
    hidden_depth: float = Field(
        0.2, gt=0, description="depth behind the face's own surface above which a landmark is hidden"
    )
    covered_share: float = Field(
        0.3, gt=0, description="share of graphics in a landmark's surroundings above which it is hidden"
    )
    sidelong_weight: float = Field(0.03, gt=0, le=1, description="weight of a view that sees a landmark edge-on")
    lack_of_fit: float = Field(50.0, gt=0, description="squared distance from the mean that halves a landmark's metric")
    learn_shape: bool = Field(True, description="whether the shape is learned while tracking")
    relief_sd: float = Field(0.12, ge=0, description="relative standard deviation of the whole face's depth")
    depth_sd: float = Field(0.08, gt=0, description="standard deviation of a landmark's depth, CANDIDE units")
    depth_length: float = Field(0.5, gt=0, description="correlation length of the depth errors, CANDIDE units")
    slope_sd: float = Field(0.1, ge=0, description="depth error from the slope of the surface, per unit of its tangent")
    lean_sd: float = Field(0.1, ge=0, description="slope of a depth error that grows from chin to forehead")
    eyes_sd: float = Field(0.13, ge=0, description="common depth error of eyes and brows: eye sockets, glasses")
    lateral_sd: float = Field(
        0.005, gt=0, description="standard deviation of a landmark across the first frame's ray, CANDIDE units"
    )
    axes_tilt_share: float = Field(
        0.2, ge=0, le=10, description="fraction of the shape's lean that the axes follow, in tilt"
    )
    axes_pan_share: float = Field(
        0.45, ge=0, le=10, description="fraction of the shape's lean that the axes follow, in pan"
    )
    location_sd: float = Field(0.05, gt=0, description="smallest systematic error of a landmark, pixels of the crop")
    temple_sd: float = Field(
        2.0,
        gt=0,
        description="smallest systematic error of a temple, pixels of the crop, as light and hair change there",
    )
    location_rate: float = Field(
        0.02, ge=0, lt=1, description="per-frame rate of the moving average of a landmark's systematic error"
    )
    unit_error: float = Field(0.1, ge=0, description="error of an animation unit, as a fraction of its effect")
    appearance_angle_sd_deg: float = Field(27.0, gt=0, description="systematic error of a patch's apparent angles")
    shape_rate: float = Field(0.8, ge=0, description="fraction of a frame's information that is independent")
    least_novelty: float = Field(0.05, ge=0, description="novelty below which a frame no longer updates the shape")
    expression_sd: float = Field(0.16, gt=0, description="animation that halves a frame's weight in learning shape")
    shape_bin_deg: float = Field(4.0, gt=0, description="size of a pose bin, within which errors repeat")
    forgetting: float = Field(0.1, ge=0, lt=1, description="alpha of Eq. (7), for eyes of unexpected appearance")
    strange_distance: float = Field(
        4.0, ge=0, description="relative distance above which the appearance of eyes is unexpected"
    )
    spectacles_distance: float = Field(
        2.5, ge=0, description="relative distance above which the appearance of eyes behind glasses is unexpected"
    )
    spectacles_rate: float = Field(
        0.15, ge=0, lt=1, description="per-frame rate of the glasses detector's moving average"
    )
    adaptation_turn_deg: float = Field(5.0, gt=0, description="rotation at which half of `forgetting` applies")
    view_rate: float = Field(0.3, ge=0, lt=1, description="alpha of Eq. (7), for a rotated face")
    view_strange_distance: float = Field(
        2.5, ge=0, description="relative distance above which a rotated face's appearance is learned"
    )
    view_turn_deg: float = Field(
        12.0,
        gt=0,
        description="rotation from the first frame from which on the appearance of a face is learned",
    )

    @field_validator("turned_limit_pan_deg")
    @classmethod
    def _is_further(cls, limit: float, info: ValidationInfo) -> float:
        if limit <= info.data.get("view_limit_pan_deg", 0.0):
            raise ValueError("must be larger than view_limit_pan_deg")
        return limit

    @field_validator("descriptor", "coarse")
    @classmethod
    def _has_derivatives(cls, descriptor: DescriptorSettings) -> DescriptorSettings:
        if descriptor.kernel != "mien":
            raise ValueError("the kernel must be mien, the only one with derivatives")
        return descriptor


SomeSettings = TypeVar("SomeSettings", bound=Settings)


def read_settings(path: Path, kind: type[SomeSettings]) -> SomeSettings:
    """Read settings of one kind from a JSON file: either the values that differ from the defaults, keyed by name, or
    the NAME.json of a track.

    Raises MienError naming the file if it cannot be read, or has an unknown setting or an invalid value.
    """
    try:
        values = json.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise MienError(f"{path} cannot be read ({error.strerror}); give a JSON file with settings") from error
    except ValueError as error:
        raise MienError(
            f"{path} is not valid JSON ({error}); give a file like the NAME.json that mien writes"
        ) from error
    require(isinstance(values, dict), f'{path} holds no settings keyed by name; give JSON like {{"view_rate": 0}}')
    try:
        return kind.model_validate(values.get("settings", values))
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(map(str, first["loc"]))
        wrong = "unknown setting" if first["type"] == "extra_forbidden" else first["msg"].lower()
        raise MienError(f"{path}: {name}: {wrong}; mien.config.{kind.__name__} lists them all") from error
