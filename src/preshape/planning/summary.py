"""A plan as text for the terminal: first the result, then the reasons."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from ..hiis.analyser import Grasp, Grip
from ..hiis.decision import Decision, Status
from ..hiis.fuzzy import SET_NAMES
from ..hiis.planes import axis_name
from ..tasks.task import COMPONENTS
from ..types import MODES, STEPS
from .answers import Answer, PlanRecord, missing_motion, scan_trust, shortfalls

_COLOURS = {"reward": "green", "learned": "green", "known": "yellow", "deadlock": "red", "no grasp": "red"}
_HEADLINES = {
    Status.ANSWER: ("green", "grasp found"),
    Status.CORRECTION: ("yellow", "task correction asked for"),
    Status.DEADLOCK: ("red", "deadlock: no grasp is good enough"),
    Status.NO_GRASP: ("red", "no grasp found"),
}


def summary_text(plan: PlanRecord, *, explain: bool = False, width: int = 80) -> str:
    """The summary as plain text.

    Args:
        plan: The plan.
        explain: Whether the paper's indices and the match of each component are shown for a real hand too.
        width: Width of the text in columns.
    """
    out = io.StringIO()
    Console(file=out, width=width).print(summary(plan, explain=explain), highlight=False)
    return out.getvalue().rstrip("\n")


def summary(plan: PlanRecord, *, explain: bool = False) -> RenderableType:
    """The summary as a rich renderable; see :func:`summary_text`."""
    decision = plan.decision
    colour, headline = headline_of(plan)
    parts: list[RenderableType] = [_what(plan)]
    shown = plan.answer or plan.best
    if shown is not None:
        if plan.answer is None:
            parts += ["", Text("the best that was found, not good enough:", style="yellow")]
        else:
            parts.append("")
        parts.append(_answer(plan, shown))
        if explain or not isinstance(shown.grasp, Grip):
            parts += ["", _indices(shown.grasp), "", _match(plan, shown)]
            parts += [Text(f"! {warning}", style="yellow") for warning in shortfalls(plan, shown)]
    parts += [Text(f"! {warning}", style="yellow") for warning in plan.warnings]
    parts += ["", _why(decision)]
    if decision.offers:
        parts += ["", _offers(decision)]
    if plan.verified is not None:
        said = plan.verified
        style = "green" if said.held else "red"
        parts += ["", _grid(("physics", Text(f"{said.reason} ({said.tried} tried)", style=style)))]
    if plan.alternatives:
        parts += ["", _alternatives(plan)]
    title = f"[bold {colour}]{headline}[/] · {MODES[decision.mode]} (mode {decision.mode})"
    return Panel(Group(*parts), title=title, title_align="left", border_style=colour)


def headline_of(plan: PlanRecord) -> tuple[str, str]:
    """Colour and words of the result; they name the motion that a virtual grasp does not give."""
    colour, headline = _HEADLINES[plan.decision.status]
    if plan.answer is not None and plan.verified is not None and not plan.verified.held:
        return "red", "no answer held in physics"
    missing = missing_motion(plan, plan.answer) if plan.answer else ""
    if missing:
        return "yellow", f"{headline}, but it gives nothing along {missing}"
    return colour, headline


def way_in_words(answer: Answer) -> str:
    """The approach direction, the approach plane, and the angle between direction and plane's axis."""
    plane, way = answer.grasp.plane, answer.way_in
    angle = float(np.degrees(np.arccos(np.clip(plane.approach_axis @ way, -1.0, 1.0))))
    if angle < 2.0:
        return f"comes in along {axis_name(plane.approach_axis).upper()}; {plane.label}"
    numbers = ", ".join(f"{x + 0.0:.2f}" for x in way)
    return f"comes in along ({numbers}), {angle:.0f}° off {plane.label}"


def _grid(*rows: tuple[str, str | Text]) -> Table:
    grid = Table.grid(padding=(0, 2))
    grid.add_column(style="bold", no_wrap=True)
    grid.add_column()
    for heading, content in rows:  # names and paths must not be read as markup
        grid.add_row(heading, Text(content) if isinstance(content, str) else content)
    return grid


def _what(plan: PlanRecord) -> Table:
    mesh, task, request = plan.mesh, plan.decision.task, plan.request
    size = " × ".join(f"{1000 * x:.3g}" for x in mesh.extents)
    rows = [("object", f"{mesh.name}, {size} mm, {len(mesh.triangles)} triangles")]
    said = scan_trust(plan, plan.answer)
    if said is not None:
        rows.append(("cloud", f"{said.points} points; trust {said.trust:.2f} of 1: {said.sentence}"))
    if request.analyser == "closure" or request.verify:
        most = plan.answer.heaviest if plan.answer else None
        bears = "" if most is None else f"; this grip holds up to {most:.2g} kg"
        rows.append(("mass", f"{plan.mass.words}{bears}"))
    rows.append(("task", f"{task.label}: {task.describe()}. {task.means}"))
    rows.append(("hand", f"{plan.hand.name}, U = {1000 * plan.hand.u:.0f} mm"))
    scene = []
    if request.analyser == "closure":
        scene.append(f"friction {request.stated_friction:g}")
        height = request.table_height(mesh)
        scene.append("free space, no table" if height is None else f"table at z = {1000 * height:.0f} mm")
        if request.avoid:
            scene.append(f"boxes to avoid: {len(request.avoid)}")
    if request.approaches:
        scene.append(f"approaches {request.approaches}")
    if scene:
        rows.append(("scene", "; ".join(scene)))
    return _grid(*rows)


def _answer(plan: PlanRecord, answer: Answer) -> Table:
    g, hand = answer.grasp, answer.hand_result
    rows: list[tuple[str, str | Text]] = []
    fingers = f"{len(hand.fingers) or g.fingers}: {', '.join(hand.fingers)}"
    if isinstance(g, Grip):
        rows += [
            ("quality", f"{g.quality:.1f} of 6 (3 is just enough)"),
            (
                "margins",
                f"{g.task_margin:.1f} times the task's load, {g.hold_margin:.1f} times pushes from any side",
            ),
            ("press", f"{g.press:.0f} N in all, by {fingers}"),
            ("clearance", f"{1000 * g.clearance:.0f} mm to the object on the way in"),
            ("way in", way_in_words(answer)),
        ]
    else:
        text = Text("reached: ", style="green") if hand.reached else Text("retracted: ", style="red")
        text.append(hand.reason, style="default")
        rows += [
            ("way in", f"{way_in_words(answer)}, thumb on the {axis_name(g.thumb_side).upper()} side"),
            ("fingers", fingers),
            ("hand", text),
        ]
    if hand.grasp is not None:
        x, y, z = 1000 * hand.grasp.palm_pose[:3]
        rows.append(("palm", f"at {x:.0f}, {y:.0f}, {z:.0f} mm in the object's frame"))
    return _grid(*rows)


def _indices(g: Grasp) -> Table:
    side = axis_name(g.thumb_side).upper()
    return _grid(
        ("plane", f"{g.plane.label}, thumb on the {side} side, {g.fingers} virtual fingers"),
        ("value", f"approach value {g.approach_value:+.2f} ({SET_NAMES[g.approach_set]})"),
        (
            "indices",
            f"TFVADI {g.tfvadi:.2f} of 6, stability {g.stability}, manipulability {g.manipulability}",
        ),
    )


def _match(plan: PlanRecord, answer: Answer) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("", no_wrap=True)
    for heading in ("task", "grasp"):
        table.add_column(heading, justify="right")
    table.add_column("match (ADI)", no_wrap=True)
    g = answer.grasp
    for name, q, w, degree in zip(COMPONENTS, plan.decision.task.q, g.net_wrench, g.adi, strict=True):
        full = round(10 * float(degree))
        bar = Text("█" * full, style="cyan") + Text("░" * (10 - full), style="dim") + f" {degree:.2f}"
        table.add_row(name, f"{q:.2f}", f"{w:.2f}", bar)
    return table


def _why(decision: Decision) -> Table:
    rows = []
    for t in decision.transitions:
        text = Text(t.outcome, style=_COLOURS.get(t.outcome, "default"))
        text.append(f": {t.reason}", style="default")
        rows.append((f"{STEPS[t.mode].lower()} ({t.mode})", text))
    return _grid(*rows)


def _offers(decision: Decision) -> Table:
    rows: list[tuple[str, str | Text]] = []
    for offer in decision.offers:
        match = f"{MODES[offer.mode]}, {offer.match:.2f} of 6"
        rows.append(("fits", f"--task {offer.task.label:<14} {offer.task.describe()} ({match})"))
    return _grid(*rows)


def _alternatives(plan: PlanRecord) -> Table:
    rows: list[tuple[str, str | Text]] = []
    for number, other in enumerate(plan.alternatives, start=2):
        g, hand = other.grasp, other.hand_result
        state = "reached" if hand.reached else "retracted"
        side = axis_name(g.thumb_side).upper()
        rows.append(
            (
                f"answer {number}",
                f"{g.plane.label}, thumb {side}, {len(hand.fingers) or g.fingers} fingers, {g.score_text}, "
                f"{state}",
            )
        )
    return _grid(*rows)


def after_words(plan: PlanRecord) -> Sequence[str]:
    """Advice on what to do next, one sentence each; empty if there is none."""
    if plan.answer is None:
        return (plan.decision.status.help,)
    if not plan.answer.hand_result.reached and not plan.alternatives:
        return ("This hand cannot execute it as it stands: --count 5 shows other answers.",)
    return ()
