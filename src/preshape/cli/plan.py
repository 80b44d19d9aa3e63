"""``preshape plan``: plan a preshape for an object and a task."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..exceptions import InputError, shown
from ..files import make_folder
from .options import (
    TableCommand,
    arm_from,
    arm_options,
    check_folder,
    closure_options,
    complete_object,
    complete_task,
    hand_from,
    json_option,
    memory_option,
    numbers_in,
    object_options,
    request_from,
    verbose_option,
)
from .printing import emit, name_files, say
from .progress import narrated, waiting
from .settings_file import name_settings

if TYPE_CHECKING:
    from ..planning.document import Document
    from ..planning.plan import Plan
    from ..planning.request import PlanRequest
    from ..planning.session import Progress, Session


def _own_session(request: PlanRequest, learn: bool, told: Progress) -> AbstractContextManager[Session]:
    from ..planning.session import Session

    return Session(request.memory, learn=learn, progress=told)


session_for: Callable[[PlanRequest, bool, Progress], AbstractContextManager[Session]] = _own_session
"""Gives the session that answers a request; a planner process of the server lends one that is warm."""


@click.command(
    cls=TableCommand,
    epilog="Example: preshape plan mug --task pour --hand leap, or "
    'preshape plan part.stl --unit mm --task "1 1 .1 .05 .8 .05"',
)
@click.argument("thing", metavar="OBJECT", required=False, shell_complete=complete_object)
@click.option(
    "--scene",
    metavar="FILE",
    help="In place of OBJECT: a depth image (.npz with depth and K) or a point cloud, of which --mask says "
    "what the object is. The rest is in the hand's way.",
)
@click.option(
    "--mask",
    metavar="FILE|N",
    help="With --scene: a .npy or .png file with a number for each point or pixel, not zero for the object, "
    "or the number of a label in the scene's file.",
)
@click.option(
    "--task",
    required=True,
    metavar="TASK",
    shell_complete=complete_task,
    help='A name (preshape tasks) or "Tx Ty Tz Rx Ry Rz".',
)
@object_options
@closure_options
@arm_options
@memory_option
@click.option("--no-learn", is_flag=True, help="Do not write to the memory.")
@click.option(
    "--count",
    type=int,
    default=1,
    show_default=True,
    help="Number of different answers: the answer, then others by score. One of them may be better than the "
    "answer: mode 0 accepts a stored or estimated grasp that is good enough.",
)
@click.option(
    "--verify",
    is_flag=True,
    help="Try the best answers in simulated physics; the first that holds is the answer.",
)
@click.option(
    "--view",
    metavar="X,Y,Z",
    help="Camera position of a point cloud, in its frame and unit, or all; default: its origin if outside.",
)
@click.option(
    "--cut-table/--no-cut-table",
    default=None,
    help="Cut off the table in a point cloud, or keep it as part of the object; default: refuse it.",
)
@click.option(
    "--explain", is_flag=True, help="Also show the paper's indices and the match of each component."
)
@click.option("--out", metavar="DIR", help="Also write plan.json, plan.png and plan.html there.")
@verbose_option
@json_option
def plan(
    thing: str | None,
    task: str,
    scene: str | None,
    mask: str | None,
    no_learn: bool,
    count: int,
    verify: bool,
    view: str | None,
    cut_table: bool | None,
    explain: bool,
    out: str | None,
    verbose: bool,
    as_json: bool,
    **options: Any,
) -> int:
    """Plan a preshape for OBJECT: a mesh file, a point cloud, or a name from `preshape objects`.

    Exit code 0: an answer. 1: no answer (task correction requested, deadlock, no grasp, or with --verify no
    grasp that holds); the JSON then has the best grasp found and why it is not enough. 2: bad input.
    """
    check_folder(out)
    source = _object(thing, scene, mask)
    if not as_json:
        name_settings()
    with narrated() if verbose else waiting() as told:
        request = request_from(
            source,
            task,
            hand=hand_from(options),
            options=options,
            view=_view(view),
            cut_table=cut_table,
            mask=mask,
            count=count,
            learn=not no_learn,
            verify=verify,
            **arm_from(options),
        )
        if out is not None:
            make_folder(Path(out))
        document, code, made = _answered(request, told, fresh=out is not None)
    given = 1 + len(document["alternatives"])
    if not as_json and document["status"] == "answer" and given < count:
        say(
            f"{given} of the {count} answers asked for: no other is different enough and good enough",
            err=True,
        )
    written: list[Path] = []
    if made is not None and out is not None:
        from ..planning.output import save_plan

        written = save_plan(made, Path(out), document)
    if as_json:
        emit(document)
    else:
        _show(document, written, explain=explain)
    return code


def _answered(request: PlanRequest, told: Progress, *, fresh: bool) -> tuple[Document, int, Plan | None]:
    """The plan's document and exit code; a request that was answered before is not searched for again.

    Args:
        request: The request.
        told: Told how the work advances.
        fresh: Whether the plan itself is needed.

    Returns:
        Document, exit code, and the plan if there was a search.
    """
    from ..planning.answer_cache import answer_key, keep_answer, known_answer

    start = time.perf_counter()
    key = answer_key(request)
    if key is not None and not fresh and (known := known_answer(key)) is not None:
        told("the same was asked before, and neither memory nor files have changed", 100)
        seconds = {"load": round(time.perf_counter() - start, 6), "prepare": 0.0, "search": 0.0}
        known[0]["seconds"] = {**seconds, "total": seconds["load"]}
        return *known, None
    from ..planning.document import plan_to_json

    with session_for(request, request.learn, told) as session:
        made = session.run(request)
    document = plan_to_json(made)
    failed = made.verified is not None and not made.verified.held
    code = 0 if made.answer is not None and not failed else 1
    if key is not None and key == answer_key(request):
        keep_answer(key, document, code)
    return document, code, made


def _object(thing: str | None, scene: str | None, mask: str | None) -> str:
    """The object's file or name, or the scene's file.

    Raises:
        UsageError: There is neither or both.
        InputError: There is a scene without a mask, or a mask without a scene.
    """
    if thing is not None and scene is not None:
        raise click.UsageError(f"give OBJECT or --scene, not both: {shown(thing)} and {shown(scene)}")
    if (scene is None) != (mask is None):
        given, other = ("--mask", "--scene FILE") if scene is None else ("--scene", "--mask FILE|N")
        raise InputError(f"{given} needs {other}: the mask says which points of the scene are the object's")
    if thing is None and scene is None:
        raise click.UsageError("Missing argument 'OBJECT'.")
    return str(scene if thing is None else thing)


def _show(document: Document, written: list[Path], *, explain: bool) -> None:
    from ..planning.summary import after_words, summary
    from ..report.terminal import terminal

    console = terminal()
    console.print(summary(document, explain=explain), highlight=False)
    for sentence in after_words(document):
        console.print(sentence, highlight=False)
    name_files(written)


def _view(text: str | None) -> list[float] | str | None:
    """A camera's position from the text of ``--view``.

    Raises:
        InputError: The text is neither three numbers nor ``all``.
    """
    if text is None or text.strip() == "all":
        return None if text is None else "all"
    numbers = numbers_in(text)
    if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
        raise InputError(f"--view takes a camera's position x,y,z or all, got {shown(text)}")
    return numbers
