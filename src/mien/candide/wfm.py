"""Read and write `.wfm`, CANDIDE's own file format, so that users can supply another face model.

A file contains eight lists in this order, each preceded by its count; `#` starts a comment, and the comment before a
unit is its name: vertices `x y z`, triangles `a b c`, animation units and shape units (each a count of vertices, then
`vertex dx dy dz`), animation parameters and shape parameters `unit value`, texture coordinates `vertex u v` with the
name of the texture file, and the global motion: rotation, scale and translation.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

import numpy as np

from mien.arrays import Array
from mien.candide.model import Candide, outward
from mien.errors import MienError, require
from mien.files import user_path, whole_file


@dataclass(frozen=True)
class Wfm:
    """The contents of a `.wfm` file: the face model, and a state of it.

    animation: (L,) alpha; shape: (K,) sigma; texture: vertex -> (u, v); rotation, scale, translation: (3,).
    """

    model: Candide
    animation: Array
    shape: Array
    texture: dict[int, tuple[float, float]] = field(default_factory=dict)
    texture_file: str = ""
    rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @classmethod
    def neutral(cls, model: Candide) -> Wfm:
        """The neutral state of a model: no animation, mean shape, no texture."""
        return cls(model, np.zeros(len(model.animation_units)), np.zeros(len(model.shape_units)))


def read_wfm(path: str | Path) -> Wfm:
    """Read a `.wfm` file. Raises MienError naming the file and the line that violates the format."""
    lines = _Lines(user_path(path))
    rows = [lines.row("a vertex", float, float, float) for _ in range(lines.count("vertices"))]
    mean = np.array([values for values, _ in rows]).reshape(-1, 3)
    vertex_names = _vertex_names([comment for _, comment in rows])
    corner = lines.index_below(len(mean), "vertex")
    triangles = [lines.row("a triangle", corner, corner, corner)[0] for _ in range(lines.count("triangles"))]
    animation_names, animation_units = _read_units(lines, "animation unit", len(mean))
    shape_names, shape_units = _read_units(lines, "shape unit", len(mean))
    model = Candide(
        mean=mean,
        vertex_names=vertex_names,
        triangles=outward(mean, np.array(triangles, dtype=np.intp).reshape(-1, 3)),
        shape_unit_names=shape_names,
        shape_units=shape_units,
        animation_unit_names=animation_names,
        animation_units=animation_units,
    )
    animation = _read_parameters(lines, "animation", len(animation_names))
    shape = _read_parameters(lines, "shape", len(shape_names))
    texture, texture_file = _read_texture(lines, corner)
    motion = [lines.row(f"the global {kind}", float, float, float)[0] for kind in ("rotation", "scale", "translation")]
    return Wfm(model, animation, shape, texture, texture_file, *motion)  # type: ignore[arg-type]


def write_wfm(path: str | Path, wfm: Wfm) -> None:
    """Write a `.wfm` file; `read_wfm` restores it exactly, with names of units in lower case. Raises MienError for
    texture coordinates without a file whose name the format can hold."""
    model, file_name = wfm.model, wfm.texture_file
    require(
        not wfm.texture or file_name.partition("#")[0].strip().splitlines() == [file_name],
        f"{path}: {file_name!r} cannot be the name of the texture's file; give one without # on one line",
    )
    vertices = [f"{_numbers(x)} # {name}" for x, name in zip(model.mean, model.vertex_names, strict=True)]
    texture = [f"{vertex} {_numbers(uv)}" for vertex, uv in wfm.texture.items()]
    lists = [
        _list("VERTEX LIST:", vertices),
        _list("FACE LIST:", [" ".join(map(str, t)) for t in model.triangles.tolist()]),
        _unit_list("ANIMATION UNITS LIST:", model.animation_unit_names, model.animation_units),
        _unit_list("SHAPE UNITS LIST:", model.shape_unit_names, model.shape_units),
        _list("ANIMATION PARAMETERS:", _parameters(wfm.animation)),
        _list("SHAPE PARAMETERS:", _parameters(wfm.shape)),
        _list("TEXTURE:", texture) + ([file_name] if texture else []),
        ["# GLOBAL MOTION:", *map(_numbers, (wfm.rotation, wfm.scale, wfm.translation)), "", "# END OF FILE"],
    ]
    text = "\n\n".join("\n".join(lines) for lines in lists) + "\n"
    with whole_file(user_path(path)) as file:
        file.write_text(text, encoding="utf-8")


class _Lines:
    """Iterates over the lines of a file that contain more than a comment."""

    def __init__(self, path: Path) -> None:
        self.path, self.number, self.heading = path, 0, ""
        try:
            self._lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
        except OSError as error:
            raise MienError(f"{path}: cannot be read ({error.strerror}); check the path") from error

    def fail(self, expected: str, found: str) -> NoReturn:
        """Raise the MienError of this reader."""
        raise MienError(f"{self.path}, line {self.number}: expected {expected} and found {found}; correct the file")

    def next(self, expected: str) -> tuple[str, str]:
        """The next line, as text and comment. Sets `heading` to the last comment on a line of its own before it."""
        self.heading = ""
        while self.number < len(self._lines):
            text, _, comment = self._lines[self.number].partition("#")
            self.number += 1
            if text.strip():
                return text.strip(), comment.strip()
            self.heading = comment.strip() or self.heading
        self.fail(expected, "the end of the file")

    def count(self, of: str) -> int:
        """Read the count before a list."""
        text, _ = self.next(f"the number of {of}")
        if not text.isdecimal() or int(text) > len(self._lines):
            self.fail(f"the number of {of}, with a line for each", repr(text))
        return int(text)

    def row(self, what: str, *columns: Callable[[str], float]) -> tuple[tuple[float, ...], str]:
        """Read a row of a list, each column with its own function; returns the values and the comment after them."""
        text, comment = self.next(what)
        words = text.split()
        try:
            values = tuple(column(word) for column, word in zip(columns, words, strict=True))
        except MienError:
            raise
        except ValueError:
            self.fail(f"{what} as {len(columns)} numbers", repr(text))
        if not np.isfinite(values).all():
            self.fail(f"{what} as finite numbers", repr(text))
        return values, comment

    def index_below(self, bound: int, of: str) -> Callable[[str], int]:
        """A column reader for an index into a list of this length."""

        def column(word: str) -> int:
            index = int(word)
            if not 0 <= index < bound:
                self.fail(f"the index of one of {bound} {of} entries", word)
            return index

        return column


def _read_units(lines: _Lines, kind: str, vertex_count: int) -> tuple[tuple[str, ...], Array]:
    vertex = lines.index_below(vertex_count, "vertex")
    names: list[str] = []
    units = np.zeros((lines.count(f"{kind}s"), vertex_count, 3))
    for number, unit in enumerate(units):
        size = lines.count(f"vertices of {kind} {number}")
        names.append(_unit_name(lines.heading) or f"{kind.replace(' ', '_')}_{number}")
        for _ in range(size):
            (index, *displacement), _comment = lines.row(
                f"a displacement of {kind} {number}", vertex, float, float, float
            )
            unit[int(index)] = displacement
    return tuple(names), units


def _read_parameters(lines: _Lines, kind: str, unit_count: int) -> Array:
    values = np.zeros(unit_count)
    unit = lines.index_below(unit_count, f"{kind} unit")
    for _ in range(lines.count(f"{kind} parameters")):
        (index, value), _comment = lines.row(f"a parameter of {kind}", unit, float)
        values[int(index)] = value
    return values


def _read_texture(lines: _Lines, vertex: Callable[[str], int]) -> tuple[dict[int, tuple[float, float]], str]:
    count = lines.count("texture coordinates")
    rows = [lines.row("a texture coordinate", vertex, float, float)[0] for _ in range(count)]
    file = lines.next("the name of the texture's file")[0] if rows else ""
    return {int(index): (u, v) for index, u, v in rows}, file


def _vertex_names(comments: list[str]) -> tuple[str, ...]:
    """The comments after the vertices; without them CANDIDE's names for the same number of vertices, else numbers."""
    if all(comments):
        return tuple(comments)
    known = Candide.default().vertex_names
    return known if len(comments) == len(known) else tuple(f"vertex_{i}" for i in range(len(comments)))


def _unit_name(comment: str) -> str:
    """`AUV0 Upper lip raiser (AU10)` -> `upper_lip_raiser`."""
    words = re.sub(r"\([^)]*\)|\bAUV\s*\d+", " ", comment)
    return re.sub(r"\W+", "_", words).strip("_").lower()


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(v)) for v in values)


def _list(heading: str, rows: list[str]) -> list[str]:
    return [f"# {heading}", str(len(rows)), *rows]


def _unit_list(heading: str, names: tuple[str, ...], units: Array) -> list[str]:
    lines = [f"# {heading}", str(len(names))]
    for name, unit in zip(names, units, strict=True):
        moved = np.flatnonzero(unit.any(axis=1))
        lines += ["", *_list(name, [f"{vertex} {_numbers(unit[vertex])}" for vertex in moved])]
    return lines


def _parameters(values: Array) -> list[str]:
    return [f"{i} {_numbers([value])}" for i, value in enumerate(values) if value != 0]
