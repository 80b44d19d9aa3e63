"""Command lines about the paper's hand, without ``--hand utah_mit`` in each of them."""

from __future__ import annotations

from collections.abc import Sequence


def of_the_papers_hand(arguments: Sequence[object]) -> list[str]:
    """A command line as texts; a plan or a lesson that names no hand is for the paper's."""
    words = [str(argument) for argument in arguments]
    if words[:1] in (["plan"], ["learn"]) and "--hand" not in words:
        words[1:1] = ["--hand", "utah_mit"]
    return words
