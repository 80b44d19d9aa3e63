"""``preshape view``: see a plan and steer it in the browser."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..exceptions import EnvironmentFailure, InputError
from .options import memory_option

if TYPE_CHECKING:
    from ..app.session import Start


@click.command(epilog="Example: preshape view mug --task pour, or preshape view out/demo/plan.json")
@click.argument("thing", metavar="[OBJECT | PLAN.json]", default="mug")
@click.option("--task", metavar="TASK", help='A name (preshape tasks) or "Tx Ty Tz Rx Ry Rz".')
@click.option("--hand", default="utah_mit", show_default=True, metavar="HAND", help="See preshape hands.")
@click.option("--unit", default="m", show_default=True, metavar="m|cm|mm|in", help="Unit of the file.")
@click.option("--scale", type=float, default=1.0, show_default=True, help="Factor on the object's size.")
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    help="Address to listen on; with another than this, whoever reaches it can use the app.",
)
@click.option("--port", type=int, default=8080, show_default=True, help="0 for any free one.")
@memory_option
def view(
    thing: str,
    task: str | None,
    hand: str,
    unit: str,
    scale: float,
    host: str,
    port: int,
    memory: str | None,
) -> int:
    """Choose objects and tasks, see why a grasp was chosen, and teach, in the browser.

    Works offline and is local only, unless --host says otherwise. Ctrl-C ends it; what was learnt is kept.
    """
    if memory == ":memory:":
        raise InputError("the browser app needs a memory file, which it may open again; give --memory FILE")
    start = start_of(thing, task, hand, unit, scale, memory)
    try:
        from ..app.server import ViewServer
    except ImportError as error:
        raise EnvironmentFailure(f"the browser app needs viser ({error}): pip install viser") from error
    server = ViewServer(start, host=host, port=port)
    click.echo(f"preshape view is at {server.address} (Ctrl-C ends it)", err=True)
    try:
        while True:
            time.sleep(3600)
    except KeyboardInterrupt:
        return 0
    finally:
        server.stop()


def start_of(
    thing: str,
    task: str | None = None,
    hand: str = "utah_mit",
    unit: str = "m",
    scale: float = 1.0,
    memory: str | None = None,
) -> Start:
    """What is shown first; whatever is wrong with it is said before anything is served."""
    from ..app.session import Start
    from ..app.worker import Order
    from ..hands.load import load_hand
    from ..objects.library import names
    from ..objects.load import load_object
    from ..planning.request import analyser_of
    from ..tasks import parse_task

    document = None
    if thing.endswith(".json"):
        path = Path(thing)
        document = _read(path)
        try:
            thing, scale = _object(document, path)
            unit, hand = "m", str(document["hand"]["name"])
            task = task or _task(document)
            if not isinstance(document.get("alternatives", []), list):
                raise TypeError("alternatives must be a list")
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise InputError(
                f"{path} is no plan of this program ({error!s:.80}); "
                "give a plan.json that preshape plan --out wrote"
            ) from error
    elif thing not in names():
        load_object(thing, unit=unit, scale=scale)
    parse_task(task or "lift")
    load_hand(hand)
    analyser = analyser_of("closure" if (document or {}).get("grip") else None, hand)
    order = Order(
        source=thing,
        unit=unit,
        scale=scale,
        task=task or "lift",
        hand=hand,
        analyser=analyser,
        memory=memory,
    )
    return Start(order=order, document=document)


def _read(path: Path) -> dict[str, Any]:
    import json

    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise InputError(f"there is no file {path}; check the path") from error
    except OSError as error:
        raise EnvironmentFailure(f"{path} cannot be read: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is no JSON ({error}); give a plan that preshape plan wrote") from error
    if not isinstance(document, dict) or not {"status", "hand", "object", "task", "plane"} <= set(document):
        raise InputError(f"{path} is no plan; give a plan.json that preshape plan --out wrote")
    return document


def _task(document: dict[str, Any]) -> str:
    """A plan's task by its name, or as six numbers where the name means nothing here."""
    from ..tasks import family_names

    name = str(document["task"]["name"])
    known = name.partition(":")[0] in family_names()
    return name if known else " ".join(f"{float(x):g}" for x in document["task"]["q"])


def _object(document: dict[str, Any], path: Path) -> tuple[str, float]:
    """Name or file of a plan's object, and the factor that gives it the size of the plan."""
    from ..physics.locate import object_extent, plan_object

    source = plan_object(str(document["object"]["source"]), None, path.parent)
    extent = object_extent(source, None)
    if extent is None:
        raise InputError(
            f"the plan's object {source!r:.80} is neither here nor built in; run from its folder"
        )
    return source, max(float(x) for x in document["object"]["extents"]) / extent
