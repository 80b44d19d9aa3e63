"""A plan as a table for people, with the reasons."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console, Group
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from ..hiis.analyser import Grip, VirtualGrasp
from ..hiis.decision import Decision, Status
from ..hiis.fuzzy import SET_NAMES
from ..hiis.planes import axis_name
from ..planner import Answer, Plan, scan_trust, shortfalls

_COMPONENTS = ("Tx", "Ty", "Tz", "Rx", "Ry", "Rz")
_COLOURS = {"reward": "green", "learned": "green", "known": "yellow", "deadlock": "red", "no grasp": "red"}
_HEADLINES = {
    Status.ANSWER: ("green", "preshape found"),
    Status.CORRECTION: ("yellow", "task correction asked for"),
    Status.DEADLOCK: ("red", "deadlock"),
    Status.NO_GRASP: ("red", "no grasp"),
}


def show_plan(plan: Plan, written: Sequence[Path] = ()) -> None:
    """Print a plan on standard output."""
    decision = plan.decision
    colour, headline = _HEADLINES[decision.status]
    parts: list[object] = [_what(plan)]
    if plan.answer is not None:
        parts += ["", _answer(plan, plan.answer), "", _match(plan, plan.answer)]
        if isinstance(plan.answer.grasp, VirtualGrasp):  # a grip was judged by its margins, not by the match
            parts += [Text(f"! {warning}", style="yellow") for warning in shortfalls(plan, plan.answer)]
    parts += ["", _why(decision)]
    if decision.offers:
        parts += ["", _offers(plan)]
    if plan.verified is not None:
        said = plan.verified
        style = "green" if said.held else "red"
        parts += ["", _grid(("physics", Text(f"{said.reason} ({said.tried} tried)", style=style)))]
    if plan.alternatives:
        parts += ["", _alternatives(plan)]
    console = Console()
    title = f"[bold {colour}]{headline}[/] · mode {decision.mode}"
    console.print(
        Panel(Group(*parts), title=title, title_align="left", border_style=colour),  # type: ignore[arg-type]
        highlight=False,
    )
    if plan.answer is None:
        console.print(decision.status.help, highlight=False)
    elif not plan.answer.hand_result.reached and not plan.alternatives:
        console.print(
            "This hand cannot execute it as it stands: --count 5 shows other answers.", highlight=False
        )
    for path in written:
        console.print(f"wrote {path}", highlight=False, markup=False, soft_wrap=True)


def _grid(*rows: tuple[str, str | Text]) -> Table:
    grid = Table.grid(padding=(0, 2))
    grid.add_column(style="bold", no_wrap=True)
    grid.add_column()
    for heading, content in rows:  # names and paths are no markup
        grid.add_row(heading, Text(content) if isinstance(content, str) else content)
    return grid


def _what(plan: Plan) -> Table:
    mesh, task = plan.mesh, plan.decision.task
    size = " × ".join(f"{1000 * x:.0f}" for x in mesh.extents)
    rows = [("object", f"{mesh.name}, {size} mm, {len(mesh.triangles)} triangles")]
    said = scan_trust(plan, plan.answer)
    if said is not None:
        rows.append(("cloud", f"{said.points} points; trust {said.trust:.2f} of 1: {said.sentence}"))
    return _grid(
        *rows,
        ("task", f"{task.label}: {task.describe()}. {task.means}"),
        ("hand", f"{plan.hand.name}, U = {1000 * plan.hand.u:.0f} mm"),
    )


def _answer(plan: Plan, answer: Answer) -> Table:
    g, hand = answer.grasp, answer.hand_result
    side = axis_name(g.thumb_side).upper()
    hand_text = Text("reached: ", style="green") if hand.reached else Text("retracted: ", style="red")
    hand_text.append(hand.reason, style="default")
    rows: list[tuple[str, str | Text]] = [
        ("plane", f"{g.plane.label}, thumb on the {side} side"),
        ("approach", f"value {g.approach_value:+.2f} ({SET_NAMES[g.approach_set]})"),
        ("fingers", f"{len(hand.fingers) or g.fingers}: {', '.join(hand.fingers)}"),
        (
            "indices",
            f"TFVADI {g.tfvadi:.2f} of 6, stability {g.stability}, manipulability {g.manipulability}",
        ),
        ("hand", hand_text),
    ]
    if isinstance(g, Grip):
        rows.append(
            (
                "grip",
                f"quality {g.quality:.1f} of 6 (3 is just enough); squeeze {g.press:.0f} N in all, "
                f"{1000 * g.clearance:.0f} mm clear on the way in",
            )
        )
    if hand.grasp is not None:
        x, y, z = 1000 * hand.grasp.palm_pose[:3]
        rows.append(("palm", f"at {x:.0f}, {y:.0f}, {z:.0f} mm in the object's frame"))
    return _grid(*rows)


def _match(plan: Plan, answer: Answer) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("", no_wrap=True)
    for heading in ("task", "grasp"):
        table.add_column(heading, justify="right")
    table.add_column("match (ADI)", no_wrap=True)
    g = answer.grasp
    for name, q, w, degree in zip(_COMPONENTS, plan.decision.task.q, g.net_wrench, g.adi, strict=True):
        full = round(10 * float(degree))
        bar = Text("█" * full, style="cyan") + Text("░" * (10 - full), style="dim") + f" {degree:.2f}"
        table.add_row(name, f"{q:.2f}", f"{w:.2f}", bar)
    return table


def _why(decision: Decision) -> Table:
    rows = []
    for t in decision.transitions:
        text = Text(t.outcome, style=_COLOURS.get(t.outcome, "default"))
        text.append(f": {t.reason}", style="default")
        rows.append((f"mode {t.mode}", text))
    return _grid(*rows)


def _offers(plan: Plan) -> Table:
    rows: list[tuple[str, str | Text]] = []
    for offer in plan.decision.offers:
        match = f"TFVADI {offer.match:.2f}, mode {offer.mode}"
        rows.append(("fits", f"--task {offer.task.label:<14} {offer.task.describe()} ({match})"))
    return _grid(*rows)


def _alternatives(plan: Plan) -> Table:
    rows: list[tuple[str, str | Text]] = []
    for number, other in enumerate(plan.alternatives, start=2):
        g, hand = other.grasp, other.hand_result
        state = "reached" if hand.reached else "retracted"
        side = axis_name(g.thumb_side).upper()
        rows.append(
            (
                f"answer {number}",
                f"{g.plane.label}, thumb {side}, {g.fingers} fingers, {g.score_text}, {state}",
            )
        )
    return _grid(*rows)
