"""What lies on the face and moves with it: a phone at the ear, a hand, a mask.

The robust weights of Eq. (9) ignore a landmark that is covered. One at the edge of a cover still looks a little like
itself, and more so from a wrong pose; and in a turn, where the appearance is learned, what lies on the face would be
learned as its look. So landmarks that something covers take no part in the next frame, nor do those beside them that
look strange, nor is their look learned. Mouth and chin are not covered alone: a mouth that opens wide looks strange as
suddenly, and where something covers nothing else the robust weights are enough. Where the mouth is known to be open,
that holds for what lies beside it, too.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mien.arrays import Array, Mask
from mien.compiled import kernel
from mien.config.realtime import VisibilitySettings
from mien.tracking.realtime.order import insert

_USUAL, _OF_THE_BEST = 25.0, 2.0
"""Squared distance at which a landmark looks strange beside a covered one: at least the first, and the second times
that of the best quarter of the face, as a whole face may look strange."""
_COVERED, _STILL_COVERED = 4.0, 2.0
"""The same, as a multiple of it, of a landmark that is covered, and of one that was covered in the last frame."""
_CAME = 0.85
"""Agreement of a patch, see `PatchHistory`, below which something has come before it: a grin makes half of a face look
strange, but gradually."""
_BESIDE = 0.3
"""Distance in CANDIDE units within which landmarks lie beside each other."""
_UNWEIGHTED = 1e-9
"""Factor of the weight of a landmark that is looked at, but takes no part."""


class Covers:
    """Which landmarks something covers, from frame to frame.

    covered: (n,) in the last frame; suspected: (n,) before which something has come, and which have not looked like the
    face since; weight: (n,) factor of their weights in the next frame.
    """

    def __init__(self, neutral: Array, eyes: Mask, mouth: Mask, settings: VisibilitySettings) -> None:
        """neutral: (n, 3) landmarks at rest; eyes, mouth: (n,) which of them are the eyes', which blink, and those of
        mouth and chin, which open."""
        self.settings = settings
        self.beside = np.linalg.norm(neutral[:, None] - neutral, axis=2) < _BESIDE
        self.telling, self.mouth = ~eyes, mouth
        self.far_from_mouth = ~(self.beside & mouth).any(axis=1)
        self.forget()

    def forget(self) -> None:
        """Take nothing to be covered: a lost face may be found again uncovered."""
        n = len(self.telling)
        self.covered: Mask = np.zeros(n, bool)
        self.suspected: Mask = np.zeros(n, bool)
        self.weight = np.ones(n)

    @property
    def learnable(self) -> Mask:
        """Which landmarks (n,) certainly show the face."""
        return np.asarray(~(self.covered | self.suspected))

    def update(self, d2: Array, facing: Mask, agreement: Array, mouth_is_open: bool = False) -> None:
        """Take a frame: squared distances d2 (n,) without noise, which landmarks face the camera (n,), how far their
        patches agree with the last frame's, agreement (n,), and whether the mouth is known to be open."""
        least, telling = self.settings.least_covered, self.telling
        if mouth_is_open:
            telling = telling & self.far_from_mouth
        self.covered, self.suspected, self.weight = _updated(
            (self.covered, self.suspected), d2, facing, agreement, (telling, self.mouth, self.beside), least
        )


@kernel(fastmath={"contract"})
def _updated(before: Any, d2: Any, facing: Any, agreement: Any, of: Any, least: int) -> Any:
    """`covered`, `suspected` and `weight` (n,) of `Covers` after a frame.

    before: `covered` and `suspected` before it; of: which landmarks (n,) can tell, which belong to the mouth, and which
    (n, n) lie beside each other; least: how many have to be covered to be believed, all but one elsewhere than at the
    mouth.
    """
    covered, suspected = before
    telling, mouth, beside = of
    n, count, found, elsewhere = d2.size, 0, 0, 0
    shown, alone, now, suspects, weight = (
        np.empty(n), np.empty(n, np.bool_), np.empty(n, np.bool_), np.empty(n, np.bool_), np.empty(n)
    )  # fmt: skip
    for i in range(n):
        if facing[i]:
            insert(d2[i], shown, count)
            count += 1
    usual = max(_USUAL, _OF_THE_BEST * (shown[count // 4] if count else np.inf))
    for i in range(n):
        suspects[i] = (suspected[i] or agreement[i] < _CAME) and (d2[i] > usual or not facing[i])
        beyond = _STILL_COVERED if covered[i] else _COVERED
        alone[i] = facing[i] and telling[i] and (covered[i] or suspects[i]) and d2[i] > beyond * usual
        found += alone[i]
        elsewhere += alone[i] and not mouth[i]
    believed = found >= least and elsewhere >= least - 1
    for i in range(n):
        now[i] = alone[i] and believed
        if facing[i] and d2[i] > usual and believed:
            for j in range(n):
                now[i] = now[i] or (alone[j] and beside[j, i])
        now[i] = now[i] or (covered[i] and not facing[i])
        weight[i] = _UNWEIGHTED if now[i] else 1.0
    return now, suspects, weight
