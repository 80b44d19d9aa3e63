"""``preshape view``: show plans and make new ones in the browser."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from ..exceptions import EnvironmentFailure, InputError, PreshapeError
from . import interrupts
from .options import (
    TableCommand,
    boxes_from,
    closure_options,
    complete_object,
    complete_task,
    hand_from,
    memory_option,
    object_options,
    request_from,
)
from .printing import wait_at
from .settings_file import name_settings

if TYPE_CHECKING:
    from ..app.browser_session import Start
    from ..planning.request import PlanRequest

FOR_PLANS = ("mass", "friction", "table", "avoid", "hold_on", "keep_off", "rules", "memory")
"""Options that may be given with a plan; they change its request."""


@click.command(
    cls=TableCommand, epilog="Example: preshape view mug --task pour, or preshape view out/demo/plan.json"
)
@click.argument("thing", metavar="[OBJECT | PLAN.json]", default="mug", shell_complete=complete_object)
@click.option(
    "--task",
    metavar="TASK",
    shell_complete=complete_task,
    help='A name (preshape tasks) or "Tx Ty Tz Rx Ry Rz".',
)
@object_options
@closure_options
@click.option(
    "--host",
    default="127.0.0.1",
    help="Address to listen on; if others can reach it, the printed address has a token.",
)
@click.option("--port", type=int, default=8080, help="Port to listen on; 0 for any free one.")
@click.option("--sessions", type=int, default=8, metavar="N", help="Largest number of open pages.")
@memory_option
def view(thing: str, task: str | None, host: str, port: int, sessions: int, **options: Any) -> int:
    """Choose objects and tasks, see why a grasp was chosen, and teach, in the browser.

    With --task, a page plans as soon as it is open. A given plan is shown unchanged; the next plan in the
    browser starts from its request. The app works offline; only this machine can reach it, unless --host
    says otherwise. Each open page has a planner process of its own. Ctrl-C or SIGTERM ends it and keeps what
    was learnt.
    """
    if options["memory"] == ":memory:":
        raise InputError("the browser app needs a memory file, which it may open again; give --memory FILE")
    if thing.endswith(".json"):
        source = click.get_current_context().get_parameter_source
        # Of a file of settings, only the memory concerns a plan that exists.
        usual = {name: {ParameterSource.DEFAULT, ParameterSource.DEFAULT_MAP} for name in options}
        usual["memory"].discard(ParameterSource.DEFAULT_MAP)
        given = {name: options[name] for name in options if source(name) not in usual[name]}
        start = start_of_plan(Path(thing), task, **given)
    else:
        name_settings()
        hand = hand_from(options)
        request = request_from(thing, task or "lift", hand=hand, options=options)
        start = replace(start_of(request), at_once=task is not None)
    try:
        from ..app.server import ViewServer
    except ImportError as error:
        raise EnvironmentFailure(f"the browser app needs viser ({error}): pip install viser") from error
    with interrupts.patient():  # SIGTERM and SIGHUP too stop the server, which ends its processes
        server = ViewServer(start, host=host, port=port, sessions=sessions)
        try:
            wait_at("preshape view", server.address, host)
        except KeyboardInterrupt:
            return 0
        finally:
            server.stop()


def start_of(request: PlanRequest) -> Start:
    """What the app shows first for a request, which is checked before anything is served.

    Raises:
        InputError: The object or the hand cannot be used.
        EnvironmentFailure: A file cannot be read.
    """
    from ..app.browser_session import Start
    from ..hands.load import load_hand
    from ..objects.library import names

    if request.object_name not in names():
        request.load()
    load_hand(request.hand_name)
    return Start(request=request)


def start_of_plan(path: Path, task: str | None = None, **options: Any) -> Start:
    """What the app shows first for a plan: the plan and its request.

    Args:
        path: The plan.
        task: Task of the next plan, if it differs from the plan's.
        options: Options of the command line; those in ``FOR_PLANS`` change the request.

    Raises:
        InputError: The file is no plan, its object or hand is not found, or an option cannot be used.
        EnvironmentFailure: A file cannot be read.
    """
    from ..app.browser_session import Start
    from ..planning.document import read_plan

    for name in options:
        if name not in FOR_PLANS:
            raise InputError(
                f"--{name.replace('_', '-')} cannot change a plan that exists; change it in the browser, or "
                "give the object in place of the plan"
            )
    if "avoid" in options:
        options["avoid"] = boxes_from(options["avoid"])
    document = read_plan(path)
    changes = {"memory": None, **options, **({"task": task, "gravity": None} if task else {})}
    try:
        if not isinstance(document.get("alternatives", []), list):
            raise TypeError("alternatives must be a list")
        request = _found(document, path.parent, changes)
        _check_shown(document, request)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(
            f"{path} is no plan of this program ({error!s:.80}); "
            "give a plan.json that preshape plan --out wrote"
        ) from error
    return Start(request=request, document=document)


def _check_shown(document: dict[str, Any], request: PlanRequest) -> None:
    """Compute the drawing of a plan, so that a damaged plan is refused before anything is served.

    Raises:
        InputError: A part of the plan cannot be drawn.
    """
    from ..hands.load import load_hand, recorded_hand
    from ..pictures import document_motion, plan_scene
    from ..viewer.words import answers_of

    load_hand(request.hand_name)
    hand = recorded_hand(document["hand"])
    mesh = request.load()
    answers: list[dict[str, Any] | None] = [*answers_of(document)]
    for answer in answers or [None]:
        plan_scene(document, mesh, hand, answer)
        document_motion(hand, answer)


def _found(document: dict[str, Any], folder: Path, changes: dict[str, Any]) -> PlanRequest:
    """A plan's request, with the place where its object is now, at the plan's scale.

    Args:
        document: The plan.
        folder: Folder of the plan.
        changes: Fields of the request that differ.

    Raises:
        InputError: The document is no plan, or its object is not found.
    """
    from ..objects.load import IN_MEMORY
    from ..physics.locate import object_extent, plan_object
    from ..planning.document import request_of, version_of

    extent = max(float(x) for x in document["object"]["extents"])
    if version_of(document) >= 2:
        asked = str(document["request"]["object"]["source"])
        if not asked.endswith(IN_MEMORY):
            source = plan_object(asked, None, folder)
            request = request_of(document, **{**changes, "source": source})
            try:
                if abs(float(request.load().extents.max()) / extent - 1.0) < 0.01:
                    return request
            except PreshapeError:
                pass  # the object's file is gone; the plan may name a file beside it with the surface
        elif document["mass_source"] == "known" and document["request"]["analyser"] == "closure":
            changes = {"mass": document["mass"], **changes}  # the file with the surface has no mass
    source = plan_object(str(document["object"]["source"]), None, folder)
    size = object_extent(source, None)
    if size is None:
        raise InputError(f"the plan's object {source!r} is neither here nor built in; run from its folder")
    place = {
        "source": source,
        "unit": "m",
        "scale": extent / size,
        "view": None,
        "cut_table": None,
        "mask": None,
    }
    return request_of(document, **(changes | place))
