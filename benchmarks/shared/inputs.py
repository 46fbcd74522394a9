"""What the benchmarks read: folders of recordings and of rendered sequences."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mien.arrays import Array
from mien.errors import require
from mien.video import VIDEO_SUFFIXES


def videos_of(folder: Path) -> list[Path]:
    """The videos of a folder, in order. Raises MienError where there is none."""
    found = sorted(folder.iterdir()) if folder.is_dir() else []
    videos = [path for path in found if path.suffix.lower() in VIDEO_SUFFIXES]
    require(bool(videos), f"{folder}: no video is there; give a folder of recordings, {', '.join(VIDEO_SUFFIXES)}")
    return videos


def truth_of(folder: Path, name: str) -> dict[str, Array]:
    """The arrays of a rendered sequence's truth by name. Raises MienError where there is none."""
    file = folder / f"{name}_truth.npz"
    require(file.is_file(), f"{file}: no such file; give the folder of the rendered sequences, with all of its files")
    return dict(np.load(file))
