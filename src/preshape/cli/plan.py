"""``preshape plan``: the main job."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..exceptions import InputError
from .options import (
    boxes_from,
    check_folder,
    closure_options,
    json_option,
    memory_option,
    object_options,
    settings_from,
)

if TYPE_CHECKING:
    from ..planner import Plan


@click.command(
    epilog="Example: preshape plan mug --task pour, or "
    'preshape plan part.stl --unit mm --task "1 1 .1 .05 .8 .05"'
)
@click.argument("thing", metavar="OBJECT")
@click.option("--task", required=True, metavar="TASK", help='A name (preshape tasks) or "Tx Ty Tz Rx Ry Rz".')
@object_options
@closure_options
@memory_option
@click.option("--no-learn", is_flag=True, help="Leave the memory as it is.")
@click.option(
    "--count",
    type=int,
    default=1,
    show_default=True,
    help="How many different answers: the mode's own first, then others, best first.",
)
@click.option(
    "--verify",
    is_flag=True,
    help="Try the best few in simulated physics; the first that holds is the answer.",
)
@click.option(
    "--view",
    metavar="X,Y,Z",
    help="Where a point cloud was seen from, in its frame and unit, or all; default: its origin if outside.",
)
@click.option("--out", metavar="DIR", help="Also write plan.json, plan.png and plan.html there.")
@json_option
def plan(
    thing: str,
    task: str,
    hand: str,
    analyser: str | None,
    scale: float,
    unit: str,
    approach: str | None,
    seed: int,
    estimation_threshold: float,
    recognition_threshold: float,
    friction: float,
    mass: float,
    table: str | None,
    avoid: tuple[str, ...],
    memory: str | None,
    no_learn: bool,
    count: int,
    verify: bool,
    view: str | None,
    out: str | None,
    as_json: bool,
) -> int:
    """Plan a preshape for OBJECT: a mesh file, a point cloud, or a name from `preshape objects`.

    Exit code 0: an answer. 1: none (task correction asked for, deadlock, no grasp, or none that holds with
    --verify). 2: bad input.
    """
    check_folder(out)
    settings = settings_from(estimation_threshold, recognition_threshold, seed)
    boxes = boxes_from(avoid)
    from ..closure.settings import ClosureSettings
    from ..files import make_folder, write_json, write_text, write_whole
    from ..planner import plan as make_plan
    from ..planning.document import plan_to_json

    if out is not None:
        make_folder(Path(out))
    made = make_plan(
        thing,
        task,
        hand=hand,
        analyser=analyser,
        scale=scale,
        unit=unit,
        memory=memory,
        learn=not no_learn,
        seed=seed,
        count=count,
        approaches=approach,
        settings=settings,
        closure=ClosureSettings(friction=friction, mass=mass),
        table=table,
        avoid=boxes,
        verify=verify,
        view=_view(view),
    )
    document = plan_to_json(made)
    given = 1 + len(made.alternatives)
    if not as_json and made.decision.grasp is not None and given < count:
        click.echo(
            f"{given} of the {count} answers asked for: no other stands apart and is good enough", err=True
        )
    written: list[Path] = []
    if out is not None:
        from ..app.scenes import plan_html
        from ..pictures import plan_png

        folder = Path(out)
        surface = written_surface(made, folder)
        if surface is not None:  # what was planned with; other commands find it beside the plan
            for one in (document, *document["alternatives"]):
                one["object"]["source"] = surface.name
        write_json(folder / "plan.json", document)
        write_whole(folder / "plan.png", lambda path: plan_png(made, path))
        page = plan_html(made, document)
        write_text(folder / "plan.html", page)
        written = [folder / "plan.json", folder / "plan.png", folder / "plan.html"]
        written += [surface] if surface is not None else []
    if as_json:
        from .main import emit

        emit(document)
    else:
        from .show import show_plan

        show_plan(made, written)
    failed = made.verified is not None and not made.verified.held
    return 0 if made.decision.grasp is not None and not failed else 1


def _view(text: str | None) -> list[float] | str | None:
    """A camera's position from the text of ``--view``.

    Raises:
        InputError: neither three numbers nor ``all``.
    """
    if text is None or text.strip() == "all":
        return None if text is None else "all"
    try:
        numbers = [float(part) for part in text.replace(",", " ").split()]
    except ValueError:
        numbers = []
    if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
        raise InputError(f"--view takes a camera's position x,y,z or all, got {text!r}")
    return numbers


def written_surface(made: Plan, folder: Path) -> Path | None:
    """Write the surface that was made of a point cloud, in metres; nothing for a mesh.

    Args:
        made: the plan.
        folder: where ``NAME-surface.obj`` goes.

    Raises:
        EnvironmentFailure: the file cannot be written.
    """
    if made.mesh.scan is None:
        return None
    from ..files import write_text
    from ..physics.task.instances import mesh_text

    path = folder / f"{made.mesh.name}-surface.obj"
    write_text(path, mesh_text(made.mesh))
    return path
