"""Running, resuming, isolation: in real processes."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np
import pytest

from evaluation import tiny
from mien.errors import MienError, MienWarning
from mien.evaluation import benchmark
from mien.evaluation.benchmark import _select, first_frame_job, run_plan, track_job
from mien.evaluation.datasets import load_dataset
from mien.evaluation.plan import Evaluation, Plan, command_of, label, result_path, timing_path
from mien.evaluation.results import SequenceResult, Timing
from mien.evaluation.scores import load_scores
from mien.evaluation.tables import by_kind
from mien.initialization.landmark_files import write_landmarks
from mien.initialization.landmarks import Landmarks
from mien.processes import Call, Command, Ended, run_commands

STILL, SHIFTED = "evaluation.tiny:Still", "evaluation.tiny:Shifted"


def _plan(root: Path, *trackers: str, names: tuple[str, ...] = ("a_uniform1",)) -> Plan:
    data = tiny.rendered(root / "data", names)
    return Plan("rendered", data, root / "out", trackers, landmarks="truth", timed=0)


def _result(plan: Plan, tracker: str, sequence: str = "a_uniform1") -> SequenceResult:
    return SequenceResult.load(result_path(plan.out, tracker, sequence))


def test_everything_is_run_once_and_kept(tmp_path: Path) -> None:
    plan = _plan(tmp_path, STILL, names=("a_uniform1", "b_wide1"))
    seen: list[tuple[int, int]] = []
    run_plan(plan, progress=lambda done, total, name: seen.append((done, total)))
    assert seen[-1] == (2, 2)
    files = sorted(plan.out.rglob("*.npz"))
    before = {f: f.stat().st_mtime_ns for f in files}
    assert len(before) == 2

    result_path(plan.out, STILL, "b_wide1").unlink()  # as if the run had been stopped
    run_plan(plan)
    after = {f: f.stat().st_mtime_ns for f in sorted(plan.out.rglob("*.npz"))}
    assert set(after) == set(before)
    kept = result_path(plan.out, STILL, "a_uniform1")
    assert after[kept] == before[kept]
    assert after != before


def test_a_result_of_other_settings_is_made_again(tmp_path: Path) -> None:
    plan = _plan(tmp_path, STILL)
    run_plan(plan)
    run_plan(replace(plan, focal_px=400.0))
    assert _result(plan, STILL).settings["focal_px"] == 400.0


def test_a_report_after_a_run_that_was_stopped_warns_of_older_results(tmp_path: Path) -> None:
    plan = _plan(tmp_path, STILL, names=("a_uniform1", "b_wide1"))
    run_plan(plan)
    load_scores(plan.out)

    def stop(done: int, total: int, name: str) -> None:
        if done == 1:
            raise KeyboardInterrupt

    other = replace(plan, focal_px=400.0)
    with pytest.raises(KeyboardInterrupt):
        run_plan(other, progress=stop)
    with pytest.warns(MienWarning, match="out has results of different focal lengths; run mien evaluate again"):
        load_scores(plan.out)
    run_plan(other)
    load_scores(plan.out)


def test_a_result_that_is_kept_is_of_the_kind_that_the_sequence_has_now(tmp_path: Path) -> None:
    """As the name of a folder tells it, which does not change the videos in it."""
    plan = replace(_plan(tmp_path, STILL), dataset="buft", root=tiny.buft(tmp_path / "set"), landmarks="detected")
    (sequence,) = load_dataset(plan.dataset, plan.root)
    first = Path(first_frame_job(plan, sequence).out)
    first.parent.mkdir(parents=True)
    write_landmarks(first, Landmarks(tiny.face68(), "ibug68"))
    run_plan(plan)
    made = result_path(plan.out, STILL, "jam1").stat().st_mtime_ns
    run_plan(replace(plan, root=plan.root.rename(tmp_path / "set_vary")))
    assert result_path(plan.out, STILL, "jam1").stat().st_mtime_ns == made
    (row,) = by_kind(load_scores(plan.out)).rows
    assert "0 of 6" in row
    assert "—" not in row


def test_landmarks_are_detected_again_for_another_focal_length(tmp_path: Path) -> None:
    """A face at the side of the image is straightened by it."""
    plan = _plan(tmp_path, STILL)
    (sequence, *_) = load_dataset(plan.dataset, plan.root)
    for source, files in (("detected", 3), ("truth", 1)):
        plans = [replace(plan, landmarks=source, focal_px=focal) for focal in (None, 400.0, 500.0)]
        assert len({first_frame_job(one, sequence).out for one in plans}) == files


@pytest.mark.parametrize("source", ["detected", "truth"])
def test_first_landmarks_are_made_again_by_other_code(
    source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As by a detector, or a reader of the truth, that was corrected."""
    plan = replace(_plan(tmp_path, STILL), landmarks=source)
    (sequence, *_) = load_dataset(plan.dataset, plan.root)
    before = first_frame_job(plan, sequence).out
    monkeypatch.setattr(benchmark, "code_checksum", lambda: "corrected")
    assert first_frame_job(plan, sequence).out != before


def test_failures_are_rows_and_stop_nothing(tmp_path: Path) -> None:
    trackers = [
        f"evaluation.tiny:{name}" for name in ("Raises", "Exits", "Vanishes", "Crashes", "Hangs", "Still", "Missing")
    ]
    plan = _plan(tmp_path, *trackers)
    run_plan(plan, jobs=2, time_limit=15.0)
    reasons = {t.split(":")[1]: _result(plan, t).failure for t in trackers}
    assert reasons["Raises"].startswith("RuntimeError: the third frame is too much (tiny.py, line")
    assert reasons["Exits"].startswith("evaluation.tiny:Exits called sys.exit(0)")
    assert reasons["Vanishes"] == "the process ended without a result"
    assert reasons["Crashes"] == "the process crashed (SIGSEGV)"
    assert reasons["Hangs"] == "no end within 15 s; stopped"
    assert reasons["Still"] == ""
    assert reasons["Missing"].endswith("the module evaluation.tiny has no class Missing")
    scores = load_scores(plan.out)
    assert [bool(s.failure) for s in scores.scores] == [True, True, True, True, True, False, True]


def test_what_is_warned_of_is_kept_with_the_result(tmp_path: Path) -> None:
    """Once, however often it is said."""
    plan = _plan(tmp_path, STILL, "evaluation.tiny:Warns", names=("a_uniform1", "b_wide1"))
    run_plan(plan, jobs=2)
    (poor,) = load_scores(plan.out).warnings.items()
    assert poor[0] == "the light is poor"
    assert [(r.tracker, r.sequence) for r in poor[1]] == [
        (plan.trackers[1], name) for name in ("a_uniform1", "b_wide1")
    ]


def test_a_damaged_sequence_is_a_row(tmp_path: Path) -> None:
    plan = _plan(tmp_path, STILL, names=("a_uniform1", "b_wide1", "c_light1"))
    (plan.root / "b_wide1.avi").write_bytes(b"no video at all")
    np.savez(plan.root / "c_light1_truth.npz", R=np.full((6, 3, 3), np.nan))
    run_plan(plan, jobs=2)
    assert _result(plan, STILL).failure == ""
    assert "b_wide1.avi" in _result(plan, STILL, "b_wide1").failure
    assert "not a finite number" in _result(plan, STILL, "c_light1").failure


def test_jobs_do_not_change_the_numbers(tmp_path: Path) -> None:
    names = ("a_uniform1", "b_wide1")
    one = _plan(tmp_path, STILL, SHIFTED, names=names)
    two = replace(one, out=tmp_path / "out2", trackers=(SHIFTED, STILL))
    run_plan(one, jobs=1)
    run_plan(two, jobs=2)
    for tracker in (STILL, SHIFTED):
        for name in names:
            a, b = _result(one, tracker, name).track, _result(two, tracker, name).track
            assert a is not None
            assert b is not None
            for field in ("time", "rotation", "landmarks", "expression", "confidence"):
                np.testing.assert_array_equal(getattr(a, field), getattr(b, field))


def test_timings_come_from_runs_of_their_own(tmp_path: Path) -> None:
    plan = replace(_plan(tmp_path, STILL, names=("a_uniform1", "b_wide1")), timed=1)
    started: list[str] = []
    run_plan(plan, jobs=2, progress=lambda done, total, name: started.append(name))
    assert started[-1] == f"timing {STILL} · a_uniform1"
    timing = Timing.load(timing_path(plan.out, STILL, "a_uniform1"))
    assert len(timing.frame_seconds) == tiny.FRAMES - 1
    assert not timing_path(plan.out, STILL, "b_wide1").exists()
    assert load_scores(plan.out).timings == (timing,)


@pytest.mark.parametrize("forked", [False, True])
def test_openface_output_beside_a_tracker(forked: bool, tmp_path: Path) -> None:
    folder = tmp_path / "openface"
    folder.mkdir()
    rows = "\n".join(f"{i + 1}, {i / 25}, 1, 0, 0.1, 0" for i in range(tiny.FRAMES))
    (folder / "a_uniform1.csv").write_text(f"frame, timestamp, success, pose_Rx, pose_Ry, pose_Rz\n{rows}\n")
    plan = _plan(tmp_path, f"openface:{folder}", names=("a_uniform1", "b_wide1"))
    run_plan(replace(plan, timed=1), forked=forked)
    read = _result(plan, "openface:openface")
    assert read.track is not None
    assert not read.track.lost.any()
    assert "no such file" in _result(plan, "openface:openface", "b_wide1").failure
    assert not (plan.out / "timing").exists()
    alone = replace(plan, trackers=(f"openface:{folder / 'a_uniform1.csv'}",))
    with pytest.raises(MienError, match="is one file for 2 sequences; give a folder"):
        run_plan(alone)
    run_plan(replace(alone, sequences=("a_uniform1",)))


def test_openface_output_below_the_home_of_the_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    (tmp_path / "of").mkdir()
    assert _plan(tmp_path, "openface:~/of").trackers == ("openface:~/of",)
    with pytest.raises(MienError, match="~/none does not exist"):
        _plan(tmp_path, "openface:~/none")


def test_what_may_be_forked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is not timed, of trackers of mien: those of your own have a new process, a timed one is as it was."""
    asked: list[tuple[str, bool]] = []

    def run(
        commands: list[Command | Call], jobs: int, limit: float, started: Callable[[str], None], forked: bool
    ) -> Iterator[Ended]:
        asked.extend((command.name.partition(" · ")[0], forked and isinstance(command, Call)) for command in commands)
        for command in commands:
            started(command.name)
        return run_commands(commands, jobs, limit)

    monkeypatch.setattr(benchmark, "run_commands", run)
    plan = _plan(tmp_path, STILL, "lefevre-2009")
    run_plan(replace(plan, timed=1), forked=True)
    assert asked[:3] == [("first frame", True), (STILL, False), ("lefevre-2009", True)]
    assert asked[3:] == [(f"timing {STILL}", False), ("timing lefevre-2009", False)]


def test_settings_of_a_file_are_a_tracker_of_their_own(tmp_path: Path) -> None:
    own = tmp_path / "own.json"
    own.write_text('{"adaptation": {"view_rate": 0}}')
    plan = _plan(tmp_path, STILL, f"realtime:{own}")
    sequence = load_dataset("rendered", plan.root)[0]
    before = track_job(plan, plan.trackers[1], sequence)
    assert before.settings["tracker"] == label(plan.trackers[1]) == "realtime:own.json"
    changed = tmp_path / "changed" / "own.json"
    changed.parent.mkdir()
    changed.write_text('{"adaptation": {"view_rate": 0.1}}')
    assert track_job(plan, f"realtime:{changed}", sequence).settings != before.settings
    own.write_text('{"view_rat": 0}')
    with pytest.raises(MienError, match="view_rat: unknown setting"):
        replace(plan)


def test_the_code_of_a_result_includes_all_that_a_job_imports_of_the_evaluation() -> None:
    package = Path(benchmark.__file__).parent
    waiting, entered = {"job.py"}, set[str]()
    while waiting:
        entered.add(name := waiting.pop())
        modules = [package / name] if name.endswith(".py") else sorted((package / name).glob("*.py"))
        parsed = (ast.walk(ast.parse(module.read_text(encoding="utf-8"))) for module in modules)
        imports = (node.module or "" for node in chain.from_iterable(parsed) if isinstance(node, ast.ImportFrom))
        parts = {name.split(".")[2] for name in imports if name.startswith("mien.evaluation.")}
        waiting |= {part if (package / part).is_dir() else f"{part}.py" for part in parts} - entered
    assert {("evaluation", name) for name in entered} == set(benchmark.READERS)


def test_a_tracker_of_ones_own_that_has_changed_runs_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for folder, tracker in ((tmp_path, "Still"), (tmp_path / "changed", "Shifted")):
        folder.mkdir(exist_ok=True)
        (folder / "own_tracker.py").write_text(f"from evaluation.tiny import {tracker} as T\n")
    monkeypatch.chdir(tmp_path)
    plan = _plan(tmp_path, "own_tracker:T")
    sequence = load_dataset("rendered", plan.root)[0]
    before = track_job(plan, plan.trackers[0], sequence)
    assert track_job(plan, plan.trackers[0], sequence).settings == before.settings
    monkeypatch.chdir(tmp_path / "changed")
    assert track_job(plan, plan.trackers[0], sequence).settings != before.settings
    with pytest.raises(MienError, match="other_tracker:T: there is no module other_tracker here"):
        replace(plan, trackers=("other_tracker:T",))


def test_commands_in_processes() -> None:
    def python(code: str) -> Command:
        return Command(code, (sys.executable, "-c", code))

    commands = [
        python("pass"),
        python("import sys; print('reason: too late'); print('noise'); sys.exit(1)"),
        python("raise SystemExit(3)"),
        python("import sys; sys.exit('alas')"),
    ]
    started: list[str] = []
    ended = {one.index: one.reason for one in run_commands(commands, 2, 60.0, started.append)}
    assert ended == {0: "", 1: "too late", 2: "the process ended with status 3", 3: "alas"}
    assert started == [c.name for c in commands]
    with pytest.raises(MienError, match="at least 1"):
        list(run_commands(commands, 0, 60.0))


def test_plans_that_are_refused(tmp_path: Path) -> None:
    plan, alike = _plan(tmp_path, STILL), (tmp_path / "a+1.csv", tmp_path / "a-1.csv")
    for file in alike:
        file.touch()
    for change, message in (
        ({"trackers": ("papper",)}, "unknown tracker 'papper'; the trackers are realtime, paper"),
        ({"trackers": ()}, "no tracker was named"),
        ({"trackers": ("paper", "paper")}, "more than one tracker would have its results in tracks/paper"),
        ({"trackers": tuple(f"openface:{file}" for file in alike)}, "tracks/openface-a-1.csv"),
        ({"trackers": ("openface",)}, "openface:PATH"),
        ({"trackers": ("openface:/no/such/folder",)}, "does not exist"),
        ({"protocol": "best"}, "unknown protocol"),
        ({"landmarks": "guessed"}, "detected or truth"),
        ({"lost_deg": 0.0}, "must be positive"),
        ({"focal_px": -1.0}, "must be positive"),
        ({"timed": -1}, "must not be negative"),
    ):
        with pytest.raises(MienError, match=message):
            replace(plan, **change)
    with pytest.raises(MienError, match="has no sequence z1; it has a_uniform1"):
        run_plan(replace(plan, sequences=("z1",)))
    with pytest.raises(MienError, match="unknown data set"):
        run_plan(replace(plan, dataset="bu"))


def test_sequences_are_chosen_by_name(tmp_path: Path) -> None:
    """Also those with a comma in their name, which is between names, too."""
    plan = _plan(tmp_path, STILL, names=("a_uniform1", "b, c_wide1", "b", "d,e"))

    def chosen(*names: str) -> list[str]:
        return [s.name for s in _select(load_dataset("rendered", plan.root), names)]

    assert chosen() == chosen(" ") == ["a_uniform1", "b, c_wide1", "b", "d,e"]
    for names in (("b,a_uniform1",), (" a_uniform1 , b,",), ("b", "a_uniform1")):
        assert chosen(*names) == ["a_uniform1", "b"]
    assert chosen("b, c_wide1") == ["b, c_wide1"]
    assert chosen("d,e,b, c_wide1,b") == ["b, c_wide1", "b", "d,e"]
    with pytest.raises(MienError, match="has no sequence c_wide1, d; it has"):
        chosen("a_uniform1,c_wide1,d")


def test_a_folder_holds_one_data_set(tmp_path: Path) -> None:
    plan = _plan(tmp_path, STILL)
    plan.out.mkdir()
    Evaluation("buft", "paper", "truth", 30.0, (), (), (), "").save(plan.out)
    with pytest.raises(MienError, match="contains results of the data set buft"):
        run_plan(plan)
    with pytest.raises(MienError, match="contains no results"):
        Evaluation.load(tmp_path)
    (plan.out / "evaluation.json").write_text("[]")
    with pytest.raises(MienError, match="not from this version"):
        Evaluation.load(plan.out)


def test_labels_and_commands() -> None:
    assert label("openface:/a/b/openface") == "openface:openface"
    assert label("paper") == "paper"
    plan = Plan("buft", Path("data"), Path("out"), ("paper", "mediapipe"), "paper", focal_px=450, timed=0)
    expected = "mien evaluate buft data --trackers paper,mediapipe --protocol paper --focal 450 --timed 0 -o out"
    assert command_of(plan) == expected
    exact = command_of(replace(plan, focal_px=1234.5678, lost_deg=12.3456789))
    assert "--focal 1234.5678 --lost 12.3456789" in exact
