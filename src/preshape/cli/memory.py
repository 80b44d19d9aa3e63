"""``preshape memory``: show, export, import or reset what was learnt."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from .lazy import HelpfulGroup
from .options import json_option, memory_option
from .printing import emit, print_rows, say

MOST_LISTED = 200
"""Largest number of objects in a list for reading."""


@click.group(cls=HelpfulGroup, epilog="Example: preshape memory show")
def memory() -> None:
    """Show, export, import or reset what was learnt."""


@memory.command(epilog="Example: preshape memory show --memory robot.sqlite")
@memory_option
@json_option
def show(memory: str | None, as_json: bool) -> None:
    """Show the known objects and the size of the memory."""
    from ..memory import Memory

    with Memory.open(memory, read_only=True) as store:
        known, numbers = store.objects(), store.statistics()
        left_out = [store.remark] if store.skipped else []
    if as_json:
        emit(
            {
                "status": "answer",
                "path": numbers.path,
                "version": numbers.version,
                "experiences": numbers.experiences,
                "kinds": dict(numbers.kinds),
                "hands": dict(numbers.hands),
                "models": dict(numbers.models),
                "trained_on": dict(numbers.trained),
                "objects": [
                    {
                        "name": o.name,
                        "hands": list(o.hands),
                        "experiences": o.experiences,
                        "tasks": o.tasks,
                        "best_match": o.best_match,
                        "best_quality": o.best_quality,
                        "seed": o.seed,
                        "last_seen": o.last_seen,
                    }
                    for o in known
                ],
                "warnings": left_out,
            }
        )
        return
    listed = known
    if len(known) > MOST_LISTED:
        newest = sorted(known, key=lambda o: o.last_seen)[-MOST_LISTED:]
        listed = tuple(sorted(newest, key=lambda o: o.name))
    if known:
        print_rows(
            ("object", ">experiences", ">tasks", "best", "last seen (UTC)", "~hand"),
            [
                (
                    f"{o.name} *" if o.seed else o.name,
                    str(o.experiences),
                    str(o.tasks),
                    o.best,
                    o.last_seen[:16].replace("T", " "),
                    " ".join(o.hands),
                )
                for o in listed
            ],
        )
    if len(listed) < len(known):
        say(f"and {len(known) - len(listed)} more, which were met earlier; --json lists all")
    if any(o.seed for o in listed):
        say("* the first lesson, which every hand gets")
    if numbers.path != ":memory:" and not Path(numbers.path).exists():
        say(f"there is no memory yet at {numbers.path}")
        return
    trained = ", ".join(f"{hand}: {n} samples" for hand, n in numbers.trained) or "not trained yet"
    say(
        f"{numbers.experiences} experiences of {numbers.objects} objects; network {trained}",
        f"{numbers.path} (version {numbers.version}, {numbers.size / 1024:.0f} KiB)",
        *(
            f"{hand}: the lessons are of {count} models of this hand; under one model, those of the others"
            " are starts for the search only"
            for hand, count in numbers.models
            if count > 1
        ),
        *left_out,
    )


@memory.command(name="export", epilog="Example: preshape memory export learnt.json")
@click.argument("file", metavar="FILE")
@memory_option
@json_option
def export_(file: str, memory: str | None, as_json: bool) -> None:
    """Write everything learnt to FILE as one JSON document."""
    from ..memory import Memory

    with Memory.open(memory, read_only=True) as store:
        count = store.export(Path(file))
        left_out = [store.remark] if store.skipped else []
    sentence = f"exported {count} experiences to {file}"
    _done(as_json, {"exported": count, "file": file, "warnings": left_out}, sentence, *left_out)


@memory.command(name="import", epilog="Example: preshape memory import learnt.json")
@click.argument("file", metavar="FILE")
@memory_option
@json_option
def import_(file: str, memory: str | None, as_json: bool) -> None:
    """Add the experiences in FILE to the memory. Those already in it are skipped."""
    from ..memory import Memory

    with Memory.open(memory) as store:
        added = store.import_(Path(file))
    _done(as_json, {"imported": added, "file": file}, f"imported {added} new experiences from {file}")


@memory.command(epilog="Example: preshape memory reset --yes")
@memory_option
@click.option("--hand", metavar="HAND", help="Name or TOML file: forget the experiences of this hand only.")
@click.option("--yes", is_flag=True, help="Do not ask for confirmation.")
@json_option
def reset(memory: str | None, hand: str | None, yes: bool, as_json: bool) -> None:
    """Forget everything learnt, after a confirmation."""
    from ..exceptions import InputError
    from ..hands.load import load_hand
    from ..memory import Memory
    from ..planning.controllers import CLOSURE_SUFFIX

    name = None if hand is None else load_hand(hand).name
    hands = [None] if name is None else [name, name + CLOSURE_SUFFIX]
    with Memory.open(memory) as store:
        count = sum(map(store.count, hands))
        if not yes:
            if as_json or not sys.stdin.isatty():
                raise InputError("reset forgets everything learnt: add --yes to confirm")
            click.confirm(f"Forget {count} experiences in {store.where}?", abort=True)
        for each in hands:
            store.reset(each)
    _done(as_json, {"forgotten": count}, f"forgot {count} experiences")


def _done(as_json: bool, document: dict[str, object], *sentences: str) -> None:
    if as_json:
        emit({"status": "answer", **document})
    else:
        say(*sentences)
