"""The real-time tracker with one mechanism off at a time, on the rendered sequences, as a Markdown table.

`OMP_NUM_THREADS=1 python benchmarks/ablation.py PATH`, with PATH the folder of the rendered sequences; --only WORDS for
those rows alone that have these words, as each takes minutes. Protocol `rebased`, landmarks from the detector, found
once for all rows. `jaw` and `smile` are the correlations of `jaw_drop` and `lip_stretcher` with the truth over the
sequences of kind `expression`, `jitter` that of `uniform`; the last two columns see every third frame alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import numpy as np
from shared.command_line import carry_out, parser_of, print_heads
from shared.runs import KINDS, prepare, score, thinned

from mien.appearance.regression import PoseRegression
from mien.candide.model import TRACKED_UNITS, Candide
from mien.config import RealtimeSettings
from mien.config.realtime import AxesSettings, CovarianceSettings, ViewSettings
from mien.errors import require
from mien.evaluation.datasets import load_dataset
from mien.evaluation.scores import Score, pooled_errors
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.initialization import fit
from mien.initialization.landmarks import LANDMARK_VERTICES, Landmarks
from mien.tracking.realtime import RealtimeTracker, learning, person, tracker
from mien.tracking.realtime.pose import Pose, Prediction
from mien.tracking.realtime.solution import Solution, View
from mien.tracking.realtime.solver import PoseSolver
from mien.tracking.state import Estimate

STEP = 3
MOUTH = [TRACKED_UNITS.index(unit) for unit in ("jaw_drop", "lip_stretcher")]


class FrontalAppearance(RealtimeTracker):
    """The regression's constant term alone: the look from the front, with the covariance of the regression."""

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        estimate = super().initialize(frame, landmarks, camera)
        for level in (self.face.coarse, self.face.fine):
            level.appearance.coefficients[:, 1:] = 0
        return estimate


WITHOUT_VIEWS = RealtimeSettings(views=ViewSettings(sidelong_weight=1), covariance=CovarianceSettings(lack_of_fit=1e9))


class _OneGaussian(PoseRegression):
    @classmethod
    def learn(cls, samples: Any, terms: Any, *args: Any) -> PoseRegression:
        return super().learn(samples, terms * (np.arange(terms.shape[1]) == 0), *args)


class OfTheFrontAlone(RealtimeTracker):
    """A face that has turned further than the views looks as at their border."""

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        estimate = super().initialize(frame, landmarks, camera)
        for level in (self.face.coarse, self.face.fine):
            vars(level)["learn_turned"] = None
        return estimate


class OneGaussian(RealtimeTracker):
    """One mean and covariance for all views, as in the paper."""

    def __init__(self) -> None:
        super().__init__(WITHOUT_VIEWS)

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        with patch.object(learning, "PoseRegression", _OneGaussian):
            return super().initialize(frame, landmarks, camera)


class WithoutDepths(RealtimeTracker):
    """The detector's depths are not used."""

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        return super().initialize(frame, replace(landmarks, depths=None), camera)


class Clipped(RealtimeTracker):
    """SIFT as Lowe prints it, with the covariance's floor that goes with it."""

    def __init__(self) -> None:
        s = RealtimeSettings()
        plain = {name: getattr(s, name).model_copy(update={"root": 0.0}) for name in ("descriptor", "coarse")}
        super().__init__(s.model_copy(update={**plain, "covariance": CovarianceSettings(floor=4e-3)}))


FIRST_AXES = RealtimeSettings(axes=AxesSettings(tilt_share=0, pan_share=0))


class FittedAxes(RealtimeTracker):
    """Nobody is taken to look into the camera when they begin, and the axes stay as they are there."""

    def __init__(self) -> None:
        super().__init__(FIRST_AXES)

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        with patch.object(fit, "most_likely_facing", lambda R, t: (R, np.radians(fit.AXES_SD_DEG))):
            return super().initialize(frame, landmarks, camera)


class HalfBrows(RealtimeTracker):
    """A raised brow is raised outside alone, as CANDIDE's unit has it."""

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        with patch.object(Candide, "with_whole_brows", lambda model: model):
            return super().initialize(frame, landmarks, camera)


class Tracking(RealtimeTracker):
    """Other vertices than usual are tracked. tracked: their names and numbers, the landmarks first."""

    def __init__(self, tracked: Mapping[str, int]) -> None:
        super().__init__()
        self.tracked = tracked

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        with patch.object(person, "TRACKED", self.tracked):
            return super().initialize(frame, landmarks, camera)


WITHOUT_TEMPLES = {name: vertex for name, vertex in person.TRACKED.items() if "temple" not in name}


class Unmoved(RealtimeTracker):
    """The motion since the last frame is not measured: the prediction stays where velocity puts it."""

    def _predict_from_motion(self, view: View, predicted: Prediction) -> Prediction:
        return predicted


class Rigid(RealtimeTracker):
    """The skin around corners of the mouth and brows follows them entirely."""

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        estimate = super().initialize(frame, landmarks, camera)
        self.features.follows = np.ones_like(self.features.follows)
        return estimate


class _UprightInTheCrop(PoseSolver):
    def solve(self, view: View, start: Pose, predicted: Prediction) -> Solution:
        return super().solve(view.upright_at(view.pose), start, predicted)


class UprightInTheCrop(RealtimeTracker):
    """Descriptors keep the orientation and the scale of the crop that they are sampled from."""

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        with patch.object(tracker, "PoseSolver", _UprightInTheCrop):
            return super().initialize(frame, landmarks, camera)


def _set(group: str, **values: Any) -> Callable[[], RealtimeTracker]:
    return lambda: RealtimeTracker(RealtimeSettings.model_validate({group: values}))


TRACKERS: dict[str, Callable[[], RealtimeTracker]] = {
    "full": RealtimeTracker,
    "appearance from the front only": FrontalAppearance,
    "one Gaussian for all views, as in the paper": OneGaussian,
    "5x5 views, not 10x10": _set("views", per_angle=5, coarse_per_angle=5),
    "views evenly to 40 degrees of pan, not 50": _set("views", limit_pan_deg=40, crowding=1),
    "no views from far aside": OfTheFrontAlone,
    "views weigh alike, however a landmark faces them": _set("views", sidelong_weight=1),
    "one covariance for all views": _set("covariance", lack_of_fit=1e9),
    "views weigh alike, with one covariance": lambda: RealtimeTracker(WITHOUT_VIEWS),
    "no light in the views": _set("views", light_contrast=0),
    "no closed or turned eyes in the views' covariance": _set("views", eye_share=0),
    "blinks not noticed": _set("visibility", closing_share=1e6),
    "histograms clipped, not rooted": Clipped,
    "head's axes as fitted": FittedAxes,
    "head's axes as the first frame shows them": lambda: RealtimeTracker(FIRST_AXES),
    "one look a frame": _set("solver", crop_roll_deg=180, crop_scale=10, crop_shift=10),
    "descriptors upright for the crop, not for the face": UprightInTheCrop,
    "shape not learned": _set("shape", learn=False),
    "no anchors beside the 26 landmarks": lambda: Tracking(LANDMARK_VERTICES),
    "no temples among the anchors": lambda: Tracking(WITHOUT_TEMPLES),
    "temples trusted as the other anchors": _set("misplacement", temple_sd=0.05),
    "depth as certain on a slope as elsewhere": _set("shape", slope_sd=0),
    "depths that lean no more than they err": _set("shape", lean_sd=0),
    "outer brows raised alone": HalfBrows,
    "rest of the animation a Gaussian": _set(
        "rest", firmness=0, mouth_firmness=0, jaw_firmness=0, animation=0.4, mouth=0.5
    ),
    "patches of the mouth's corners as large as others": _set("motion", corner=0.2),
    "rest of the mouth as firm as the brows'": _set("rest", mouth=0.7, mouth_firmness=22, jaw_firmness=11),
    "animation units believed entirely": _set("misplacement", unit_error=0),
    "expressive frames teach the shape too": _set("shape", expression_sd=1e6),
    "a face that seems at rest may move where the shape is learned": _set("shape", rest_sd=1e3, rest_jaw_sd=1e3),
    "eyes at the depth of the rest": _set("shape", eyes_sd=0),
    "landmarks weigh alike wherever they are found": _set("misplacement", rate=0),
    "detector's depths ignored": WithoutDepths,
    "no robust weights": _set("weights", robust_factor=1e9),
    "no visibility by normals": _set("visibility", hidden_cosine=-1),
    "no visibility by what of the face is before": _set("visibility", hidden_depth=1e9),
    "what lies on the face takes part": _set("visibility", least_covered=99),
    "motion not measured": Unmoved,
    "no prediction": _set("prior", velocity=0),
    "last pose counts for nothing where little is seen": _set("hold", share=0),
    "no coarse search": _set("solver", retry_distance=1e9),
    "no jaw search": _set("mouth", jaw_distance=1e9),
    "corners and brows may look no stranger alone": _set("features", tolerance=1),
    "rigid skin around corners and brows": Rigid,
    "corners of the mouth believed near rest, too": _set("features", rest=0),
    "skin says nothing of lips and brows": _set("skin", energy=0, corner_energy=0),
    "skin says nothing of brows": _set("skin", brow_least=1),
    "no loss, no recovery": _set("recovery", least_share=0),
    "angles of patches believed entirely": _set("misplacement", angle_sd_deg=0.01),
    "angles of patches ignored": _set("misplacement", angle_sd_deg=1000),
    "covariance as the views have it, Eq. (8) unused": _set("covariance", learned=0),
    "half of what Eq. (8) adds, however a landmark looks": _set("covariance", usual_distance=0, share=0.5),
    "eyes that look strange not adapted": _set("adaptation", forgetting=0),
    "turned faces not learned": _set("adaptation", view_rate=0),
}


def cells(every: list[Score], third: list[Score]) -> Iterator[str]:
    """A tracker's row of the table."""
    for kind in KINDS:
        yield f"{pooled_errors([s for s in every if s.result.kind == kind]).mean():.2f}"
    yield f"{pooled_errors(every).mean():.2f}"
    yield str(sum(s.lost for s in every))
    for correlation in np.mean([s.unit_correlations[MOUTH] for s in every if s.result.kind == "expression"], axis=0):
        yield f"{correlation:.2f}"
    yield f"{max(np.nanmax(s.false_movement) for s in every if s.result.kind == 'uniform'):.2f}"
    yield f"{np.mean([s.jitter_deg for s in every if s.result.kind == 'uniform']):.2f}"
    yield f"{pooled_errors(third).mean():.2f}"
    yield str(sum(s.lost for s in third))


def main() -> None:
    parser = parser_of(__doc__, "path")
    parser.add_argument("--only", default="", metavar="WORDS", help="the rows with these words, instead of all")
    arguments = parser.parse_args()
    path, rows = arguments.path, {name: make for name, make in TRACKERS.items() if arguments.only in name}
    require(bool(rows), f"no row has the words {arguments.only!r}; the rows are {'; '.join(TRACKERS)}")
    sequences = load_dataset("rendered", path)
    missing = set(KINDS) - {sequence.kind for sequence in sequences}
    require(not missing, f"{path} holds no sequence of the kind {', '.join(sorted(missing))}; give one of each kind")
    every = [prepare(sequence) for sequence in sequences]
    print_heads("", *KINDS, "all", "lost", "jaw", "smile", "false", "jitter", "all, every third", "lost")
    for name, make in rows.items():
        scores = ([score(make, thinned(run, step)) for run in every] for step in (1, STEP))
        print("| " + " | ".join((name, *cells(*scores))) + " |", flush=True)


if __name__ == "__main__":
    carry_out(main)
