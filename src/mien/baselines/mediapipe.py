"""MediaPipe Face Mesh for comparison: its 478 landmarks, and PnP with its own mesh of the first frame.

The network estimates the depth of each landmark relative to the head's centre, in pixels. The landmarks of the first
frame, back-projected with these depths, are the rigid mesh; the pose of every later frame is the PnP solution between
that mesh and the frame's landmarks, with the camera of the sequence. The mesh is aligned to CANDIDE once, so that
angles are zero when the face looks into the camera, and lengths are in CANDIDE units.
"""

from __future__ import annotations

import cv2
import numpy as np

from mien.arrays import Array
from mien.candide.model import Candide, mm_per_unit
from mien.errors import MienError
from mien.frame import Frame
from mien.geometry.camera import Camera, back_project
from mien.geometry.rotation import exp, log, similarity
from mien.initialization.landmarks import Landmarks, in_common, is_same_place, place_of, rows_of_scheme, rows_reported
from mien.initialization.mediapipe_mesh import face_mesh, read_faces, silenced
from mien.tracking.state import Estimate, Status, TrackedLandmarks, require_next_of

NOT_INSTALLED = "the tracker 'mediapipe' needs MediaPipe: pip install mediapipe==0.10.21 (Python 3.10 to 3.12)"
NO_FACE = "MediaPipe sees no face"
NO_MESH = "MediaPipe saw no face in the first frame, from which it would have had its mesh"
OTHER_FACE = "MediaPipe chooses for itself and saw another face in the first frame than the one to track"


class MediaPipeTracker:
    """MediaPipe 0.10.21 Face Mesh in video mode with refined landmarks.

    It detects the face itself, whatever landmarks are given to `initialize`; if it is another one than theirs, the face
    is lost in all frames. It estimates neither animation nor covariance; its confidence is 1 whenever it detects a
    face, as it reports none.
    """

    def __init__(self) -> None:
        try:
            self._mesh = face_mesh(1, static=False)
        except ImportError as e:
            raise MienError(NOT_INSTALLED) from e
        self._model = Candide.default().vertices()
        self._mm_per_unit = mm_per_unit(self._model)
        self._shape: Array | None = None
        self.size: tuple[int, int] | None = None
        rows = rows_reported("mediapipe478")
        self._names, self._rows = tuple(rows), np.array(list(rows.values()))

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        """Detect the face, and use its landmarks with their depths as the mesh."""
        self.size, self._camera = (frame.width, frame.height), camera
        self._shape, self._lost, self._unlearned = None, False, NO_MESH
        with silenced():
            self._mesh.reset()  # it would look for the face where it has last seen one
            points = self._detect(frame)
        if points is None:
            return Estimate.lost(frame, NO_FACE, self._mm_per_unit)
        seen, given = in_common(dict(zip(self._names, self._reported(points), strict=True)), landmarks.reported())
        if not is_same_place(*place_of(seen), *place_of(given)):
            self._unlearned = OTHER_FACE
            return Estimate.lost(frame, OTHER_FACE, self._mm_per_unit)
        X = back_project(points, camera)
        vertices, rows = rows_of_scheme("mediapipe478")
        scale, R, t = similarity(self._model[vertices], X[rows].mean(axis=1))
        self._shape = (X - t) @ R / scale
        self._R, self._t = R, t / scale
        return self._estimate(frame, points, Status.INITIALIZED)

    def track(self, frame: Frame) -> Estimate:
        """The pose of the face by PnP, starting from that of the last frame. Raises MienError before `initialize`, and
        for a frame whose size differs from the first one's."""
        require_next_of(self.size, frame)
        points = self._detect(frame)
        if points is None or self._shape is None:
            self._lost = True
            return Estimate.lost(frame, NO_FACE if points is None else self._unlearned, self._mm_per_unit)
        status, self._lost = Status.RECOVERED if self._lost else Status.TRACKED, False
        self._R, self._t = solve_pnp(self._shape, points[:, :2], self._camera, self._R, self._t)
        return self._estimate(frame, points, status)

    def _estimate(self, frame: Frame, points: Array, status: Status) -> Estimate:
        assert self._shape is not None
        X = self._shape[self._rows].mean(axis=1) @ self._R.T + self._t
        seen = TrackedLandmarks(self._names, self._reported(points), X)
        return Estimate(
            frame.index,
            frame.time,
            status,
            rotation=self._R,
            translation=self._t,
            landmarks=seen,
            confidence=1.0,
            mm_per_unit=self._mm_per_unit,
        )

    def _reported(self, points: Array) -> Array:
        """The reported landmarks (25, 2) of points (478, 3)."""
        return np.asarray(points[self._rows, :2].mean(axis=1))

    def _detect(self, frame: Frame) -> Array | None:
        """Landmarks (478, 3) in pixels, the third coordinate a depth relative to the head's centre; None without a
        face."""
        faces = read_faces(self._mesh, frame.pixels)
        return faces[0] if faces else None


def solve_pnp(shape: Array, pixels: Array, camera: Camera, R: Array, t: Array) -> tuple[Array, Array]:
    """Pose of a rigid shape (n, 3) seen at pixels (n, 2), by Levenberg-Marquardt from the pose R, t."""
    # OpenCV writes its result into the starting values.
    _, rotation, translation = cv2.solvePnP(
        shape,
        np.ascontiguousarray(pixels),
        camera.matrix,
        None,
        log(R)[:, None],
        t[:, None].copy(),
        True,
        cv2.SOLVEPNP_ITERATIVE,
    )
    return exp(rotation.ravel()), np.asarray(translation.ravel())
