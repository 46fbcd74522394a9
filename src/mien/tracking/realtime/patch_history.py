"""How well the patches around the landmarks agree with themselves over the last frames.

A patch that moves with the face looks the same from frame to frame, one that something passes before does not. The
median over the patches says whether the face is the same as a moment ago; each patch's own correlation says whether it
has moved with the face.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mien.arrays import Array, Float32, Mask
from mien.compiled import kernel
from mien.tracking.realtime.order import insert
from mien.tracking.recent import Recent

LOOK_BACK, LOOK_BACK_SECONDS = 12, 0.39
"""Frames and seconds after which a patch is compared with itself once more, as one picture may dissolve into another,
alike from frame to frame."""
_LASTING, _LASTING_SECONDS = 3, 0.09
"""Frames and seconds for which it has to differ, so that a quick grimace does not count."""
_OF_THE_FACE, _LEAST_PATCHES = 0.2, 4
"""Weight above which a patch belongs to the face, and the least number of such patches for a median."""
_AGREEMENT_RATE = 0.05
"""How fast a patch's agreement rises per frame: one that was covered has to move with the face for 45 frames."""


Patches = tuple[Float32, Array, Array]
"""Values (n, m) less their mean, norms (n,), and how far each patch belongs to the face (n,)."""


class PatchHistory:
    """The patches of the last frames, and their correlations over time.

    agreement: (n,) correlation of each patch from frame to frame: the moving average or the last one, if lower; later:
    of each of the last frames the median correlation with the patches `LOOK_BACK` frames before.
    """

    def __init__(self, distinctive: Array) -> None:
        """distinctive: (n,) 1 for patches that differ from person to person, 0 for the others."""
        self.distinctive = distinctive
        self.agreement = np.ones(len(distinctive))
        self.frames: Recent[Patches] = Recent(LOOK_BACK, LOOK_BACK_SECONDS)
        self.later: Recent[float] = Recent(_LASTING, _LASTING_SECONDS)
        self.kept: Patches | None = None

    def add(self, values: Float32, norms: Array, weight: Array, time: float) -> tuple[float, float]:
        """Take the patches of a new frame, at a time in seconds: values (n, m) less their mean, norms (n,), and how far
        each belongs to the face, weight (n,) in [0, 1].

        Returns the median correlation with the patches that belonged to the face in the last frame, and the highest of
        the last frames' with those that did `LOOK_BACK` frames before and still do; 0 where hardly any are seen.
        """
        self.frames.add((values, norms, weight), time)
        if len(self.frames) == 1:
            return 0.0, 0.0
        earlier, last, now = self.frames[0], self.frames[-2], self.frames[-1]
        correlation, median = _agreement(last, now, self.distinctive, last[2])
        _follow(self.agreement, correlation)
        self.later.add(_agreement(earlier, now, self.distinctive, weight)[1], time)
        return median, max(self.later)

    def disregard(self, patches: Mask) -> None:
        """Treat these patches (n,) of the last frame as something else's."""
        self.frames[-1][2][patches] = 0

    def keep(self, wanted: bool = True) -> None:
        """Keep the patches of `LOOK_BACK` frames ago, before something covered the face; or drop what is kept."""
        self.kept = self.frames[0] if wanted else None

    def matches_kept(self, least: float) -> bool:
        """Whether the median correlation of the last frame with the patches that were kept exceeds `least`. If so, the
        frames between are forgotten, in which something covered the face."""
        if self.kept is None:
            return False
        now = self.frames[-1]
        matches: bool = _agreement(self.kept, now, self.distinctive, now[2])[1] > least
        if matches:
            self.frames.restart(self.kept, now)
            self.later.restart(1.0)
            self.kept = None
        return matches


@kernel()
def _follow(agreement: Any, correlation: Any) -> None:
    """`PatchHistory.agreement` (n,) after a frame with these correlations (n,)."""
    for i in range(agreement.size):
        average = agreement[i] + _AGREEMENT_RATE * (correlation[i] - agreement[i])
        agreement[i] = min(average, correlation[i])


@kernel()
def _agreement(before: Any, now: Any, distinctive: Any, weight: Any) -> Any:
    """Correlation (n,) of each patch with an earlier one, and the median over the distinctive ones.

    before, now: values (n, m) less their mean, norms (n,), and how far each patch belongs to the face (n,); weight:
    (n,) the same of now, as far as it matters. Where hardly any belongs to the face, all that are seen count, since the
    whole face may look strange; the median is 0 where these are too few, too.
    """
    earlier, earlier_norms, earlier_weight = before
    values, norms, _ = now
    n, m = values.shape
    correlation, face, seen = np.empty(n), np.empty(n), np.empty(n)
    of_face, of_seen = 0, 0
    for i in range(n):
        product = np.float32(0.0)
        for j in range(m):
            product += earlier[i, j] * values[i, j]
        correlation[i] = product / (max(earlier_norms[i], 1e-3) * max(norms[i], 1e-3))
        known = distinctive[i] * min(earlier_weight[i], weight[i])
        if known > 0.0:
            insert(correlation[i], seen, of_seen)
            of_seen += 1
        if known > _OF_THE_FACE:
            insert(correlation[i], face, of_face)
            of_face += 1
    ordered, count = (face, of_face) if of_face >= _LEAST_PATCHES else (seen, of_seen)
    median = 0.5 * (ordered[(count - 1) // 2] + ordered[count // 2]) if count >= _LEAST_PATCHES else 0.0
    return correlation, median
