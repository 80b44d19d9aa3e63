"""Geometry of the planner's grips, checked on the exact triangles and the exact shapes of the hand.

    python -m hardening.grips [FOLDER] [--hands shadow,allegro,leap] [--tasks lift,turn] [--count 3]

FOLDER holds URDF files that name a mesh each, or mesh files; without it the library's objects are used. For
each answer the following must hold:

- At the grasp no link is a millimetre deep in the object, and every finger that presses touches it.
- The open hand is clear of the object, and so is its straight way in.
- No link goes deep while the fingers close.

None of the planner's own distances is used. An interrupted run is resumed; a finished one starts again.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from preshape.files import write_json

from .long_runs import show_progress, stored_rows
from .objects import found_objects

if TYPE_CHECKING:
    from preshape.hands.hand import Hand
    from preshape.hiis.analyser import Grip
    from preshape.objects.mesh import TriangleMesh

DEEP = 1e-3
"""Depth in the object that no link may reach [m]."""
TOUCHING = 1e-3
"""Largest distance of a link that touches [m]."""
WAY = np.arange(0.7e-3, 0.118, 4.1e-3)
"""Checked distances from the end of the way in [m]; the planner checks others."""
SHARES = (0.13, 0.38, 0.61, 0.87)
"""Checked shares of the closing motion."""


def flaws(hand: Hand, mesh: TriangleMesh, grip: Grip) -> list[str]:
    """Every flaw of a grip, in words; empty for a sound grip.

    Args:
        hand: The hand.
        mesh: The object [m].
        grip: The grip.
    """
    from preshape.hands.collision import object_collision
    from preshape.hands.kinematics import HandKinematics, finger_of, hand_geometry, move_shape, pose_matrix

    surface, found = object_collision(mesh), []
    at_grasp = hand_geometry(hand, grip.palm_pose, grip.grasp)
    found += [f"{shape.link} is deep in the object" for shape in at_grasp if surface.touches(shape, -DEEP)]
    touching = {finger_of(hand, shape) for shape in at_grasp if surface.touches(shape, TOUCHING)}
    found += [f"{finger} does not touch" for finger in grip.fingers_touching if finger not in touching]
    opened = hand_geometry(hand, grip.palm_pose, grip.pregrasp)
    found += [f"{shape.link} touches when opened" for shape in opened if surface.touches(shape)]
    kinematics = HandKinematics(hand)
    kinematics.set_posture(grip.pregrasp)
    shapes = kinematics.shapes()
    for way in WAY:
        pose = np.array(grip.palm_pose)
        pose[:3] -= way * grip.approach
        placed = pose_matrix(pose)
        if any(surface.touches(move_shape(shape, *placed)) for shape in shapes):
            found.append(f"the hand touches {1e3 * way:.0f} mm before the end of its way in")
    for share in SHARES:
        between = (1 - share) * grip.pregrasp + share * grip.grasp
        closing = hand_geometry(hand, grip.palm_pose, between)
        deep = [shape.link for shape in closing if surface.touches(shape, -DEEP)]
        found += [f"{link} is deep in the object at {share:.0%} of the closing motion" for link in deep]
    return found


def look(file: str, factor: float, hand: str, task: str, count: int, seed: int) -> dict[str, Any]:
    """Plan for one object and task, and check every answer."""
    from preshape import Grip, plan
    from preshape.exceptions import ObjectError
    from preshape.objects.load import load_object
    from preshape.types import FIELD_MASS

    try:
        mesh = load_object(file, scale=factor)
        made = plan(
            mesh,
            task,
            hand=hand,
            analyser="closure",
            mass=FIELD_MASS,
            table=None,
            memory=":memory:",
            learn=False,
            count=count,
            seed=seed,
        )
    except ObjectError as error:
        return {"answers": 0, "flaws": [], "reason": str(error)}
    answers = [a for a in (made.answer, *made.alternatives) if a is not None]
    found = [flaws(made.hand, mesh, a.grasp) for a in answers if isinstance(a.grasp, Grip)]
    return {"answers": len(found), "flaws": [f for f in found if f], "reason": made.decision.reason}


def run(
    rows: list[tuple[str, Path | str, float]],
    hands: list[str],
    tasks: list[str],
    count: int,
    seed: int,
    out: Path,
) -> dict[str, Any]:
    """Check every object with every hand and task that an earlier run has not checked, and summarise."""
    out.mkdir(parents=True, exist_ok=True)
    store = out / "grips.jsonl"
    done = {row["key"]: row for row in stored_rows(store)}
    plans = [
        (f"{name} {file} {factor:g} {hand} {task} {count} {seed}", str(file), factor, hand, task)
        for name, file, factor in rows
        for hand in hands
        for task in tasks
    ]
    todo = [one for one in plans if one[0] not in done]
    begin = time.monotonic()
    with store.open("a") as log:
        for number, (key, file, factor, hand, task) in enumerate(todo, start=1):
            row = {"key": key, "hand": hand, **look(file, factor, hand, task, count, seed)}
            done[key] = row
            log.write(json.dumps(row) + "\n")
            log.flush()
            last = number == len(todo)
            if sys.stderr.isatty() or number % 50 == 0 or last:
                seconds = (len(todo) - number) * (time.monotonic() - begin) / number
                left = "" if last else f", about {seconds:.0f} s left"
                show_progress(f"{number} of {len(todo)} plans{left}", last=last)
    store.unlink()  # the report has the results; the next run may test another planner
    found = [done[key] for key, *_ in plans]
    wrong = [row for row in found if row["flaws"]]
    return {
        "asked": len(found),
        "answered": sum(row["answers"] > 0 for row in found),
        "answers": sum(row["answers"] for row in found),
        "sound": sum(row["answers"] - len(row["flaws"]) for row in found),
        "by_hand": dict(Counter(row["hand"] for row in found if row["answers"])),
        "wrong": wrong,
        "without_answer": [{"key": r["key"], "reason": r["reason"]} for r in found if not r["answers"]],
    }


def main(arguments: list[str]) -> int:
    """Run from the command line; returns 0 where every answer is sound, 1 where not, 2 for bad input."""
    from preshape.exceptions import InputError
    from preshape.hands.load import load_hand
    from preshape.objects.library import names
    from preshape.tasks import parse_task

    parser = argparse.ArgumentParser(prog="python -m hardening.grips", description="Check grips exactly.")
    parser.add_argument("folder", nargs="?", type=Path, help="URDF or mesh files; default: the library")
    parser.add_argument("--hands", default="shadow,allegro,leap", help="default: %(default)s")
    parser.add_argument("--tasks", default="lift", help="default: %(default)s")
    parser.add_argument("--count", type=int, default=3, help="answers for each plan; default: %(default)s")
    parser.add_argument("--seed", type=int, default=0, help="default: %(default)s")
    parser.add_argument("--limit", type=int, help="largest number of objects")
    parser.add_argument("--out", type=Path, default=Path("out/grips"), help="default: %(default)s")
    given = parser.parse_args(arguments)
    rows: list[tuple[str, Path | str, float]] = [(name, name, 1.0) for name in names()]
    if given.folder is not None:
        rows = list(found_objects(given.folder))
    rows = rows[: given.limit]
    if not rows or given.count < 1:
        print(f"nothing to plan for: no objects in {given.folder}, or --count under 1", file=sys.stderr)
        return 2
    hands, tasks = given.hands.split(","), given.tasks.split(",")
    try:
        for hand in hands:
            load_hand(hand)
        for task in tasks:
            parse_task(task)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    try:
        found = run(rows, hands, tasks, given.count, given.seed, given.out)
    except KeyboardInterrupt:
        print("\ninterrupted; the same command resumes from here", file=sys.stderr)
        return 130
    write_json(given.out / "grips.json", found)
    print(f"answered {found['answered']} of {found['asked']}; sound {found['sound']} of {found['answers']}")
    for row in found["wrong"]:
        for some in row["flaws"]:
            print(f"  {row['key']}: {'; '.join(some[:3])}")
    return int(bool(found["wrong"]))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
