"""Settings: frozen, validated, saved beside every result. The paper's values are `PaperSettings()`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from mien.errors import MienError, require


class Settings(BaseModel):
    """A frozen set of settings; an unknown or impossible value is refused with its name."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class DescriptorSettings(Settings):
    """Where and how descriptors are read: in a crop in which the face has a fixed size.

    pixels_per_unit: size of a CANDIDE unit in the crop, in pixels; cell: side of one of SIFT's 4x4 cells in
    pixels of the crop; blur: standard deviation in pixels of a Gaussian applied first; root: 0 clips the entries as
    Lowe does, more takes their square root after adding it (only the kernel `mien`).
    """

    kernel: Literal["mien", "opencv"] = "mien"
    pixels_per_unit: float = Field(64.0, gt=0)
    cell: int = Field(6, ge=1)
    blur: float = Field(1.0, ge=0)
    root: float = Field(0.0, ge=0)


class PaperSettings(Settings):
    """The method of the paper as printed; where it gives no value, the measured default of docs/method.md."""

    preset: Literal["paper"] = "paper"
    descriptor: DescriptorSettings = DescriptorSettings(cell=5)
    view_step_deg: float = Field(10.0, gt=0, description="degrees between the rendered views")
    view_limit_deg: float = Field(30.0, gt=0, description="largest tilt, pan and roll of the rendered views")
    eigenvalue_floor: float = Field(1e-3, gt=0, description="least eigenvalue of a descriptor's covariance")
    forgetting: float = Field(0.002, ge=0, lt=1, description="alpha of Eq. (7) and (8)")
    innovation: Literal["sum", "mean"] = Field(
        "sum", description="Eq. (8): the squared norm as printed (sum), or divided by 128 (mean)"
    )
    prior_rotation_deg: float = Field(4.0, gt=0, description="Psi of Eq. (4): degrees a frame")
    prior_translation: float = Field(0.15, gt=0, description="Psi: CANDIDE units a frame, across the view")
    prior_depth: float = Field(0.3, gt=0, description="Psi: CANDIDE units a frame, along the view")
    prior_animation: float = Field(0.15, gt=0, description="Psi: animation units a frame")
    simplex_spread: float = Field(0.5, gt=0, description="initial simplex, in standard deviations of the prior")
    simplex_evaluations: int = Field(500, ge=13, description="most evaluations of the energy")
    seed: int = Field(0, description="of the initial simplex")


class RealtimeSettings(Settings):
    """The tracker for use: gradient optimisation, appearance by pose, shape that is learned, visibility."""

    preset: Literal["realtime"] = "realtime"
    descriptor: DescriptorSettings = DescriptorSettings(pixels_per_unit=64.0, cell=4, blur=0.8, root=0.01)
    coarse: DescriptorSettings = DescriptorSettings(pixels_per_unit=32.0, cell=5, blur=0.8, root=0.01)
    view_limit_tilt_deg: float = Field(40.0, gt=0, description="largest tilt of the rendered views")
    view_limit_pan_deg: float = Field(50.0, gt=0, description="largest pan of the rendered views")
    view_crowding: float = Field(1.4, gt=0, description="exponent: 1 spaces them evenly, more crowds the middle")
    views_per_angle: int = Field(10, ge=4, description="rendered tilts, and as many pans")
    light_contrast: float = Field(0.45, ge=0, description="side light in the rendered views, logarithm of its gain")
    eye_share: float = Field(0.2, ge=0, description="weight of moved eyes in the covariance, all views' being 1")
    closing_share: float = Field(0.25, gt=0, description="how far eyes are closed at which they are not believed")
    rank: int = Field(20, ge=0, description="dimensions of the covariance beyond its floor")
    floor: float = Field(1e-3, gt=0, description="variance of a descriptor's entry in every direction")
    iterations: int = Field(12, ge=1, description="most evaluations of the energy in one solve")
    tolerance: float = Field(0.7, gt=0, description="gain in energy below which the solver stops")
    crop_roll_deg: float = Field(4.0, gt=0, description="roll of a crop from the face's that asks for another look")
    crop_scale: float = Field(
        0.05, gt=0, description="difference of a crop's size from the face's, as a share, that asks for another look"
    )
    crop_shift: float = Field(
        0.07, gt=0, description="distance of a crop from the face's place, CANDIDE units, that asks for another look"
    )
    robust_factor: float = Field(
        0.75, gt=0, description="distance over the expected one at which a weight is a quarter"
    )
    jaw_tolerance: float = Field(
        1.75, gt=0, description="factor of `robust_factor` for lower lip and chin, whose look the jaw changes"
    )
    nose_tolerance: float = Field(
        1.4, gt=0, description="factor of `robust_factor` for the nose, which no expression moves"
    )
    expected_distance: float = Field(25.0, gt=0, description="squared distance of a landmark, until measured")
    expectation_rate: float = Field(0.02, ge=0, lt=1, description="how fast the expected distance follows, by frame")
    least_distance: float = Field(6.0, gt=0, description="below which the expected distance does not sink")
    retry_distance: float = Field(2.5, gt=0, description="distance over the expected one that asks for a coarse search")
    retry_share: float = Field(0.8, ge=0, le=1, description="share of landmarks like the face's that needs no search")
    seen_distance: float = Field(100.0, gt=0, description="squared distance of a landmark that can still be the face's")
    least_share: float = Field(0.25, ge=0, le=1, description="share of such landmarks below which the face is lost")
    recovered_share: float = Field(
        0.6, ge=0, le=1, description="share of such landmarks that a proposed pose must have"
    )
    recovery_interval: int = Field(5, ge=1, description="frames between searches once the face is lost")
    recovery_patience: int = Field(30, ge=0, description="frames lost after which one in three searches is thorough")
    doubt_interval: int = Field(
        15, ge=1, description="frames between searches while what is tracked may be another face"
    )
    jaw_retry_distance: float = Field(
        4.0, gt=0, description="distance of lower lip and chin over the expected one that asks for another jaw"
    )
    velocity: float = Field(0.5, ge=0, le=1, description="share of the last motion that is predicted to go on")
    prior_rotation_deg: float = Field(10.0, gt=0, description="standard deviation of the change in a frame: degrees")
    prior_translation: float = Field(
        0.3, gt=0, description="standard deviation of the change in a frame: CANDIDE units across the view"
    )
    prior_depth: float = Field(
        0.07, gt=0, description="standard deviation of the change in a frame: CANDIDE units along the view"
    )
    prior_animation: float = Field(
        0.06, gt=0, description="standard deviation of the change in a frame: animation units but jaw_drop"
    )
    prior_jaw: float = Field(
        0.6, gt=0, description="standard deviation of the change in a frame: jaw_drop, as a mouth opens in few frames"
    )
    motion_grid: int = Field(7, ge=2, description="sampling points along each side of a patch whose motion is measured")
    motion_patch: float = Field(0.2, gt=0, description="half of the side of such a patch, CANDIDE units")
    motion_corner: float = Field(
        0.08, gt=0, description="half of the side of the patches at the corners of the mouth, beside which skin stays"
    )
    motion_iterations: int = Field(8, ge=1, description="most iterations of the alignment")
    motion_tolerance: float = Field(3.0, gt=0, description="gain in the pixels' energy below which the alignment stops")
    motion_robust_factor: float = Field(1.2, gt=0, description="residual over the usual one: weight a quarter")
    motion_noise: float = Field(100.0, gt=0, description="variance of the measured motion, over independent pixels'")
    motion_rotation_deg: float = Field(
        0.32, ge=0, description="systematic error of a measured motion, standard deviation by frame: degrees"
    )
    motion_translation: float = Field(0.0085, ge=0, description="systematic error of a measured motion: CANDIDE units")
    motion_animation: float = Field(0.015, ge=0, description="systematic error of a measured motion: animation units")
    motion_share: float = Field(0.35, ge=0, description="systematic error of a measured motion, as a share of it")
    hold_share: float = Field(0.6, ge=0, le=1, description="share of landmarks seen below which the last pose counts")
    hold_rotation_deg: float = Field(
        4.0, gt=0, description="how far a head moves in a frame, standard deviation: degrees"
    )
    hold_translation: float = Field(0.1, gt=0, description="how far a head moves in a frame: CANDIDE units")
    hold_animation: float = Field(0.2, gt=0, description="how far a face moves in a frame: animation units")
    rest_animation: float = Field(0.7, gt=0, description="standard deviation of the animation from the first frame's")
    rest_mouth: float = Field(2.0, gt=0, description="standard deviation of the mouth's units from the first frame's")
    rest_firmness: float = Field(22.0, ge=0, description="by how much, at rest, an animation's inverse variance grows")
    rest_mouth_firmness: float = Field(
        120.0, ge=0, description="by how much, at rest, the inverse variance of the mouth's units grows"
    )
    rest_jaw_firmness: float = Field(
        92.0, ge=0, description="by how much, at rest, that of jaw_drop grows, which opens soon"
    )
    rest_within: float = Field(0.04, gt=0, description="animation at which half of that is left")
    rest_turn_deg: float = Field(12.0, gt=0, description="turn of the head at which these variances are halved")
    hidden_cosine: float = Field(-0.1, description="cosine between normal and ray below which a landmark is hidden")
    hidden_depth: float = Field(0.2, gt=0, description="depth behind the face's own surface at which it is, too")
    sidelong_weight: float = Field(0.03, gt=0, le=1, description="weight of a view that sees a landmark edge-on")
    lack_of_fit: float = Field(50.0, gt=0, description="squared distance from the mean at which a view is half trusted")
    learn_shape: bool = Field(True, description="whether the shape is learned while tracking")
    relief_sd: float = Field(0.12, ge=0, description="relative standard deviation of the depth of the whole face")
    depth_sd: float = Field(0.08, gt=0, description="standard deviation of a landmark's depth, CANDIDE units")
    depth_length: float = Field(0.5, gt=0, description="distance over which depths err together, CANDIDE units")
    slope_sd: float = Field(0.1, ge=0, description="what the slope of the surface there adds to it, by its tangent")
    eyes_sd: float = Field(
        0.13, ge=0, description="what eyes and brows together add to their depth: sockets, spectacles"
    )
    lateral_sd: float = Field(
        0.005, gt=0, description="standard deviation of a landmark across the ray of the first frame, CANDIDE units"
    )
    axes_tilt_share: float = Field(0.2, description="how far the head's axes lean with the shape, in tilt")
    axes_pan_share: float = Field(0.45, description="how far the head's axes lean with the shape, in pan")
    location_sd: float = Field(0.05, gt=0, description="systematic error of a landmark in pixels of the crop, at least")
    temple_sd: float = Field(2.0, gt=0, description="the same of the temples, whose look light and hair move")
    location_rate: float = Field(0.02, ge=0, lt=1, description="how fast it follows what is measured, by frame")
    unit_error: float = Field(0.1, ge=0, description="error of an animation unit, as a share of what it moves")
    appearance_angle_sd_deg: float = Field(27.0, gt=0, description="systematic error of the angles a patch shows")
    shape_rate: float = Field(0.8, ge=0, description="share of a frame's information that is independent")
    least_novelty: float = Field(0.05, ge=0, description="share below which a frame no longer teaches the shape")
    expression_sd: float = Field(0.16, gt=0, description="animation at which a frame teaches half as much of the shape")
    shape_bin_deg: float = Field(4.0, gt=0, description="poses this near repeat each other's errors")
    forgetting: float = Field(0.1, ge=0, lt=1, description="alpha of Eq. (7), for eyes that look strange")
    strange_distance: float = Field(4.0, ge=0, description="distance over the expected one from which they do")
    spectacles_distance: float = Field(2.5, ge=0, description="the same where they mostly do: behind spectacles")
    spectacles_rate: float = Field(0.15, ge=0, lt=1, description="how fast that is noticed, by frame")
    adaptation_turn_deg: float = Field(5.0, gt=0, description="turn at which half of that is learned")
    view_rate: float = Field(0.3, ge=0, lt=1, description="alpha of Eq. (7), for a face that has turned")
    view_strange_distance: float = Field(2.5, ge=0, description="distance over the expected one from which it learns")
    view_turn_deg: float = Field(12.0, gt=0, description="turn below which it does not")


SomeSettings = TypeVar("SomeSettings", bound=Settings)


def read_settings(path: Path, kind: type[SomeSettings]) -> SomeSettings:
    """Settings of a kind from a JSON file: by name, those that differ from the default, or the NAME.json of a track.

    Raises MienError, with the file's name, where it cannot be read, or for an unknown or impossible value.
    """
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise MienError(f"{path} cannot be read ({error.strerror}); give a JSON file with settings") from error
    except ValueError as error:
        raise MienError(f"{path} is no JSON ({error}); give one like the NAME.json that mien writes") from error
    require(isinstance(values, dict), f'{path} holds no settings by name; give a JSON like {{"view_rate": 0}}')
    try:
        return kind.model_validate(values.get("settings", values))
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(map(str, first["loc"]))
        wrong = "unknown setting" if first["type"] == "extra_forbidden" else first["msg"].lower()
        raise MienError(f"{path}: {name}: {wrong}; mien.config.{kind.__name__} has them all") from error
