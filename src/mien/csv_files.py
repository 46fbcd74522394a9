"""CSVs as mien and OpenFace write them, and as spreadsheets do where numbers have commas: semicolons between cells."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from contextlib import contextmanager
from io import StringIO
from pathlib import Path
from typing import TextIO

_WITH_COMMA = re.compile(r"\s*[-+]?\d*,\d+(e[-+]?\d+)?\s*", re.IGNORECASE)


@contextmanager
def opened_csv(path: Path) -> Iterator[TextIO]:
    """A CSV with commas between cells and points in numbers: the file, or a StringIO where that has semicolons.

    Raises UnicodeDecodeError and csv.Error where it cannot be read.
    """
    with path.open(encoding="utf-8-sig", newline="") as file:
        names = file.readline()
        file.seek(0)
        yield file if names.count(";") <= names.count(",") else _with_commas(file)


def csv_rows(path: Path) -> Iterator[dict[str, str]]:
    """The rows of a CSV, by the names of their columns; OpenFace puts a space before most names and values.

    Raises as `opened_csv`.
    """
    with opened_csv(path) as file:
        for row in csv.DictReader(file, skipinitialspace=True):
            yield {name.strip(): (cell or "").strip() for name, cell in row.items() if isinstance(name, str)}


def _with_commas(file: TextIO) -> StringIO:
    """What is in a CSV with semicolons."""
    written = StringIO(newline="")
    rows = csv.reader(file, delimiter=";")
    csv.writer(written, lineterminator="\n").writerows(map(_with_point, row) for row in rows)
    written.seek(0)
    return written


def _with_point(cell: str) -> str:
    """A number with a point in it, where it has a comma; other cells as they are."""
    return cell.replace(",", ".") if _WITH_COMMA.fullmatch(cell) else cell
