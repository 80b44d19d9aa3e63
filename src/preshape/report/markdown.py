"""Reports as Markdown."""

from __future__ import annotations

from collections.abc import Iterator

from .values import Block, Bullets, Cell, Figure, Heading, Report, Table, cell_text


def markdown(report: Report) -> str:
    """The whole report as Markdown, with links to the figures."""
    return "\n\n".join(_paragraphs(report)) + "\n"


def markdown_table(table: Table) -> str:
    """A table without its caption."""
    if not table.rows:
        return "None."
    rule = f"|{'---|' * len(table.columns)}"
    return "\n".join([_line(table.columns, " "), rule, *(_line(row, " · ") for row in table.rows)])


def _line(cells: tuple[Cell, ...], newline: str) -> str:
    texts = (cell_text(cell).replace("|", "/").replace("\n", newline) for cell in cells)
    return f"| {' | '.join(texts)} |"


def _paragraphs(report: Report) -> Iterator[str]:
    yield f"# {report.title}"
    for block in report.preface:
        yield from _block(block)
    listed = [chapter for chapter in report.chapters if chapter.headline]
    if listed:
        yield "\n".join(f"- **{chapter.title}.** {chapter.headline}" for chapter in listed)
    for chapter in report.chapters:
        yield f"## {chapter.title}"
        for block in chapter.blocks:
            yield from _block(block)


def _block(block: Block) -> Iterator[str]:
    match block:
        case Heading():
            yield f"### {block.text}"
        case Bullets():
            yield "\n".join(f"- {item}" for item in block.items)
        case Table():
            if block.caption:
                yield block.caption
            yield markdown_table(block)
        case Figure():
            yield f"![{block.caption}]({block.file})"
            yield f"*{block.caption}*"
        case _:
            yield block
