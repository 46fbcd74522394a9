"""The estimates of a running track, collected on disk."""

from __future__ import annotations

import math
import mmap
import tempfile
from array import array
from contextlib import suppress
from pathlib import Path
from typing import IO

import numpy as np
import pyarrow as pa

from mien.arrays import Array
from mien.errors import require
from mien.files import named_errors
from mien.output.columns import sort_columns, table_from_estimates
from mien.tracking.state import Estimate, landmark_names_with

BATCH = 256
"""Number of estimates that the recorder buffers in memory before it writes them to its file."""
_MAPPED_BYTES = 1 << 24
"""Size from which a table stays in the file: one that does holds the file open, of which a process may have a few
hundred, and who tracks many videos may keep the tracks of all."""


class Recorder:
    """Collects estimates in an unnamed temporary file, so that memory does not grow with the video.

    The file is in the folder of `path`, if given, and disappears with the process, however that ends. face_id: index
    of the face in the video. turn: (3, 3), in camera axes, what corrects the rotation of every row so far, which the
    table does not contain yet.
    """

    def __init__(self, path: Path | None = None, face_id: int = 0) -> None:
        self.path = path or Path(tempfile.gettempdir())
        self.face_id = face_id
        self.landmark_names: tuple[str, ...] = ()
        self.mm_per_unit = 1.0
        self.turn = np.eye(3)
        self._buffer: list[Estimate] = []
        self._flushed, self._flushed_index = 0, -1  # number of rows in the file, and the index of the last of them
        self._written = 0  # bytes of the file that hold whole batches; an interrupt may leave a part of one after them
        self._model_rotations = array("d")
        with named_errors(self.path):
            folder = None if path is None else path.parent
            self._file: IO[bytes] = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - closed by __exit__

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(OSError):  # on a full disk, flushing the buffer fails; its content is no longer needed
            self._file.close()

    @property
    def count(self) -> int:
        """Number of rows so far."""
        return self._flushed + len(self._buffer)

    @property
    def last_index(self) -> int:
        """Index of the frame of the last row, -1 if there is none."""
        return self._buffer[-1].index if self._buffer else self._flushed_index

    def add(self, estimate: Estimate) -> None:
        """Append one row; where this is interrupted, `last_index` tells whether it is there. Raises MienError if it has
        other landmarks than an earlier one."""
        self.landmark_names = landmark_names_with(self.landmark_names, estimate)
        if estimate.status.success:
            self.mm_per_unit = float(estimate.mm_per_unit)  # as JSON takes it
        self._buffer.append(estimate)
        if len(self._buffer) >= BATCH:
            self._flush()

    @property
    def model_rotations(self) -> Array:
        """(n, 3, 3) `Estimate.model_rotation` of all rows, NaN where there is none."""
        self._flush()
        return np.array(self._model_rotations).reshape(-1, 3, 3)

    def table(self) -> pa.Table:
        """The table of all rows so far; those of a long video stay in the file and are read on demand."""
        require(self.count > 0, "there is nothing to write, as no frame was tracked")
        self._flush()
        content = pa.BufferReader(pa.py_buffer(self._content()))
        tables = []
        while content.tell() < content.size():
            tables.append(pa.ipc.open_stream(content).read_all())
        table = pa.concat_tables(tables, promote_options="default")
        return table.select(sort_columns(table.column_names))

    def _content(self) -> bytes | mmap.mmap:
        """What is in the file, which is then written on at its end."""
        if self._file.tell() >= _MAPPED_BYTES:
            return mmap.mmap(self._file.fileno(), 0, access=mmap.ACCESS_READ)
        self._file.seek(0)
        return self._file.read()

    def _flush(self) -> None:
        """Each batch has its own schema, as the estimated quantities may change during a video."""
        if self._buffer:
            table = table_from_estimates(self._buffer, self.face_id)
            with named_errors(self.path):
                self._file.seek(self._written)
                with pa.ipc.new_stream(self._file, table.schema) as stream:
                    stream.write_table(table)
                self._file.flush()
                written = self._file.tell()
            del self._model_rotations[9 * self._flushed :]  # those of a flush that was interrupted
            for estimate in self._buffer:
                R = estimate.model_rotation
                self._model_rotations.extend([math.nan] * 9 if R is None else R.ravel().tolist())
            # Without a call from one to the next, where an interrupt could come.
            self._flushed, self._flushed_index, self._written, self._buffer = self.count, self.last_index, written, []
