"""`mien evaluate` and `mien report` as commands, in this process and once in one of their own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from evaluation import tiny
from mien.cli import app
from mien.errors import MienError
from mien.evaluation import commands
from mien.evaluation.commands import _tracker_names


def _mien(*arguments: object) -> tuple[int, str]:
    """Exit status and output of the command."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    return result.exit_code, result.output


def test_one_command_gives_a_report_and_report_gives_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    data = tiny.rendered(tmp_path / "data", ("a_uniform1", "b, c_wide1"))
    arguments = [
        "evaluate", "rendered", data, "--trackers", "evaluation.tiny:Warns",
        "--landmarks", "truth", "--timed", 0, "--jobs", 2, "--sequences", "b, c_wide1", "-o", tmp_path / "out",
    ]  # fmt: skip
    run = subprocess.run(
        [sys.executable, "-c", "from mien.cli import main; main()", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    assert run.stderr == "mien: b, c_wide1: the light is poor\n"
    assert "report.html" in run.stdout
    assert "Rotation error in degrees" in run.stdout
    assert "protocol: rebased" in run.stdout
    assert "…" not in run.stdout, "a name is cut, and others may begin alike"
    assert "mien: b, c_wide1: the light is poor\n" in _mien(*arguments)[1], "it also holds of results that are kept"
    for form, ending in (("latex", "tex"), ("csv", "csv"), ("markdown", "md")):
        status, printed = _mien("report", tmp_path / "out", "--format", form, "--protocol", "sensor")
        assert status == 0, printed
        text = (tmp_path / "out" / f"report.{ending}").read_text(encoding="utf-8")
        assert "sensor" in text
        assert "the light is poor" in text


@pytest.mark.parametrize("name", ["report.html", "report.md", "figures"])
def test_reports_and_figures_of_others_are_not_replaced(name: str, tmp_path: Path) -> None:
    (tmp_path / name).mkdir()  # as a file would be
    with pytest.raises(MienError, match=rf"{name} exists and is not of mien evaluate; choose another folder with -o"):
        commands.evaluate("rendered", tmp_path / "data", tmp_path)


def test_trackers_are_named_with_commas_between(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also those with a comma in the name of their file; the longest name of a file that exists is one."""
    monkeypatch.chdir(tmp_path)
    for name in ("a,b.csv", "own.json", "own.json,paper"):
        (tmp_path / name).touch()
    for texts, names in (
        (["realtime, paper,", "paper"], ("realtime", "paper")),
        (["realtime,openface:a,b.csv, paper"], ("realtime", "openface:a,b.csv", "paper")),
        (["realtime:own.json,mediapipe"], ("realtime:own.json", "mediapipe")),
        (["realtime:own.json,paper,mediapipe"], ("realtime:own.json,paper", "mediapipe")),
        (["openface:none,b.csv,mine:Own"], ("openface:none", "b.csv", "mine:Own")),
        ([f"openface:{'a' * 300}"], (f"openface:{'a' * 300}",)),
    ):
        assert _tracker_names(texts) == names
    assert "openface" not in _tracker_names(["all"])
    assert _tracker_names(["paper,all"])[0] == "paper"


def test_bad_input_is_one_sentence_and_status_2(tmp_path: Path) -> None:
    data, out = tiny.rendered(tmp_path / "data"), tmp_path / "out"
    tracker = ("--trackers", "evaluation.tiny:Still")
    for arguments, sentence in (
        (("evaluate", "bu", data, "-o", out), "buft, talking-face, rendered, video"),
        (("evaluate", "buft", tmp_path / "none", "-o", out, *tracker), "does not exist"),
        (("evaluate", "buft", data, "-o", out, *tracker), "contains no sequence of BUFT"),
        (("evaluate", "rendered", data, "-o", out, "--trackers", "papper"), "unknown tracker 'papper'"),
        (("evaluate", "rendered", data, "-o", out, *tracker, "--protocol", "best"), "paper, rebased, sensor"),
        (("report", tmp_path), "contains no results"),
    ):
        status, printed = _mien(*arguments)
        assert status == 2, (arguments, printed)
        assert sentence in printed
        assert len(printed.splitlines()) == 1


def test_from_python_nothing_is_printed(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Scores and the path of the report are returned instead; a failure is a score with its reason."""
    data, out = tiny.rendered(tmp_path / "data"), tmp_path / "out"
    names = ("evaluation.tiny:Still,evaluation.tiny:Raises",)
    scores, written = commands.evaluate("rendered", data, out, trackers=names, first_landmarks="truth", timed=0)
    assert written == out / "report.html"
    assert [bool(score.failure) for score in scores.scores] == [False, True]
    assert commands.report(out) == out / "report.md"
    assert capfd.readouterr() == ("", "")


def test_quiet_tells_of_sequences_without_a_result(tmp_path: Path) -> None:
    data = tiny.rendered(tmp_path / "data", ("a_uniform1", "b_wide1"))
    np.savez(data / "b_wide1_truth.npz", R=np.full((6, 3, 3), np.nan))
    status, printed = _mien(
        "evaluate", "rendered", data, "--trackers", "evaluation.tiny:Still", "--landmarks", "truth",
        "--timed", 0, "--quiet", "-o", tmp_path / "out",
    )  # fmt: skip
    assert status == 0
    (line,) = printed.splitlines()
    assert line.startswith("mien: b_wide1: no result of evaluation.tiny:Still: ")
    assert "not a finite number" in line


def test_a_focal_length_in_millimetres_is_told(tmp_path: Path) -> None:
    """Not landmarks that fit no face, as every face would be distorted beyond recognition."""
    data = tiny.rendered(tmp_path / "data")
    status, printed = _mien(
        "evaluate", "rendered", data, "--trackers", "evaluation.tiny:Still", "--landmarks", "truth",
        "--timed", 0, "--quiet", "--focal", 3.6, "-o", tmp_path / "out",
    )  # fmt: skip
    assert status == 2
    assert "a focal length of 3.6 pixels sees more than 150 degrees" in printed


def test_where_nothing_could_be_done_the_reason_is_given(tmp_path: Path) -> None:
    data = tiny.rendered(tmp_path / "data")
    np.savez(data / "a_uniform1_truth.npz", R=np.full((6, 3, 3), np.nan))
    status, printed = _mien(
        "evaluate", "rendered", data, "--trackers", "evaluation.tiny:Still", "--landmarks", "truth",
        "--quiet", "-o", tmp_path / "out",
    )  # fmt: skip
    assert status == 2
    assert "no tracker gave a result" in printed
    assert "not a finite number" in printed
    assert (tmp_path / "out" / "report.html").is_file()
