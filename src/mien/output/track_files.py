"""The files of a track: NAME.csv, NAME.json and NAME.parquet, how they are recognised, read and written."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Collection, Mapping
from csv import Error as CSVError
from csv import reader, writer
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from mien.csv_files import number_in, opened_csv
from mien.errors import MienError, require
from mien.files import exists, json_text, user_path
from mien.output.columns import column_type, import_pandas
from mien.tracking.state import Status

ENDINGS = (".csv", ".json", ".parquet")
PLOT_ENDINGS = (".png", ".pdf", ".svg")
GLTF_ENDINGS = (".glb",)
OVERLAY_ENDINGS = (".mp4",)
_IN_EVERY_ROW = {"frame", "timestamp", "confidence", "success", "status"}
_ROW_GROUP = 4096
"""Number of rows of a Parquet file that are written, and read, at once, which bounds the memory."""
_NOT_READ = (pa.ArrowException, OSError, ValueError, CSVError)
"""What the readers of files raise."""


def track_paths(path: str | Path) -> tuple[Path, Path, Path]:
    """The paths NAME.csv, NAME.json and NAME.parquet, given NAME or one of the three."""
    path = user_path(path)
    name = path.name.removesuffix(path.suffix) if path.suffix.lower() in ENDINGS else path.name
    require(bool(name), f"{path} is not the name of a file; give one such as out.csv")
    csv, settings, parquet = (path.with_name(name + ending) for ending in ENDINGS)
    return csv, settings, parquet


def paths_to_write(path: str | Path) -> tuple[Path, Path, Path]:
    """`track_paths`, for writing. Raises MienError for the name of a picture or video, and for a folder: the files
    would be beside it, and replaced by those of the next track that is written "to" it."""
    named = user_path(path)
    folder = str(path).endswith(("/", os.sep)) or (named.suffix.lower() not in ENDINGS and named.is_dir())
    require(not folder, f"{path} is a folder; give the name of a table, such as {Path(path, 'out.csv')}")
    require(
        named.suffix.lower() not in (*OVERLAY_ENDINGS, *PLOT_ENDINGS, *GLTF_ENDINGS),
        f"{path}: the table is written here; choose a name such as {named.with_suffix('.csv').name}, and use the "
        "options --overlay, --plot and --gltf (overlay, plot and gltf in Python) for pictures",
    )
    return track_paths(path)


def is_table_of_track(path: Path) -> bool:
    """Whether a CSV or a Parquet file has the columns that every table of mien has."""
    try:
        if path.suffix.lower() == ".parquet":
            from pyarrow import parquet

            with path.open("rb") as stream:
                return set(parquet.read_schema(stream).names) >= _IN_EVERY_ROW
        with opened_csv(path) as file:
            return {name.strip() for name in next(reader(file), [])} >= _IN_EVERY_ROW
    except _NOT_READ:
        return False


def read_outline(csv: Path) -> pa.Table:
    """The columns that every row of a NAME.csv fills: from NAME.parquet, which takes a tenth of the time, unless the
    CSV was edited since. Raises MienError as `read_table`."""
    files = filter(exists, (csv.with_suffix(ENDINGS[-1]), csv))
    return read_table(max(files, key=lambda file: file.stat().st_mtime_ns, default=csv), _IN_EVERY_ROW)


def read_table(path: Path, only: Collection[str] | None = None) -> pa.Table:
    """The table of a `.csv` or `.parquet` file, in the order of its frames. only: the columns to read, by default all.
    Raises MienError if it is not that of a track."""
    import_pandas()
    try:
        table = _read_parquet(path, only) if path.suffix.lower() == ".parquet" else _read_csv(path, only)
    except _NOT_READ as error:
        raise MienError(f"{path} is not a track of mien ({error}); track the video again") from error
    several = ", ".join(repr(name) for name, count in Counter(table.column_names).items() if count > 1)
    require(not several, f"{path} has several columns {several}; rename or delete all but one")
    missing = _IN_EVERY_ROW - set(table.column_names)
    require(not missing, f"{path} is not a track of mien: it lacks the columns {sorted(missing)}")
    empty = sorted(name for name in _IN_EVERY_ROW if table.column(name).null_count)
    require(not empty, f"{path}: a cell of the column {', '.join(empty)} is empty; fill it, or delete the row")
    unknown = set(table.column("status").to_pylist()) - {status.value for status in Status}
    require(not unknown, f"{path}: unknown status {', '.join(map(str, sorted(unknown)))}; correct it")
    frames = np.asarray(table.column("frame"))
    if (np.diff(frames) > 0).all():
        return table
    require(
        len(np.unique(frames)) == len(frames),
        f"{path} has two rows for one frame; keep one of them, or the rows of one face",
    )
    return table.take(np.argsort(frames))


def read_metadata(path: Path) -> dict[str, Any]:
    """The content of a NAME.json, empty if there is no such file. Raises MienError if it is another's."""
    try:
        metadata = json.loads(path.read_text(encoding="utf-8-sig")) if path.is_file() else {}
    except (OSError, ValueError) as error:
        raise MienError(f"{path} is not a track of mien ({error}); track the video again") from error
    require(isinstance(metadata, dict), f"{path} is not the JSON of a track of mien; track the video again")
    return dict(metadata)


def write_csv(table: pa.Table, path: Path) -> None:
    """Write a NAME.csv, in which only what needs it is quoted."""
    from pyarrow import compute, csv

    plain = [field.with_type(pa.string()) if _is_text(field.type) else field for field in table.schema]
    table = table.cast(pa.schema(plain))
    text = [field.name for field in plain if pa.types.is_string(field.type)]
    special = (compute.match_substring_regex(table.column(name), '[",\r\n]') for name in text)
    quoting = "needed" if any(compute.any(found).as_py() for found in special) else "none"
    if quoting == "none":  # then PyArrow refuses special characters also in what an empty cell held before
        for name in text:
            filled = compute.fill_null(table.column(name), "")
            table = table.set_column(table.column_names.index(name), name, filled)
    options = csv.WriteOptions(include_header=False, quoting_style=quoting)
    with path.open("wb") as f:
        header = StringIO()
        writer(header, lineterminator="\n").writerow(table.column_names)
        f.write(header.getvalue().encode())
        csv.write_csv(table, f, options)


def _is_text(kind: pa.DataType) -> bool:
    """Whether a column holds text, also as Polars and pandas store it: as large strings or as categories."""
    kind = kind.value_type if pa.types.is_dictionary(kind) else kind
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def write_json(metadata: Mapping[str, Any], path: Path) -> None:
    """Write a NAME.json."""
    path.write_text(json_text(metadata), encoding="utf-8")


def write_parquet(table: pa.Table, path: Path) -> None:
    """Write a NAME.parquet."""
    from pyarrow import parquet

    with path.open("wb") as stream:  # see `_read_csv`
        parquet.write_table(table, stream, row_group_size=_ROW_GROUP)


def _read_csv(path: Path, only: Collection[str] | None) -> pa.Table:
    """The table of a CSV, possibly rewritten by R, pandas or a spreadsheet, with additional columns."""
    from pyarrow import csv

    with opened_csv(path) as file:
        names = [n.strip() for n in next(reader(file), [])]
        content = file.getvalue().encode() if isinstance(file, StringIO) else path.read_bytes()
    read = [n for n in names if only is None or n in only]
    types = {n: known for n in read if (known := column_type(n)) is not None}
    # pandas writes whole numbers as 1.0 once a column has had gaps.
    read_as = {n: pa.float64() if known == pa.int64() else known for n, known in types.items()}
    read_as |= {"success": pa.string()} if "success" in types else {}
    missing = ["", "NA", "NaN", "nan"]
    options = csv.ConvertOptions(
        column_types=read_as,
        null_values=missing,
        strings_can_be_null=True,
        include_columns=[] if only is None else read,
    )
    # Not by its path: PyArrow opens no file whose name is not UTF-8.
    table = csv.read_csv(
        pa.BufferReader(content), csv.ReadOptions(column_names=names, skip_rows=1), convert_options=options
    )
    if "success" in types:  # pandas and R may have made it a column of truth values
        column = read.index("success")
        success = [None if cell is None else number_in(cell.strip()) for cell in table.column(column).to_pylist()]
        table = table.set_column(column, "success", pa.array(success, pa.float64()))
    kinds = zip(read, table.schema.types, strict=True)
    return table.cast(pa.schema([(n, types.get(n, kind)) for n, kind in kinds]))


def _read_parquet(path: Path, only: Collection[str] | None) -> pa.Table:
    """The table of a Parquet file, possibly rewritten by pandas or Polars with other types of the same columns."""
    from pyarrow import parquet

    with path.open("rb") as stream:
        table = parquet.read_table(stream, columns=None if only is None else sorted(only))
    fields = [(field.name, column_type(field.name) or field.type) for field in table.schema]
    return table.cast(pa.schema(fields, table.schema.metadata))
