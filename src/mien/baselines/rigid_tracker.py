"""Shared by the trackers with a rigid surface, apart from the registration: first frame, loss, and what is reported."""

from __future__ import annotations

from abc import ABC, abstractmethod

from mien.baselines.rigid_head import RigidHead
from mien.baselines.surface import Pose, Surface
from mien.baselines.view import View, look, look_first
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.initialization.fit import FirstFrame, fit_first_frame
from mien.initialization.landmarks import Landmarks
from mien.tracking.state import Estimate, Status, require_first, require_next_of


class RigidTracker(ABC):
    """A tracker of a rigid head that learns from the first frame and registers every other, starting from the last.

    A lost head is also searched for where the face of the first frame matches best. A head that is found outside the
    image, or turned away, is lost too.
    """

    size: tuple[int, int] | None = None
    """Width and height of the first frame."""

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        """Fit the surface to the first frame's face and learn its appearance. Raises MienError for landmarks that
        cannot be tracked."""
        require_first(frame, landmarks, camera)
        self.size = None  # until the face is known
        fit = fit_first_frame(landmarks, camera)
        self.head = RigidHead.from_first_frame(frame, fit, camera, self.surface_of(fit))
        self.pose = self.head.first
        self._was_lost = False
        self._learn(look_first(frame, self.pose, camera))
        self.size = frame.width, frame.height
        return self.head.estimate(frame, Status.INITIALIZED, self.pose)

    def track(self, frame: Frame) -> Estimate:
        """Register the next frame and learn from it. Raises MienError before `initialize`, and for a frame whose size
        differs from the first one's."""
        require_next_of(self.size, frame)
        view, found = self._registered(frame)
        if found is None or view is None or not self.head.in_sight(frame, found):
            self._was_lost = True
            return self.head.lost(frame, self.pose if found is None else found)
        self.pose = found
        self._adapt(view)
        status = Status.RECOVERED if self._was_lost else Status.TRACKED
        self._was_lost = False
        return self.head.estimate(frame, status, self.pose)

    def _registered(self, frame: Frame) -> tuple[View | None, Pose | None]:
        """The view of a frame and the pose at which it is registered."""
        view = look(frame, self.pose, self.head.camera)
        found = None if view is None else self._follow(view)
        if found is None and self._was_lost:
            start = self.head.relocate(frame)
            view = look(frame, start, self.head.camera)
            found = None if view is None else self._recover(view, start)
        return view, found

    @staticmethod
    @abstractmethod
    def surface_of(fit: FirstFrame) -> Surface:
        """The surface of the face that was fitted to the first frame."""

    @abstractmethod
    def _learn(self, view: View) -> None:
        """Learn from the view of the first frame, at `pose`."""

    @abstractmethod
    def _follow(self, view: View) -> Pose | None:
        """The pose of the head in a view, starting from the last one, `pose`."""

    @abstractmethod
    def _recover(self, view: View, start: Pose) -> Pose | None:
        """The pose of a lost head in a view, starting from where it probably is, in the first frame's rotation."""

    def _adapt(self, view: View) -> None:  # noqa: B027 (most of these trackers do not)
        """Learn from a view in which the head was found at `pose`; may correct that."""
