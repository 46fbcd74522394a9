"""The wait of a live camera for a face that looks into it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from contextlib import suppress
from itertools import cycle

from mien.errors import MienError
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.initialization.fit import FirstFrame, fit_first_frame
from mien.initialization.landmarks import Landmarks, Point
from mien.initialization.straight import straightened
from mien.initialization.upright import Upright, quarters_of, roll_of
from mien.start.looks import TURNED_DEG, eye_opening, turn_of

_GONE_SECONDS = 1.0
"""How long a live camera's face may not be detected before the wait for it begins anew."""
_PATIENCE = 3.0
"""Seconds that a live camera waits for a face to look into it with open eyes."""
_SHUT = 0.15
"""Height of the eyes over their width below which they are shut: on recordings of 12 people mostly 0.2 to 0.4, and 0.03
to 0.1 in blinks."""
_UPRIGHT = math.radians(60.0)
"""Roll of a face up to which detectors see it as well as an upright one."""


class Patience:
    """Face search on a live camera: waits a while for the face to look into the camera, with open eyes, as there is no
    going back to a better frame.

    Where no upright face is seen, each frame is also turned, by another quarter turn than the last: cameras hang upside
    down, or lie on their side. A face that is found so is then looked for in frames that are turned likewise.
    """

    def __init__(self, camera: Camera, at: Point | None = None, quarters: int = 0) -> None:
        """at: pixels; only a face at this point is considered. quarters: by how many quarter turns the face has
        probably rolled, clockwise."""
        self.camera, self.at, self.quarters = camera, at, quarters
        self.first_detection: tuple[Landmarks, FirstFrame] | None = None
        self.last_seen = -math.inf
        self._confirmed = False  # whether copies of the frame have shown the face of the first detection, too
        self._turns, self._turned_distant = cycle((2, 1, 3)), cycle((False, False, False, True))

    def anew(self) -> Patience:
        """One that waits for another face before the same camera."""
        return Patience(self.camera, self.at, self.quarters)

    def __call__(self, frame: Frame) -> list[Landmarks]:
        """The faces of a frame, largest first, if tracking may start with it; else none."""
        from mien.initialization.detector import detect

        face = self._face(frame)
        if face is not None:
            self.last_seen = frame.time
        elif frame.time - self.last_seen > _GONE_SECONDS:
            self.first_detection = None
        if face is None or self.first_detection is None:
            return []
        first, fit = self.first_detection
        waited = frame.time - first.time
        if waited < _PATIENCE and not self._is_ready(face, first, fit):
            return []
        view = Upright(frame, self.quarters)
        return _trackable(view, detect(view.frame, view.point(self.at)))

    def _face(self, frame: Frame) -> Landmarks | None:
        """The largest face that can be tracked, by a single detection; from the first one on `first_detection` is
        known."""
        if self.first_detection is not None and self._confirmed:
            return self._largest(Upright(frame, self.quarters))
        distant = next(self._turned_distant)  # a search that takes long, so not in both
        view, turned = (Upright(frame, (self.quarters + turn) % 4) for turn in (0, next(self._turns)))
        seen = self._largest(view, not distant)
        if seen is not None and self.first_detection is None and self._begins(view, seen):
            return seen
        other = self._largest(turned, distant)
        if other is not None and self._begins(turned, other):
            return other
        if seen is not None and self.first_detection is None and self.quarters == view.quarters:
            self._remember(frame, seen)
        return seen

    def _largest(self, view: Upright, distant: bool = True) -> Landmarks | None:
        from mien.initialization.detector import detect_once

        faces = _trackable(view, detect_once(view.frame, view.point(self.at), distant))
        return faces[0] if faces else None

    def _begins(self, view: Upright, seen: Landmarks) -> bool:
        """Whether copies of the frame show the face of a view, upright there, where it was `seen`; if so, it becomes
        the first detection, unless no face has such landmarks. One that lies in the view is looked for in another one
        from then on."""
        from mien.initialization.detector import TURNED_AGREEMENT, refine

        # All later turns are measured from this detection, so it is found as well as it can be.
        face = refine(view.frame, view.turned_upright(seen))
        # As in a face upside down the detector sees an upright one, others must agree as well as they do mostly.
        if face is None or (view.quarters != self.quarters and (face.disagreement or 0.0) > TURNED_AGREEMENT):
            return False
        roll = roll_of(face)
        if abs(roll) > _UPRIGHT:
            self.quarters, self.first_detection = (view.quarters + quarters_of(roll)) % 4, None
            return False
        self.quarters = view.quarters
        self._remember(view.seen, view.seen_by_camera(face), confirmed=True)
        return True

    def _remember(self, frame: Frame, face: Landmarks, confirmed: bool = False) -> None:
        """Let this be the first detection."""
        self._confirmed = confirmed
        with suppress(MienError):  # no face has such landmarks; the next frame may show it better
            straight = straightened(frame, face, self.camera)
            self.first_detection = straight, fit_first_frame(straight, self.camera)

    def _is_ready(self, face: Landmarks, first: Landmarks, fit: FirstFrame) -> bool:
        """Whether a face looks into the camera with open eyes; fit: of its first detection."""
        return turn_of(face, first, self.camera, fit.R, fit.t) <= TURNED_DEG and eye_opening(face) > _SHUT


def _trackable(view: Upright, faces: Iterable[Landmarks]) -> list[Landmarks]:
    """Those of the faces of a view that can be tracked, as the camera has seen them."""
    size = view.seen.width, view.seen.height
    return [face for face in map(view.seen_by_camera, faces) if face.are_trackable(*size)]
