"""What to evaluate, and the description of a results folder."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from mien._version import __version__
from mien.errors import MienError, require
from mien.evaluation.protocols import DEFAULT_LOST_DEG, protocol_named
from mien.files import exists, whole_file
from mien.registry import TRACKERS, argument_of, code_of, file_of, unknown_tracker

LANDMARK_SOURCES = ("detected", "truth")


@dataclass(frozen=True)
class Plan:
    """What to evaluate.

    dataset, root: the data set and its folder; out: the results folder; trackers: names for `create_tracker`,
    OpenFace's as `openface:PATH`; protocol: its name; landmarks: one of `LANDMARK_SOURCES`; focal_px: replaces that of
    the data set; lost_deg: threshold of the protocol `paper`; sequences: their names, as strings that may contain
    several separated by commas, or empty for all; timed: number of sequences on which the cost of each tracker is
    measured. Raises MienError for what cannot be evaluated, as an unknown tracker.
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
        names = [file_name(label(t)) for t in self.trackers]
        folded = [name.casefold() for name in names]  # as some file systems compare them
        twice = sorted({name for name in folded if folded.count(name) > 1})
        require(
            not twice,
            f"more than one tracker would have its results in tracks/{', '.join(twice)}; name each once, and files of "
            "settings so that they differ in letters or digits",
        )


@dataclass(frozen=True)
class Evaluation:
    """The content of `evaluation.json` in a results folder: data set, protocol, trackers and sequences."""

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
        """Write it to a results folder, atomically."""
        with whole_file(evaluation_path(out)) as temporary:
            temporary.write_text(json.dumps(asdict(self), indent=1) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, out: Path) -> Evaluation:
        """Read it from a results folder. Raises MienError if there is none."""
        path = evaluation_path(out)
        require(path.is_file(), f"{out} contains no results; create them with mien evaluate DATASET PATH -o {out}")
        try:
            values: Any = json.loads(path.read_text(encoding="utf-8"))
            members: Any = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
            return cls(**members)
        except (ValueError, TypeError, AttributeError) as e:
            raise MienError(f"{path} is not from this version of mien ({e}); evaluate into another folder") from e


def split_names(text: str, is_known: Callable[[str], bool]) -> list[str]:
    """Split a text at commas into names; a known name may itself contain commas, and the longest match wins."""
    parts, names = text.split(","), list[str]()
    while parts:
        heads = {",".join(parts[:count]).strip(): count for count in range(len(parts), 0, -1)}
        name = next((head for head in heads if is_known(head)), parts[0].strip())
        names += [name] * bool(name)
        parts = parts[heads[name] :]
    return names


def is_tracker(name: str) -> bool:
    """Whether this is the name of a tracker, or one with a file or folder that exists."""
    file = file_of(name)
    return name in TRACKERS if file is None else exists(file)


def label(tracker: str) -> str:
    """The name of a tracker in tables: for NAME:PATH, with only the last component of the path."""
    file = file_of(tracker)
    return tracker if file is None else f"{tracker.partition(':')[0]}:{file.name}"


def replays(tracker: str) -> bool:
    """Whether the tracker only reads results computed elsewhere, so that timing it is meaningless."""
    return tracker.partition(":")[0] == "openface"


def ignores_landmarks(tracker: str) -> bool:
    """Whether the tracker makes no use of the landmarks of the first frame that it is given, as it has its own."""
    return tracker == "mediapipe" or replays(tracker)


def evaluation_path(out: Path) -> Path:
    """Path of the description of a results folder."""
    return out / "evaluation.json"


def result_path(out: Path, tracker: str, sequence: str) -> Path:
    """Path of the result of a tracker (its label) on a sequence."""
    return out / "tracks" / file_name(tracker) / f"{sequence}.npz"


def timing_path(out: Path, tracker: str, sequence: str) -> Path:
    """Path of the timing of a tracker (its label) on a sequence."""
    return out / "timing" / file_name(tracker) / f"{sequence}.json"


def file_name(tracker: str) -> str:
    """The label of a tracker as a path component."""
    return re.sub(r"[^\w.-]+", "-", tracker)


def command_of(plan: Plan) -> str:
    """The command line that reproduces the results."""
    words = ["mien", "evaluate", plan.dataset, str(plan.root), "--trackers", ",".join(plan.trackers)]
    words += ["--protocol", plan.protocol]
    words += ["--landmarks", plan.landmarks] if plan.landmarks != "detected" else []
    words += ["--focal", f"{plan.focal_px:.15g}"] if plan.focal_px is not None else []
    words += ["--lost", f"{plan.lost_deg:.15g}"] if plan.lost_deg != DEFAULT_LOST_DEG else []
    words += ["--sequences", ",".join(plan.sequences)] if plan.sequences else []
    words += ["--timed", str(plan.timed)] if plan.timed != 1 else []
    return shlex.join([*words, "-o", str(plan.out)])


def _require_known(tracker: str) -> None:
    """Raise MienError for an unknown tracker before anything runs."""
    name, _, argument = tracker.partition(":")
    require(name in TRACKERS or bool(argument), unknown_tracker(tracker))
    if name == "openface":
        require(bool(argument), "openface needs a CSV or a folder of them: --trackers openface:PATH")
        require(is_tracker(tracker), f"{argument} does not exist; give OpenFace's CSV, or a folder of them")
    argument_of(tracker)  # report invalid settings once, now, and not for every sequence
    require(
        name in TRACKERS or code_of(tracker) is not None,
        f"{tracker}: there is no module {name} here; give the MODULE:CLASS of a file that Python can import",
    )
