"""The report of a results folder: Markdown, LaTeX, CSV, or one self-contained HTML file."""

from __future__ import annotations

import base64
import html
from collections.abc import Callable
from pathlib import Path

from mien.errors import require
from mien.evaluation.cells import listed, sequences_of
from mien.evaluation.figures import save_figures
from mien.evaluation.formats import to_csv, to_html, to_latex, to_markdown
from mien.evaluation.plan import evaluation_path, ignores_landmarks
from mien.evaluation.scores import Scores
from mien.evaluation.tables import all_tables
from mien.files import whole_file

STYLE = """ body { font: 15px/1.5 system-ui, sans-serif; max-width: 72rem; margin: 2rem auto; padding: 0 1rem;
color: #222; } h1 { font-size: 1.6rem; } h2 { font-size: 1.15rem; margin-top: 2.2rem; } p { max-width: 52rem;
} table { border-collapse: collapse; font-size: 0.9rem; display: block; overflow-x: auto; } th, td { padding:
0.2rem 0.7rem; text-align: left; border-bottom: 1px solid #ddd; white-space: nowrap; } th { border-bottom: 2px
solid #888; } td.number { text-align: right; font-variant-numeric: tabular-nums; } #warnings td, #failures td {
white-space: normal; overflow-wrap: anywhere; min-width: 6rem; } figure { margin: 2rem 0; }
img { max-width: 100%; } figcaption { color: #555; } code { background: #f3f1ee; } pre { background: #f3f1ee;
padding: 0.7rem; overflow-x: auto; }
"""

FIGURES = "figures"
MEDIA_TYPES = {".png": "image/png", ".jpg": "image/jpeg"}


def write_report(scores: Scores, out: Path, form: str) -> Path:
    """Write the report of these scores to their folder, in a format of `FORMATS`; returns its path."""
    require(form in FORMATS, f"unknown format {form!r}; the formats are {', '.join(FORMATS)}")
    ending, make = FORMATS[form]
    path = out / f"report.{ending}"
    text = make(scores, out)
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace")
    return path


def _markdown(scores: Scores, out: Path) -> str:
    figures = save_figures(scores, out / FIGURES)
    pictures = [f"### {title}\n\n![{title}]({file.relative_to(out).as_posix()})\n" for title, file in figures.items()]
    tables = [to_markdown(t) for t in all_tables(scores)]
    return "\n".join([f"## {_title(scores)}", "", *(f"{line}\n" for line in _about(scores)), *tables, *pictures])


def _latex(scores: Scores, out: Path) -> str:
    return "\n".join(
        [f"% {_title(scores)}", *(f"% {line}" for line in _about(scores)), *map(to_latex, all_tables(scores))]
    )


def _csv(scores: Scores, out: Path) -> str:
    return to_csv(all_tables(scores))


def _html(scores: Scores, out: Path) -> str:
    figures = save_figures(scores, out / FIGURES)
    title = html.escape(_title(scores))
    command, *about = _about(scores)
    body = [f"<h1>{title}</h1>", f"<pre>{html.escape(command.strip('`'))}</pre>"]
    body += [f"<p>{html.escape(line)}</p>" for line in about]
    body += [to_html(t) for t in all_tables(scores)]
    body += [_html_figure(caption, file) for caption, file in figures.items()]
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>\n'
        f'<meta name="viewport" content="width=device-width">\n<style>{STYLE}</style></head>\n'
        f"<body>\n{chr(10).join(body)}\n</body></html>\n"
    )


FORMATS: dict[str, tuple[str, Callable[[Scores, Path], str]]] = {
    "markdown": ("md", _markdown),
    "latex": ("tex", _latex),
    "csv": ("csv", _csv),
    "html": ("html", _html),
}
"""Name of a format -> suffix of its file, function that writes it."""


def require_own(out: Path) -> None:
    """Raise MienError if a folder in which nothing was evaluated yet has a file, or figures, where a report will be."""
    places = [*(out / f"report.{ending}" for ending, _ in FORMATS.values()), out / FIGURES]
    taken = next((path for path in places if path.exists()), None)
    require(
        taken is None or evaluation_path(out).exists(),
        f"{taken} exists and is not of mien evaluate; choose another folder with -o, or move it away",
    )


def _title(scores: Scores) -> str:
    return f"Trackers on {scores.evaluation.dataset}, protocol {scores.protocol.value}"


def _about(scores: Scores) -> list[str]:
    """The command line, and what all numbers have in common."""
    e = scores.evaluation
    own = listed(filter(ignores_landmarks, e.trackers))
    return [
        f"`{e.command}`",
        f"mien {e.version}; {sequences_of(e.sequences)}; every tracker is given "
        f"the same landmarks of the first frame ({e.landmarks}){f', which are ignored by {own}' if own else ''}. "
        f"The protocol of all angles is {scores.protocol.value}.",
    ]


def _html_figure(caption: str, file: Path) -> str:
    data = base64.b64encode(file.read_bytes()).decode()
    source = f"data:{MEDIA_TYPES[file.suffix]};base64,{data}"
    text = html.escape(caption)
    return f'<figure><img alt="{text}" src="{source}"><figcaption>{text}</figcaption></figure>'
