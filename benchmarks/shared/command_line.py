"""Command lines of the benchmarks: what they name, how bad input ends them, the heads of what they print."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

from mien.errors import MienError


def parser_of(description: str | None, *paths: str) -> argparse.ArgumentParser:
    """A command line that names these files and folders."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in paths:
        parser.add_argument(name, type=Path)
    return parser


def carry_out(main: Callable[[], None]) -> None:
    """Run a benchmark; bad input ends it as it ends `mien`: one sentence on stderr, status 2."""
    try:
        main()
    except MienError as error:
        print(f"{Path(sys.argv[0]).name}: {error}", file=sys.stderr)
        sys.exit(2)


def print_heads(*columns: str) -> None:
    """The first two lines of a table in Markdown."""
    print(f"| {' | '.join(columns)} |", "|---" * len(columns) + "|", sep="\n")
