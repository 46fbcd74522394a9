"""What `import mien` offers."""

from __future__ import annotations

import ast
from pathlib import Path

import mien


def test_every_public_name_is_there() -> None:
    for name in mien.__all__:
        assert getattr(mien, name) is not None


def test_editors_and_type_checkers_see_every_public_name() -> None:
    tree = ast.parse(Path(mien.__file__).read_text(encoding="utf-8"))
    (checked,) = (node for node in tree.body if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING")
    seen = {
        alias.name: node.module for node in checked.body if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    assert seen == mien._HOME
    assert {*seen, "__version__"} == set(mien.__all__)
    assert "__getattr__" not in {
        node.name for node in tree.body if isinstance(node, ast.FunctionDef)
    }  # any name is right
