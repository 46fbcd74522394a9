"""The evolution model of the real-time tracker: `p(b_t | b_{t-1})` of Eq. (4), about a measured motion."""

from __future__ import annotations

from typing import Any

import numpy as np

from mien.arrays import Array
from mien.candide.model import MOVES_MOUTH
from mien.compiled import kernel
from mien.config import RealtimeSettings
from mien.tracking.prior import JAW_DROP, state_sd
from mien.tracking.realtime.kernels import PriorArrays
from mien.tracking.realtime.pose import Pose, Prediction


class StatePrior:
    """The prior of the real-time tracker: of the pose about a prediction, and of the animation about rest.

    The latter has heavy tails (Student's t, reweighted by the last frame), since a face is mostly at rest, and
    otherwise may show anything. What a turn does to a face looks much like an expression, so it tightens as the head
    turns.

    information: (12, 12) of a step from the last pose, where no motion has been measured; seen_from: (3,) from
    where the first frame sees the head, `Pose.seen_from`, from which turns are counted.
    """

    def __init__(self, first: Pose, settings: RealtimeSettings) -> None:
        """first: pose of the first frame, whose animation is the rest."""
        s = settings
        sd = state_sd(s.prior.rotation_deg, s.prior.translation, s.prior.depth, s.prior.animation, s.prior.jaw)
        self.settings = s
        self.information = np.diag(1 / sd**2)
        self.rest, self.seen_from = first.animation, first.seen_from
        self.rest_information, self.firmness = np.full(6, s.rest.animation**-2), np.full(6, s.rest.firmness)
        self.rest_information[MOVES_MOUTH], self.firmness[MOVES_MOUTH] = s.rest.mouth**-2, s.rest.mouth_firmness
        self.firmness[JAW_DROP] = s.rest.jaw_firmness

    def prediction(self, pose: Pose, last: Pose) -> Prediction:
        """The prediction of a pose by the last one alone, without a measured motion."""
        (x, y, z), (x0, y0, z0) = pose.seen_from.tolist(), self.seen_from.tolist()
        cosine: float = x * x0 + y * y0 + z * z0  # of three numbers, faster than by NumPy
        return Prediction(pose, self.information, last, max(1 - cosine * cosine, 0.0))

    def arrays(self, predicted: Prediction) -> PriorArrays:
        """The prior about a prediction, as the kernels take it."""
        information = self._rest_information(predicted)
        return PriorArrays(predicted.pose.arrays, predicted.information, self.rest, information)

    def _rest_information(self, predicted: Prediction) -> Array:
        """Information (6,) of the animation about rest, reweighted by that of the last frame."""
        s = self.settings
        factor = 1 + predicted.turned(s.rest.turn_deg)
        information: Array = student_information(
            self.rest_information, self.firmness, predicted.last.animation - self.rest, s.rest.within, factor
        )
        return information


@kernel()
def student_information(information: Any, firmness: Any, moved: Any, within: float, factor: float) -> Any:
    """Information (6,) of the animation about its rest, with the tails of Student's t: `information` times `1 +
    firmness` at rest, of which the firmness has halved where an entry of moved (6,) is `within`; all that times
    `factor`."""
    out = np.empty(information.size)
    for k in range(out.size):
        x = moved[k] / within
        out[k] = factor * information[k] * (1 + firmness[k] / (1 + x * x))
    return out
