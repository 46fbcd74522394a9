"""A module imports only what stands above it in the design's list."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import mien

LAYERS = (
    ("_version", "errors", "arrays"),
    ("files", "csv_files", "compiled", "processes", "threads"),
    ("config", "graphics", "lens"),
    ("frame",),
    ("video",),
    ("geometry",),
    ("candide",),
    ("initialization",),
    ("appearance",),
    ("tracking",),
    ("registry", "synthetic"),
    ("output",),
    ("start",),
    ("pipeline",),
    ("live", "batch", "faces"),
    ("evaluation",),
    ("baselines",),
    ("demo",),
    ("terminal",),
    ("cli",),
    ("worker", "__main__"),
)
RANK = {name: rank for rank, names in enumerate(LAYERS) for name in names}
ROOT = Path(mien.__file__).parent
MODULES = sorted(p for p in ROOT.rglob("*.py") if p != ROOT / "__init__.py")


def _layer(module: Path) -> str:
    first = module.relative_to(ROOT).parts[0]
    return first.removesuffix(".py")


def _imported_layers(module: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module.name} imports relatively; imports here are absolute"
            assert node.module != "mien", f"{module.name} imports from `mien`; name the module that defines it"
            names = [str(node.module)]
        else:
            continue
        yield from (name.split(".")[1] for name in names if name.startswith("mien."))


@pytest.mark.parametrize("module", MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_point_upwards(module: Path) -> None:
    layer = _layer(module)
    assert layer in RANK, f"{layer} has no place in the order of layers; give it one"
    below = {name for name in _imported_layers(module) if RANK[name] > RANK[layer]}
    assert not below, f"{module.relative_to(ROOT)} imports {sorted(below)}, which stand below it"
