"""What the documents say of the code, of the settings and of each other holds."""

from __future__ import annotations

import json
import re
import threading
from collections import Counter
from collections.abc import Iterator
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pytest
from typer.main import get_command

import mien
from mien.arrays import Pixels
from mien.cli import app
from mien.config import PaperSettings, RealtimeSettings
from mien.geometry.rotation import FACING, matrix_from_euler
from mien.tracking.state import Closing
from videos import Device, gradient

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
REALTIME = (DOCS / "realtime.md").read_text(encoding="utf-8")
METHOD = (DOCS / "method.md").read_text(encoding="utf-8")
EXPLAINED = METHOD + REALTIME
REFERENCES = sorted(set(re.findall(r"`([a-z0-9_/]+)\.py:([A-Za-z0-9_.]+)`", EXPLAINED)))
SETTINGS = [
    (settings, name, value)
    for settings, text in ((RealtimeSettings(), REALTIME), (PaperSettings(), METHOD))
    for name, value in sorted(set(re.findall(r"`([a-z_.]+)` = (-?[0-9.]*[0-9])", text)))
]
TO_CHANGE = re.findall(r"^\| (.+?) \| (`.+) \|$", (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"), re.MULTILINE)
PAGES = [*DOCS.glob("*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"]


@pytest.mark.parametrize(("module", "name"), REFERENCES)
def test_the_function_exists(module: str, name: str) -> None:
    attrgetter(name)(import_module("mien." + module.replace("/", ".")))


def test_every_equation_is_named_in_the_code() -> None:
    code = "\n".join(p.read_text(encoding="utf-8") for p in (ROOT / "src").rglob("*.py"))
    for number in range(1, 10):
        assert f"Eq. ({number})" in code


@pytest.mark.parametrize(
    ("command", "pages"),
    [
        *((command, ("README.md", "docs/usage.md")) for command in ("track", "batch", "landmarks")),
        *((command, ("docs/evaluation.md",)) for command in ("evaluate", "report")),
    ],
)
def test_every_option_is_explained(command: str, pages: tuple[str, ...]) -> None:
    text = "".join((ROOT / page).read_text(encoding="utf-8") for page in pages)
    options = get_command(app).commands[command].params  # type: ignore[attr-defined]
    names = {max(option.opts, key=len) for option in options if option.opts[0].startswith("-")}
    assert {name for name in names if not re.search(rf"{name}\b", text)} <= {"--output", "--quiet"}


@pytest.mark.parametrize(("settings", "name", "value"), SETTINGS)
def test_the_setting_has_this_value(settings: object, name: str, value: str) -> None:
    assert attrgetter(name)(settings) == float(value)


def test_the_page_on_the_paper_states_its_defaults() -> None:
    stated = {name for settings, name, _ in SETTINGS if isinstance(settings, PaperSettings)}
    assert stated >= {"descriptor.cell", "forgetting"}


def test_contributions_are_those_of_the_ablation() -> None:
    rows = re.findall(r"^\| ([^|]+) \|(?: [0-9.]+ \|){5} ([0-9.]+) \|", _text(DOCS / "benchmark.md"), re.MULTILINE)
    contributions = re.findall(r'"([^"]+)" \(([0-9]\.[0-9]{2})\)', " ".join(REALTIME.split()))
    assert contributions
    assert set(contributions) <= set(rows)


def test_what_else_a_mechanism_gains_is_that_of_the_ablation() -> None:
    head, *rows = re.findall(r"^\| (.*) \|$", _text(DOCS / "benchmark.md").split("## Ablation")[1], re.MULTILINE)
    columns = [name.strip() for name in f" {head}".split("|")]
    ablation = {row.split(" | ")[0]: dict(zip(columns, row.split(" | "), strict=False)) for row in rows}
    said = re.findall(
        r'"([^"]+)" \([0-9.]+\),? (?:with|and) (?:a )?(?:correlations? of the )?(jaw|smile|jitter) of ([0-9. and]+) '
        r"instead of ([0-9]\.[0-9]{2})",
        " ".join(REALTIME.split()),
    )
    assert len(said) == 4
    for mechanism, quantity, values, full in said:
        assert ablation[mechanism][quantity] in values.split(" and ")
        assert ablation["full"][quantity] == full


@pytest.mark.parametrize("row", TO_CHANGE, ids=lambda row: row[0])
def test_what_is_to_change_is_there(row: tuple[str, str]) -> None:
    """Each file or folder is in the package, in the repository, or `there`, in the folder of one that precedes it."""
    places = [ROOT / "src" / "mien", ROOT]
    for name in re.findall(r"`([^`]+)`", row[1]):
        found = [place / name for place in places if (place / name).exists()]
        assert found, name
        places.append(found[0] if name.endswith("/") else found[0].parent)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for link in re.findall(r"\]\(([^)\s]+)\)", _text(page)):
        if link.startswith("http"):
            continue
        file, _, anchor = link.partition("#")
        target = page.parent / file if file else page
        assert target.exists(), link
        assert not anchor or anchor in _anchors(target), link


def test_the_recipes_find_what_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A minute at 25 frames a second: ten blinks, one long closing of the eyes, six nods, five shakes and a slow bow;
    the mouth smiles in four fifths of the time; ten seconds are not known."""
    time = np.arange(1500) / 25
    table = pd.DataFrame({"timestamp": time, "confidence": 0.99, "eyes_closed": 0.02, "pose_Rz": 0.0})
    for start in np.linspace(2, 45, 10):
        table.loc[(time >= start) & (time < start + 0.2), "eyes_closed"] = 0.9
    table.loc[(time > 47) & (time < 49), "eyes_closed"] = 1.0
    swing = np.radians(4) * np.maximum(np.sin(4 * np.pi * time), 0)
    table["pose_Rx"] = np.where((time > 20) & (time < 23), swing, 0) + np.radians(20) * np.exp(
        -(((time - 40) / 2) ** 2)
    )
    table["pose_Ry"] = np.where((time > 10) & (time < 12.5), swing, 0)
    table[["jaw_drop", "lip_corner_depressor", "brow_lowerer", "outer_brow_raiser", "upper_lip_raiser"]] = 0.1
    table["lip_stretcher"] = np.where(time < 40, 0.5, -0.15)
    table["status"] = np.where(time == 42, "initialized", "tracked")
    table.loc[time >= 50, "confidence"] = 0.2
    table.loc[time >= 55, ["pose_Rx", "pose_Ry", "pose_Rz", "eyes_closed"]] = np.nan
    table.to_csv(tmp_path / "video.csv", index=False)
    monkeypatch.chdir(tmp_path)
    recipes = (DOCS / "usage.md").read_text(encoding="utf-8").split("## Recipes")[1]
    found: dict[str, Any] = {}
    exec("\n".join(re.findall(r"^```python\n(.*?)^```", recipes, re.DOTALL | re.MULTILINE)), found)
    assert len(found["blinks"]) == 10
    assert found["per_minute"] == pytest.approx(12, rel=0.01)
    assert (len(found["nods"]), len(found["shakes"])) == (6, 5)
    assert found["smiling"] == pytest.approx(0.8)
    turned = np.degrees(np.abs(np.diff(table["pose_Rx"])) + np.abs(np.diff(table["pose_Ry"])))[:1249]
    assert found["mean_speed"] == pytest.approx(turned.mean() * 25, rel=0.01)


def test_the_live_example_tells_of_each_face_that_is_not_lost(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    frame = mien.Frame(np.zeros((48, 64, 3), np.uint8), 3, 0.12)
    turned = matrix_from_euler(np.radians([0.0, 20.0, 0.0])) @ FACING
    seen = mien.Estimate(3, 0.12, mien.Status.TRACKED, turned, np.array([0.0, 0, 5]), confidence=0.9, mm_per_unit=110.0)
    answers = [(frame, seen), (frame, mien.Estimate.lost(frame, "it left"))]
    monkeypatch.setattr("mien.live.stream", lambda *_, **__: answers)
    examples = re.findall(r"^```python\n(.*?)^```", (ROOT / "README.md").read_text("utf-8"), re.DOTALL | re.MULTILINE)
    (live,) = (example for example in examples if "mien.stream" in example)
    exec(live, {})
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("0.12 s: yaw 20 degrees, 550 mm away, 90% sure, {'upper_lip_raiser': ")


def test_the_example_that_runs_for_hours_goes_on_after_its_camera_has_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A camera that fails twice, after three images each time; then the program is told to end."""
    recipe = (DOCS / "usage.md").read_text(encoding="utf-8").split("### A program that runs for hours")[1]
    (program,) = re.findall(r"^```python\n(.*?)^```", recipe.split("## Recipes")[0], re.DOTALL | re.MULTILINE)
    there: dict[str, Any] = {}
    opened: list[Device] = []
    threads = set[threading.Thread]()

    class Failing(Device):
        def __init__(self, address: str) -> None:
            super().__init__([gradient(index) for index in range(3)])
            threads.add(threading.current_thread())
            if len(opened) == 2:
                there["newest"].put(None)
                raise SystemExit  # which ends the thread
            opened.append(self)

        def read(self) -> tuple[bool, Pixels | None]:
            while not there["newest"].empty():  # else it would show more than the program takes
                pass
            return super().read()

    seen = mien.Estimate(4, 0.2, mien.Status.TRACKED, FACING, np.zeros(3), confidence=0.9, closing=Closing(0.1, 0.2))

    def stream(frames: Iterator[mien.Frame], anew_after: float) -> Iterator[tuple[mien.Frame, mien.Estimate]]:
        for frame in frames:
            yield frame, seen if frame.index == 4 else mien.Estimate.lost(frame, "no face was seen yet")

    monkeypatch.setattr("mien.live.stream", stream)
    monkeypatch.setattr(cv2, "VideoCapture", Failing)
    monkeypatch.setattr("time.sleep", lambda seconds: None)
    monkeypatch.setattr(threading, "excepthook", threading.__excepthook__)  # pytest's own would warn of that end
    monkeypatch.chdir(tmp_path)
    exec(program, there)
    for thread in threads:
        thread.join()
    rows = [json.loads(line) for line in (tmp_path / "estimates.jsonl").read_text().splitlines()]
    assert [row["frame"] for row in rows] == list(range(6))
    assert [device.released for device in opened] == [True, True]
    assert rows[0]["reason"] == "no face was seen yet"
    assert rows[4] == {
        "frame": 4, "time": 0.2, "status": "tracked", "reason": "", "confidence": 0.9, "angles_deg": [0.0, 0.0, 0.0],
        "eyes_closed": 0.1,
    }  # fmt: skip


def _text(page: Path) -> str:
    """A page without its blocks of code."""
    return re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)


def _anchors(page: Path) -> set[str]:
    """The anchors that GitHub gives to the headings of a page."""
    headings = [_anchor(heading) for heading in re.findall(r"^#+ (.*)$", _text(page), re.MULTILINE)]
    counts: Counter[str] = Counter()
    anchors = set()
    for heading in headings:
        anchors.add(f"{heading}-{counts[heading]}" if counts[heading] else heading)
        counts[heading] += 1
    return anchors


def _anchor(heading: str) -> str:
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")
