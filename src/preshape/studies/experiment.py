"""What an experiment of ``preshape reproduce`` is made of: measurement, section, tables, pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeAlias

from ..types import value
from .bench import Bench, Data

__all__ = [
    "Cell", "Data", "Experiment", "Measurement", "Picture", "Progress", "Section", "Table", "joined",
]  # fmt: skip

Progress: TypeAlias = Callable[[float, str], None]
"""Called with the fraction done, 0..1, and what is being done; may raise to stop the work."""

Cell: TypeAlias = str | int | float | None


@value
class Table:
    """A table of the report.

    Attributes:
        caption: one line above it.
        columns: headings.
        rows: as long as ``columns`` each; numbers are written with two decimals, ``None`` as a dash;
            text may have more than one line.
    """

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]


@value
class Picture:
    """A picture of the report.

    Attributes:
        name: file name without ``.png``.
        caption: what it shows, for readers who do not see it as well.
        draw: writes it to a path.
    """

    name: str
    caption: str
    draw: Callable[[Path], None]


@value
class Section:
    """An experiment as the report tells it.

    Attributes:
        headline: the outcome in one sentence.
        text: paragraphs: what was done and what came of it.
        tables: the paper's values beside ours.
        pictures: the same as plots.
        disagreements: one sentence for each place where the two differ, with the reason where there is one.
    """

    headline: str
    text: tuple[str, ...]
    tables: tuple[Table, ...]
    pictures: tuple[Picture, ...]
    disagreements: tuple[str, ...]


@value
class Experiment:
    """One experiment.

    Attributes:
        name: as typed.
        title: heading.
        version: counts up when ``measure`` changes; older results are then measured anew.
        cost: rough seconds that it takes in full; shares out the progress.
        measure: does it. The path is a file for what is half done; whoever uses it removes it.
        present: tells it.
    """

    name: str
    title: str
    version: int
    cost: float
    measure: Callable[[Bench, Path, Progress], Data]
    present: Callable[[Data], Section]


@value
class Measurement:
    """What an experiment measured, and under what settings.

    Attributes:
        name: the experiment's.
        settings: what must be equal for the measurement to be used again.
        data: the measured values.
    """

    name: str
    settings: Data
    data: Data


def joined(parts: Iterator[str] | list[str]) -> str:
    """``a, b and c``."""
    words = list(parts)
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
