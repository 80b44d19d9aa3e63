"""Reports as one HTML file that opens from disk, offline, with the look of a plan's page.

The Markdown that is read here is what this program's own reports are written in: headings, paragraphs, lists,
tables, pictures, **strong**, *emphasised* and `code`; anything else is shown as it is.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator, Sequence
from html import escape
from importlib import resources
from pathlib import Path

from ..exceptions import EnvironmentFailure

POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
"""What a report may do: show itself. It has no scripts and asks for nothing."""


def stylesheet(name: str) -> str:
    """The style that all pages share, and a page's own, by its file's name."""
    web = resources.files("preshape.viewer") / "web"
    return "".join((web / part).read_text(encoding="utf-8") for part in ("base.css", name))


def report_page(title: str, body: str) -> str:
    """A whole page around a report's HTML.

    Args:
        title: of the window; plain text.
        body: HTML; whoever made it has escaped it.
    """
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
        '<meta name="color-scheme" content="light dark">\n<link rel="icon" href="data:,">\n'
        f"<title>{escape(title)}</title>\n<style>{stylesheet('report.css')}</style>\n</head>\n"
        f"<body>\n<main>\n{body}\n</main>\n</body>\n</html>\n"
    )


def markdown_page(text: str, folder: Path) -> str:
    """A report in Markdown as one page, with its pictures in it.

    Args:
        text: the Markdown; its first heading is the title.
        folder: where the pictures lie that it names.

    Raises:
        EnvironmentFailure: a picture cannot be read.
    """
    title = next((line[2:].strip() for line in text.splitlines() if line.startswith("# ")), "preshape")
    return report_page(f"{title} · preshape", "\n".join(_blocks(text, folder)))


def picture(file: Path, caption: str) -> str:
    """A PNG as a figure that carries it.

    Raises:
        EnvironmentFailure: it cannot be read.
    """
    try:
        content = base64.b64encode(file.read_bytes()).decode("ascii")
    except OSError as error:
        raise EnvironmentFailure(f"{file} cannot be read: {error.strerror or error}") from error
    words = escape(caption)
    return (
        f'<figure><img alt="{words}" src="data:image/png;base64,{content}">'
        f"<figcaption>{words}</figcaption></figure>"
    )


def _blocks(text: str, folder: Path) -> Iterator[str]:
    """Each block of lines that a blank line ends; headings need none."""
    separated = re.sub(r"(?m)^(#{1,4} .*)$", r"\n\1\n", text)
    shown = ""
    for block in re.split(r"\n\s*\n", separated.strip("\n")):
        lines = block.strip("\n").splitlines()
        if not lines or not block.strip():
            continue
        heading = re.match(r"(#{1,4}) (.*)", lines[0])
        image = re.fullmatch(r"!\[(.*)\]\(([^()]+)\)", block.strip())
        if heading:
            level = len(heading[1])
            yield f"<h{level}>{_inline(heading[2])}</h{level}>"
        elif image:
            shown = image[1]
            yield picture(folder / image[2], shown)
        elif all(line.startswith("|") for line in lines) and len(lines) > 1:
            yield _table(lines)
        elif lines[0].startswith("- "):
            items = re.split(r"(?m)^- ", block)[1:]
            yield "<ul>" + "".join(f"<li>{_inline(' '.join(item.split()))}</li>" for item in items) + "</ul>"
        elif block.strip() != f"*{shown}*":  # a picture's caption stands beneath it already
            yield f"<p>{_inline(' '.join(lines))}</p>"


def _table(lines: Sequence[str]) -> str:
    rows = [[cell.strip() for cell in line.strip().strip("|").split("|")] for line in lines]
    heads, body = rows[0], rows[2:]
    numeric = [
        bool(body) and all(re.fullmatch(r"[-+–]?[\d.,%() ~to-]*", row[i]) for row in body if i < len(row))
        for i in range(len(heads))
    ]

    def cells(row: Sequence[str], tag: str) -> str:
        kinds = [" class=number" if number else "" for number in numeric]
        return "".join(f"<{tag}{kind}>{_inline(c)}</{tag}>" for kind, c in zip(kinds, row, strict=False))

    inside = "".join(f"<tr>{cells(row, 'td')}</tr>" for row in body)
    head = f"<thead><tr>{cells(heads, 'th')}</tr></thead>"
    return f'<div class="wide"><table>{head}<tbody>{inside}</tbody></table></div>'


def _inline(text: str) -> str:
    """Strong, emphasised and code within a line; all else is escaped."""
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
