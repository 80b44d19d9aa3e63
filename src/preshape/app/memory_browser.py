"""The content of the memory as a table and a learning curve, for the browser's panel."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..exceptions import PreshapeError
from ..report.plain import html_text as escape

if TYPE_CHECKING:
    from ..types import Experience

WIDE, HIGH = 300, 90
MOST_LISTED = 200
"""Largest number of objects in the table."""


def memory_place(memory: str | None) -> str:
    """Location of the memory, to display."""
    from ..memory import default_path

    return str(default_path() if memory is None else memory)


def memory_html(memory: str | None) -> str:
    """The known objects and the learning curve; a sentence if the memory cannot be read."""
    from ..memory import Memory

    try:
        with Memory.open(memory, read_only=True) as store:
            known = list(store.objects())
            met = store.experiences(kinds=["task"])
            numbers = store.statistics()
            remark = store.remark
    except PreshapeError as error:
        return f'<div class="head bad"><b>The memory cannot be read</b>{escape(str(error))}</div>'
    rows = "".join(
        f"<tr><td><b>{escape(o.name)}</b>{' (first lesson)' if o.seed else ''}</td>"
        f"<td>{escape(', '.join(o.hands))}</td>"
        f'<td class="num">{o.tasks}</td><td class="num">{o.best}</td>'
        f'<td class="quiet num">{escape(o.last_seen[:16].replace("T", " "))}</td></tr>'
        for o in sorted(known, key=lambda o: o.last_seen, reverse=True)[:MOST_LISTED]
    )
    if not rows:
        return "<h3>Nothing learnt yet</h3>" + (
            "<p class='quiet'>The first plan teaches the cube, then your object.</p>"
        )
    head = (
        "<tr><th>object</th><th>hand</th><th class='num'>tasks</th>"
        "<th class='num'>best</th><th class='num'>last (UTC)</th></tr>"
    )
    more = len(known) - MOST_LISTED
    rest = f"<p class='quiet'>and {more} more, which were met earlier</p>" if more > 0 else ""
    left_out = f"<p class='quiet'>{escape(remark)}</p>" if remark else ""
    samples = ", ".join(f"{escape(hand)} {n}" for hand, n in numbers.trained)
    return (
        f"<h3>{len(known)} objects known</h3><table>{head}{rows}</table>{rest}{left_out}"
        f"<p class='quiet'>{numbers.experiences} experiences; samples behind the networks: {samples}</p>"
        f"{curve(met)}"
    )


def curve(met: tuple[Experience, ...]) -> str:
    """Plot the match (0..6) of each lesson, and the number of known objects after it."""
    if not met:
        return ""
    count = max(1, len(met) - 1)
    known = [len({e.object_name for e in met[: i + 1]}) for i in range(len(met))]
    top = max(known)

    def place(i: int, share: float) -> tuple[float, float]:
        return 26 + (WIDE - 36) * i / count, HIGH - 16 - (HIGH - 26) * share

    dots = "".join(
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="#0072B2"/>'
        for x, y in (place(i, e.match / 6) for i, e in enumerate(met))
    )
    points = [place(i, k / top) for i, k in enumerate(known)]
    line = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return (
        "<h3>Learning, lesson by lesson</h3>"
        f'<svg viewBox="0 0 {WIDE} {HIGH}" width="100%" role="img" aria-label="learning curve">'
        f'<path d="M26 8V{HIGH - 16}H{WIDE - 8}" fill="none" stroke="#8791A0"/>'
        f'<polyline points="{line}" fill="none" stroke="#D55E00" stroke-width="1.6"/>{dots}'
        f'<text x="22" y="14" text-anchor="end" font-size="9" fill="#59626D">6</text>'
        f'<text x="22" y="{HIGH - 14}" text-anchor="end" font-size="9" fill="#59626D">0</text>'
        f'<text x="{WIDE - 8}" y="{HIGH - 4}" text-anchor="end" font-size="9" fill="#59626D">'
        f"{len(met)} lesson{'s' if len(met) > 1 else ''}</text></svg>"
        '<div class="quiet"><span class="chip" style="background:#0072B2"></span>match (TFVADI, 0 to 6) '
        f'<span class="chip" style="background:#D55E00"></span>objects known (up to {top})</div>'
    )
