"""What to evaluate, and what a folder of results says of itself."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from mien._version import __version__
from mien.errors import MienError, require
from mien.evaluation.protocols import DEFAULT_LOST_DEG, protocol_named
from mien.files import whole_file
from mien.registry import TRACKERS, argument_of, code_of, file_of

LANDMARK_SOURCES = ("detected", "truth")


@dataclass(frozen=True)
class Plan:
    """What to evaluate.

    dataset, root: the data set and its folder; out: the folder for results; trackers: for `create_tracker`,
    OpenFace's as `openface:PATH`; protocol: the name of one; landmarks: one of `LANDMARK_SOURCES`; focal_px:
    instead of the data set's; lost_deg: threshold of the protocol `paper`; sequences: the names of those to
    take, in one text or several, with commas between, all where empty; timed: on how many sequences each
    tracker's cost is measured.
    """

    dataset: str
    root: Path
    out: Path
    trackers: tuple[str, ...]
    protocol: str = "rebased"
    landmarks: str = "detected"
    focal_px: float | None = None
    lost_deg: float = DEFAULT_LOST_DEG
    sequences: tuple[str, ...] = ()
    timed: int = 1

    def __post_init__(self) -> None:
        protocol_named(self.protocol)
        require(bool(self.trackers), "no tracker was named; give --trackers with one name or more")
        require(
            self.landmarks in LANDMARK_SOURCES,
            f"the first landmarks come from {' or '.join(LANDMARK_SOURCES)}, not {self.landmarks!r}",
        )
        require(self.lost_deg > 0, f"the lost threshold must be positive, not {self.lost_deg:g} degrees")
        require(
            self.focal_px is None or self.focal_px > 0,
            f"the focal length must be positive, not {self.focal_px} pixels",
        )
        require(self.timed >= 0, f"the number of timed sequences must not be negative, but it is {self.timed}")
        for tracker in self.trackers:
            _require_known(tracker)
        labels = [label(t) for t in self.trackers]
        twice = sorted({name for name in labels if labels.count(name) > 1})
        require(not twice, f"more than one tracker is called {', '.join(twice)}; name each once")


@dataclass(frozen=True)
class Evaluation:
    """What `evaluation.json` says of a folder of results: the data set, the protocol, what belongs to it."""

    dataset: str
    protocol: str
    landmarks: str
    lost_deg: float
    trackers: tuple[str, ...]
    sequences: tuple[str, ...]
    kinds_of_sequences: tuple[str, ...]
    command: str
    version: str = __version__

    @property
    def kinds(self) -> tuple[str, ...]:
        """The kinds of sequences, each once."""
        return tuple(dict.fromkeys(self.kinds_of_sequences))

    def save(self, out: Path) -> None:
        """Write it, whole or not at all."""
        with whole_file(_file(out)) as beside:
            beside.write_text(json.dumps(asdict(self), indent=1) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, out: Path) -> Evaluation:
        """Raises MienError where the folder holds no evaluation."""
        path = _file(out)
        require(path.is_file(), f"{out} holds no results; make them with mien evaluate DATASET PATH -o {out}")
        try:
            values: Any = json.loads(path.read_text(encoding="utf-8"))
            members: Any = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
            return cls(**members)
        except (ValueError, TypeError) as e:
            raise MienError(f"{path} is not of this version of mien ({e}); evaluate into another folder") from e


def names_in(text: str, is_known: Callable[[str], bool]) -> list[str]:
    """The names in a text with commas between; a known name that has commas itself is one, and the longest first."""
    parts, names = text.split(","), list[str]()
    while parts:
        heads = {",".join(parts[:count]).strip(): count for count in range(len(parts), 0, -1)}
        name = next((head for head in heads if is_known(head)), parts[0].strip())
        names += [name] * bool(name)
        parts = parts[heads[name] :]
    return names


def is_tracker(name: str) -> bool:
    """Whether this is a tracker by its name alone, or one with a file, or folder, that exists."""
    file = file_of(name)
    return name in TRACKERS if file is None else os.path.exists(file)  # other than Path's, also of too long a name


def label(tracker: str) -> str:
    """A tracker's name in tables: of `openface:PATH` only the last part of the path."""
    file = file_of(tracker)
    return tracker if file is None else f"{tracker.partition(':')[0]}:{file.name}"


def replays(tracker: str) -> bool:
    """Whether it reads what was computed elsewhere, so that its time says nothing."""
    return tracker.partition(":")[0] == "openface"


def result_path(out: Path, tracker: str, sequence: str) -> Path:
    """Where the result of a tracker (its label) on a sequence is."""
    return out / "tracks" / file_name(tracker) / f"{sequence}.npz"


def timing_path(out: Path, tracker: str, sequence: str) -> Path:
    """Where the timing of a tracker (its label) on a sequence is."""
    return out / "timing" / file_name(tracker) / f"{sequence}.json"


def file_name(tracker: str) -> str:
    """A tracker's label as part of a path."""
    return re.sub(r"[^\w.-]+", "-", tracker)


def command_of(plan: Plan) -> str:
    """The command line that makes the same results."""
    words = ["mien evaluate", plan.dataset, str(plan.root), f"--trackers {','.join(plan.trackers)}"]
    words.append(f"--protocol {plan.protocol}")
    words += [f"--landmarks {plan.landmarks}"] if plan.landmarks != "detected" else []
    words += [f"--focal {plan.focal_px:g}"] if plan.focal_px is not None else []
    words += [f"--lost {plan.lost_deg:g}"] if plan.lost_deg != DEFAULT_LOST_DEG else []
    words += [f"--sequences {','.join(plan.sequences)}"] if plan.sequences else []
    words += [f"--timed {plan.timed}"] if plan.timed != 1 else []
    return " ".join([*words, f"-o {plan.out}"])


def _file(out: Path) -> Path:
    return out / "evaluation.json"


def _require_known(tracker: str) -> None:
    """Refuse a name that no tracker has, before anything runs."""
    name, _, argument = tracker.partition(":")
    require(
        name in TRACKERS or bool(argument),
        f"unknown tracker {tracker!r}; the trackers are {', '.join(TRACKERS)}, or MODULE:CLASS of your own",
    )
    if name == "openface":
        require(bool(argument), "openface needs a CSV or a folder of them: --trackers openface:PATH")
        require(Path(argument).exists(), f"{argument} does not exist; give OpenFace's CSV, or a folder of them")
    argument_of(tracker)  # settings that are wrong are told now, and not of every sequence
    require(
        name in TRACKERS or code_of(tracker) is not None,
        f"{tracker}: there is no module {name} here; give MODULE:CLASS of a file that Python finds",
    )
