"""One job of an evaluation, run in a separate process: `main(JSON)`.

A job finds the landmarks of a first frame, tracks a sequence, or times a tracker on it. It writes one file; if it
fails, it prints one sentence and ends with status 1.
"""

from __future__ import annotations

import json
import sys
import traceback
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any
from warnings import catch_warnings, simplefilter

from mien.errors import MienError, MienWarning, require
from mien.evaluation.datasets import load_dataset
from mien.evaluation.datasets.sequence import Sequence
from mien.evaluation.run import count_frames, run_sequence, time_sequence
from mien.initialization.landmark_files import read_landmarks, write_landmarks
from mien.initialization.landmarks import Landmarks
from mien.processes import REASON_PREFIX
from mien.registry import create_tracker
from mien.video import open_video


@dataclass(frozen=True)
class Job:
    """A task and its output file.

    task: `landmarks`, `track` or `time`; tracker: name for `create_tracker`; label: its name in tables; landmarks: file
    of the first frame's landmarks; source: their origin, `detected` or `truth`; focal_px: replaces that of the data
    set; out: the file to write.
    """

    task: str
    dataset: str
    root: str
    sequence: str
    landmarks: str
    source: str
    out: str
    focal_px: float | None = None
    tracker: str = ""
    label: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)

    def to_json(self) -> str:
        return json.dumps(asdict(self))


def run(job: Job) -> None:
    """Run a job. Raises any error."""
    tasks: dict[str, Callable[[Job, Sequence], None]] = {"landmarks": _find_landmarks, "track": _track, "time": _time}
    tasks[job.task](job, _sequence(job))


def main(job: str) -> None:
    """Run a job given as JSON; if it fails, end the process with a sentence and status 1."""
    try:
        run(Job(**json.loads(job)))
    except MienError as e:
        sys.exit(f"{REASON_PREFIX}{e}")
    except Exception as e:
        traceback.print_exc()
        where = traceback.extract_tb(e.__traceback__)[-1]
        sys.exit(
            f"{REASON_PREFIX}{type(e).__name__}: {' '.join(str(e).split())} ({Path(where.filename).name}, line "
            f"{where.lineno})"
        )


def _sequence(job: Job) -> Sequence:
    sequence = next(s for s in load_dataset(job.dataset, Path(job.root)) if s.name == job.sequence)
    return sequence if job.focal_px is None else sequence.with_focal(job.focal_px)


def _find_landmarks(job: Job, sequence: Sequence) -> None:
    """Write the landmarks of the first frame, from its truth or from the detector."""
    if job.source == "truth":
        landmarks = sequence.truth_of(count_frames(sequence.video)).first_landmarks(str(sequence.source))
    else:
        landmarks = _detect(sequence)
    write_landmarks(job.out, landmarks)


def _detect(sequence: Sequence) -> Landmarks:
    from mien.initialization.detector import detect
    from mien.initialization.straight import straightened

    frame = next(iter(open_video(sequence.video)))
    faces = detect(frame)
    require(bool(faces), f"{sequence.video}: no face was found in the first frame; give --landmarks truth")
    return straightened(frame, faces[0], sequence.camera_for(frame.width, frame.height))


def _track(job: Job, sequence: Sequence) -> None:
    """Write the result of a tracker, with what is warned of, as nobody reads what this process prints."""
    with catch_warnings(record=True) as told:
        simplefilter("always", MienWarning)
        landmarks = read_landmarks(job.landmarks)
        tracker = create_tracker(job.tracker)
        result = run_sequence(tracker, sequence, landmarks, job.label, job.dataset, job.settings)
    texts = [str(one.message) for one in told if issubclass(one.category, MienWarning)]
    replace(result, warnings=tuple(dict.fromkeys(texts))).save(Path(job.out))


def _time(job: Job, sequence: Sequence) -> None:
    landmarks = read_landmarks(job.landmarks)
    timing = time_sequence(partial(create_tracker, job.tracker), sequence, landmarks, job.label, job.settings)
    timing.save(Path(job.out))
