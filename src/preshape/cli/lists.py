"""``preshape objects`` and ``preshape tasks``: lists of the built-in objects and of the named tasks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ..exceptions import InputError
from .options import check_folder, complete_object, json_option
from .printing import emit, name_files, print_rows, say


@click.command(epilog="Example: preshape objects, or preshape objects hammer --out out/hammer")
@click.argument("thing", metavar="[OBJECT]", required=False, shell_complete=complete_object)
@click.option("--scale", type=float, default=1.0, help="Factor on the object's size.")
@click.option("--unit", default="m", metavar="m|cm|mm|in", help="Unit of the file.")
@click.option("--out", metavar="DIR", help="Folder for a picture of the object's parts, with their names.")
@json_option
def objects(thing: str | None, scale: float, unit: str, out: str | None, as_json: bool) -> None:
    """List the built-in objects with size, mass and tasks, or show one object or mesh file with its parts.

    Parts are what --hold-on and --keep-off of preshape plan take.
    """
    if thing is not None:
        _one_object(thing, scale=scale, unit=unit, out=out, as_json=as_json)
        return
    if out is not None or scale != 1.0 or unit != "m":
        raise InputError("--out, --scale and --unit are for one object: preshape objects OBJECT --out DIR")
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


def _one_object(thing: str, *, scale: float, unit: str, out: str | None, as_json: bool) -> None:
    """Show one object with its parts.

    Raises:
        InputError: The object, its sidecar or an option cannot be used.
        EnvironmentFailure: A file cannot be read or written.
    """
    from ..files import file_stem, make_folder
    from ..objects.load import load_object, split_part
    from ..objects.mass import object_mass
    from ..objects.parts import part_pieces
    from ..objects.sidecar import sidecar_path
    from ..tasks import parse_task

    check_folder(out)
    mesh = load_object(thing, scale=scale, unit=unit)
    mass = object_mass(mesh)
    beside = sidecar_path(split_part(thing)[0])
    try:
        for task in mesh.tasks:
            parse_task(task)  # a sidecar may name anything
    except InputError as error:
        raise InputError(f"{beside}: tasks: {error}") from error
    parts: list[dict[str, Any]] = [
        {"name": part.name, "origin": part.origin, "area": part_pieces(mesh, part.region).area}
        for part in mesh.parts
    ]
    notes = [*mesh.notes, *([mass.warning] if mass.warning else [])]
    notes += [f"nothing of the surface lies in the part {p['name']}" for p in parts if not p["area"]]
    written = []
    if out is not None:
        from ..pictures import parts_picture_of

        make_folder(Path(out))
        written.append(Path(out) / f"{file_stem(mesh.name)}-parts.png")
        parts_picture_of(mesh, written[0])
    rules = [
        {"tasks": list(rule.tasks), "hold_on": list(rule.hold_on), "keep_off": list(rule.keep_off)}
        for rule in mesh.rules
    ]
    if as_json:
        document = {
            "name": mesh.name,
            "extents": mesh.extents.tolist(),
            "mass": mass.kg,
            "mass_source": mass.source,
            "com": None if mesh.com is None else mesh.com.tolist(),
            "up": mesh.up,
            "rest": None if mesh.rest is None else mesh.rest.tolist(),
            "tasks": list(mesh.tasks),
            "area": mesh.area,
            "parts": parts,
            "rules": rules,
            "notes": notes,
            "files": [str(path) for path in written],
        }
        emit({"status": "answer", "object": document})
        return
    size = " × ".join(f"{1000 * x:.3g}" for x in mesh.extents)
    say(f"{mesh.name}: {size} mm, {mass.words}, {mesh.up} is up")
    for name, numbers in (("centre of mass [m]", mesh.com), ("rest [quaternion w x y z]", mesh.rest)):
        if numbers is not None:
            say(f"{name}: {' '.join(f'{x:.4g}' for x in numbers + 0.0)}")
    if mesh.tasks:
        say(f"tasks: {' '.join(mesh.tasks)}")
    for note in notes:
        say(f"! {note}")
    for rule in mesh.rules:
        held = [f"hold on {' or '.join(rule.hold_on)}"] if rule.hold_on else []
        said = ", ".join([*held, *(f"keep off {name}" for name in rule.keep_off)])
        say(f"to {', '.join(rule.tasks)}: {said}")
    if parts:
        say("")
        origins = {"library": "the library", "file": "a group of the file", "sidecar": beside.name}
        print_rows(
            ("part", ">area [cm²]", ">share", "from"),
            [
                (p["name"], f"{1e4 * p['area']:.1f}", f"{p['area'] / mesh.area:.0%}", origins[p["origin"]])
                for p in parts
            ],
        )
    else:
        say("no named parts: name them in NAME.preshape.toml beside the mesh, or describe them, as z>0.05")
    name_files(written)


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
