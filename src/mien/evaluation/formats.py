"""Tables as Markdown, LaTeX, CSV and HTML."""

from __future__ import annotations

import csv
import html
import io
import re
from collections.abc import Iterable, Iterator, Sequence

from mien.evaluation.cells import NONE
from mien.evaluation.tables import Table

_LATEX = {"%": r"\%", "&": r"\&", "_": r"\_", "#": r"\#", "$": r"\$", "±": r"$\pm$", "°": r"$^\circ$", "²": "$^2$"}
_LATEX |= {"—": "--", "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
_LATEX |= {"\\": r"\textbackslash{}", "<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}"}
_MARKDOWN = str.maketrans({"|": r"\|", "<": r"\<", "\n": " "})
"""What would end a cell or a row, or begin a tag of HTML, which renderers drop."""
_TWO_NUMBERS = re.compile(r"([0-9.]+) (±|of) ([0-9.]+)")


def to_markdown(table: Table) -> str:
    """A heading, the note, and a table with aligned columns."""
    rows = [table.columns, *table.rows]
    rows = [tuple(cell.translate(_MARKDOWN) for cell in row) for row in rows]
    widths = [max(len(row[i]) for row in rows) for i in range(len(table.columns))]
    lines = ["| " + " | ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)) + " |" for row in rows]
    lines.insert(1, "|" + "|".join("-" * (w + 2) for w in widths) + "|")
    return "\n".join([f"### {table.title}", "", table.caption, "", *lines, ""])


def to_latex(table: Table) -> str:
    """A `table` environment that needs no packages."""
    rows = [" & ".join(_latex(c) for c in row) + r" \\" for row in table.rows]
    return "\n".join(
        [
            r"\begin{table}",
            r"\centering",
            rf"\caption{{{_latex(table.title)}. {_latex(table.caption.replace('`', ''))}}}",
            rf"\label{{tab:{table.name}}}",
            rf"\begin{{tabular}}{{{'l' * len(table.columns)}}}",
            r"\hline",
            " & ".join(_latex(c) for c in table.columns) + r" \\",
            r"\hline",
            *rows,
            r"\hline",
            r"\end{tabular}",
            r"\end{table}",
            "",
        ]
    )


def to_html(table: Table) -> str:
    """A section with a heading, the note and the table."""
    head = "".join(f"<th>{html.escape(c)}</th>" for c in table.columns)
    body = "\n".join("<tr>" + "".join(_html_cell(c) for c in row) + "</tr>" for row in table.rows)
    return (
        f'<section id="{table.name}"><h2>{html.escape(table.title)}</h2>\n<p>{_code(html.escape(table.caption))}</p>\n'
        f"<table><thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody></table></section>\n"
    )


def to_csv(tables: Iterable[Table]) -> str:
    """All tables in long format, one line per number, ready to pivot: of `0.34 ± 0.23` or `4 of 597` the second is that
    of a column of its own. Missing values are empty."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(("table", "protocol", "row", "tracker", "column", "value"))
    for table in tables:
        for number, row in enumerate(table.rows):
            for column, value in _cells(table.columns, row):
                writer.writerow((table.name, table.protocol, number, row[0], column, "" if value == NONE else value))
    return out.getvalue()


def _cells(columns: Sequence[str], row: Sequence[str]) -> Iterator[tuple[str, str]]:
    for column, value in list(zip(columns, row, strict=True))[1:]:
        two = _TWO_NUMBERS.fullmatch(value)
        yield from [(column, two[1]), (f"{column}, {two[2]}", two[3])] if two else [(column, value)]


def _latex(text: str) -> str:
    return "".join(_LATEX.get(c, c) for c in text)


def _html_cell(cell: str) -> str:
    number = cell.removeprefix("-")[:1].isdigit()
    return f'<td class="{"number" if number else "text"}">{html.escape(cell)}</td>'


def _code(escaped: str) -> str:
    """Mark up text between backquotes as code."""
    parts = escaped.split("`")
    return "".join(f"<code>{p}</code>" if i % 2 else p for i, p in enumerate(parts))
