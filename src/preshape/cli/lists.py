"""``preshape objects`` and ``preshape tasks``: lists of the built-in objects and of the named tasks."""

from __future__ import annotations

from typing import Any

import click

from .options import json_option
from .printing import emit, print_rows


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
    sizes = (" × ".join(f"{1000 * float(x):.0f}" for x in row["extents"]) for row in rows)
    print_rows(
        ("object", ">W × H × D [mm]", ">mass [g]", "~description", "~tasks"),
        [
            (row["name"], size, f"{1000 * row['mass']:.0f}", row["description"], " ".join(row["tasks"]))
            for row, size in zip(rows, sizes, strict=True)
        ],
    )


@click.command(epilog="Example: preshape tasks")
@json_option
def tasks(as_json: bool) -> None:
    """List the named tasks. A colon and an axis select another direction: push:-y, turn:+x."""
    from ..tasks import FAMILIES, OTHER_NAMES, named_task

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
                "other_names": [word for word, meant in OTHER_NAMES.items() if meant == name],
            }
        )
    if as_json:
        emit({"status": "answer", "tasks": rows})
        return
    print_rows(
        ("task", ">Tx   Ty   Tz    Rx   Ry   Rz", "~meaning"),
        [(f"{row['name']}:{row['axis']}", _six(row["q"]), _meaning(row)) for row in rows],
    )


def _meaning(row: dict[str, Any]) -> str:
    """What a task means, and the other words for it."""
    others = ", ".join(word.replace("_", " ") for word in row["other_names"])
    return row["means"] + (f" Also: {others}." if others else "")


def _six(q: list[float]) -> str:
    """Six numbers in columns of equal width."""
    return " ".join("".join(f"{x:<5.2g}" for x in part) for part in (q[:3], q[3:]))
