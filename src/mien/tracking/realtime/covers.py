"""What lies on the face and moves with it: a phone at the ear, a hand, a mask.

The robust weights of Eq. (9) ignore a landmark that is covered. One at the edge of a cover still looks a little like
itself, and more so from a wrong pose; and in a turn, where the appearance is learned, what lies on the face would be
learned as its look. So landmarks that something covers take no part in the next frame, nor do those beside them that
look strange, nor is their look learned.
"""

from __future__ import annotations

import numpy as np

from mien.arrays import Array, Mask
from mien.config.realtime import VisibilitySettings
from mien.tracking.realtime.solution import largest_of_best

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


class Covers:
    """Which landmarks something covers, from frame to frame.

    covered: (n,) in the last frame; suspected: (n,) before which something has come, and which have not looked like the
    face since.
    """

    def __init__(self, neutral: Array, eyes: Mask, settings: VisibilitySettings) -> None:
        """neutral: (n, 3) landmarks at rest; eyes: (n,) which of them are the eyes', which blink."""
        self.settings = settings
        self.beside = np.linalg.norm(neutral[:, None] - neutral, axis=2) < _BESIDE
        self.telling = ~eyes
        self.forget()

    def forget(self) -> None:
        """Take nothing to be covered: a lost face may be found again uncovered."""
        self.covered = np.zeros_like(self.telling)
        self.suspected = np.zeros_like(self.telling)

    @property
    def learnable(self) -> Mask:
        """Which landmarks (n,) certainly show the face."""
        return ~(self.covered | self.suspected)

    def update(self, d2: Array, facing: Mask, agreement: Array) -> None:
        """Take a frame: squared distances d2 (n,) without noise, which landmarks face the camera (n,), and how far
        their patches agree with the last frame's, agreement (n,)."""
        usual = max(_USUAL, _OF_THE_BEST * largest_of_best(d2[facing], 4))
        strange = d2 > usual
        self.suspected = (self.suspected | (agreement < _CAME)) & (strange | ~facing)
        self.covered = self._found(d2 / usual, facing, strange) | self.covered & ~facing

    def _found(self, d2: Array, facing: Mask, strange: Mask) -> Mask:
        """What is covered in a frame in which the squared distance of a strange landmark is above 1."""
        least = np.where(self.covered, _STILL_COVERED, np.where(self.suspected, _COVERED, np.inf))
        covered = facing & self.telling & (d2 > least)
        if np.count_nonzero(covered) < self.settings.least_covered:
            return np.zeros_like(covered)
        return np.asarray(covered | facing & strange & self.beside[covered].any(axis=0))
