"""Settings of the real-time tracker, in groups: each module of `mien.tracking.realtime` reads those of its own."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import Field, ValidationInfo, field_validator

from mien.config.settings import DescriptorSettings, Settings


class ViewSettings(Settings):
    """The views of the first frame's face that are rendered, and how each teaches the appearance."""

    limit_tilt_deg: float = Field(40.0, gt=0, lt=90, description="largest tilt of the rendered views")
    limit_pan_deg: float = Field(50.0, gt=0, lt=90, description="largest pan of the rendered views")
    turned_limit_pan_deg: float = Field(
        75.0, gt=0, lt=90, validate_default=True, description="largest pan of the views for faces beyond it"
    )
    per_angle: int = Field(10, ge=5, le=50, description="number of rendered tilts, and of rendered pans")
    coarse_per_angle: int = Field(7, ge=5, le=50, description="the same for the coarse level")
    crowding: float = Field(1.4, gt=0, description="spacing exponent: 1 is even, more is denser near frontal")
    light_contrast: float = Field(0.6, ge=0, description="side light in the rendered views: logarithm of its gain")
    eye_share: float = Field(0.2, ge=0, description="weight of moved eyes in the covariance, relative to all views")
    sidelong_weight: float = Field(0.03, gt=0, le=1, description="weight of a view that sees a landmark edge-on")

    @field_validator("turned_limit_pan_deg")
    @classmethod
    def _is_further(cls, limit: float, info: ValidationInfo) -> float:
        if limit <= info.data.get("limit_pan_deg", 0.0):
            raise ValueError("must be larger than limit_pan_deg")
        return limit


class CovarianceSettings(Settings):
    """The covariance of a landmark's descriptor about its mean."""

    rank: int = Field(20, ge=0, description="rank of the covariance above its floor")
    floor: float = Field(1e-3, gt=0, description="variance of a descriptor entry in every direction")
    lack_of_fit: float = Field(50.0, gt=0, description="squared distance from the mean that halves a landmark's metric")
    learned: int = Field(2, ge=0, description="directions that are added to it while tracking, Eq. (8)")
    rate: float = Field(0.04, ge=0, lt=1, description="rate per frame of the moving average that these come from")
    usual_distance: float = Field(
        10.0, ge=0, description="squared distance, expected of a landmark, up to which nothing is added to it"
    )
    share: float = Field(1.0, ge=0, description="share of the variance along them that is added beyond, in the limit")
    covered_share: float = Field(
        0.5, ge=0, description="share that is added to every landmark while something covers a part of the face"
    )


class VisibilitySettings(Settings):
    """Which landmarks take part in a frame."""

    hidden_cosine: float = Field(
        -0.1, description="cosine between the normal and the direction to the camera below which a landmark is hidden"
    )
    hidden_depth: float = Field(
        0.2, gt=0, description="depth behind the face's own surface above which a landmark is hidden"
    )
    graphics_share: float = Field(
        0.3, gt=0, description="share of graphics in a landmark's surroundings above which it is hidden"
    )
    least_covered: int = Field(
        4, ge=1, description="number of landmarks that something on the face covers at least, at most one at the mouth"
    )
    closing_share: float = Field(0.25, gt=0, description="eye closure above which the eye landmarks are ignored")
    least_eye_contrast: float = Field(
        0.15, ge=0, description="contrast of an eye, relative to that of the face, below which it cannot be seen"
    )
    least_mouth_contrast: float = Field(
        0.25, ge=0, description="contrast of a mouth, relative to that of the face, below which it cannot be seen"
    )
    eye_glare: float = Field(
        1.25, gt=0, description="brightness of an eye, relative to the brightest skin, above which it cannot be seen"
    )


class SolverSettings(Settings):
    """The minimum of Eq. (9), and the crop that it is searched in."""

    iterations: int = Field(12, ge=1, description="maximum number of evaluations of the energy in one solve")
    tolerance: float = Field(0.7, gt=0, description="energy decrease below which the solver stops")
    crop_roll_deg: float = Field(
        4.0, gt=0, description="in-plane rotation of the crop from the face above which it is resampled"
    )
    crop_scale: float = Field(0.05, gt=0, description="relative difference in scale above which the crop is resampled")
    crop_shift: float = Field(
        0.07, gt=0, description="offset from the face, CANDIDE units, above which the crop is resampled"
    )
    retry_distance: float = Field(2.5, gt=0, description="relative distance above which a coarse search starts")
    retry_share: float = Field(
        0.8, ge=0, le=1, description="fraction of matching landmarks above which no coarse search is needed"
    )


class WeightSettings(Settings):
    """How much a landmark counts, by how well it matches what is expected of it."""

    robust_factor: float = Field(0.75, gt=0, description="relative distance at which a landmark's weight is a quarter")
    jaw_tolerance: float = Field(
        1.75, gt=0, description="`robust_factor` multiplier for lower lip and chin, which the jaw changes"
    )
    nose_tolerance: float = Field(1.4, gt=0, description="`robust_factor` multiplier for the nose, which is rigid")
    expected_distance: float = Field(25.0, gt=0, description="initial expected squared distance of a landmark")
    expectation_rate: float = Field(
        0.02, ge=0, lt=1, description="per-frame rate of the expected distance's moving average"
    )
    least_distance: float = Field(6.0, gt=0, validate_default=True, description="lower bound of the expected distance")
    quality_rate: float = Field(
        0.02, ge=0, description="growth of the expected distance per frame, by how much worse a face looks than usual"
    )
    quality_turn_deg: float = Field(
        8.0, ge=0, description="turn from the first frame below which expected distances may grow"
    )

    @field_validator("least_distance")
    @classmethod
    def _is_less(cls, least: float, info: ValidationInfo) -> float:
        if least > info.data.get("expected_distance", math.inf):
            raise ValueError("must not be larger than expected_distance")
        return least


class MisplacementSettings(Settings):
    """The systematic error of where a landmark is found."""

    least_sd: float = Field(0.05, gt=0, description="smallest systematic error of a landmark, pixels of the crop")
    temple_sd: float = Field(
        2.0,
        gt=0,
        description="smallest systematic error of a temple, pixels of the crop, as light and hair change there",
    )
    worn_sd: float = Field(
        4.0,
        gt=0,
        description="smallest systematic error of what lies behind glasses or a mask, which slide; pixels of the crop",
    )
    rate: float = Field(
        0.02, ge=0, lt=1, description="per-frame rate of the moving average of a landmark's systematic error"
    )
    unit_error: float = Field(0.1, ge=0, description="error of an animation unit, as a fraction of its effect")
    angle_sd_deg: float = Field(27.0, gt=0, description="systematic error of a patch's apparent angles")


class PriorSettings(Settings):
    """The state before a frame is seen: Psi of Eq. (4), where no motion has been measured."""

    velocity: float = Field(0.5, ge=0, le=1, description="fraction of the last motion that is extrapolated")
    rotation_deg: float = Field(10.0, gt=0, description="standard deviation of the change per frame: degrees")
    translation: float = Field(
        0.3, gt=0, description="standard deviation of the change per frame: CANDIDE units across the view"
    )
    depth: float = Field(
        0.07, gt=0, description="standard deviation of the change per frame: CANDIDE units along the view"
    )
    animation: float = Field(
        0.06, gt=0, description="standard deviation of the change per frame: animation units except jaw_drop"
    )
    jaw: float = Field(
        0.6,
        gt=0,
        description="standard deviation of the change per frame: jaw_drop, as a mouth opens within a few frames",
    )


class RestSettings(Settings):
    """The prior of the animation about that of the first frame."""

    animation: float = Field(0.7, gt=0, description="standard deviation of the brows' units about the first frame's")
    mouth: float = Field(4.0, gt=0, description="standard deviation of the mouth's units about the first frame's")
    firmness: float = Field(
        22.0, ge=0, description="relative increase, at rest, of the inverse variance of the brows' units"
    )
    mouth_firmness: float = Field(
        480.0, ge=0, description="relative increase, at rest, of the inverse variance of the mouth's units"
    )
    jaw_firmness: float = Field(
        360.0, ge=0, description="relative increase, at rest, of the inverse variance of jaw_drop, which moves readily"
    )
    within: float = Field(0.035, gt=0, description="animation at which half of the increase at rest remains")
    turn_deg: float = Field(10.0, gt=0, description="rotation of the head at which variances about rest are halved")


class MotionSettings(Settings):
    """The motion since the last frame, measured in patches of pixels."""

    grid: int = Field(7, ge=2, le=50, description="sampling points along each side of a patch whose motion is measured")
    patch: float = Field(0.2, gt=0, description="half the side of a patch whose motion is measured, CANDIDE units")
    corner: float = Field(
        0.08, gt=0, description="half the side of the patches at the mouth corners, close to skin that does not move"
    )
    iterations: int = Field(8, ge=1, description="maximum number of iterations of the alignment")
    tolerance: float = Field(3.0, gt=0, description="energy decrease below which the alignment stops")
    robust_factor: float = Field(1.2, gt=0, description="relative residual at which the weight of a patch is a quarter")
    mouth_share: float = Field(
        0.4,
        gt=0,
        description="residual of a mouth's patch, as a fraction of its contrast, at which its weight is a quarter",
    )
    noise: float = Field(100.0, gt=0, description="variance of the motion, relative to that of independent pixels")
    rotation_deg: float = Field(
        0.32, ge=0, description="systematic error of the measured motion, standard deviation per frame: degrees"
    )
    translation: float = Field(0.0085, ge=0, description="systematic error of measured motion: CANDIDE units")
    animation: float = Field(0.015, ge=0, description="systematic error of measured motion: animation units")
    share: float = Field(0.35, ge=0, description="systematic error of measured motion, as a fraction of it")


class HoldSettings(Settings):
    """How little a head moves in a frame, which counts where few landmarks match."""

    share: float = Field(
        0.6, ge=0, le=1, description="fraction of matching landmarks below which the prediction is mixed in"
    )
    rotation_deg: float = Field(4.0, gt=0, description="standard deviation of head motion per frame: degrees")
    translation: float = Field(0.1, gt=0, description="standard deviation of head motion: CANDIDE units")
    animation: float = Field(
        0.2, gt=0, description="standard deviation of facial motion: animation units except jaw_drop, as in `prior`"
    )


class SkinSettings(Settings):
    """Lips and brows, as the skin that moves with them shows them."""

    energy: float = Field(
        50.0,
        ge=0,
        description="energy that skin above the upper lip, or the brows, exactly as in the first frame are worth",
    )
    corner_energy: float = Field(
        15.0, ge=0, description="the same, of the skin around the corners of the mouth, and of both together"
    )
    least: float = Field(
        0.5,
        ge=-1,
        le=1,
        description="correlation of skin beside the lips with the first frame below which it says nothing",
    )
    brow_least: float = Field(0.8, ge=-1, le=1, description="the same, of the brows")
    gain: float = Field(
        0.2, ge=0, description="by how much that correlation must be higher elsewhere for a prediction to be given up"
    )
    turn_deg: float = Field(
        3.0, gt=0, description="rotation of the head at which what the skin beside the lips says counts for half"
    )
    brow_turn_deg: float = Field(8.0, gt=0, description="the same, of the brows")


class MouthSettings(Settings):
    """When other mouths are tried than the one that was found."""

    jaw_distance: float = Field(
        3.5, gt=0, description="relative distance of lower lip and chin above which other jaw positions are tried"
    )
    chin_energy: float = Field(
        50.0, ge=0, description="energy that skin of the chin exactly as in the first frame is worth"
    )
    chin_seen: float = Field(
        0.8, ge=-1, le=1, description="correlation of the chin with the first frame above which it is certainly seen"
    )
    chin_least: float = Field(
        0.2, ge=-1, le=1, description="correlation of the chin with the first frame below which it says nothing"
    )
    distance: float = Field(1.0, gt=0, description="relative distance of the mouth above which it is tried at rest")
    share: float = Field(
        0.6,
        ge=0,
        description="fraction of its relative distance below which a mouth tried at rest stays there; 0: never",
    )
    interval: int = Field(5, ge=2, description="frames between trials of the mouth at rest")
    moved: float = Field(0.1, gt=0, description="animation above which the mouth is tried at rest")


class FeatureSettings(Settings):
    """How corners of the mouth and brows are found again, with all else held."""

    tolerance: float = Field(8.0, ge=1, description="`robust_factor` multiplier for these landmarks")
    turn_deg: float = Field(
        8.0, gt=0, description="rotation of the head at which half of what `tolerance` adds remains"
    )
    jaw: float = Field(
        0.15, gt=0, description="jaw_drop, more than at rest, at which that is so for the corners of the mouth"
    )
    rest: float = Field(
        0.025,
        ge=0,
        description="distance from rest of what moves the corners of the mouth of which half is reported",
    )


class RecoverySettings(Settings):
    """When a face is lost, and how it is searched for."""

    seen_distance: float = Field(
        100.0, gt=0, description="largest squared distance of a landmark that matches the face"
    )
    least_share: float = Field(
        0.25, ge=0, le=1, description="fraction of matching landmarks below which the face is lost"
    )
    recovered_share: float = Field(
        0.6, ge=0, le=1, validate_default=True, description="fraction of matching landmarks that a proposed pose needs"
    )
    interval: int = Field(5, ge=1, description="frames between searches while the face is lost")
    patience: int = Field(30, ge=0, description="lost frames after which only one search in three is thorough")
    doubt_interval: int = Field(15, ge=1, description="frames between searches while the face is in doubt")

    @field_validator("recovered_share")
    @classmethod
    def _is_no_less(cls, share: float, info: ValidationInfo) -> float:
        if share < info.data.get("least_share", 0.0):
            raise ValueError("must not be smaller than least_share")
        return share


class ShapeSettings(Settings):
    """The shape of the face: its prior, and how frames teach it."""

    learn: bool = Field(True, description="whether the shape is learned while tracking")
    relief_sd: float = Field(0.12, ge=0, description="relative standard deviation of the whole face's depth")
    depth_sd: float = Field(0.08, gt=0, description="standard deviation of a landmark's depth, CANDIDE units")
    depth_length: float = Field(0.5, gt=0, description="correlation length of the depth errors, CANDIDE units")
    slope_sd: float = Field(0.1, ge=0, description="depth error from the slope of the surface, per unit of its tangent")
    lean_sd: float = Field(0.1, ge=0, description="slope of a depth error that grows from chin to forehead")
    eyes_sd: float = Field(0.13, ge=0, description="common depth error of eyes and brows: eye sockets, glasses")
    lateral_sd: float = Field(
        0.005, gt=0, description="standard deviation of a landmark across the first frame's ray, CANDIDE units"
    )
    rate: float = Field(0.8, ge=0, description="fraction of a frame's information that is independent")
    least_novelty: float = Field(0.05, ge=0, description="novelty below which a frame no longer updates the shape")
    expression_sd: float = Field(0.14, gt=0, description="animation that halves a frame's weight in learning shape")
    rest_sd: float = Field(
        0.12, gt=0, description="standard deviation of an animation unit about rest, where a frame teaches the shape"
    )
    rest_jaw_sd: float = Field(0.3, gt=0, description="the same, of jaw_drop, which moves readily")
    bin_deg: float = Field(4.0, gt=0, description="size of a pose bin, within which errors repeat")


class AxesSettings(Settings):
    """How the head's axes follow what is learned of the shape."""

    tilt_share: float = Field(
        0.35, ge=0, le=10, description="fraction of the shape's lean that the axes follow, in tilt"
    )
    pan_share: float = Field(0.45, ge=0, le=10, description="fraction of the shape's lean that the axes follow, in pan")


class AdaptationSettings(Settings):
    """What is learned of the appearance while tracking, Eq. (7)."""

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
    turn_deg: float = Field(5.0, gt=0, description="rotation at which half of `forgetting` applies")
    view_rate: float = Field(0.3, ge=0, lt=1, description="alpha of Eq. (7), for a rotated face")
    view_strange_distance: float = Field(
        2.5, ge=0, description="relative distance above which a rotated face's appearance is learned"
    )
    view_turn_deg: float = Field(
        12.0,
        gt=0,
        description="rotation from the first frame from which on the appearance of a face is learned",
    )


class RealtimeSettings(Settings):
    """The tracker for practical use: gradient-based optimisation, pose-dependent appearance, learned shape, visibility.

    A relative distance or residual is divided by its expected value.
    """

    preset: Literal["realtime"] = "realtime"
    descriptor: DescriptorSettings = DescriptorSettings(pixels_per_unit=64.0, cell=4, blur=0.8, root=0.01)
    coarse: DescriptorSettings = DescriptorSettings(pixels_per_unit=32.0, cell=5, blur=0.8, root=0.01)
    views: ViewSettings = ViewSettings()
    covariance: CovarianceSettings = CovarianceSettings()
    visibility: VisibilitySettings = VisibilitySettings()
    solver: SolverSettings = SolverSettings()
    weights: WeightSettings = WeightSettings()
    misplacement: MisplacementSettings = MisplacementSettings()
    prior: PriorSettings = PriorSettings()
    rest: RestSettings = RestSettings()
    motion: MotionSettings = MotionSettings()
    hold: HoldSettings = HoldSettings()
    skin: SkinSettings = SkinSettings()
    mouth: MouthSettings = MouthSettings()
    features: FeatureSettings = FeatureSettings()
    recovery: RecoverySettings = RecoverySettings()
    shape: ShapeSettings = ShapeSettings()
    axes: AxesSettings = AxesSettings()
    adaptation: AdaptationSettings = AdaptationSettings()

    @field_validator("descriptor", "coarse")
    @classmethod
    def _has_derivatives(cls, descriptor: DescriptorSettings) -> DescriptorSettings:
        if descriptor.kernel != "mien":
            raise ValueError("the kernel must be mien, the only one with derivatives")
        return descriptor
