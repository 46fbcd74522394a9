"""Data sets with ground truth, one module each, and `load_dataset`, which loads them by name."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

from mien.errors import require
from mien.evaluation.datasets import annotated_video, buft, rendered, talking_face
from mien.evaluation.datasets.sequence import Sequence

DATASETS: Mapping[str, Callable[[Path], tuple[Sequence, ...]]] = MappingProxyType(
    {
        "buft": buft.load,
        "talking-face": talking_face.load,
        "rendered": rendered.load,
        "video": annotated_video.load,
    }
)


def load_dataset(name: str, path: Path) -> tuple[Sequence, ...]:
    """Load the sequences of a data set, ordered by name.

    Raises MienError for an unknown data set (listing the known ones), a missing folder, a folder without sequences, and
    duplicate sequence names.
    """
    require(name in DATASETS, f"unknown data set {name!r}; the data sets are {', '.join(DATASETS)}")
    require(path.exists(), f"{path} does not exist; give the folder that contains the data set")
    path = Path(os.path.abspath(path)) if path.name in ("", "..") else path  # the name of a folder tells its kind
    sequences = DATASETS[name](path)
    names = [sequence.name for sequence in sequences]
    twice = sorted({name for name in names if names.count(name) > 1})
    require(not twice, f"{path} contains more than one sequence named {', '.join(twice)}; give one set at a time")
    return sequences
