"""A run of holding tests as tables, warnings and a page of Markdown for people."""

from __future__ import annotations

import math
from pathlib import Path

from ...objects.load import SUFFIXES
from ...types import value
from ..protocol import HoldProtocol
from .report import HoldFigures, HoldReport
from .six_directions import HoldStatus

ALL = "all"
"""Name of the last line of a table."""

LONGEST = 24  # characters of an object's name in a table


@value
class TextTable:
    """A table of words.

    Attributes:
        caption: what it shows.
        columns: headings; may have two lines.
        rows: as many cells each.
    """

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def tables(report: HoldReport, *, full_names: bool = False) -> tuple[TextTable, TextTable]:
    """Score, and measures at the grasp pose: a line for each object and one for all.

    Args:
        report: of one hand.
        full_names: objects as they were given, however long.
    """
    names = report.object_names
    lines = [(name if full_names else short_name(name), report.figures(name)) for name in names]
    if len(names) > 1:
        lines.append((ALL, report.figures()))
    ladder = any(figures.strength is not None for _, figures in lines)
    score = TextTable(
        caption="Score",
        columns=(
            "object", "held", "%", "95 %", "contact\nat grasp", "clean", "by squeeze\nonly",
            *(("strength",) if ladder else ()),
        ),
        rows=tuple((name, *_score(figures, ladder)) for name, figures in lines),
    )  # fmt: skip
    measures = TextTable(
        caption="At the grasp pose, means; lengths in mm, depth is penetration",
        columns=(
            "object", "depth in\nobject", "depth in\nhand", "links", "distance", "consistency", "diversity",
        ),
        rows=tuple((name, *_measures(figures)) for name, figures in lines),
    )  # fmt: skip
    return score, measures


def warnings(report: HoldReport, protocol: HoldProtocol) -> tuple[str, ...]:
    """What a score alone would hide, one sentence each."""
    f = report.figures()
    deep = sum(
        r.held and r.at_grasp is not None and r.at_grasp.penetration >= protocol.clean_penetration
        for r in report.results
    )
    limit, clean = 1e3 * protocol.penetration_limit, 1e3 * protocol.clean_penetration
    found = (
        (f.only_by_squeeze, f"{_grasps(f.only_by_squeeze)} held only through the squeeze: at the grasp pose "
         "fewer than two parts of the hand touch the object"),
        (deep, f"{_grasps(deep)} held but cut {clean:g} mm or more into the object at the grasp pose"),
        (f.penetrating, f"{_grasps(f.penetrating)} failed before anything moved: the pregrasp cuts more than "
         f"{limit:g} mm into the object or the hand"),
        (f.unstable, f"{_grasps(f.unstable)} failed because the simulation became unstable"),
    )  # fmt: skip
    return tuple(sentence for count, sentence in found if count)


def settings_line(protocol: HoldProtocol) -> str:
    """The test in one line.

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


def markdown(reports: list[tuple[str, HoldReport]], protocol: HoldProtocol, preface: str) -> str:
    """The page: tables of each hand, warnings, and every grasp that did not hold.

    Args:
        reports: name of the hand, and its report.
        protocol: of all of them.
        preface: a line under the title.
    """
    page = ["# Holding test", "", f"{settings_line(protocol)}. {preface}", ""]
    page += ["Every measure and option is explained in `docs/grasp-file.md`.", ""]
    for hand, report in reports:
        figures = report.figures()
        page += [f"## {hand}: {figures.held} of {figures.tested} held{_interval(figures)}", ""]
        for table in tables(report, full_names=True):
            page += [table.caption, "", *markdown_table(table), ""]
        page += [f"- {sentence}." for sentence in warnings(report, protocol)]
        page += ["", f"### Failures of {hand}", "", *markdown_table(_failures(report)), ""]
        if report.faults:
            page += [f"### Not tested of {hand}", "", *(f"- {line}" for line in report.fault_lines()), ""]
    return "\n".join(page)


def markdown_table(table: TextTable) -> list[str]:
    """The lines of a table in Markdown, without its caption."""
    if not table.rows:
        return ["None."]

    def line(cells: tuple[str, ...]) -> str:
        return f"| {' | '.join(cell.replace('|', '/').replace(chr(10), ' ') for cell in cells)} |"

    return [line(table.columns), f"|{'---|' * len(table.columns)}", *map(line, table.rows)]


def short_name(name: str) -> str:
    """An object's name for a narrow column: a file's without folder and suffix, and not too long.

    >>> short_name("scans/mug.obj"), short_name("core_bottle_523cddb320608c09a37f3fc191551700")
    ('mug', 'core_bottle_523cddb3206…')
    """
    path = Path(name)
    if path.suffix.lower() in SUFFIXES:
        name = path.stem
    return name if len(name) <= LONGEST else name[: LONGEST - 1] + "…"


def _failures(report: HoldReport) -> TextTable:
    failed = [r for r in report.results if not r.held and r.status is not HoldStatus.INVALID]
    rows = []
    for r in failed:
        file, row = report.grasps.origin[r.row] if report.grasps.origin else ("", r.row)
        rows.append((file, str(row), r.object_name, f"{r.scale:g}", r.reason))
    return TextTable(caption="", columns=("file", "row", "object", "scale", "why"), rows=tuple(rows))


def _score(f: HoldFigures, ladder: bool) -> tuple[str, ...]:
    percent = "–" if f.rate is None else f"{100 * f.rate:.1f}"
    interval = "–" if f.interval is None else f"{100 * f.interval[0]:.0f}-{100 * f.interval[1]:.0f}"
    counts = (str(f.touching), str(f.clean), str(f.only_by_squeeze))
    strength = (_number(f.strength, 1.0, 2),) if ladder else ()
    return (f"{f.held}/{f.tested}", percent, interval, *counts, *strength)


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


def _interval(f: HoldFigures) -> str:
    if f.rate is None or f.interval is None:
        return ""
    low, high = (100 * x for x in f.interval)
    return f", {100 * f.rate:.1f} % (95 %: {low:.1f} to {high:.1f} %)"


def _grasps(count: int) -> str:
    return f"{count} grasp{'s' if count != 1 else ''}"
