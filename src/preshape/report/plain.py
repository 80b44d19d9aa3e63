"""Text from files, memories and names, made fit for a terminal or a page."""

from __future__ import annotations

import html
import re

# Control characters but line feed and tab, marks that change the direction of text, and halves of surrogates.
_UNSEEN = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u2069\ufeff\ud800-\udfff]"
)


def escaped(text: object) -> str:
    r"""Text whose control characters are shown, so that they cannot act on a terminal.

    >>> print(escaped("mug\x1b[2J"))
    mug\x1b[2J
    """
    return _UNSEEN.sub(lambda found: ascii(found[0])[1:-1], str(text))


def html_text(text: object) -> str:
    """Text as HTML: control characters are shown, and markup is read as text."""
    return html.escape(escaped(text))
