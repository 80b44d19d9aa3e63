"""``preshape bench pick``: plan objects on a table, then pick them up in simulated physics."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..exceptions import EnvironmentFailure, InputError
from ..files import MOST_OF_JSON, loads, read_file
from ..report.terminal import print_table, report_console
from ..types import FRICTION
from .bench_planner import OWN, PICTURES, cases_of, mass_of
from .options import (
    check_folder,
    check_least,
    checkpoint_option,
    json_option,
    kept_results,
    workers_option,
)
from .printing import emit, name_files
from .progress import GOES_ON, steps

if TYPE_CHECKING:
    from ..physics.pick.objects import PickObject
    from ..physics.pick.protocol import PickProtocol, PickResult
    from ..physics.pick.report import PickReport
    from ..planning.planned_answers import PlannedPicks
    from ..planning.planner_bench import Case
    from ..report import Figure
    from ..viewer.film import Film


@click.command(epilog="Example: preshape bench pick mug box bottle --hand leap --out out/pick")
@click.argument("objects", metavar="OBJECTS...", nargs=-1, required=True)
@click.option("--hand", default="shadow", metavar="HAND", help="Name or TOML file.")
@click.option(
    "--model",
    metavar="FILE.xml",
    help="Pick with this published MJCF of HAND (right_hand.xml of MuJoCo Menagerie) instead.",
)
@click.option("--task", default="lift", metavar="TASK", help="Task to plan for.")
@click.option("--mass", default=OWN, metavar="KG|own", help="Mass to plan for and test with [kg].")
@click.option("--masses", metavar="FILE.json", help="Masses by object name [kg]; they replace --mass.")
@click.option("--do", is_flag=True, help="Then do the task: its gravity, motion and load.")
@click.option("--friction", type=float, default=FRICTION, help="Friction of the test; harder: 0.3.")
@click.option(
    "--position-error", type=float, default=0.0, help="Error of the object's place [m]; harder: 0.005."
)
@click.option("--turn-error", type=float, default=0.0, help="Error of its heading [degrees]; harder: 5.")
@click.option("--seed", type=int, default=0, help="Seed of the planner and of these errors.")
@workers_option
@checkpoint_option
@click.option(
    "--out", metavar="DIR", help="Folder for report.json, .md, .html, grasps and pictures; resumable as well."
)
@json_option
def pick(
    objects: tuple[str, ...],
    hand: str,
    model: str | None,
    task: str,
    mass: str,
    masses: str | None,
    do: bool,
    friction: float,
    position_error: float,
    turn_error: float,
    seed: int,
    workers: int | None,
    checkpoint: str | None,
    out: str | None,
    as_json: bool,
) -> int:
    """Plan OBJECTS (library names, files, or folders of files) on a table, then pick them up in physics.

    The hand comes in, closes, squeezes, lifts by 0.2 m and holds for 3 s, with its own gains and torque
    limits. With --do, the hand then turns the object to the task's gravity and does the task against its
    load. docs/pick-test.md says what counts as picked up. The first answer of a fresh memory is tested. The
    first run cuts each object into convex pieces, which may take a minute or two for each.

    Exit code 0: every object was tried, picked up or not.
    """
    from ..hands.load import load_hand
    from ..physics.hand import physics_hand, published_hand
    from ..physics.pick.protocol import PickProtocol
    from ..physics.pick.runner import run_picks
    from ..planning.planned_answers import PlannedPicks

    check_folder(out)
    check_folder(checkpoint, "--checkpoint")
    check_least(1, workers=workers)
    check_least(0, seed=seed)
    protocol = PickProtocol(
        friction=friction,
        position_error=position_error,
        turn_error=math.radians(turn_error),
        seed=seed,
        do=do,
    )
    own = load_hand(hand)
    picks_with = physics_hand(own) if model is None else published_hand(own, model)
    cases = cases_of(objects, "1", None)
    things = things_of(cases, mass, masses, seed)
    answers = PlannedPicks(hand=own, task=task, model=picks_with)
    kept = kept_results(checkpoint, out)
    with steps(GOES_ON if kept else "with --out or --checkpoint they would be kept") as shown:
        report = run_picks(
            things,
            picks_with,
            answers,
            protocol=protocol,
            workers=workers,
            progress=lambda done, of: shown.step("objects", done, of),
            checkpoint=kept,
        )
    load = "given masses" if masses else "own masses" if mass_of(mass) is None else f"{mass} kg"
    who = f"{picks_with.name}, {task}, {load}"
    document = _document(report, protocol, who)
    written = _write(report, things, answers, protocol, who, document, out)
    if out is not None and checkpoint is None and kept is not None:  # the report now contains all results
        kept.unlink(missing_ok=True)
    if as_json:
        emit({**document, "files": [str(path) for path in written]})
    else:
        _show(report, protocol, who, written)
    return 0


def things_of(cases: list[Case], mass: str, masses: str | None, seed: int) -> tuple[PickObject, ...]:
    """The objects of cases with the masses that ``--mass`` and ``--masses`` state.

    Raises:
        InputError: A mass or the file of masses cannot be used, or an object cannot.
        EnvironmentFailure: A file cannot be read.
    """
    from ..physics.pick.objects import pick_objects

    stated = {} if masses is None else _masses(Path(masses))
    return pick_objects(
        [case.source for case in cases],
        mass=mass_of(mass),
        masses={case.source: stated[case.object_name] for case in cases if case.object_name in stated},
        seed=seed,
    )


def _masses(file: Path) -> dict[str, float]:
    """Masses by object name [kg].

    Raises:
        InputError: The file is not a JSON object of numbers.
        EnvironmentFailure: The file cannot be read.
    """
    try:
        content = loads(read_file(file, MOST_OF_JSON, "file of masses"))
        return {str(name): float(kg) for name, kg in content.items()}
    except OSError as error:
        raise EnvironmentFailure(f"cannot read {file}: {error.strerror}") from error
    except (ValueError, TypeError, AttributeError) as error:
        raise InputError(
            f'{file}: expected masses such as {{"mug": 0.118}} in JSON ({error!s:.60})'
        ) from error


def _document(report: PickReport, protocol: PickProtocol, who: str) -> dict[str, Any]:
    """All results except the duration, so that the same input gives the same document."""
    from dataclasses import asdict

    import mujoco

    from .._version import __version__

    return {
        "status": "answer",
        "version": __version__,
        "mujoco": mujoco.__version__,
        "planner": who,
        "protocol": asdict(protocol),
        **report.to_json(),
    }


def _write(
    report: PickReport,
    things: tuple[PickObject, ...],
    answers: PlannedPicks,
    protocol: PickProtocol,
    who: str,
    document: dict[str, Any],
    out: str | None,
) -> list[Path]:
    if out is None:
        return []
    from ..physics.grasps import write_grasps
    from ..physics.pick.tables import pick_report
    from ..report import write_report

    folder = Path(out)
    failed = [r for r in report.failures() if r.touching or r.settled is not None][:PICTURES]
    pictures = [_picture(result, things[result.row], report, answers, protocol) for result in failed]
    document["pictures"] = [picture.file for picture in pictures]
    versions = f"MuJoCo {document['mujoco']}, preshape {document['version']}."
    written = write_report(folder, pick_report(report, protocol, who, versions, pictures), document)
    grasps = report.planned_grasps()
    if len(grasps):
        written.append(folder / "grasps.npz")
        write_grasps(written[-1], grasps)
    return [*written, *(folder / picture.file for picture in pictures)]


def _picture(
    result: PickResult, thing: PickObject, report: PickReport, answers: PlannedPicks, protocol: PickProtocol
) -> Figure:
    """The filmstrip of a failure, to be drawn with the report."""
    from ..physics.hold.tables import short_name
    from ..report import Figure
    from ..viewer.filmstrip import filmstrip

    def draw(path: Path) -> None:
        filmstrip(_film(result, thing, report, answers, protocol), path)

    name = short_name(thing.name)
    return Figure(
        file=f"failed-{result.row:03d}-{name}.png", caption=f"{name}: {result.status.value}", draw=draw
    )


def _film(
    result: PickResult, thing: PickObject, report: PickReport, answers: PlannedPicks, protocol: PickProtocol
) -> Film:
    from ..objects.load import load_object
    from ..physics.pick.recording import record_pick
    from ..physics.pick.runner import pick_scene
    from ..physics.pieces import load_pieces
    from ..planning.recorded import part_names
    from .simulate_film import pick_film_of

    assert result.turn is not None
    scene = pick_scene(report.hand, load_pieces(thing.name), thing, result.turn, protocol)
    parts, work = part_names(scene, answers.hand), answers.work(thing) if protocol.do else None
    recording = record_pick(scene, result, protocol, parts=parts, work=work)
    return pick_film_of(recording, scene, protocol, mesh=load_object(thing.name, scale=thing.scale))


def _show(report: PickReport, protocol: PickProtocol, who: str, written: list[Path]) -> None:
    from rich.text import Text

    from ..physics.pick.tables import cause_table, failure_table, pick_settings_line, rate_line

    console = report_console(100)
    console.print(Text(pick_settings_line(protocol, who), style="bold"))
    for content in (cause_table(report.score()), failure_table(report.failures())):
        if content.rows:
            words = [heading for heading in content.columns if heading != "reason"]
            print_table(console, content, left=content.columns[-1] == "reason", unbroken=words)
    console.print(Text(f"{rate_line(report.score())}, in {report.seconds:.0f} s"))
    name_files(written)
