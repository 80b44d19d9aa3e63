"""The parts of an experiment of ``preshape reproduce``, and the text helpers of its report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeAlias

from ..report import Block, Bullets, Chapter, Figure, Heading, Table
from ..types import value
from .setup import Data, Setup

Progress: TypeAlias = Callable[[float, str], None]
"""Called with the completed fraction, 0..1, and the current step; an exception in it stops the work."""


@value
class Section:
    """Content of an experiment's chapter in the report.

    Attributes:
        headline: The outcome in one sentence.
        text: Paragraphs on what was done and found.
        tables: The paper's values beside ours.
        figures: The paper's values and ours as plots.
        remarks: One sentence for each disagreement with the paper, with the reason if it is known.
        remarks_title: Heading of the remarks.
    """

    headline: str
    text: tuple[str, ...]
    tables: tuple[Table, ...]
    figures: tuple[Figure, ...] = ()
    remarks: tuple[str, ...] = ()
    remarks_title: str = "Disagreements"


@value
class Experiment:
    """One experiment.

    Attributes:
        name: Name on the command line.
        title: Title in the report.
        version: Increased when ``measure`` changes; results of older versions are measured again.
        cost: Rough duration of the full form [s]; it sets the experiment's share of the progress.
        measure: Function that measures; its path argument is a file for partial results.
        present: Function that makes the chapter's content from the measured values.
    """

    name: str
    title: str
    version: int
    cost: float
    measure: Callable[[Setup, Path, Progress], Data]
    present: Callable[[Data], Section]

    def chapter(self, data: Data) -> Chapter:
        """The measured values as a chapter of the report."""
        section = self.present(data)
        blocks: tuple[Block, ...] = (*section.text, *section.figures, *section.tables)
        if section.remarks:
            blocks += (Heading(text=section.remarks_title), Bullets(items=section.remarks))
        return Chapter(name=self.name, title=self.title, headline=section.headline, blocks=blocks)


def joined(parts: Sequence[str]) -> str:
    """The parts as a list in a sentence.

    >>> joined(["a"]), joined(["a", "b", "c"])
    ('a', 'a, b and c')
    """
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def numbers_text(numbers: Sequence[float]) -> str:
    """Numbers separated by blanks.

    >>> numbers_text([1.0, 0.25])
    '1 0.25'
    """
    return " ".join(f"{x:g}" for x in numbers)


def or_none(number: float | None) -> str:
    """A number with two decimals, or ``none``."""
    return "none" if number is None else f"{number:.2f}"


def status_text(status: str) -> str:
    """A status of the controller in words."""
    return status.replace("_", " ")
