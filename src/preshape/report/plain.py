"""Text from files, memories and names, made fit for a terminal or a page."""

from __future__ import annotations

import html
import re

# Control characters but line feed and tab, marks that change the direction of text, other marks that are not
# seen, halves of surrogates, and what no XML may hold.
_UNSEEN = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u2069\ufeff\ud800-\udfff\ufff9-\ufffb\ufffe\uffff]"
)


def escaped(text: object) -> str:
    r"""Text whose control characters are shown, so that they cannot act on a terminal.

    >>> print(escaped("mug\x1b[2J"))
    mug\x1b[2J
    """
    return _UNSEEN.sub(lambda found: ascii(found[0])[1:-1], str(text))


def escaped_line(text: object) -> str:
    r"""Text as :func:`escaped` gives it, with line feeds and tabs shown too, so that it stays one line.

    >>> print(escaped_line("mug\npen"))
    mug\npen
    """
    return escaped(text).replace("\n", r"\n").replace("\t", r"\t")


def html_text(text: object) -> str:
    """Text as HTML: control characters are shown, and markup is read as text."""
    return html.escape(escaped(text))
