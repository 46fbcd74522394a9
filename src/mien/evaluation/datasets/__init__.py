"""Data sets with ground truth, one file each, and `load_dataset`, which finds them by name."""

from __future__ import annotations

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
    """The sequences of a data set, in the order of their names.

    Raises MienError for an unknown name (with those that exist), a missing folder, one without a sequence, and one with
    two of the same name.
    """
    require(name in DATASETS, f"unknown data set {name!r}; the data sets are {', '.join(DATASETS)}")
    require(path.exists(), f"{path} does not exist; give the folder that holds the data set")
    sequences = DATASETS[name](path)
    names = [sequence.name for sequence in sequences]
    twice = sorted({name for name in names if names.count(name) > 1})
    require(not twice, f"{path} holds more than one sequence named {', '.join(twice)}; give one set at a time")
    return sequences
