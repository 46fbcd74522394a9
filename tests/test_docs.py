"""What the documents say of the code, of the settings and of each other holds."""

from __future__ import annotations

import re
from collections import Counter
from importlib import import_module
from operator import attrgetter
from pathlib import Path

import pytest

from mien.config import RealtimeSettings

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
REALTIME = (DOCS / "realtime.md").read_text(encoding="utf-8")
EXPLAINED = (DOCS / "method.md").read_text(encoding="utf-8") + REALTIME
REFERENCES = sorted(set(re.findall(r"`([a-z0-9_/]+)\.py:([A-Za-z0-9_.]+)`", EXPLAINED)))
SETTINGS = sorted(set(re.findall(r"`([a-z_]+)` = (-?[0-9.]*[0-9])", REALTIME)))
PAGES = [*DOCS.glob("*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"]


@pytest.mark.parametrize(("module", "name"), REFERENCES)
def test_the_function_exists(module: str, name: str) -> None:
    attrgetter(name)(import_module("mien." + module.replace("/", ".")))


def test_every_equation_is_named_in_the_code() -> None:
    code = "\n".join(p.read_text(encoding="utf-8") for p in (ROOT / "src").rglob("*.py"))
    for number in range(1, 10):
        assert f"Eq. ({number})" in code


@pytest.mark.parametrize(("name", "value"), SETTINGS)
def test_the_setting_has_this_value(name: str, value: str) -> None:
    assert getattr(RealtimeSettings(), name) == float(value)


def test_contributions_are_those_of_the_ablation() -> None:
    rows = re.findall(r"^\| ([^|]+) \|(?: [0-9.]+ \|){5} ([0-9.]+) \|", _text(DOCS / "benchmark.md"), re.MULTILINE)
    contributions = re.findall(r'"([^"]+)" \(([0-9]\.[0-9]{2})\)', " ".join(REALTIME.split()))
    assert contributions
    assert set(contributions) <= set(rows)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for link in re.findall(r"\]\(([^)\s]+)\)", _text(page)):
        if link.startswith("http"):
            continue
        file, _, anchor = link.partition("#")
        target = page.parent / file if file else page
        assert target.exists(), link
        assert not anchor or anchor in _anchors(target), link


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
