"""Every function that `docs/method.md` names exists."""

from __future__ import annotations

import re
from importlib import import_module
from operator import attrgetter
from pathlib import Path

import pytest

METHOD = Path(__file__).parents[1] / "docs" / "method.md"
REFERENCES = sorted(set(re.findall(r"`([a-z0-9_/]+)\.py:([A-Za-z0-9_.]+)`", METHOD.read_text(encoding="utf-8"))))


@pytest.mark.parametrize(("module", "name"), REFERENCES)
def test_the_function_exists(module: str, name: str) -> None:
    attrgetter(name)(import_module("mien." + module.replace("/", ".")))


def test_every_equation_is_named_in_the_code() -> None:
    code = "\n".join(p.read_text(encoding="utf-8") for p in (METHOD.parents[1] / "src").rglob("*.py"))
    for number in range(1, 10):
        assert f"Eq. ({number})" in code
