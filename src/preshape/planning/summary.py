"""A plan as text for the terminal: first the result, then the reasons."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from ..hiis.decision import Status
from ..report.plain import escaped_line
from ..report.terminal import fact_grid, terminal
from ..tasks import task_from_numbers
from ..tasks.task import COMPONENTS
from ..types import STEPS, quality_text, two_digits
from ..viewer import words
from .answers import PlanRecord
from .document import Document, plan_to_json

_COLOURS = {"reward": "green", "learned": "green", "known": "yellow", "deadlock": "red", "no grasp": "red"}
_KINDS = {"good": "green", "warn": "yellow", "bad": "red"}
Row = tuple[str, str | Text]


def summary_text(plan: PlanRecord, *, explain: bool = False, width: int = 80) -> str:
    """The summary as plain text.

    Args:
        plan: The plan.
        explain: Whether the paper's indices and the match of each component are shown for a real hand too,
            and how quality and margins are related.
        width: Width of the text in columns.
    """
    out = io.StringIO()
    terminal(file=out, width=width).print(summary(plan_to_json(plan), explain=explain), highlight=False)
    return out.getvalue().rstrip("\n")


def summary(document: Document, *, explain: bool = False) -> RenderableType:
    """The summary of a plan's document as a rich renderable; see :func:`summary_text`."""
    document = _in_lines(document)
    _, kind, headline = words.result(document)
    colour = _KINDS[kind]
    parts: list[RenderableType] = [_what(document)]
    answer = next(iter(words.answers_of(document)), None)
    if answer is not None:
        parts.append("")
        if answer is not document:
            parts.append(Text("the best that was found, not to be executed:", style="yellow"))
        parts.append(_answer(answer))
        if explain and answer["grip"]:
            parts += ["", Text(words.QUALITY)]
        if explain or not answer["grip"]:
            parts += ["", _indices(answer), "", _match(document, answer)]
    notes = [*(answer or document)["warnings"], *(document["arm"] or {"notes": ()})["notes"]]
    parts += [Text(f"! {note}", style="yellow") for note in notes]
    parts += ["", _why(document)]
    if document["offers"]:
        parts += ["", _offers(document)]
    said = document["verified"]
    if said is not None:
        style = "green" if said["held"] else "red"
        parts += ["", fact_grid(("physics", Text(f"{said['reason']} ({said['tried']} tried)", style=style)))]
    if document["alternatives"]:
        parts += ["", _alternatives(document)]
    title = f"[bold {colour}]{headline}[/] · {words.plan_mode(document)}"
    return Panel(Group(*parts), title=title, title_align="left", border_style=colour)


def _in_lines(part: Any) -> Any:
    """A part of a document whose texts are one line each, whatever names they hold."""
    if isinstance(part, dict):
        return {name: _in_lines(content) for name, content in part.items()}
    if isinstance(part, list | tuple):
        return [_in_lines(content) for content in part]
    return escaped_line(part) if isinstance(part, str) else part


def _what(document: Document) -> Table:
    thing, task, request = document["object"], document["task"], document["request"]
    size = " × ".join(f"{1000 * x:.3g}" for x in thing["extents"])
    rows: list[Row] = [("object", f"{thing['name']}, {size} mm")]
    if document["cloud"] is not None:
        said = document["cloud"]
        rows.append(("cloud", f"{said['points']} points; trust {said['trust']:.2f} of 1: {said['sentence']}"))
    if request["analyser"] == "closure" or request["verify"]:
        rows.append(("mass", words.mass_words(document["best"] or document)))
    motion = task_from_numbers(task["q"]).describe()
    rows.append(("task", f"{task['name']}: {motion}. {task['means']}"))
    rows.append(("hand", f"{document['hand']['name']}, U = {1000 * document['U']:.0f} mm"))
    scene = words.scene_words(document)
    rules = words.rules_words(document)
    rows += [("scene", scene)] if scene else []
    return fact_grid(*rows, *([("rules", rules)] if rules else []))


def _answer(answer: Document) -> Table:
    grip, hand = answer["grip"], answer["hand"]
    named = words.fingers_words(answer)
    fingers = f"{''.join(words.touching_words(answer))}: {named}" if answer["contacts"] else named
    way = f"{words.way_in_words(answer)}; {_plane(answer)}"
    rows: list[Row]
    if grip:
        task, hold = two_digits(grip["task_margin"]), two_digits(grip["hold_margin"])
        margins = f"{task} times the task's load, {hold} times pushes"
        enough = "but it is not to be executed" if words.refused(answer) else "3 is just enough"
        rows = [
            ("quality", f"{quality_text(grip['quality'], 1)} of 6 ({enough})"),
            ("margins", f"{margins} from any side, {words.load_words(answer)}"),
            *([("pick-up", words.odds_words(answer))] if words.odds_words(answer) else []),
            *([("type", words.type_words(answer))] if words.type_words(answer) else []),
            ("fingers", fingers),
            ("clearance", f"{1000 * grip['clearance']:.0f} mm to the object on the way in"),
            ("way in", way),
        ]
        if words.refused(answer):
            rows[-2] = "refused", Text(words.refused(answer), style="red")
    else:
        reached = hand["status"] == "reached"
        text = Text("reached: " if reached else "retracted: ", style="green" if reached else "red")
        text.append(hand["reason"], style="default")
        rows = [("way in", way), ("fingers", fingers), ("hand", text)]
    if arm := words.arm_words(answer):
        rows.append(("arm", Text(arm, style="" if answer["arm"]["path"] else "red")))
    if hand["grasp"] is not None:
        x, y, z = (1000 * x for x in hand["grasp"]["palm_pose"][:3])
        rows.append(("palm", f"at {x:.0f}, {y:.0f}, {z:.0f} mm in the object's frame"))
    return fact_grid(*rows)


def _plane(answer: Document) -> str:
    """Approach plane with its axes and the thumb's side."""
    return f"plane {answer['plane']}: {words.plane_words(answer)}, {words.thumb_words(answer)}"


def _indices(answer: Document) -> Table:
    return fact_grid(
        ("value", f"approach value {answer['approach_value']:+.2f} ({answer['approach_set']})"),
        (
            "indices",
            f"{answer['fingers']} virtual fingers, TFVADI {answer['tfvadi']:.2f} of 6, stability "
            f"{answer['stability']}, manipulability {answer['manipulability']}",
        ),
    )


def _match(document: Document, answer: Document) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("", no_wrap=True)
    for heading in ("task", "grasp"):
        table.add_column(heading, justify="right")
    table.add_column("match (ADI)", no_wrap=True)
    columns = (document["task"]["q"], answer["net_wrench"], answer["adi"])
    for name, q, w, degree in zip(COMPONENTS, *columns, strict=True):
        full = round(10 * float(degree))
        bar = Text("█" * full, style="cyan") + Text("░" * (10 - full), style="dim") + f" {degree:.2f}"
        table.add_row(name, f"{q:.2f}", f"{w:.2f}", bar)
    return table


def _why(document: Document) -> Table:
    rows = []
    for t in document["transitions"]:
        text = Text(t["outcome"], style=_COLOURS.get(t["outcome"], "default"))
        text.append(f": {t['reason']}", style="default")
        rows.append((f"{STEPS[t['mode']].lower()} ({t['mode']})", text))
    return fact_grid(*rows)


def _offers(document: Document) -> Table:
    rows: list[Row] = []
    for offer in document["offers"]:
        match = f"{words.mode_words(offer['mode'])}, {offer['tfvadi']:.2f} of 6"
        motion = task_from_numbers(offer["q"]).describe()
        rows.append(("fits", f"--task {offer['task']:<14} {motion} ({match})"))
    return fact_grid(*rows)


def _alternatives(document: Document) -> Table:
    answers = words.answers_of(document, best=False)
    lines = zip(words.answers_words(answers), answers, strict=True)
    rows: list[Row] = [
        (f"answer {number}", f"{line}; {_where(answer)}")
        for number, (line, answer) in enumerate(lines, start=1)
        if answer is not document
    ]
    return fact_grid(*rows)


def _where(answer: Document) -> str:
    """Where a grasp is; its name says the plane of a virtual grasp already."""
    place = words.place_words(answer)
    return f"plane {answer['plane']}: {place}" if answer["grip"] else place


def after_words(document: Document) -> Sequence[str]:
    """Advice on what to do next, one sentence each; empty if there is none."""
    if words.none_reached(document):
        return ("The arm reaches no answer; the reason says what would help.",)
    if document["status"] != "answer":
        return (Status(document["status"]).help, *words.correction_words(document))
    if not document["executable"] and not document["alternatives"]:
        return ("This hand cannot execute it as it stands: --count 5 shows other answers.",)
    return ()
