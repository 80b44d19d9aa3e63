"""``preshape objects`` and ``preshape tasks``: lists of the built-in objects and of the named tasks."""

from __future__ import annotations

from typing import Any

import click

from .options import json_option
from .printing import emit


@click.command(epilog="Example: preshape objects")
@json_option
def objects(as_json: bool) -> None:
    """List the built-in objects with size, mass and tasks."""
    from ..objects.library import entry, load_library_object, names

    rows: list[dict[str, Any]] = []
    for name in names():
        item, mesh = entry(name), load_library_object(name)
        rows.append(
            {
                "name": name,
                "description": item.description,
                "extents": mesh.extents.tolist(),
                "mass": item.mass,
                "triangles": len(mesh.triangles),
                "tasks": list(item.tasks),
            }
        )
    if as_json:
        emit({"status": "answer", "objects": rows})
        return
    from rich.table import Table

    table = Table(box=None, header_style="bold", pad_edge=False)
    for heading, justify in (("object", "left"), ("W × H × D [mm]", "right"), ("mass [g]", "right")):
        table.add_column(heading, justify=justify, no_wrap=True)  # type: ignore[arg-type]
    table.add_column("description")
    table.add_column("tasks", style="dim")
    for row in rows:
        size = " × ".join(f"{1000 * float(x):.0f}" for x in row["extents"])
        table.add_row(
            row["name"], size, f"{1000 * row['mass']:.0f}", row["description"], " ".join(row["tasks"])
        )
    _print(table)


@click.command(epilog="Example: preshape tasks")
@json_option
def tasks(as_json: bool) -> None:
    """List the named tasks. A colon and an axis select another direction: push:-y, turn:+x."""
    from ..tasks import FAMILIES, named_task

    rows: list[dict[str, Any]] = []
    for name, family in FAMILIES.items():
        task = named_task(name)
        rows.append(
            {
                "name": name,
                "axis": family.axis,
                "q": task.q.tolist(),
                "motion": task.describe(),
                "means": task.means,
            }
        )
    if as_json:
        emit({"status": "answer", "tasks": rows})
        return
    from rich.table import Table

    table = Table(box=None, header_style="bold", pad_edge=False)
    table.add_column("task", no_wrap=True)
    table.add_column("Tx   Ty   Tz    Rx   Ry   Rz", no_wrap=True)
    table.add_column("meaning")
    for row in rows:
        q = "".join(f"{x:<5.2g}" for x in row["q"][:3]) + " " + "".join(f"{x:<5.2g}" for x in row["q"][3:])
        table.add_row(f"{row['name']}[dim]:{row['axis']}[/]", q, row["means"])
    _print(table)


def _print(table: object) -> None:
    from rich.console import Console

    Console().print(table, highlight=False)
