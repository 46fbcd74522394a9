"""The commands `mien evaluate` and `mien report`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mien.errors import MienError, warn
from mien.evaluation.benchmark import DEFAULT_TIME_LIMIT, run_plan
from mien.evaluation.plan import Plan, is_tracker, split_names
from mien.evaluation.protocols import DEFAULT_LOST_DEG
from mien.evaluation.report import write_report
from mien.evaluation.scores import Scores, load_scores
from mien.evaluation.tables import by_kind, failures, landmarks, listed
from mien.processes import progress_bar
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
    quiet: bool = False,
    forked: bool = False,
) -> Path:
    """Run trackers on a data set, continue where an earlier run stopped, and write an HTML report; returns its path.

    trackers, sequences: names, as one or more strings, each of which may contain several separated by commas.

    Raises MienError for bad input, or if no tracker has a result for any sequence.
    """
    names = _tracker_names(trackers)
    plan = Plan(dataset, path, out, names, protocol, first_landmarks, focal_px, lost_deg, tuple(sequences), timed)
    try:
        with progress_bar("reading the data set", quiet) as progress:
            run_plan(plan, jobs, time_limit, progress, forked)
    except KeyboardInterrupt:
        warn(f"stopped; what is done is in {out}; run the same command again to continue")
        raise
    scores = load_scores(out)
    written = write_report(scores, out, "html")
    for warning, concerned in scores.warnings.items():
        warn(f"{listed(result.sequence for result in concerned)}: {warning}")
    if not quiet:
        _print_summary(scores)
        print(f"wrote {written}")
    failed = [s.failure for s in scores.scores if s.failure]
    if len(failed) == len(scores.scores):
        raise MienError(f"no tracker gave a result for any sequence; the first reason: {failed[0]}")
    return written


def _tracker_names(trackers: Sequence[str]) -> tuple[str, ...]:
    """The tracker names in these comma-separated strings; `all` stands for all that need no file."""
    every = tuple(name for name in TRACKERS if name != "openface")
    names = (name for text in trackers for name in split_names(text, is_tracker))
    return tuple(dict.fromkeys(t for name in names for t in (every if name == "all" else (name,))))


def report(directory: Path, form: str = "markdown", protocol: str | None = None) -> Path:
    """Write the report of a results folder in a format, print its path, and return it.

    protocol: by default that of the evaluation; the tracks are the same for all. Raises MienError if there are no
    results, or the format or protocol is unknown.
    """
    written = write_report(load_scores(directory, protocol), directory, form)
    print(f"wrote {written}")
    return written


def _print_summary(scores: Scores) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Column
    from rich.table import Table as RichTable

    console = Console()
    for table in (by_kind(scores), landmarks(scores), failures(scores)):
        if table.rows:
            # Truncated names with the same beginning would be indistinguishable.
            columns = [Column(name, overflow="fold") for name in table.columns]
            shown = RichTable(*columns, title=table.title, title_justify="left")
            for row in table.rows:
                shown.add_row(*map(escape, row))
            console.print(shown)
    console.print(f"protocol: {scores.protocol.value}", highlight=False)
