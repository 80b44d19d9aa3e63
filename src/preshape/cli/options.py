"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..exceptions import InputError, shown

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

    from ..planning.request import PlanRequest

Command = Callable[..., Any]

best_option = click.option(
    "--best", is_flag=True, help="Of a plan without an answer: the best grasp that was found."
)
checkpoint_option = click.option(
    "--checkpoint", metavar="FILE", help="File of results, from which the same command resumes."
)
ladder_option = click.option(
    "--ladder", is_flag=True, help="Repeat the probes 1.4 times stronger each time, until the grasp is lost."
)
motors_option = click.option(
    "--motors",
    metavar="FILE",
    help="TOML file with the motors of a hand whose own file does not state them: [[couple]], [actuators].",
)
pieces_option = click.option(
    "--pieces", metavar="DIR", help="Folder with NAME/mesh.obj and NAME/convex of each object."
)
probes_option = click.option(
    "--probes",
    default="six",
    metavar="six|all",
    help="six: forces along the axes. all: 14 forces, 14 torques.",
)
scales_option = click.option("--scales", default="1", metavar="S,S", help="Factors on the size.")
workers_option = click.option(
    "--workers", type=int, metavar="N", help="Number of processes; default: one for each core."
)


def complete_object(context: click.Context, parameter: click.Parameter, typed: str) -> list[CompletionItem]:
    """Built-in objects that begin with what was typed, for the shell; where there are none, files."""
    from ..objects.library import names

    return [_file(typed), *_completed(names(), typed)]


def complete_task(context: click.Context, parameter: click.Parameter, typed: str) -> list[CompletionItem]:
    """Names of tasks that begin with what was typed, for the shell."""
    from ..tasks import family_names

    return _completed(family_names(), typed)


def complete_hand(context: click.Context, parameter: click.Parameter, typed: str) -> list[CompletionItem]:
    """Built-in hands that begin with what was typed, for the shell; where there are none, files."""
    from ..hands.load import hand_names

    return [_file(typed), *_completed(hand_names(), typed)]


def _file(typed: str) -> CompletionItem:
    from click.shell_completion import CompletionItem

    return CompletionItem(typed, type="file")


def _completed(names: Iterable[str], typed: str) -> list[CompletionItem]:
    from click.shell_completion import CompletionItem

    return [CompletionItem(name) for name in names if name.startswith(typed)]


class TableCommand(click.Command):
    """A command whose ``--table`` takes an optional height, which may be negative.

    After an option with an optional value, Click reads ``-0.05`` as another option; it refuses
    ``--table=-0.05`` for the same reason. The number is therefore marked as a value before Click parses it.
    """

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Mark the height after ``--table``, then parse as usual."""
        marked: list[str] = []
        for word in args:
            if word.startswith("--table="):
                marked += ["--table", f" {word.removeprefix('--table=')}"]
            elif marked and marked[-1] == "--table" and _is_number(word):
                marked.append(f" {word}")
            else:
                marked.append(word)
        return super().parse_args(ctx, marked)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def check_folder(name: str | None, option: str = "--out") -> None:
    """Refuse a folder without a name.

    Raises:
        InputError: The name is empty or blank.
    """
    if name is not None and not name.strip():
        raise InputError(f"{option} needs a folder, got an empty name")


def kept_results(checkpoint: str | None, out: str | None) -> Path | None:
    """The file with the results of an unfinished run: that of ``--checkpoint``, else one in ``--out``."""
    if checkpoint is not None:
        return Path(checkpoint)
    return None if out is None else Path(out) / "unfinished.jsonl"


def check_least(least: int, **numbers: int | None) -> None:
    """Refuse numbers that are too small.

    Args:
        least: The smallest number that is allowed.
        numbers: Value of each option; the key ``per_shard`` stands for ``--per-shard``.

    Raises:
        InputError: One of them is below ``least``.
    """
    for name, number in numbers.items():
        if number is not None and number < least:
            raise InputError(f"--{name.replace('_', '-')} must be {least} or more, got {number}")


def names_in(text: str, option: str) -> tuple[str, ...]:
    """The names in a comma-separated list, without duplicates.

    Raises:
        InputError: A name is missing.
    """
    names = [part.strip() for part in text.split(",")]
    if not all(names):
        raise InputError(f"{option} takes names with commas between, got {shown(text)}")
    return tuple(dict.fromkeys(names))


def memory_option(command: Command) -> Command:
    """``--memory FILE``."""
    text = "Memory file; default: the user's data directory, or PRESHAPE_MEMORY."
    return click.option("--memory", metavar="FILE", help=text)(command)


def verbose_option(command: Command) -> Command:
    """``--verbose``."""
    text = "Say on standard error what the search does, stage by stage."
    return click.option("--verbose", is_flag=True, help=text)(command)


def json_option(command: Command) -> Command:
    """``--json``."""
    text = "Print exactly one JSON document on standard output."
    return click.option("--json", "as_json", is_flag=True, help=text)(command)


def object_options(command: Command) -> Command:
    """``--hand --motors --analyser --scale --unit --up --approach --type --seed`` and thresholds."""
    options = (
        click.option(
            "--hand",
            default="shadow",
            show_default=True,
            metavar="HAND",
            shell_complete=complete_hand,
            help="A name (see preshape hands), or the URDF, MJCF or TOML file of your own hand.",
        ),
        motors_option,
        click.option(
            "--analyser",
            metavar="NAME",
            help="rays (the paper's) or closure (closes the hand); default rays for utah_mit, else closure.",
        ),
        click.option("--scale", type=float, default=1.0, help="Factor on the object's size."),
        click.option("--unit", default="m", metavar="m|cm|mm|in", help="Unit of the file."),
        click.option(
            "--up",
            metavar="x|y|z|-x|-y|-z",
            help="Axis of the file that is up; task, table and gravity follow it.  [default: z; glTF: y]",
        ),
        click.option(
            "--part-of-file",
            metavar="N|all",
            help="Of a file with several bodies: the one to plan for, or all as one object.",
        ),
        click.option(
            "--approach", metavar="AXES", help="Allowed approaches, as +z,-x (a table below, a wall behind)."
        ),
        click.option(
            "--type",
            "grasp_type",
            default="any",
            metavar="power|precision|any",
            help="power: only wraps, with the palm or several links of a finger; precision: only fingertips.",
        ),
        click.option("--seed", type=int, default=0, help="Seed of every random draw."),
        click.option(
            "--estimation-threshold",
            type=float,
            default=3.0,
            help="TFVADI (0 to 6) that a preshape must reach.",
        ),
        click.option(
            "--recognition-threshold",
            type=float,
            default=5.0,
            help="TFVADI (0 to 6) at which an object counts as known.",
        ),
    )
    for option in reversed(options):
        command = option(command)
    return command


def hand_from(options: dict[str, Any]) -> str:
    """The hand of ``--hand``, with the motors of ``--motors``."""
    from ..hands.load import joined

    return joined(options["hand"], options["motors"])


_rule_options = (
    click.option(
        "--hold-on",
        metavar="PART",
        multiple=True,
        help='Contacts only on this part: a name (preshape objects OBJECT), "z>0.05", or six numbers of a '
        "box [m]; repeatable, any of them.",
    ),
    click.option(
        "--keep-off",
        metavar="PART",
        multiple=True,
        help="No contact on this part, and no link within 3 mm of it; repeatable.",
    ),
    click.option(
        "--rules",
        default="task",
        metavar="task|none",
        help="task: rules of object and task too, as hold a hammer's handle to strike.",
    ),
)


def closure_options(command: Command) -> Command:
    """``--friction --mass --table --avoid``, for the closure analyser; ``--hold-on --keep-off --rules``."""
    options = (
        click.option(
            "--friction",
            type=float,
            help="Friction between fingers and object; closure, and --verify.  [default: 0.6]",
        ),
        click.option(
            "--mass",
            type=float,
            help="Mass of the object [kg]; closure, and --verify.  [default: the object's own, else its "
            "volume filled with water]",
        ),
        click.option(
            "--table",
            metavar="[HEIGHT|none]",
            is_flag=False,
            flag_value="auto",
            default="default",
            help="A table that the object rests on; with a number, a table at this height along up [m], and "
            "the object as it is modelled; none for free space.  [default: a table, for a real hand]",
        ),
        click.option(
            "--obstacle",
            metavar="FILE[@POSE]",
            multiple=True,
            help="A mesh or point cloud in metres that the hand stays away from, in the mesh frame or at "
            "x,y,z,qw,qx,qy,qz of it; repeatable.",
        ),
        click.option(
            "--avoid",
            metavar="BOX",
            multiple=True,
            help='A box that the hand stays out of, "x0 y0 z0 x1 y1 z1" in the mesh frame [m]; repeatable.',
        ),
        *_rule_options,
    )
    for option in reversed(options):
        command = option(command)
    return command


def arm_options(command: Command) -> Command:
    """``--arm --arm-tip --mount --base-pose``: the arm that carries the hand."""
    pose = '"X Y Z W X Y Z"'
    options = (
        click.option(
            "--arm", metavar="URDF", help="Arm that carries the hand; answers that it reaches only."
        ),
        click.option("--arm-tip", metavar="LINK", help="Link of the arm that carries the hand."),
        click.option(
            "--mount", metavar=pose, help="Pose of the hand's root on that link [m].  [default: the link's]"
        ),
        click.option(
            "--base-pose",
            metavar=pose,
            help="Pose of the arm's base in a world with z up and the origin of the object's file [m].",
        ),
    )
    for option in reversed(options):
        command = option(command)
    return command


def arm_from(options: dict[str, Any]) -> dict[str, Any]:
    """The fields of a request that say which arm carries the hand.

    Raises:
        InputError: A pose is no list of numbers.
    """
    poses: dict[str, list[float] | None] = {}
    for name in ("mount", "base_pose"):
        text = options[name]
        poses[name] = None if text is None else numbers_in(text)
        if text is not None and not poses[name]:
            raise InputError(
                f"--{name.replace('_', '-')} takes seven numbers, x y z in metres and a unit quaternion "
                f"w x y z, got {shown(text)}"
            )
    return {"arm": options["arm"], "arm_tip": options["arm_tip"], **poses}


def numbers_in(text: str) -> list[float]:
    """The numbers in a text, separated by spaces or commas; empty if a part is no number."""
    try:
        return [float(part) for part in text.replace(",", " ").split()]
    except ValueError:
        return []


def boxes_from(given: tuple[str, ...]) -> list[list[float]]:
    """Boxes from the texts of ``--avoid``.

    Raises:
        InputError: A text is not six numbers.
    """
    boxes = [numbers_in(text) for text in given]
    for text, box in zip(given, boxes, strict=True):
        if len(box) != 6:
            raise InputError(f'--avoid takes six numbers, "x0 y0 z0 x1 y1 z1", got {shown(text)}')
    return boxes


def source_from(thing: str, options: dict[str, Any]) -> str:
    """The object, with the part of its file that ``--part-of-file`` chooses.

    Raises:
        InputError: The option is neither a number from 1 nor ``all``.
    """
    part = options["part_of_file"]
    if part is None:
        return thing
    if part != "all" and not (part.isascii() and part.isdecimal() and 1 <= int(part) < 10**6):
        raise InputError(f"--part-of-file takes a number from 1, or all, got {part!r:.40}")
    return f"{thing}#{part}"


def request_from(thing: str, task: str, *, hand: Any, options: dict[str, Any], **more: Any) -> PlanRequest:
    """The request of a command with ``object_options``, ``closure_options`` and ``memory_option``.

    Args:
        thing: The object.
        task: The task.
        hand: The hand, by name, by file or loaded.
        options: What Click made of the options.
        more: Further fields of the request.

    Raises:
        InputError: An option has an unusable value.
    """
    from ..hiis.critic import Thresholds
    from ..hiis.decision import Settings
    from ..planning.request import PlanRequest

    if options["seed"] < 0:
        raise InputError(f"--seed must not be negative, got {options['seed']}")
    thresholds = Thresholds(
        estimation=options["estimation_threshold"], recognition=options["recognition_threshold"]
    )
    same = ("scale", "unit", "mass", "friction", "table", "memory", "up", "hold_on", "keep_off", "rules")
    return PlanRequest(
        source=source_from(thing, options),
        task=task,
        hand=hand,
        analyser=options["analyser"] or "",
        avoid=boxes_from(options["avoid"]),
        obstacle=options["obstacle"],
        approaches=options["approach"],
        grasp_type=options["grasp_type"],
        settings=Settings(thresholds=thresholds, seed=options["seed"]),
        **{name: options[name] for name in same},
        **more,
    )
