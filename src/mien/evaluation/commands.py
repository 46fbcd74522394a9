"""The commands `mien evaluate` and `mien report`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mien.errors import MienError, warn
from mien.evaluation.benchmark import DEFAULT_TIME_LIMIT, run_plan
from mien.evaluation.cells import listed
from mien.evaluation.plan import Plan, is_tracker, split_names
from mien.evaluation.protocols import DEFAULT_LOST_DEG
from mien.evaluation.report import require_own, write_report
from mien.evaluation.scores import Scores, load_scores
from mien.processes import Progress
from mien.registry import TRACKERS


def evaluate(
    dataset: str,
    path: Path,
    out: Path,
    *,
    trackers: Sequence[str] = ("realtime", "paper", "mediapipe"),
    protocol: str = "rebased",
    jobs: int = 1,
    first_landmarks: str = "detected",
    focal_px: float | None = None,
    lost_deg: float = DEFAULT_LOST_DEG,
    time_limit: float = DEFAULT_TIME_LIMIT,
    sequences: Sequence[str] = (),
    timed: int = 1,
    progress: Progress = lambda done, total, name: None,
    forked: bool = False,
) -> tuple[Scores, Path]:
    """Run trackers on a data set, continue where an earlier run stopped, and write an HTML report; returns the scores,
    and the path of the report. What the trackers warned of is warned of once more.

    trackers, sequences: names, as one or more strings, each of which may contain several separated by commas. Raises
    MienError for bad input; a failed sequence becomes a score with its reason.
    """
    require_own(out)
    names = _tracker_names(trackers)
    plan = Plan(dataset, path, out, names, protocol, first_landmarks, focal_px, lost_deg, tuple(sequences), timed)
    try:
        run_plan(plan, jobs, time_limit, progress, forked)
    except KeyboardInterrupt:
        warn(f"stopped; what is done is in {out}; run the same command again to continue")
        raise
    scores = load_scores(out)
    written = write_report(scores, out, "html")
    for warning, concerned in scores.warnings.items():
        warn(f"{listed(result.sequence for result in concerned)}: {warning}")
    return scores, written


def require_a_result(scores: Scores) -> None:
    """Raise MienError if no tracker has a result for any sequence."""
    failed = [s.failure for s in scores.scores if s.failure]
    if len(failed) == len(scores.scores):
        raise MienError(f"no tracker gave a result for any sequence; the first reason: {failed[0]}")


def _tracker_names(trackers: Sequence[str]) -> tuple[str, ...]:
    """The tracker names in these comma-separated strings; `all` stands for all that need no file."""
    every = tuple(name for name in TRACKERS if name != "openface")
    names = (name for text in trackers for name in split_names(text, is_tracker))
    return tuple(dict.fromkeys(t for name in names for t in (every if name == "all" else (name,))))


def report(directory: Path, form: str = "markdown", protocol: str | None = None) -> Path:
    """Write the report of a results folder in a format; returns its path.

    protocol: by default that of the evaluation; the tracks are the same for all. Raises MienError if there are no
    results, or the format or protocol is unknown.
    """
    return write_report(load_scores(directory, protocol), directory, form)
