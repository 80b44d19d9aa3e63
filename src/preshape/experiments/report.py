"""The report: Markdown with PNGs beside it, and one HTML file that holds everything."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path

from ..io import write_whole
from ..types import value
from .values import Cell, Section, Table

TITLE = "preshape: the paper's results, reproduced"

FOLDER = "figures"
"""Where the PNGs lie, beside the report."""


@value
class Chapter:
    """A section under its heading.

    Attributes:
        name: the experiment's.
        title: heading.
        section: what it says.
    """

    name: str
    title: str
    section: Section


def write_report(out: Path, preface: Sequence[str], chapters: Sequence[Chapter]) -> tuple[Path, Path]:
    """Draw the pictures and write both forms.

    Returns:
        The Markdown and the HTML file.

    Raises:
        EnvironmentFailure: a file cannot be written.
    """
    for chapter in chapters:
        for picture in chapter.section.pictures:
            write_whole(out / FOLDER / f"{picture.name}.png", picture.draw)
    markdown, html = out / "report.md", out / "report.html"
    write_whole(markdown, lambda path: _write(path, "\n".join(_markdown(preface, chapters)) + "\n"))
    write_whole(html, lambda path: _write(path, "\n".join(_html(out, preface, chapters)) + "\n"))
    return markdown, html


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")


def cell_text(cell: Cell) -> str:
    """A table's cell.

    >>> cell_text(3), cell_text(3.14159), cell_text(None)
    ('3', '3.14', '–')
    """
    if cell is None or cell == "":
        return "–"
    return f"{cell:.2f}" if isinstance(cell, float) else str(cell)


def _sided(chapter: Chapter) -> str:
    return "Disagreements" if chapter.name != "learning" else "Remarks"


# Markdown.


def _markdown(preface: Sequence[str], chapters: Sequence[Chapter]) -> Iterator[str]:
    yield f"# {TITLE}\n"
    for paragraph in preface:
        yield f"{paragraph}\n"
    for chapter in chapters:
        yield f"- **{chapter.title}.** {chapter.section.headline}"
    for chapter in chapters:
        section = chapter.section
        yield f"\n## {chapter.title}\n"
        for paragraph in section.text:
            yield f"{paragraph}\n"
        for picture in section.pictures:
            yield f"![{picture.caption}]({FOLDER}/{picture.name}.png)\n\n*{picture.caption}*\n"
        for table in section.tables:
            yield from _markdown_table(table)
        if section.disagreements:
            yield f"**{_sided(chapter)}**\n"
            yield from (f"- {sentence}" for sentence in section.disagreements)


def _markdown_table(table: Table) -> Iterator[str]:
    def line(cells: Sequence[str]) -> str:
        return f"| {' | '.join(cell.replace('|', '/').replace(chr(10), ' · ') for cell in cells)} |"

    yield f"{table.caption}\n"
    yield line(table.columns)
    yield f"|{'---|' * len(table.columns)}"
    yield from (line([cell_text(cell) for cell in row]) for row in table.rows)
    yield ""


# HTML.

_STYLE = """
:root {
  --paper: #ffffff; --ink: #22262b; --quiet: #5b6470; --rule: #dde2e7; --band: #f5f7f9; --mark: #0072b2;
}
@media (prefers-color-scheme: dark) {
  :root {
    --paper: #15181c; --ink: #e4e7eb; --quiet: #9aa4b0; --rule: #333a42; --band: #1c2126; --mark: #56b4e9;
  }
}
* { box-sizing: border-box; }
body {
  margin: 0; background: var(--paper); color: var(--ink); font-size: 16px; line-height: 1.55;
  font-family: system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif;
}
main { max-width: 66rem; margin: 0 auto; padding: 2.5rem 1.25rem 5rem; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 1rem; }
h2 {
  font-size: 1.35rem; line-height: 1.25; margin: 3.5rem 0 .75rem; padding-top: 1.25rem;
  border-top: 1px solid var(--rule);
}
h3 { font-size: 1rem; margin: 1.5rem 0 .4rem; }
p, li { max-width: 46rem; }
p { margin: .6rem 0; }
a { color: var(--mark); }
nav ul { padding-left: 1.1rem; }
nav li { margin: .35rem 0; }
ul { margin: .4rem 0; }
li { margin: .25rem 0; }
figure { margin: 1.4rem 0; }
figure img {
  display: block; max-width: 100%; height: auto; background: #fff; border: 1px solid var(--rule);
  border-radius: 6px;
}
figcaption, .caption { color: var(--quiet); font-size: .9rem; }
figcaption { margin-top: .4rem; }
.caption { margin: 1.6rem 0 .4rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .85rem; font-variant-numeric: tabular-nums; }
th, td {
  padding: .35rem .5rem; text-align: left; vertical-align: top; border-bottom: 1px solid var(--rule);
}
th { font-weight: 600; vertical-align: bottom; border-bottom: 2px solid var(--rule); }
td.number { text-align: right; white-space: nowrap; }
th.number { text-align: right; }
.lines { white-space: nowrap; }
tbody tr:nth-child(even) { background: var(--band); }
@media print { h2, figure, .caption { break-after: avoid; } }
"""


def _html(out: Path, preface: Sequence[str], chapters: Sequence[Chapter]) -> Iterator[str]:
    yield '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">'
    yield '<meta name="viewport" content="width=device-width, initial-scale=1">'
    yield '<meta name="color-scheme" content="light dark">'
    yield f"<title>{escape(TITLE)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n<main>"
    yield f"<h1>{escape(TITLE)}</h1>"
    yield from (f"<p>{escape(paragraph)}</p>" for paragraph in preface)
    yield "<nav><ul>"
    for chapter in chapters:
        title, headline = escape(chapter.title), escape(chapter.section.headline)
        yield f'<li><a href="#{chapter.name}">{title}</a>. {headline}</li>'
    yield "</ul></nav>"
    for chapter in chapters:
        section = chapter.section
        yield f'<section id="{chapter.name}">\n<h2>{escape(chapter.title)}</h2>'
        yield from (f"<p>{escape(paragraph)}</p>" for paragraph in section.text)
        for picture in section.pictures:
            content = base64.b64encode((out / FOLDER / f"{picture.name}.png").read_bytes()).decode()
            caption = escape(picture.caption)
            yield f'<figure><img alt="{caption}" src="data:image/png;base64,{content}">'
            yield f"<figcaption>{caption}</figcaption></figure>"
        for table in section.tables:
            yield from _html_table(table)
        if section.disagreements:
            yield f"<h3>{_sided(chapter)}</h3>\n<ul>"
            yield from (f"<li>{escape(sentence)}</li>" for sentence in section.disagreements)
            yield "</ul>"
        yield "</section>"
    yield "</main>\n</body>\n</html>"


def _html_table(table: Table) -> Iterator[str]:
    columns = list(zip(*table.rows, strict=True)) or [()] * len(table.columns)
    styles = [" class=number" if _is_numeric(cells) else "" for cells in columns]
    yield f'<p class="caption">{escape(table.caption)}</p>\n<div class="wide"><table>'
    heads = zip(styles, table.columns, strict=True)
    yield f"<thead><tr>{''.join(f'<th{style}>{escape(name)}</th>' for style, name in heads)}</tr></thead>"
    yield "<tbody>"
    for row in table.rows:
        yield f"<tr>{''.join(_html_cell(style, cell) for style, cell in zip(styles, row, strict=True))}</tr>"
    yield "</tbody></table></div>"


def _is_numeric(cells: Sequence[Cell]) -> bool:
    there = [cell for cell in cells if cell is not None]
    return bool(there) and all(isinstance(cell, int | float) for cell in there)


def _html_cell(style: str, cell: Cell) -> str:
    text = cell_text(cell)
    style = " class=lines" if "\n" in text else style
    return f"<td{style}>{'<br>'.join(map(escape, text.split(chr(10))))}</td>"
