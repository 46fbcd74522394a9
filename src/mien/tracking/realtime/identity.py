"""Whether the tracked face is still that of the first frame.

There are two kinds of evidence. Familiarity: how near the descriptors are to those of the first frame. And continuity:
whether the face is the same as a moment ago, by the correlation of its patches with those of the last frame and of some
time before, see `LOOK_BACK`; where that leaves it open, by the surroundings, which a cut or a dissolve changes, and a
hand or a grimace does not. A face that no longer looks familiar, since it has turned or is lit otherwise, stays known
as long as it has been the same in every frame since it did.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from mien.arrays import Array
from mien.tracking.realtime.patch_history import LOOK_BACK, LOOK_BACK_SECONDS, PatchHistory
from mien.tracking.scene import Scene

FAMILIAR = 0.5
"""`familiarity` above which a face looks like that of the first frame."""
_STRANGER = (43.0, 3.0, 2.5)
"""Squared distance that even the best quarter of another person's landmarks exceeds, its growth by radian of turn, and
the width of the step: between strangers and the same face, on three subjects."""
_SAME, _ANOTHER = 0.9, 0.7
"""Correlation of a face's patches with the last frame's above which it is the same face, and below which another one:
mostly it is 0.99, in one of a hundred frames less than 0.95, and 0.4 where something comes before it."""
_SAME_LATER, _ANOTHER_LATER = 0.85, 0.75
"""The same over that time, where the face does not look familiar: of recordings nearly all such frames have more than
the first; while a picture dissolves into another person's hardly any face has."""
_SAME_SCENE = 0.8
"""Correlation of the surroundings over that time, which decides in between: a blurred frame or a hand before the face
leaves them as they were, another picture does not."""
_RECOGNITION_RATE, _DOUBT_RATE = 0.1, 0.002
"""Rates per frame at which identity is recognised, and doubted: a stranger looks familiar now and then, and what is the
same patch by patch may have come slowly."""
_KNOWN, _DOUBTED = 0.5, 0.1
"""Probabilities above which the face is taken to be that of the first frame, and below which it may be another one."""


class Identity:
    """The belief that the tracked face is that of the first frame.

    probability: that it is, as far as it could be followed from a familiar frame to this one.
    """

    def __init__(self, distinctive: Array) -> None:
        """distinctive: (n,) 1 for patches that differ from person to person, 0 for the others."""
        self.patches = PatchHistory(distinctive)
        self.scene = Scene(LOOK_BACK, LOOK_BACK_SECONDS)
        self.probability = 1.0
        self._when_covered = 1.0

    @property
    def is_known(self) -> bool:
        """Whether the face is taken to be that of the first frame."""
        return self.probability > _KNOWN

    @property
    def is_doubted(self) -> bool:
        """Whether the face may be another one."""
        return self.probability < _DOUBTED

    @property
    def is_steady(self) -> bool:
        """Whether it is known to be the same face, and the same as some time ago: how it looks may be learned. In a
        jump, or in a picture that dissolves, something else would be."""
        return self.is_known and self.patches.later[-1] > _SAME_LATER

    def update(self, familiar: float, agreements: tuple[float, float], surroundings: Callable[[], float]) -> None:
        """Take the evidence of a frame: its familiarity, what `PatchHistory.add` said of its patches, and the
        correlation of its surroundings, which is asked for where it is needed."""
        same = _is_same(familiar, agreements, surroundings)
        if not same and self.is_known:
            self._when_covered = self.probability
            self.patches.keep(_may_be_covered(agreements[0], surroundings()))
        elif self.probability < _KNOWN and self.patches.matches_kept(_SAME_LATER):
            self.probability, same = self._when_covered, True
        self.probability = _updated(self.probability, familiar, same)


def familiarity(d2: float, turn: float) -> float:
    """Probability that a face which has turned by `turn`, radians, looks like that of the first frame, by the squared
    distance of its best quarter, `Solution.best_d2`."""
    stranger, by_turn, width = _STRANGER
    return logistic((stranger + by_turn * turn - d2) / width) if d2 < math.inf else 0.0


def logistic(x: float) -> float:
    """1 / (1 + exp(-x))."""
    return 1 / (1 + math.exp(-min(max(x, -30.0), 30.0)))


def _is_same(familiar: float, agreements: tuple[float, float], surroundings: Callable[[], float]) -> bool:
    """Whether a face is the one of the frame before; arguments as of `Identity.update`."""
    lately, later = agreements
    later = later if familiar < FAMILIAR else 1.0
    if lately <= _ANOTHER or later <= _ANOTHER_LATER:
        return False
    return (lately > _SAME and later > _SAME_LATER) or surroundings() > _SAME_SCENE


def _may_be_covered(lately: float, surroundings: float) -> bool:
    """Whether a face that is no longer the same may be behind a hand, and known again when that has gone: nothing has
    jumped since the last frame, as it does in a cut, and the surroundings are as they were."""
    return lately > _SAME and surroundings > _SAME_SCENE


def _updated(probability: float, familiar: float, same: bool) -> float:
    """The probability of `Identity` after a frame."""
    if not same:
        return 0.0
    return probability + (_RECOGNITION_RATE if familiar > probability else _DOUBT_RATE) * (familiar - probability)
