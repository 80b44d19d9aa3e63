"""Presents a run of holding tests as tables, warnings and a report."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from ...objects.load import SUFFIXES
from ...report import Block, Bullets, Chapter, Heading, Report, Table
from ..measures import rate_text
from ..protocol import HoldProtocol
from .report import HoldFigures, HoldReport
from .six_directions import HoldStatus

ALL = "all"
"""First cell of the row with the figures over all objects."""

LONGEST_NAME = 24
"""Longest name of an object in a table, in characters."""


def tables(report: HoldReport, *, full_names: bool = False) -> tuple[Table, Table]:
    """Two tables, score and measures at the grasp pose, with a row for each object and one for all.

    Args:
        report: Results of one hand.
        full_names: Whether long names of objects are kept; otherwise they are shortened.
    """
    names = report.object_names
    rows = [(name if full_names else short_name(name), report.figures(name)) for name in names]
    if len(names) > 1:
        rows.append((ALL, report.figures()))
    ladder = any(figures.strength is not None for _, figures in rows)
    score = Table(
        caption="Score",
        columns=(
            "object", "held", "%", "95 %", "contact\nat grasp", "clean", "by squeeze\nonly",
            *(("strength",) if ladder else ()),
        ),
        rows=tuple((name, *_score(figures, ladder)) for name, figures in rows),
    )  # fmt: skip
    measures = Table(
        caption="Means at the grasp pose; lengths in mm, depth is penetration",
        columns=(
            "object", "depth in\nobject", "depth in\nhand", "links", "distance", "consistency", "diversity",
        ),
        rows=tuple((name, *_measures(figures)) for name, figures in rows),
    )  # fmt: skip
    return score, measures


def warnings(report: HoldReport, protocol: HoldProtocol) -> tuple[str, ...]:
    """One sentence for each problem that the score alone does not show."""
    f = report.figures()
    deep = sum(
        r.held and r.at_grasp is not None and r.at_grasp.penetration >= protocol.clean_penetration
        for r in report.results
    )
    limit, clean = 1e3 * protocol.penetration_limit, 1e3 * protocol.clean_penetration
    sentences = (
        (f.only_by_squeeze, f"{_grasps(f.only_by_squeeze)} held only through the squeeze: at the grasp pose "
         "fewer than two parts of the hand touch the object"),
        (deep, f"{_grasps(deep)} held but cut {clean:g} mm or more into the object at the grasp pose"),
        (f.penetrating, f"{_grasps(f.penetrating)} failed before anything moved: the pregrasp cuts more than "
         f"{limit:g} mm into the object or the hand"),
        (f.unstable, f"{_grasps(f.unstable)} failed because the simulation became unstable"),
    )  # fmt: skip
    return tuple(sentence for count, sentence in sentences if count)


def settings_line(protocol: HoldProtocol) -> str:
    """The settings of the test in one line.

    >>> settings_line(HoldProtocol())
    'six directions, 1 N on 0.1 kg, friction 0.6'
    """
    kind = "six directions" if protocol.probes == "six" else f"{len(protocol.loads())} probes"
    parts = [f"{kind}, {protocol.acceleration * protocol.mass:g} N on {protocol.mass:g} kg"]
    parts.append(f"friction {protocol.friction:g}")
    if protocol.ladder:
        parts.append("strength ladder")
    errors = [
        f"{1e3 * protocol.position_error:g} mm" if protocol.position_error else "",
        f"{math.degrees(protocol.turn_error):g}°" if protocol.turn_error else "",
        f"{100 * protocol.size_error:g} % of size" if protocol.size_error else "",
    ]
    if any(errors):
        parts.append(f"errors {', '.join(filter(None, errors))} (seed {protocol.seed})")
    return ", ".join(parts)


def hold_report(reports: Sequence[tuple[str, HoldProtocol, HoldReport]], versions: str) -> Report:
    """The report: for each hand and load the tables, the warnings, and every grasp that did not hold.

    Args:
        reports: Title, settings and results of each chapter; the title names the hand.
        versions: Sentence that names the versions of the programs.
    """
    return Report(
        title="Holding test",
        preface=(versions, "Every measure and option is explained in `docs/grasp-file.md`."),
        chapters=tuple(_chapter(title, report, protocol) for title, protocol, report in reports),
    )


def _chapter(hand: str, report: HoldReport, protocol: HoldProtocol) -> Chapter:
    figures = report.figures()
    blocks: list[Block] = [f"{settings_line(protocol)}.", *tables(report, full_names=True)]
    if found := warnings(report, protocol):
        blocks.append(Bullets(items=tuple(f"{sentence}." for sentence in found)))
    blocks += [Heading(text=f"Failures of {hand}"), _failures(report)]
    if report.faults:
        blocks += [Heading(text=f"Not tested of {hand}"), Bullets(items=report.fault_lines())]
    rate = rate_text(figures.rate, figures.interval)
    title = f"{hand}: {figures.held} of {figures.tested} held{rate and f', {rate}'}"
    return Chapter(title=title, blocks=tuple(blocks))


def short_name(name: str) -> str:
    """Name of an object for a narrow column: at most 24 characters; a file loses folder and suffix.

    >>> short_name("scans/mug.obj"), short_name("core_bottle_523cddb320608c09a37f3fc191551700")
    ('mug', 'core_bottle_523cddb3206…')
    """
    path = Path(name)
    if path.suffix.lower() in SUFFIXES:
        name = path.stem
    return name if len(name) <= LONGEST_NAME else name[: LONGEST_NAME - 1] + "…"


def rate_cells(rate: float | None, interval: tuple[float, float] | None) -> tuple[str, str]:
    """Two cells: a rate and its 95 % interval, both in per cent.

    >>> rate_cells(0.25, (0.112, 0.469)), rate_cells(None, None)
    (('25.0', '11-47'), ('–', '–'))
    """
    if rate is None or interval is None:
        return "–", "–"
    low, high = interval
    return f"{100 * rate:.1f}", f"{100 * low:.0f}-{100 * high:.0f}"


def _failures(report: HoldReport) -> Table:
    failed = [r for r in report.results if not r.held and r.status is not HoldStatus.INVALID]
    rows = []
    for r in failed:
        file, row = report.grasps.origin[r.row] if report.grasps.origin else ("", r.row)
        rows.append((file, row, r.object_name, f"{r.scale:g}", r.reason))
    return Table(caption="", columns=("file", "row", "object", "scale", "reason"), rows=tuple(rows))


def _score(f: HoldFigures, ladder: bool) -> tuple[str, ...]:
    counts = (str(f.touching), str(f.clean), str(f.only_by_squeeze))
    strength = (_number(f.strength, 1.0, 2),) if ladder else ()
    return (f"{f.held}/{f.tested}", *rate_cells(f.rate, f.interval), *counts, *strength)


def _measures(f: HoldFigures) -> tuple[str, ...]:
    return (
        _number(f.penetration, 1e3, 2),
        _number(f.self_penetration, 1e3, 2),
        _number(f.links, 1.0, 1),
        _number(f.contact_distance, 1e3, 2),
        _number(f.consistency, 1e3, 2),
        _number(f.diversity, 1.0, 2),
    )


def _number(number: float | None, factor: float, digits: int) -> str:
    return "–" if number is None else f"{factor * number:.{digits}f}"


def _grasps(count: int) -> str:
    return f"{count} grasp{'s' if count != 1 else ''}"
