"""What is known of a file."""

from __future__ import annotations

from pathlib import Path

from mien.files import checksum


def test_checksum_depends_on_contents_and_names(tmp_path: Path) -> None:
    a, b = tmp_path / "a", tmp_path / "b"
    a.write_bytes(b"abc")
    assert checksum(a) == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    before = checksum(tmp_path)
    a.rename(b)
    assert checksum(tmp_path) != before
