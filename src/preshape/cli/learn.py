"""``preshape learn``: teach objects to the memory one by one (meta control, §3.5)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .options import (
    TableCommand,
    closure_options,
    complete_object,
    complete_task,
    hand_from,
    json_option,
    memory_option,
    object_options,
    request_from,
)
from .printing import emit
from .settings_file import name_settings

if TYPE_CHECKING:
    from ..planning.plan import Plan
    from ..types import NetworkWeights


@click.command(cls=TableCommand, epilog="Example: preshape learn mug bottle hammer --task lift --task pour")
@click.argument("things", metavar="OBJECT...", nargs=-1, required=True, shell_complete=complete_object)
@click.option(
    "--task",
    "tasks",
    multiple=True,
    metavar="TASK",
    shell_complete=complete_task,
    help="Task to teach; repeatable. Default: the library object's own tasks, or lift.",
)
@object_options
@closure_options
@memory_option
@json_option
def learn(things: tuple[str, ...], tasks: tuple[str, ...], as_json: bool, **options: Any) -> int:
    """Teach objects to the memory, each with its tasks, even if they are already known.

    A real hand learns grips, the paper's hand learns virtual grasps; `preshape plan` with the same hand
    recalls them. Every object and task is saved before its line appears, so the command can be interrupted at
    any time. The object ALL stands for the whole library.

    Exit code 0: all were learnt and recalled. 1: some are not good enough; the table says which.
    """
    from rich.markup import escape
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeRemainingColumn

    from ..hands.load import load_hand
    from ..objects.library import names
    from ..objects.load import load_object, split_part
    from ..planning.session import Session
    from ..report.plain import escaped_line
    from ..report.terminal import terminal

    if not as_json:
        name_settings()
    model = load_hand(hand_from(options))
    lessons = [
        (task, request_from(name, task, hand=model, options=options))
        for name in _names(things)
        for task in (tasks or _own_tasks(name))
    ]
    for name in dict.fromkeys(lesson.object_name for _, lesson in lessons):
        if name not in names() and not Path(split_part(name)[0]).is_file():
            load_object(name)  # refuse a wrong name before anything is learnt
    console = terminal(stderr=as_json)
    rows: list[dict[str, Any]] = []
    with Session(options["memory"]) as session:
        columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeRemainingColumn())
        with Progress(*columns, console=terminal(stderr=True), transient=True) as bar:
            step = bar.add_task("learning", total=len(lessons))
            for text, lesson in lessons:
                words = f"learning {lesson.object_name}, {text}"
                bar.update(step, description=escape(escaped_line(words)))
                taught = session.teach(lesson)
                row = _row(lesson.object_name, text, taught, session.prepare(lesson).controller.weights)
                rows.append(row)
                if not as_json:
                    console.print(_line(row), highlight=False, soft_wrap=True)
                bar.advance(step)
        where = session.memory.where
    good = sum(row["status"] == "answer" for row in rows)
    if as_json:
        emit({"status": "answer" if good == len(rows) else "incomplete", "lessons": rows})
    else:
        console.print(
            f"{good} of {len(rows)} learnt and recalled; memory: {where}", highlight=False, markup=False
        )
    return 0 if good == len(rows) else 1


def _names(things: tuple[str, ...]) -> list[str]:
    from ..objects.library import names

    return [name for thing in things for name in (names() if thing == "ALL" else (thing,))]


def _own_tasks(name: str) -> tuple[str, ...]:
    from ..objects.library import entry, names

    return entry(name).tasks if name in names() else ("lift",)


def _row(name: str, task: str, plan: Plan, weights: NetworkWeights) -> dict[str, Any]:
    from ..planning.document import plan_to_json
    from ..viewer.words import missing_words

    document = plan_to_json(plan)
    shown = plan.answer or plan.best
    grasp = shown.grasp if shown else None
    return {
        "object": name,
        "task": task,
        "status": plan.decision.status.value,
        "analyser": plan.request.analyser,
        "mass": plan.mass.kg,
        "plane": grasp.plane.index if grasp else None,
        "judged": grasp.judged if grasp else None,
        "tfvadi": grasp.tfvadi if grasp else None,
        "score": grasp.score_text if grasp else None,
        "missing_motion": document["missing_motion"],
        "mismatch": missing_words(document) if document["missing_motion"] else "",
        "samples": weights.trained_on,
        "mean_square_error": weights.mean_square_error,
        "reason": plan.decision.reason,
    }


def _line(row: dict[str, Any]) -> str:
    from rich.markup import escape

    row = {key: escape(text) if isinstance(text, str) else text for key, text in row.items()}
    mark = "[green]✓[/]" if row["status"] == "answer" else "[yellow]✗[/]"
    if row["missing_motion"]:
        mark = "[yellow]![/]"
    if row["plane"] is None:
        return f"{mark} {row['object']:<14} {row['task']:<12} {row['reason']}"
    lacking = f" {row['mismatch']}; " if row["mismatch"] else ""
    return (
        f"{mark} {row['object']:<14} {row['task']:<12} plane {row['plane']:>2}  {row['score']}  "
        f"[dim]{lacking}{row['reason']}[/]"
    )
