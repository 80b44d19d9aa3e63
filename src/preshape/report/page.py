"""Reports as files: Markdown with separate figures, and one HTML page that opens from disk, offline."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any

from ..exceptions import EnvironmentFailure
from ..files import write_json, write_text, write_whole
from .markdown import markdown
from .plain import html_text as escape
from .values import Block, Bullets, Cell, Figure, Heading, Report, Table, cell_text

POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
"""Content security policy of a report: no scripts, and nothing is loaded."""


def write_report(folder: Path, report: Report, document: Any = None) -> list[Path]:
    """Draw the figures and write ``report.md`` and ``report.html``, each completely or not at all.

    Args:
        folder: Folder of the files.
        report: The report.
        document: The same results as JSON, to be written as ``report.json``; ``None`` for none.

    Returns:
        The files, without the figures.

    Raises:
        EnvironmentFailure: A file cannot be written.
    """
    for figure in report.figures:
        write_whole(folder / figure.file, figure.draw)
    files = [folder / "report.md", folder / "report.html"]
    write_text(files[0], markdown(report))
    write_text(files[1], html_page(report, folder))
    if document is not None:
        write_json(folder / "report.json", document)
        files.insert(0, folder / "report.json")
    return files


def base_style() -> str:
    """The style sheet that all pages share."""
    return _style("base.css")


def _style(name: str) -> str:
    return (resources.files("preshape.report") / name).read_text(encoding="utf-8")


def html_page(report: Report, folder: Path) -> str:
    """The whole report as one HTML page that contains its figures.

    Args:
        report: The report.
        folder: Folder with the figures.

    Raises:
        EnvironmentFailure: A figure cannot be read.
    """
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
        '<meta name="color-scheme" content="light dark">\n<link rel="icon" href="data:,">\n'
        f"<title>{escape(report.title)} · preshape</title>\n"
        f"<style>{base_style()}{_style('report.css')}</style>\n</head>\n"
        f"<body>\n<main>\n{chr(10).join(_body(report, folder))}\n</main>\n</body>\n</html>\n"
    )


def _body(report: Report, folder: Path) -> Iterator[str]:
    yield f"<h1>{escape(report.title)}</h1>"
    yield from (_block(block, folder) for block in report.preface)
    listed = [chapter for chapter in report.chapters if chapter.headline]
    if listed:
        items = (f'<a href="#{c.name}">{escape(c.title)}</a>. {_inline(c.headline)}' for c in listed)
        yield f"<nav>{_list(items)}</nav>"
    for chapter in report.chapters:
        anchor = f' id="{chapter.name}"' if chapter.name else ""
        yield f"<section{anchor}>\n<h2>{escape(chapter.title)}</h2>"
        yield from (_block(block, folder) for block in chapter.blocks)
        yield "</section>"


def _block(block: Block, folder: Path) -> str:
    match block:
        case Heading():
            return f"<h3>{escape(block.text)}</h3>"
        case Bullets():
            return _list(map(_inline, block.items))
        case Table():
            caption = f'<p class="caption">{_inline(block.caption)}</p>\n' if block.caption else ""
            return caption + _table(block)
        case Figure():
            return _figure(folder / block.file, block.caption)
        case _:
            return f"<p>{_inline(block)}</p>"


def _list(items: Iterator[str] | map[str]) -> str:
    return f"<ul>{''.join(f'<li>{item}</li>' for item in items)}</ul>"


def _figure(file: Path, caption: str) -> str:
    """The picture inside the page, so that the page needs no other file."""
    try:
        content = base64.b64encode(file.read_bytes()).decode("ascii")
    except OSError as error:
        raise EnvironmentFailure(f"{file} cannot be read: {error.strerror or error}") from error
    words = escape(caption)
    return (
        f'<figure><img alt="{words}" src="data:image/png;base64,{content}">'
        f"<figcaption>{words}</figcaption></figure>"
    )


def _table(table: Table) -> str:
    if not table.rows:
        return "<p>None.</p>"
    numbers = [all(_is_number(row[i]) for row in table.rows) for i in range(len(table.columns))]

    def line(cells: tuple[Cell, ...], tag: str) -> str:
        return "".join(_cell(cell, tag, number) for cell, number in zip(cells, numbers, strict=True))

    rows = "".join(f"<tr>{line(row, 'td')}</tr>" for row in table.rows)
    head = f"<thead><tr>{line(table.columns, 'th')}</tr></thead>"
    return f'<div class="wide"><table>{head}<tbody>{rows}</tbody></table></div>'


def _is_number(cell: Cell) -> bool:
    """Whether a cell holds numbers only; a column of numbers is aligned right."""
    return re.fullmatch(r"[-+–]?[\d.,%() ~to-]*", cell_text(cell)) is not None


def _cell(cell: Cell, tag: str, number: bool) -> str:
    text = cell_text(cell)
    kind = " class=lines" if "\n" in text and tag == "td" else " class=number" if number else ""
    return f"<{tag}{kind}>{'<br>'.join(map(_inline, text.splitlines()))}</{tag}>"


def _inline(text: str) -> str:
    """A line as HTML with strong, emphasised and code words; everything else is escaped."""
    parts = re.split(r"(`[^`]+`)", text)
    out = []
    for part in parts:
        if part.startswith("`") and part.endswith("`") and len(part) > 2:
            out.append(f"<code>{escape(part[1:-1])}</code>")
            continue
        words = escape(part)
        words = re.sub(r"\*\*([^*]+)\*\*", r"<strong>\1</strong>", words)
        out.append(re.sub(r"(?<![\w*])\*([^*\s][^*]*)\*(?![\w*])", r"<em>\1</em>", words))
    return "".join(out)
