"""What the command line prints: errors, warnings and results, each a sentence; and progress bars, on a terminal."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, TextIO

import typer

from mien.errors import MienWarning

if TYPE_CHECKING:
    from rich.console import Console

    from mien.evaluation.scores import Scores
    from mien.processes import Progress
    from mien.tracking.state import Estimate


def print_written(paths: list[Path]) -> None:
    """Say which files were written."""
    for path in paths:
        typer.echo(f"wrote {path}")


def print_scores(scores: Scores) -> None:
    """The tables of an evaluation that say most."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Column, Table

    from mien.evaluation.tables import by_kind, failures, landmarks

    console = Console()
    errors = by_kind(scores)
    if errors.rows and len(errors.rows) + 1 < len(errors.columns):  # there may be fifteen kinds
        errors = errors.transposed
    for table in (errors, landmarks(scores), failures(scores)):
        if table.rows:
            # Truncated names with the same beginning would be indistinguishable.
            columns = [Column(name, overflow="fold") for name in table.columns]
            shown = Table(*columns, title=table.title, title_justify="left")
            for row in table.rows:
                shown.add_row(*map(escape, row))
            console.print(shown)
    console.print(f"protocol: {scores.protocol.value}", highlight=False)


def print_error(sentence: str) -> None:
    """Print a sentence, on one line, on stderr."""
    # By `print`, above a progress bar if there is one: Click writes past it, behind its end.
    print(" ".join(sentence.split()), file=sys.stderr)


@cache
def print_error_once(sentence: str) -> None:
    """Problems of a file are found again each time it is read."""
    print_error(sentence)


def show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Print warnings of mien as one sentence, all others as Python does."""
    if issubclass(category, MienWarning):
        print_error_once(f"mien: {message}")
    else:
        print(warnings.formatwarning(message, category, filename, lineno), file=sys.stderr, end="")


def _console(quiet: bool) -> Console | None:
    """The terminal for a progress bar; None if none is wanted, or stderr is no terminal."""
    if quiet:
        return None
    from rich.console import Console

    console = Console(stderr=True)
    return console if console.is_terminal else None  # in Rich before 14.3 a disabled bar ends with an empty line


@contextmanager
def frames_bar(quiet: bool) -> Iterator[Callable[[Estimate, int | None], None] | None]:
    """A progress bar with the speed and the state of the track, if stderr is a terminal."""
    console = _console(quiet)
    if console is None:
        yield None
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[speed]}"),
        TimeRemainingColumn(),
        TextColumn("{task.description}"),
    )
    with Progress(*columns, console=console) as bar:
        task = bar.add_task("looking for the face", total=None, speed="")
        first: list[float] = []  # end time of the first frame: the speed excludes finding and learning the face

        def advance(estimate: Estimate, total: int | None) -> None:
            if not first:
                first.append(monotonic())
            seconds = monotonic() - first[0]
            speed = f"{bar.tasks[0].completed / seconds:.1f} frames/s" if seconds > 0.2 else ""
            bar.update(task, advance=1, total=total, speed=speed, description=_state(estimate))

        yield advance


def _state(estimate: Estimate) -> str:
    """`tracked, confidence 97%`, or `lost: REASON`."""
    if estimate.status.success:
        return f"{estimate.status.value}, confidence {100 * estimate.confidence:.0f}%"
    return f"lost: {estimate.reason}"


@contextmanager
def jobs_bar(initial_text: str, quiet: bool) -> Iterator[Progress]:
    """A progress bar on stderr, if that is a terminal, that names the last job started; initial_text: shown before the
    first one."""
    console = _console(quiet)
    if console is None:
        yield lambda done, total, name: None
        return
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as RichProgress

    columns = (BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), TextColumn("{task.description}"))
    with RichProgress(*columns, console=console) as bar:
        task = bar.add_task(initial_text, total=None)

        def show(done: int, total: int, name: str) -> None:
            bar.update(task, completed=done, total=total, description=name)

        yield show
