"""CSV files of mien and OpenFace, and those of spreadsheets: separated by tabs, or by semicolons where decimals have
commas."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from io import StringIO
from pathlib import Path
from typing import TextIO

_DECIMAL_COMMA = re.compile(r"\s*[-+]?\d*,\d+(e[-+]?\d+)?\s*", re.IGNORECASE)
_WORDS = {"": math.nan, "na": math.nan, "true": 1.0, "false": 0.0}


def landmark_count(names: Iterable[str]) -> int:
    """Number of landmarks of a table with these columns: x_0, x_1 .., among others."""
    return sum(1 for name in names if re.fullmatch(r"x_\d+", name))


@contextmanager
def opened_csv(path: Path) -> Iterator[TextIO]:
    """The CSV as comma-separated text with decimal points: the file itself, or a converted copy if it uses semicolons
    or tabs.

    Raises UnicodeDecodeError or csv.Error if it cannot be read.
    """
    with path.open(encoding="utf-8-sig", newline="") as file:
        names = file.readline()
        file.seek(0)
        delimiter = max(",;\t", key=names.count)  # the comma if there is none
        yield file if delimiter == "," else _with_commas(file, delimiter)


def csv_rows(path: Path) -> Iterator[dict[str, str]]:
    """The rows of a CSV, keyed by column name, without the space that OpenFace puts before most names and values, and
    without the rows of separators that spreadsheets leave; where frames have no numbers, such a row is that of a frame.

    Raises the same errors as `opened_csv`.
    """
    with opened_csv(path) as file:
        for cells in csv.DictReader(file, skipinitialspace=True):
            row = {name.strip(): (cell or "").strip() for name, cell in cells.items() if isinstance(name, str)}
            if "frame" not in row or any(row.values()):
                yield row


def number_in(cell: str) -> float:
    """The number in a cell: NaN if it is empty or, as R writes it, NA; 1 and 0 for what R and pandas write as TRUE and
    False. Raises ValueError if it is none."""
    known = _WORDS.get(cell.lower())
    return float(cell) if known is None else known


def _with_commas(file: TextIO, delimiter: str) -> StringIO:
    """Convert a CSV with another delimiter to commas and decimal points."""
    written = StringIO(newline="")
    rows = csv.reader(file, delimiter=delimiter)
    csv.writer(written, lineterminator="\n").writerows(map(_with_decimal_point, row) for row in rows)
    written.seek(0)
    return written


def _with_decimal_point(cell: str) -> str:
    """Replace a decimal comma with a point; leave cells that are not numbers unchanged."""
    return cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell
