"""Trackers by name, with the settings of a file."""

from __future__ import annotations

import json
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mien
from mien.config import DescriptorSettings, PaperSettings, RealtimeSettings, Settings
from mien.config.realtime import AdaptationSettings, CovarianceSettings
from mien.errors import MienError
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.initialization.landmarks import Landmarks
from mien.registry import checked, create_tracker, file_of
from mien.tracking.paper import PaperTracker
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.state import Closing, Estimate, Status, TrackedLandmarks
from small_motion import face
from videos import portrait_images, write_video


def _written(path: Path, values: Any) -> Path:
    path.write_text(values if isinstance(values, str) else json.dumps(values), encoding="utf-8")
    return path


def test_settings_that_differ_come_from_a_file(tmp_path: Path) -> None:
    tracker = create_tracker(
        f"realtime:{_written(tmp_path / 'own.json', {'adaptation': {'view_rate': 0}, 'covariance': {'rank': 12}})}"
    )
    assert isinstance(tracker, RealtimeTracker)
    assert tracker.settings == RealtimeSettings(
        adaptation=AdaptationSettings(view_rate=0), covariance=CovarianceSettings(rank=12)
    )
    paper = create_tracker(f"paper:{_written(tmp_path / 'paper.json', {'seed': 3})}")
    assert isinstance(paper, PaperTracker)
    assert paper.settings == PaperSettings(seed=3)


def test_a_track_is_made_again_with_the_settings_that_it_has_written(tmp_path: Path) -> None:
    video, known = write_video(tmp_path / "face.mkv", portrait_images(), fps=25), face().landmarks
    own = _written(tmp_path / "own.json", {"views": {"per_angle": 5}})
    first = mien.track(video, preset=f"realtime:{own}", landmarks=known, save=tmp_path / "first.csv")
    again = mien.track(video, preset=f"realtime:{tmp_path / 'first.json'}", landmarks=known)
    assert first.metadata["settings"]["views"]["per_angle"] == 5
    assert again.metadata["settings"] == first.metadata["settings"]
    np.testing.assert_array_equal(again.euler_deg, first.euler_deg)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"view_rate": 0}, "own.json: view_rate: unknown setting; mien.config.RealtimeSettings lists them all"),
        ({"adaptation": {"view_rat": 0}}, "own.json: adaptation.view_rat: unknown setting; mien.config.Real"),
        ({"covariance": {"rank": -1}}, "own.json: covariance.rank: input should be greater than or equal to 0"),
        ({"descriptor": {"cell": "four"}}, "own.json: descriptor.cell: input should be a valid integer"),
        ({"settings": {"preset": "paper"}}, "own.json: preset: input should be 'realtime'"),
        ({"covariance": {"floor": float("inf")}}, "own.json: covariance.floor: input should be a finite number"),
        (
            {"views": {"limit_pan_deg": 80}},
            "own.json: views.turned_limit_pan_deg: value error, must be larger than limit_pan_deg",
        ),
        (
            {"weights": {"expected_distance": 1}},
            "own.json: weights.least_distance: value error, must not be larger than expected_distance",
        ),
        (
            {"recovery": {"least_share": 0.9}},
            "own.json: recovery.recovered_share: value error, must not be smaller than least_share",
        ),
        ({"descriptor": {"kernel": "opencv"}}, "own.json: descriptor: value error, the kernel must be mien"),
        ({"weights": 3}, "own.json: weights: input should be settings keyed by name; mien.config.RealtimeSettings"),
        ({"settings": {}, "weights": {}}, "own.json: weights: stands beside `settings` .*; move it into them"),
        ([1], "own.json holds no settings keyed by name"),
        ({"settings": 1}, "own.json holds no settings keyed by name"),
        ("{", "own.json is not valid JSON"),
    ],
)
def test_settings_that_are_wrong_are_refused_by_name(tmp_path: Path, values: Any, message: str) -> None:
    with pytest.raises(MienError, match=message):
        create_tracker(f"realtime:{_written(tmp_path / 'own.json', values)}")


@pytest.mark.parametrize("preset", ["realtime", "paper"])
def test_the_settings_that_are_advised_are_read(tmp_path: Path, preset: str) -> None:
    with pytest.raises(MienError, match="give JSON like") as refused:
        create_tracker(f"{preset}:{_written(tmp_path / 'own.json', [])}")
    advised = json.loads(str(refused.value).partition("give JSON like ")[2])
    found = create_tracker(f"{preset}:{_written(tmp_path / 'own.json', advised)}").settings
    assert found == create_tracker(preset).settings


def test_settings_within_settings_that_are_not_given_are_those_of_the_preset(tmp_path: Path) -> None:
    own = _written(tmp_path / "own.json", {"descriptor": {"cell": 5}})
    for preset, kind in (("realtime", RealtimeSettings), ("paper", PaperSettings)):
        found, default = create_tracker(f"{preset}:{own}").settings.descriptor, kind().descriptor
        assert found == default.model_copy(update={"cell": 5})


def test_a_file_that_is_not_there_and_one_that_nobody_reads(tmp_path: Path) -> None:
    with pytest.raises(MienError, match=r"none\.json cannot be read"):
        create_tracker(f"realtime:{tmp_path / 'none.json'}")
    with pytest.raises(MienError, match="realtime: names no file after the colon"):
        create_tracker("realtime:")
    with pytest.raises(MienError, match="xiao-2003 reads no file"):
        create_tracker("xiao-2003:own.json")
    assert file_of("realtime:own.json") == Path("own.json")
    assert file_of("realtime") is file_of("mymodule:MyTracker") is None


OWN = """
class Whole:
    def initialize(self, frame, landmarks, camera): ...
    def track(self, frame): ...

class Half:
    def track(self, frame): ...

class Choosy(Whole):
    def __init__(self, needed): ...

class Silent(dict, Whole): ...

class Faulty(Whole):
    def __init__(self):
        len(5)

class Leaving(Whole):
    def __init__(self):
        raise SystemExit(0)
"""


def test_a_tracker_of_your_own_is_found_where_python_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "own_trackers_here.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [folder for folder in sys.path if folder])
    assert type(create_tracker("own_trackers_here:Whole")).__name__ == "Whole"
    assert type(create_tracker("own_trackers_here:Silent")).__name__ == "Silent"  # it says nothing of its arguments
    assert "" not in sys.path
    with pytest.raises(MienError, match="the module own_trackers_here has no class Hole"):
        create_tracker("own_trackers_here:Hole")
    with pytest.raises(MienError, match="own_trackers_here:Half has no method initialize; see"):
        create_tracker("own_trackers_here:Half")
    with pytest.raises(MienError, match=r"Choosy cannot be created \(missing.*needed.*it must need no arguments"):
        create_tracker("own_trackers_here:Choosy")
    with pytest.raises(TypeError, match=r"len\(\)"):  # its own fault, with its own traceback
        create_tracker("own_trackers_here:Faulty")
    with pytest.raises(MienError, match=r"own_trackers_here:Leaving called sys\.exit\(0\)"):
        create_tracker("own_trackers_here:Leaving")
    (tmp_path / "a_script.py").write_text("import sys\nsys.exit('done')\n")
    with pytest.raises(MienError, match=r"a_script:Whole called sys\.exit\('done'\)"):
        create_tracker("a_script:Whole")
    for name in ("not_there_at_all:Whole", ":Whole", ".own_trackers_here:Whole"):
        with pytest.raises(MienError, match=f"unknown tracker '{re.escape(name)}'; .*realtime:FILE or paper:FILE with"):
            create_tracker(name)
    with pytest.raises(MienError, match="math:sin cannot be created"):
        create_tracker("math:sin")


@pytest.mark.parametrize("settings", [{}, {"adaptation": {"view_rate": 0}}, "own.json", Settings()])
def test_a_tracker_takes_only_settings_of_its_own_kind(settings: Any) -> None:
    with pytest.raises(MienError, match=r"give mien\.config\.RealtimeSettings"):
        RealtimeTracker(settings)
    with pytest.raises(MienError, match=r"give mien\.config\.PaperSettings"):
        PaperTracker(settings)


def test_an_estimate_belongs_to_its_frame() -> None:
    frame = Frame(np.zeros((8, 8, 3), np.uint8), 3, 0.12)
    estimate = Estimate.lost(frame, "behind a hand")
    assert checked(estimate, PaperTracker(), frame) is estimate
    with pytest.raises(MienError, match=r"PaperTracker returned the estimate of frame 3 for frame 4"):
        checked(estimate, PaperTracker(), Frame(frame.pixels, 4, 0.16))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"status": "tracked"}, "no mien.Status"),
        ({"confidence": float("nan")}, "not between 0 and 1"),
        ({"rotation": np.ones((3, 3))}, "not a rotation matrix"),
        ({"rotation": [1.0, 0.0, 0.0]}, "not a rotation matrix"),
        ({"rotation": np.diag([1.0, 1.0, -1.0])}, "not a rotation matrix"),
        ({"model_rotation": np.eye(2)}, "not a rotation matrix"),
        ({"status": Status.LOST}, "a rotation that belongs to a lost frame"),
        ({"translation": np.zeros(2)}, r"no array \(3,\) of finite numbers as translation, but one \(2,\)"),
        ({"translation": np.full(3, np.nan)}, r"as translation, but array\(\[nan, nan, nan\]\)"),
        ({"translation": [0.0, 0.0, 9.0]}, r"as translation, but \[0.0, 0.0, 9.0\]"),
        ({"translation": np.array([0, 0, None])}, "as translation, but"),
        ({"animation": np.zeros(3)}, r"no array \(6,\) of finite numbers as animation, but one \(3,\)"),
        ({"animation": np.full(6, np.inf)}, "as animation, but"),
        ({"covariance": np.eye(6)}, r"no array \(12, 12\) .* as covariance, but one \(6, 6\)"),
        ({"covariance": np.full((12, 12), np.nan)}, "as covariance, but"),
        ({"covariance": -np.eye(12)}, "a covariance with the negative variance -1"),
        ({"confidence": None}, "not between 0 and 1"),
        ({"time": float("nan")}, "the time nan, which is not that of the frame"),
        ({"mm_per_unit": float("nan")}, "nan millimetres per unit, which is no positive number"),
        ({"mm_per_unit": None}, "None millimetres per unit"),
        ({"reason": None}, "the reason None, which is no text"),
        ({"closing": 0.5}, "the closing 0.5, which is no mien.Closing of finite numbers"),
        ({"closing": Closing(0.5, float("nan"))}, r"the closing Closing\(.*nan\), which is no mien.Closing"),
        ({"landmarks": [[1, 2]]}, r"the landmarks \[\[1, 2\]\], which are no mien.TrackedLandmarks"),
        ({"landmarks": TrackedLandmarks((np.int64(3),), np.zeros((1, 2)))}, "the names .*3.*, which are not all text"),  # type: ignore[arg-type]
        ({"landmarks": TrackedLandmarks(("tip",), np.zeros(2))}, r"1 landmarks whose image is no array \(1, 2\)"),
        ({"landmarks": TrackedLandmarks(("tip",), np.zeros((1, 2)), np.zeros((2, 3)))}, "whose camera is no array"),
        ({"landmarks": TrackedLandmarks(("tip",), [[1, 2]])}, r"image is no array \(1, 2\), but \[\[1, 2\]\]"),  # type: ignore[arg-type]
    ],
)
def test_what_a_tracker_of_ones_own_returns_is_checked(changes: dict[str, Any], message: str) -> None:
    class Own:
        def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
            return self.track(frame)

        def track(self, frame: Frame) -> Estimate:
            return replace(Estimate(frame.index, frame.time, Status.TRACKED, np.eye(3)), **changes)

    frame = Frame(np.zeros((8, 8, 3), np.uint8), 3, 0.12)
    own = Own()
    with pytest.raises(MienError, match=f"Own returned for frame 3 .*{message}"):
        checked(own.track(frame), own, frame)


@pytest.mark.parametrize("settings", [PaperSettings, RealtimeSettings])
def test_every_setting_says_what_it_is(settings: type[Settings]) -> None:
    """A group does so in its docstring, as do the descriptors."""
    groups = {
        name: field.default for name, field in settings.model_fields.items() if isinstance(field.default, Settings)
    }
    for group in (settings, *map(type, groups.values())):
        assert group.__doc__
        if group is not DescriptorSettings:
            own = {name: field for name, field in group.model_fields.items() if name not in {"preset", *groups}}
            assert own or group is RealtimeSettings
            assert all(field.description for field in own.values())
