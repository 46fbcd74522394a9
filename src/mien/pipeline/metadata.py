"""What NAME.json says of a track: everything needed to reproduce it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mien._version import __version__
from mien.candide.model import TRACKED_UNITS
from mien.errors import noted_warnings
from mien.output.recorder import Recorder
from mien.start.first_frame import Start
from mien.start.footage import requested_options
from mien.tracking.abilities import FittedTracker, axes_of, settings_of
from mien.tracking.state import Tracker


def metadata(
    begin: Start, preset: str, tracker: Tracker, recorder: Recorder, number: int, face_id: int, stopped: str | None
) -> Mapping[str, Any]:
    """The content of NAME.json. tracker: one that has learned the face; number: of the pass; face_id: index of the face
    in the video; stopped: why tracking ended before the video, None if it did not."""
    video = begin.footage.video
    stopped = stopped or video.stopped
    values: dict[str, Any] = {
        "mien": __version__,
        "complete": stopped is None,
        "stopped": stopped,
        "warnings": noted_warnings(),
        "frames": recorder.count,
        "video": {
            "name": video.name,
            "sha256": None if stopped else begin.footage.sha256,  # who stops does not wait until a file is read again
            **begin.footage.identity,
            "width": begin.first.width,
            "height": begin.first.height,
            "fps": video.fps if video.repeatable else None,  # what gives each frame once does not say its rate
            "interlaced": begin.first.interlaced,
        },
        "preset": preset,
        "passes": number,
        "face_id": face_id,
        "asked": requested_options(begin.footage, begin.at_once, begin.face, begin.footage.fps),
        "camera": begin.camera.to_dict(),
        "landmarks": begin.landmarks.to_dict() | {"source": begin.landmarks.source},
        "landmark_names": list(recorder.landmark_names),
        "mm_per_unit": recorder.mm_per_unit,
    }
    settings = settings_of(tracker)
    if settings:
        values["settings"] = settings
    if isinstance(tracker, FittedTracker):
        names = tracker.fit.model.shape_unit_names
        values["shape_units"] = dict(zip(names, (np.round(tracker.fit.sigma, 6) + 0.0).tolist(), strict=True))
        values["fit_residual_px"] = round(tracker.fit.residual_px, 4)
        values["mesh"] = _mesh_at_rest(tracker)
    return values


def _mesh_at_rest(tracker: FittedTracker) -> dict[str, Any]:
    """What `Track.mesh` needs: in millimetres and the axes of the head, as they are known now, the vertices (V, 3) at
    rest, and of each animation unit the displacements (m, 3) of those of the vertices that it moves."""
    fit, axes = tracker.fit, axes_of(tracker)
    to_head = fit.mm_per_unit * (np.eye(3) if axes is None else axes.R_model_head)
    units = {}
    for name, displacements in zip(TRACKED_UNITS, fit.model.animation_units, strict=True):
        moved = np.flatnonzero(np.abs(displacements).max(axis=1) > 0)
        units[name] = {"moved": moved.tolist(), "by": np.round(displacements[moved] @ to_head, 2).tolist()}
    return {"vertices": np.round(fit.shape @ to_head, 2).tolist(), "units": units}
