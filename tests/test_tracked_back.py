"""The pipeline with the tracker that people use, from a first frame in the middle: what it has learned on the way back
and forwards is in what is written, also if it is stopped between the two."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import mien
from mien.arrays import Array
from mien.config import RealtimeSettings
from mien.config.realtime import AxesSettings
from mien.errors import MienWarning
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.initialization.landmarks import LANDMARK_NAMES, LANDMARK_VERTICES, Landmarks
from mien.output.track import Track
from mien.synthetic import make_sequence, moved
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.state import Estimate
from own_trackers import use_tracker
from small_motion import face

_FIRM = [name for name in LANDMARK_NAMES if name.startswith("nose") or "eye_inner" in name]
_TURNS_DEG = np.concatenate([np.linspace(-24, 0, 9), np.linspace(3, 24, 8)])
_FIRST = 8


class LeaningTracker(RealtimeTracker):
    """Its head axes follow the shape so far that it matters which axes are written."""

    def __init__(self, before: RealtimeTracker | None = None) -> None:
        settings = RealtimeSettings(axes=AxesSettings(tilt_share=9.0, pan_share=9.0))
        super().__init__(settings, before=before.person if before else None)

    def again(self) -> LeaningTracker:
        return LeaningTracker(self)


class Stopped(LeaningTracker):
    """Is interrupted as it begins again."""

    def again(self) -> Stopped:
        return Stopped(self)

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        if self.before is not None:
            raise KeyboardInterrupt
        return super().initialize(frame, landmarks, camera)


@cache
def frames() -> list[Frame]:
    angles = np.stack([0.3 * _TURNS_DEG, _TURNS_DEG, 0 * _TURNS_DEG], axis=1)
    n = len(angles)
    sequence = make_sequence(face(), moved(face(), angles, np.zeros((n, 3)), np.zeros((n, 6))), noise_sd=2)
    return [Frame(frame.pixels, k, k / 30) for k, frame in enumerate(sequence.frames)]


def track(monkeypatch: pytest.MonkeyPatch, tracker: type[RealtimeTracker], save: Path | None = None) -> Track:
    use_tracker(monkeypatch, lambda preset: tracker())
    first = frames()[_FIRST]
    marks = replace(face().landmarks, frame_index=first.index, time=first.time)
    return mien.track(frames(), landmarks=marks, camera=face().camera, save=save)


def mesh_error_px(of: Track) -> Array:
    """Mean distance (n,) of firm landmarks from the vertices of the mesh that are theirs."""
    camera, seen = Camera(**of.metadata["camera"]), of.landmarks
    assert seen is not None
    error = np.empty(len(of))
    for row in range(len(of)):
        mesh = of.mesh(row)
        assert mesh is not None
        shown = camera.project(mesh[[LANDMARK_VERTICES[name] for name in _FIRM]])[0]
        error[row] = np.linalg.norm(shown - seen[row, [LANDMARK_NAMES.index(n) for n in _FIRM]], axis=1).mean()
    return error


def test_the_mesh_of_the_files_lies_on_the_face_on_both_sides_of_the_first_frame(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    done = track(monkeypatch, LeaningTracker)
    assert done.index.tolist() == list(range(len(_TURNS_DEG)))
    assert mesh_error_px(done).max() < 2


def test_stopped_as_the_way_forwards_begins_the_way_back_is_kept(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with pytest.warns(MienWarning, match=f"stopped after {_FIRST} frames"), pytest.raises(KeyboardInterrupt):
        track(monkeypatch, Stopped, tmp_path / "out")
    kept = Track.read(tmp_path / "out")
    assert kept.index.tolist() == list(range(_FIRST))
    assert mesh_error_px(kept).max() < 2
