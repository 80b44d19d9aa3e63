"""``preshape export``: a plan for other programs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..exceptions import InputError, shown
from ..report.plain import escaped_line
from .options import best_option, json_option, numbers_in
from .printing import emit, name_files, say

if TYPE_CHECKING:
    from ..export.moveit import MoveItOptions
    from ..export.planned import PlannedGrasp

FORMATS = ("moveit", "trajectory", "isaac", "usd", "mjcf", "npz")


@click.command(
    epilog="Example: preshape export plan.json --format moveit --out grasps.yaml --out grasps.mcap"
)
@click.argument("file", metavar="PLAN")
@click.option("--format", "kind", required=True, metavar="|".join(FORMATS), help="Format to write.")
@click.option(
    "--out",
    multiple=True,
    metavar="FILE",
    help="File to write; repeatable. moveit: .yaml, .mcap, or no ending for a ROS 2 bag; trajectory: .yaml, "
    ".csv or .npz; isaac: .yaml; usd: .usda (text), .usdc or .usd; default: text here.",
)
@click.option(
    "--answer",
    type=int,
    metavar="N",
    help="0 for the answer, 1 … for the alternatives; default: all (usd, mjcf, trajectory: the answer).",
)
@best_option
@click.option("--hand", metavar="HAND", help="Name or TOML file; default: the plan's hand.")
@click.option("--mass", type=float, help="usd, mjcf: mass of the object [kg]; default: the plan's.")
@click.option("--friction", type=float, help="usd, mjcf: friction coefficient; default: the plan's.")
@click.option("--frame", default="object", help="moveit, isaac: name of the object's frame.")
@click.option(
    "--parent-link",
    metavar="LINK",
    help="moveit, isaac: link whose pose is written; default: the hand's root body.",
)
@click.option(
    "--mount",
    metavar='"X Y Z W X Y Z"',
    help="moveit, isaac: pose of the hand's root in --parent-link, a link of your robot [m]; default for the "
    "link of the plan's arm: as planned.",
)
@click.option(
    "--object-name",
    multiple=True,
    help="moveit: object that the hand may touch; repeatable; default: the plan's object.",
)
@click.option(
    "--approach-distance",
    type=float,
    default=0.1,
    help="moveit: length of the straight way in [m].",
)
@click.option(
    "--retreat-distance",
    type=float,
    default=0.1,
    help="moveit: length of the lift afterwards [m].",
)
@click.option(
    "--up-frame",
    metavar="FRAME",
    help="moveit: frame whose +z is up; default: against the task's gravity, in --frame.",
)
@click.option(
    "--driver",
    metavar="NAME",
    help="trajectory: names, order and numbers of the hand's own driver: leap, allegro, shadow, inspire, or "
    "a TOML file.",
)
@click.option(
    "--duration",
    type=float,
    metavar="SECONDS",
    help="trajectory: time from the first point to the end of the lift; default 3.5, or what the arm takes.",
)
@click.option("--objects", metavar="DIR", help="usd, mjcf, npz: folder of the objects that are not built in.")
@json_option
def export(
    file: str,
    kind: str,
    out: tuple[str, ...],
    answer: int | None,
    best: bool,
    hand: str | None,
    mass: float | None,
    friction: float | None,
    frame: str,
    parent_link: str | None,
    mount: str | None,
    object_name: tuple[str, ...],
    approach_distance: float,
    retreat_distance: float,
    up_frame: str | None,
    driver: str | None,
    duration: float | None,
    objects: str | None,
    as_json: bool,
) -> int:
    """Write PLAN for other programs. PLAN is a plan.json, or - for standard input.

    moveit: moveit_msgs/msg/Grasp, one for each answer, the plan's own first (docs/ros.md). trajectory:
    commands of the motors, and of the arm's joints where the plan has an arm, from the open hand to the lift.
    isaac: a grasp file of Isaac Sim's grasp editor. usd, mjcf: a USD stage with physics, or a MuJoCo scene,
    with hand and object at the grasp.
    npz: grasp arrays (docs/grasp-file.md).

    Exit code 0: written. 2: bad input, such as a plan whose hand has no posture. 3: a file or a package is
    missing.
    """
    if kind not in FORMATS:
        raise InputError(f"--format must be one of {', '.join(FORMATS)}, got {shown(kind)}")
    if not all(name.strip() for name in out):
        raise InputError("--out needs a file, got an empty name")
    for option, given in (("--driver", driver), ("--duration", duration)):
        if given is not None and kind != "trajectory":
            raise InputError(f"{option} belongs to --format trajectory")
    from ..export.moveit import MoveItOptions
    from ..export.planned import planned_grasps
    from ..planning.document import obstacles_of, read_plan

    paths, document = _paths(kind, out), read_plan(file)
    asked = document.get("request") or {}
    seven: Any = None if mount is None else numbers_in(mount)
    if mount is None and parent_link and parent_link == asked.get("arm_tip"):
        seven = asked.get("mount")  # where the plan has the hand on its arm
    options = MoveItOptions(
        frame="object" if kind == "isaac" else frame,  # there it may be a prim's path
        parent_link=parent_link or "",
        mount=seven,
        touch_objects=object_name,
        approach_distance=approach_distance,
        retreat_distance=retreat_distance,
        up_frame=up_frame or "",
    )
    grasps, left_out = planned_grasps(document, file, hand=hand, answer=answer, best=best)
    first = grasps[0]
    if kind in ("usd", "mjcf"):
        first = replace(
            first,
            mass=first.mass if mass is None else mass,
            friction=first.friction if friction is None else friction,
        )
        grasps = (first,)
    report: dict[str, Any] = {
        "status": "answer",
        "format": kind,
        "plan": file,
        "hand": first.hand.name,
        "object": first.object_name,
        "mass": first.mass,
        "friction": first.friction,
        "answers": [grasp.number for grasp in grasps],
        "best": bool(first.lacking),
        "executable": not first.lacking,
        "lacking": first.lacking,
        "left_out": [{"answer": each.row, "reason": each.reason} for each in left_out],
        "obstacles_left_out": obstacles_of(document),
    }
    if kind == "moveit":
        text, more = _moveit(grasps, options, paths, file)
    elif kind == "trajectory":
        grasps = (first,)
        report["answers"] = [first.number]
        text, more = _trajectory(first, driver, duration, paths, file)
    elif kind == "isaac":
        text, more = _isaac(grasps, options, frame, paths, file)
    elif kind == "usd":
        text, more = _usd(document, first, objects, paths, file)
    else:
        text, more = _other(kind, document, grasps, objects, paths, file)
    report |= {**more, "files": [str(path) for path in paths]}
    if as_json:
        emit(report)
    elif not paths:
        click.echo(text, nl=False)
    _tell(report, paths, as_json)
    return 0


def _paths(kind: str, out: tuple[str, ...]) -> list[Path]:
    """The files to write.

    Raises:
        InputError: A file's ending is not one of the format's, or the format needs a file and none is given.
    """
    endings = {
        "moveit": (".yaml", ".yml", ".mcap", ""),
        "trajectory": (".yaml", ".yml", ".csv", ".npz"),
        "isaac": (".yaml", ".yml"),
        "usd": (".usda", ".usdc", ".usd"),
        "mjcf": (".xml", ".mjcf"),
        "npz": (".npz",),
    }[kind]
    paths = [Path(name) for name in out]
    for path in paths:
        if path.suffix.lower() not in endings:
            known = ", ".join(ending or "none for a ROS 2 bag" for ending in endings)
            raise InputError(f"--out {path}: the ending says what is written; {kind} has the endings {known}")
    if kind == "npz" and not paths:
        raise InputError("--format npz is not text; give a file, such as --out grasps.npz")
    return paths


def _moveit(
    grasps: tuple[PlannedGrasp, ...], options: MoveItOptions, paths: list[Path], file: str
) -> tuple[str, dict[str, Any]]:
    from .._version import __version__
    from ..export.moveit import messages_yaml, moveit_grasps, parent_link
    from ..export.ros_bag import write_bag, write_mcap
    from ..files import write_text

    messages = moveit_grasps(grasps, options)
    link, _ = parent_link(grasps[0], options)
    text = messages_yaml(
        messages,
        f"moveit_msgs/msg/Grasp, {_count(len(messages))}{', the answer first' if len(messages) > 1 else ''}\n"
        f"from {escaped_line(Path(file).name)} by preshape {__version__}\n"
        f"planned for {grasps[0].mass:g} kg, friction {grasps[0].friction:g}\n"
        f"grasp_pose: {link} in {options.frame}, the object's own frame [m]\n"
        "grasp_quality: 0 to 1, a sixth of a grip's quality or a virtual grasp's TFVADI; 0.5 is just enough\n"
        f"{grasps[0].warning}",
    )
    for path in paths:
        if path.suffix.lower() == ".mcap":
            write_mcap(path, messages)
        elif path.suffix:
            write_text(path, text)
        else:
            write_bag(path, messages)
    return text, {"frame": options.frame, "parent_link": link, "grasps": messages}


def _isaac(
    grasps: tuple[PlannedGrasp, ...], options: MoveItOptions, frame: str, paths: list[Path], file: str
) -> tuple[str, dict[str, Any]]:
    from .._version import __version__
    from ..export.isaac import isaac_grasps
    from ..export.moveit import messages_yaml
    from ..files import write_text

    document = isaac_grasps(grasps, options, frame)
    text = messages_yaml(
        [document],
        f"isaac_grasp of the hand {grasps[0].hand.name} on {grasps[0].object_name}\n"
        f"from {escaped_line(Path(file).name)} by preshape {__version__}\n"
        f"planned for {grasps[0].mass:g} kg, friction {grasps[0].friction:g}\n"
        f"object frame: {frame}, that of the mesh file [m]\n"
        "confidence: a sixth of a grip's quality or a virtual grasp's TFVADI; 0.5 is just enough\n"
        f"{grasps[0].warning}",
    )
    for path in paths:
        write_text(path, text)
    return text, {"frame": frame, "parent_link": document["gripper_frame_link"], "isaac": document}


def _trajectory(
    grasp: PlannedGrasp, driver: str | None, duration: float | None, paths: list[Path], file: str
) -> tuple[str, dict[str, Any]]:
    from .._version import __version__
    from ..export.drivers import load_driver
    from ..export.moveit import messages_yaml
    from ..export.trajectory import (
        arm_message,
        motor_trajectory,
        trajectory_arrays,
        trajectory_csv,
        trajectory_message,
    )
    from ..files import write_arrays, write_text

    chosen = None if driver is None else load_driver(driver)
    found = motor_trajectory(grasp, chosen, duration)
    message, arm = trajectory_message(found), arm_message(found)
    ends = dict(zip(found.stages, found.times.tolist(), strict=True))
    stages = ", ".join(f"{stage} {time:.4g} s" for stage, time in ends.items())
    whose = f"the hand {grasp.hand.name}" + ("" if arm is None else ", then of its arm on the same clock")
    text = messages_yaml(
        [message] if arm is None else [message, arm],
        f"trajectory_msgs/msg/JointTrajectory of {whose}\n"
        f"from {escaped_line(Path(file).name)} by preshape {__version__}\n"
        f"planned for {grasp.mass:g} kg, friction {grasp.friction:g}\n"
        f"positions in {found.unit}; {stages}\n"
        f"{grasp.warning}",
    )
    for path in paths:
        if path.suffix.lower() == ".csv":
            write_text(path, trajectory_csv(found))
        elif path.suffix.lower() == ".npz":
            write_arrays(path, **trajectory_arrays(found))
        else:
            write_text(path, text)
    return text, {
        "driver": None if chosen is None else chosen.name,
        "unit": found.unit,
        "stages": ends,
        "efforts": found.efforts.tolist(),
        "cut": list(found.cut),
        "trajectory": message,
        "arm_trajectory": arm,
    }


def _usd(
    document: dict[str, Any], grasp: PlannedGrasp, objects: str | None, paths: list[Path], file: str
) -> tuple[str, dict[str, Any]]:
    from ..export.scene_object import find_object, object_parts
    from ..export.usd import require_usd, scene_stage, stage_bytes, standing
    from ..files import write_bytes
    from ..planning.document import obstacles_of

    require_usd()
    found = find_object(document, folder=objects, beside=Path(file).parent if file != "-" else None)
    stands = standing(document, grasp)
    say("cutting the object into convex pieces, or taking them from the cache", err=True)
    stage = scene_stage(grasp, *object_parts(found), stands)
    for path in paths:
        write_bytes(path, stage_bytes(stage, path.suffix))
    text = "" if paths else stage_bytes(stage, ".usda").decode()
    return text, {
        "table": stands.table is not None,
        "obstacles_left_out": obstacles_of(document, table=stands.table is None),
        "prims": [str(prim.GetPath()) for prim in stage.GetDefaultPrim().GetChildren()],
    }


def _other(
    kind: str,
    document: dict[str, Any],
    grasps: tuple[PlannedGrasp, ...],
    objects: str | None,
    paths: list[Path],
    file: str,
) -> tuple[str, dict[str, Any]]:
    from ..export.scene_object import find_object, grasp_set, object_parts
    from ..physics.grasps import write_grasps

    beside = Path(file).parent if file != "-" else None
    found = find_object(document, folder=objects, beside=beside)
    if kind == "npz":
        for path in paths:
            write_grasps(path, grasp_set(grasps, found))
        return "", {}
    from ..export.mjcf import scene_mjcf
    from ..files import write_text

    say("cutting the object into convex pieces, or taking them from the cache", err=True)
    text = scene_mjcf(grasps[0], *object_parts(found))
    for path in paths:
        write_text(path, text)
    return text, {"keyframes": ["pregrasp", "grasp", "squeeze"]}


def _tell(report: dict[str, Any], paths: list[Path], as_json: bool) -> None:
    """Report what was written and, on standard error, what was left out."""
    for each in report["left_out"]:
        say(f"answer {each['answer']} is left out, its hand has no posture: {each['reason']}", err=True)
    if report["obstacles_left_out"]:
        say(f"left out, though planned with: {report['obstacles_left_out']}", err=True)
    if cut := report.get("cut"):
        say(
            f"the driver's limits cut the command of {', '.join(cut)}: the hand presses less there than "
            "planned",
            err=True,
        )
    if report["best"]:
        say(f"this is the best grasp found, not an answer; executable: false; {report['lacking']}", err=True)
    if as_json or not paths:
        return
    name_files(paths)
    what = f"{_count(len(report['answers']))} of {report['object']} with the hand {report['hand']}"
    what += f", planned for {report['mass']:g} kg and friction {report['friction']:g}"
    if report["format"] == "moveit":
        best = report["grasps"][0]["grasp_quality"]
        what += f"; grasp_pose is {report['parent_link']} in {report['frame']}, best quality {best:.2f}"
    say(what)


def _count(number: int) -> str:
    return f"{number} grasp{'s' if number != 1 else ''}"
