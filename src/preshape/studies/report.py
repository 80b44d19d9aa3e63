"""The report: Markdown with PNGs beside it, and one HTML file that holds everything."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path

from ..files import write_text, write_whole
from ..types import value
from ..viewer.report_page import markdown_page, report_page
from ..viewer.report_page import picture as figure
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
    write_text(markdown, "\n".join(_markdown(preface, chapters)) + "\n")
    write_text(html, report_page(TITLE, "\n".join(_html(out, preface, chapters))))
    return markdown, html


def write_pages(folder: Path, text: str) -> list[Path]:
    """Write a report as report.md and report.html, each whole or not at all.

    Args:
        folder: where; pictures that the report names lie there already.
        text: the Markdown.

    Raises:
        EnvironmentFailure: the folder cannot be written, or a picture is missing.
    """
    files = [folder / "report.md", folder / "report.html"]
    for file, content in zip(files, (text, markdown_page(text, folder)), strict=True):
        write_text(file, content)
    return files


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


def _html(out: Path, preface: Sequence[str], chapters: Sequence[Chapter]) -> Iterator[str]:
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
            yield figure(out / FOLDER / f"{picture.name}.png", picture.caption)
        for table in section.tables:
            yield from _html_table(table)
        if section.disagreements:
            yield f"<h3>{_sided(chapter)}</h3>\n<ul>"
            yield from (f"<li>{escape(sentence)}</li>" for sentence in section.disagreements)
            yield "</ul>"
        yield "</section>"


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
