"""What is known of a file, and what is written."""

from __future__ import annotations

import json
import os
import re
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mien.errors import MienError
from mien.files import checksum, json_text, require_writable, user_path, whole_file


def test_through_a_link_its_target_is_written(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    target, link = tmp_path / "elsewhere" / "target", tmp_path / "link.csv"
    link.symlink_to(target)
    require_writable(link)
    for text in ("new", "newer"):
        with whole_file(link) as file:
            assert file.suffix == ".csv"
            file.write_text(text)
        assert link.is_symlink()
        assert target.read_text() == text
    assert list((tmp_path / "elsewhere").iterdir()) == [target]


@pytest.mark.parametrize("path", [None, 5, b"out.csv"])
def test_what_is_no_path_is_told(path: Any) -> None:
    with pytest.raises(MienError, match=f"{re.escape(repr(path))} is no path of a file; give text or a pathlib.Path"):
        user_path(path)


def test_a_missing_folder_is_created(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere" / "target")
    for path in (tmp_path / "a" / "b" / "c", tmp_path / "link"):
        with whole_file(path) as file:
            file.write_text("new")
        assert path.read_text() == "new"


def test_a_name_that_is_too_long_is_refused_before_anything_is_done(tmp_path: Path) -> None:
    require_writable(tmp_path / f"{'n' * 247}.parquet")
    with pytest.raises(MienError, match=r"cannot be written \(file name too long\); choose a shorter name"):
        require_writable(tmp_path / f"{'n' * 248}.parquet")
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with a name")
def test_what_is_neither_file_nor_folder_is_not_replaced(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.mp4")
    (tmp_path / "link.mp4").symlink_to(tmp_path / "pipe.mp4")
    for name in ("pipe.mp4", "link.mp4"):
        with pytest.raises(MienError, match=rf"{name} is a pipe or a device; give the name of a file"):
            require_writable(tmp_path / name)
    assert (tmp_path / "pipe.mp4").is_fifo()


def test_lists_of_numbers_stand_on_one_line_and_strings_stay_as_they_are() -> None:
    values = {"name": "a[ 1 ].mp4", "lines": "[\n 1,\n 2\n]", "of": [[1, -2.5e-07], []], "not": ["[ 3 ]", None]}
    text = json_text(values)
    assert json.loads(text) == values
    assert "  [1, -2.5e-07],\n" in text


def test_what_json_does_not_know_is_told() -> None:
    for value, why in (
        (float("nan"), "nan"),
        (datetime(2024, 2, 29), "type datetime"),
        (np.float32(1), "type float32"),
    ):
        with pytest.raises(MienError, match=rf"cannot be written as JSON \(.*{why}.*\); give text, finite numbers"):
            json_text({"value": value})


def test_checksum_depends_on_contents_and_names(tmp_path: Path) -> None:
    a, b = tmp_path / "a", tmp_path / "b"
    a.write_bytes(b"abc")
    assert checksum(a) == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    before = checksum(tmp_path)
    a.rename(b)
    assert checksum(tmp_path) != before
