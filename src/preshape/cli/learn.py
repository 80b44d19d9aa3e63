"""``preshape learn``: meta control teaches objects one by one (§3.5)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from .options import json_option, memory_option, object_options, settings_from


@click.command(epilog="Example: preshape learn mug bottle hammer --task lift --task pour")
@click.argument("things", metavar="OBJECT...", nargs=-1, required=True)
@click.option(
    "--task",
    "tasks",
    multiple=True,
    metavar="TASK",
    help="May be given several times; default: the library object's own tasks, or lift.",
)
@object_options
@memory_option
@json_option
def learn(
    things: tuple[str, ...],
    tasks: tuple[str, ...],
    hand: str,
    analyser: str | None,
    scale: float,
    unit: str,
    approach: str | None,
    seed: int,
    estimation_threshold: float,
    recognition_threshold: float,
    memory: str | None,
    as_json: bool,
) -> int:
    """Teach objects to the memory, each with its tasks, whether or not they are known.

    Every object and task is on disk as soon as its line appears; it can be interrupted at any time. The
    object ALL stands for the whole library.

    Exit code 0: all were learnt and recalled. 1: some are not good enough; the table says which.
    """
    settings = settings_from(estimation_threshold, recognition_threshold, seed)
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeRemainingColumn

    from ..hands.load import load_hand
    from ..hiis.controller import Controller
    from ..memory import Memory
    from ..objects.library import names
    from ..objects.load import load_object
    from ..planner import check_analyser, layout_of
    from ..tasks import parse_task

    model = load_hand(hand)
    check_analyser(analyser, hand)
    lessons = [(name, task) for name in _names(things) for task in (tasks or _own_tasks(name))]
    for name, task in lessons:  # a wrong name is refused before anything is learnt
        parse_task(task)
        if name not in names() and not Path(name).is_file():
            load_object(name)
    console = Console(stderr=as_json)
    rows: list[dict[str, Any]] = []
    with Memory.open(memory) as store:
        controller = Controller(store, layout_of(model), settings=settings)
        columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeRemainingColumn())
        with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
            step = bar.add_task("learning", total=len(lessons))
            prepared: tuple[str, Any] = ("", None)
            for name, task in lessons:
                bar.update(step, description=escape(f"learning {name}, {task}"))
                if prepared[0] != name:
                    prepared = (name, controller.prepare(load_object(name, unit=unit, scale=scale)))
                decision = controller.teach(prepared[1], parse_task(task), approaches=approach)
                controller.reset()
                row = _row(name, task, decision, controller)
                rows.append(row)
                if not as_json:
                    console.print(_line(row), highlight=False, soft_wrap=True)
                bar.advance(step)
    good = sum(row["status"] == "answer" for row in rows)
    if as_json:
        from .main import emit

        emit({"status": "answer" if good == len(rows) else "incomplete", "lessons": rows})
    else:
        console.print(
            f"{good} of {len(rows)} learnt and recalled; memory: {store.where}", highlight=False, markup=False
        )
    return 0 if good == len(rows) else 1


def _names(things: tuple[str, ...]) -> list[str]:
    from ..objects.library import names

    return [name for thing in things for name in (names() if thing == "ALL" else (thing,))]


def _own_tasks(name: str) -> tuple[str, ...]:
    from ..objects.library import entry, names

    return entry(name).tasks if name in names() else ("lift",)


def _row(name: str, task: str, decision: Any, controller: Any) -> dict[str, Any]:
    best = decision.best
    return {
        "object": name,
        "task": task,
        "status": decision.status.value,
        "plane": best.plane.index if best else None,
        "tfvadi": best.tfvadi if best else None,
        "samples": controller.weights.trained_on,
        "mean_square_error": controller.weights.mean_square_error,
        "reason": decision.reason,
    }


def _line(row: dict[str, Any]) -> str:
    from rich.markup import escape

    row = {key: escape(text) if isinstance(text, str) else text for key, text in row.items()}
    mark = "[green]✓[/]" if row["status"] == "answer" else "[yellow]✗[/]"
    if row["plane"] is None:
        return f"{mark} {row['object']:<14} {row['task']:<12} {row['reason']}"
    return (
        f"{mark} {row['object']:<14} {row['task']:<12} plane {row['plane']:>2}  TFVADI {row['tfvadi']:.2f}  "
        f"[dim]{row['reason']}[/]"
    )
