"""``preshape bench planner``: plan grasps of objects, then put the answers to the holding test."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..exceptions import EnvironmentFailure, InputError, shown
from ..types import FRICTION
from .options import (
    check_folder,
    check_least,
    json_option,
    ladder_option,
    numbers_in,
    pieces_option,
    probes_option,
    scales_option,
    workers_option,
)
from .printing import emit, name_files, say
from .progress import steps

if TYPE_CHECKING:
    from ..physics.grasps import GraspSet
    from ..physics.protocol import HoldProtocol
    from ..planning.planner_bench import Case, PlannerReport

PICTURES = 12
"""Largest number of answers that did not hold and are drawn."""
OWN = "own"
"""Value of ``--mass`` that selects each object's own mass."""


@click.command(epilog="Example: preshape bench planner mug box bottle --hand shadow --count 5")
@click.argument("objects", metavar="OBJECTS...", nargs=-1, required=True)
@click.option("--hand", default="shadow", metavar="HAND", help="Name or TOML file.")
@click.option("--task", default="lift", metavar="TASK", help="Task to plan for.")
@click.option("--analyser", default="closure", metavar="closure|rays", help="Analyser to plan with.")
@click.option("--count", type=int, default=1, help="Number of answers for each object.")
@scales_option
@pieces_option
@click.option("--friction", type=float, default=FRICTION, help="Friction of the test; harder: 0.3.")
@click.option(
    "--mass",
    default="0.1",
    metavar="KG|own",
    help="Mass to plan for and test with [kg]; own: each object's own.",
)
@probes_option
@ladder_option
@click.option("--seed", type=int, default=0, help="Seed of the planner.")
@workers_option
@click.option("--out", metavar="DIR", help="Folder for report.json, grasps.npz and pictures of lost answers.")
@json_option
def planner(
    objects: tuple[str, ...],
    hand: str,
    task: str,
    analyser: str,
    count: int,
    scales: str,
    pieces: str | None,
    friction: float,
    mass: str,
    probes: str,
    ladder: bool,
    seed: int,
    workers: int | None,
    out: str | None,
    as_json: bool,
) -> int:
    """Plan OBJECTS (library names, files, or folders of files), then test the answers in physics.

    An object without an answer counts as lost. Exit code 0: the test ran.
    """
    from ..files import write_json
    from ..hands.load import load_hand
    from ..physics.grasps import write_grasps
    from ..physics.protocol import HoldProtocol
    from ..planning.planner_bench import bench_planner, grasps_of, plan_cases
    from ..types import FIELD_MASS

    check_folder(out)
    check_least(1, count=count, workers=workers)
    cases, model = cases_of(objects, scales, pieces), load_hand(hand)
    kg = mass_of(mass)
    protocol = HoldProtocol(
        friction=friction,
        mass=FIELD_MASS if kg is None else kg,
        probes=probes,
        ladder=ladder,
        stop_early=not ladder,
    )
    with steps("this bench keeps nothing before its end") as shown:
        planned = plan_cases(
            cases,
            model,
            task=task,
            analyser=analyser,
            count=count,
            seed=seed,
            mass=kg,
            progress=shown.step,
        )
        report = bench_planner(
            planned,
            model,
            protocol=protocol,
            own_mass=kg is None,
            asked=count,
            workers=workers,
            progress=shown.step,
        )
    load = OWN if kg is None else kg
    document = {"status": "answer", **report.row(), "mass": load, "failures": _failures(report)}
    if out is not None:
        grasps = grasps_of(report.planned, model)
        if grasps is not None:
            write_grasps(Path(out) / "grasps.npz", grasps)
            document["pictures"] = _pictures(report, grasps, protocol, Path(out))
        write_json(Path(out) / "report.json", document)
    if as_json:
        emit(document)
        return 0
    _show(document)
    return 0


def mass_of(text: str) -> float | None:
    """The mass of every object [kg]; ``None`` for each object's own.

    Raises:
        InputError: The text is neither a number nor ``own``.
    """
    if text.strip().lower() == OWN:
        return None
    try:
        return float(text)
    except ValueError as error:
        raise InputError(f"--mass takes a number of kilograms or {OWN}, got {shown(text)}") from error


def cases_of(objects: tuple[str, ...], scales: str, pieces: str | None) -> list[Case]:
    """Every object at every scale.

    A library name means the built-in object even if a folder has the same name; write ``bottle/`` for the
    folder.

    Args:
        objects: Library names, files and folders of files; ``ALL`` alone stands for the library.
        scales: Numbers separated by commas.
        pieces: Folder with ``NAME/mesh.obj`` and ``NAME/convex`` of each object, or ``None``.

    Raises:
        InputError: A scale is no positive number.
        EnvironmentFailure: A folder is missing, or has no meshes.
    """
    from ..objects.library import names
    from ..planning.planner_bench import Case

    factors = numbers_in(scales)
    if not factors or not all(0 < f < 1e3 for f in factors):
        raise InputError(f"--scales takes positive numbers such as 0.06,0.08, got {shown(scales)}")
    folder = None if pieces is None else Path(pieces)
    if folder is not None and not folder.is_dir():
        raise EnvironmentFailure(f"no folder {folder}; --pieces is the one that holds the objects")
    found: list[tuple[str, str]] = []
    library = names()
    for name in library if objects == ("ALL",) else objects:
        if folder is not None:
            found.append((name, str(folder / name / "mesh.obj")))
        elif name not in library and Path(name).is_dir():
            meshes = sorted(p for p in Path(name).iterdir() if p.suffix.lower() in (".obj", ".stl", ".ply"))
            if not meshes:
                raise EnvironmentFailure(f"{name}: no mesh in this folder (.obj, .stl or .ply)")
            found += [(p.stem, str(p)) for p in meshes]
        else:
            found.append((Path(name).stem, name))
    return [
        Case(name=f"{name}@{factor:g}", source=source, scale=factor, pieces=folder)
        for name, source in found
        for factor in factors
    ]


def _failures(report: PlannerReport) -> list[dict[str, Any]]:
    lost: list[dict[str, Any]] = [
        {"object": p.case.name, "answer": None, "reason": p.reason} for p in report.planned if not p.answers
    ]
    if report.holds is None:
        return lost
    row = 0
    for p in report.planned:
        for number in range(1, len(p.answers) + 1):
            result = report.holds.results[row]
            row += 1
            if not result.held:
                lost.append({"object": p.case.name, "answer": number, "reason": result.reason})
    return lost


def _pictures(report: PlannerReport, grasps: GraspSet, protocol: HoldProtocol, folder: Path) -> list[str]:
    """Draw filmstrips of the first ``PICTURES`` answers that did not hold; returns the files."""
    from ..files import write_whole
    from ..objects.load import load_object
    from ..physics.hand import physics_hand
    from ..planning.recorded import recorded_run
    from ..viewer.filmstrip import filmstrip
    from .simulate_film import film_of_run

    hand = report.hand
    own = grasps.for_hand(physics_hand(hand))
    cases = [p.case for p in report.planned for _ in p.answers]
    results = report.holds.results if report.holds else ()
    files: list[str] = []
    for row in [k for k, result in enumerate(results) if not result.held][:PICTURES]:
        case = cases[row]
        rules, name = replace(protocol, mass=report.masses[row]), case.object_name
        run = recorded_run(own, row, hand, case.load_pieces(), rules, None, name=name)
        film = film_of_run(run, load_object(case.source, scale=case.scale))
        file = folder / f"lost-{row:03d}-{name}.png"
        write_whole(file, partial(filmstrip, film))
        files.append(str(file))
    return files


def _show(document: dict[str, Any]) -> None:
    interval = document["interval"]
    between = f" (95 %: {100 * interval[0]:.1f}-{100 * interval[1]:.1f} %)" if interval else ""
    say(
        f"{document['hand']}: {document['held']} of {document['tested']} answers held, "
        f"{100 * (document['share'] or 0):.1f} %{between}"
    )
    if document["penetration_max"] is not None:
        say(
            f"touching at the grasp pose: {document['touching']}; "
            f"deepest penetration: {1000 * document['penetration_max']:.2f} mm"
        )
    if document["search_median"] is not None:
        say(f"median time of the search: {1000 * document['search_median']:.0f} ms")
    if document["strength_median"] is not None:
        say(f"median strength: {document['strength_median']:.2f} times the probes")
    name_files(document.get("pictures", ()))
    for failure in document["failures"]:
        which = "no answer" if failure["answer"] is None else f"answer {failure['answer']}"
        say(f"  {failure['object']}, {which}: {failure['reason']}")
