"""``preshape dataset``: grasps with margins, indices and physics outcomes, as Parquet."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Any

import click

from ..exceptions import InputError, shown
from ..types import FIELD_MASS, FRICTION
from .options import check_least, json_option, names_in, pieces_option, scales_option
from .printing import emit
from .progress import GOES_ON, duration, steps

if TYPE_CHECKING:
    from ..dataset.engines import Engine
    from ..dataset.run import DatasetReport

ENGINES = ("local", "ray")
SHOWN = 12
"""Largest number of incomplete shards shown in the terminal; ``--json`` lists all."""


@click.command(
    epilog="Example: preshape dataset mug box --hands shadow,allegro --tasks lift,pour --per 100 --out d"
)
@click.argument("objects", metavar="OBJECTS...", nargs=-1, required=True)
@click.option("--hands", required=True, metavar="HAND,…", help="Names or TOML files; see preshape hands.")
@click.option("--tasks", required=True, metavar="TASK,…", help="See preshape tasks; ALL: every family.")
@click.option(
    "--per", type=int, required=True, metavar="N", help="Number of grasps for each object, hand and task."
)
@click.option("--out", required=True, metavar="DIR", help="Folder of the dataset; the same command resumes.")
@scales_option
@pieces_option
@click.option(
    "--unranked", is_flag=True, help="Write randomly closed hands instead of the planner's answers."
)
@click.option("--no-physics", is_flag=True, help="Leave the holding test and the task test out.")
@click.option("--friction", type=float, default=FRICTION, help="Friction coefficient of planning and tests.")
@click.option("--mass", type=float, default=FIELD_MASS, help="Mass of every object [kg].")
@click.option("--seed", type=int, default=0, help="Seed of every random draw.")
@click.option("--per-shard", type=int, default=25, metavar="N", help="Number of grasps in a file.")
@click.option("--candidates", type=int, default=2000, metavar="N", help="Number of candidates for a shard.")
@click.option("--engine", default="local", metavar="local|ray", help="Local processes or Ray.")
@click.option(
    "--workers", type=int, metavar="N", help="Number of local processes; default: one for each core."
)
@click.option(
    "--address", metavar="ADDRESS", help="Address of the Ray cluster; default: RAY_ADDRESS, or a local one."
)
@json_option
def dataset(
    objects: tuple[str, ...],
    hands: str,
    tasks: str,
    per: int,
    out: str,
    scales: str,
    pieces: str | None,
    unranked: bool,
    no_physics: bool,
    friction: float,
    mass: float,
    seed: int,
    per_shard: int,
    candidates: int,
    engine: str,
    workers: int | None,
    address: str | None,
    as_json: bool,
) -> int:
    """Write grasps of OBJECTS (library names, files, or folders of files) as Parquet, for learning.

    Each grasp has its postures, contacts, forces, margins and indices, and the outcomes of the holding test
    and the task test; docs/dataset.md lists the columns. The same command resumes a run that was stopped:
    finished shards are kept. The content depends on neither workers nor engine.

    Exit code 1: not one grasp was found.
    """
    from ..dataset.run import run_dataset
    from ..dataset.settings import DatasetSettings
    from ..tasks import FAMILIES
    from .bench_planner import cases_of

    check_least(1, per=per, per_shard=per_shard, candidates=candidates, workers=workers)
    settings = DatasetSettings(
        per=per,
        per_shard=per_shard,
        ranked=not unranked,
        candidates=candidates,
        physics=not no_physics,
        friction=friction,
        mass=mass,
        seed=seed,
    )
    cases = cases_of(objects, scales, pieces)
    chosen = _engine(engine, workers, address)
    with steps(GOES_ON) as shown, _interrupts() as interrupted:

        def progress(what: str, done: int, of: int) -> None:
            shown.step(what, done, of)
            if interrupted and done < of:
                raise KeyboardInterrupt

        report = run_dataset(
            cases,
            names_in(hands, "--hands"),
            list(FAMILIES) if tasks == "ALL" else names_in(tasks, "--tasks"),
            out,
            engine=chosen,
            settings=settings,
            progress=progress,
        )
    if as_json:
        emit(report.to_json())
    else:
        _show(report, settings.physics)
    return 0 if report.total("rows") else 1


def _engine(name: str, workers: int | None, address: str | None) -> Engine:
    from ..dataset.engines import LocalEngine, RayEngine
    from ..processes import usable_cores

    if name not in ENGINES:
        raise InputError(f"no engine {shown(name)}; known: {', '.join(ENGINES)}")
    if name == "ray":
        if workers is not None:
            raise InputError("--workers is for local processes; a Ray cluster has its own number")
        return RayEngine(address=address)
    if address is not None:
        raise InputError("--address belongs to a Ray cluster; add --engine ray")
    return LocalEngine(workers=usable_cores() if workers is None else workers)


@contextmanager
def _interrupts() -> Iterator[list[int]]:
    """Record every Ctrl-C in addition to its usual effect; Python loses one in a destructor or a callback."""
    seen: list[int] = []
    usual = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(usual):
        yield seen
        return

    def interrupt(number: int, frame: FrameType | None) -> None:
        seen.append(number)
        usual(number, frame)

    signal.signal(signal.SIGINT, interrupt)
    try:
        yield seen
    finally:
        signal.signal(signal.SIGINT, usual)


def _show(report: DatasetReport, physics: bool) -> None:
    shards, rows = len(report.facts), report.total("rows")
    click.echo(
        f"{rows} of {report.total('asked')} grasps, in {shards} shards; "
        f"{report.made} shards made now in {duration(report.seconds)}"
    )
    if report.damaged:
        click.echo(f"{report.damaged} shards of an earlier run could not be read and were made again")
    if physics:
        click.echo(
            f"holding test: {_share(report, 'held', 'hold_tested')}; "
            f"task test, where the task suits the object: {_share(report, 'task_done', 'task_tested')}"
        )
    short = report.short()
    for row in short[:SHOWN]:
        click.echo(f"  {row['shard']}: {row['rows']} of {row['asked']}; {row['reason']}")
    if len(short) > SHOWN:
        click.echo(f"  and {len(short) - SHOWN} more with fewer than asked for; --json lists all")
    click.echo(f"wrote {report.folder}")


def _share(report: DatasetReport, part: str, whole: str) -> str:
    tested = report.total(whole)
    passed: Any = report.total(part)
    return f"{passed} of {tested} passed ({100 * passed / tested:.1f} %)" if tested else "none tested"
