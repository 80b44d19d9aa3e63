"""Grasps planned on the depth image of a cluttered table, tried on the objects that really stand there.

    python -m hardening.clutter [--long] [--hand shadow] [--seed N] [--out out/clutter]

Each scene has five objects of the library at rest on a table, 20 mm apart or more, and a depth camera with
noise looks at them from above at a slant. Each object in turn is the wanted one, with its true mass and its
mask. Of an answer it is asked, on the true surfaces that the planner never saw:

- does the hand stay clear of the neighbours, opened on its way in and closed? And
- does it pick the object up, in physics (the pick test of docs/pick-test.md, without the neighbours)?
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from preshape import spatial
from preshape.exceptions import PreshapeError
from preshape.files import write_json
from preshape.hands.collision import object_collision
from preshape.hands.kinematics import hand_geometry
from preshape.kernels.rays import RayCaster
from preshape.objects.library import load_library_object
from preshape.objects.mesh import TriangleMesh
from preshape.objects.scans.sight import level_axes
from preshape.planner import plan
from preshape.planning.plan import Plan
from preshape.types import Array

from .long_runs import show_progress

OBJECTS = ("mug", "bottle", "box", "apple", "jar", "teapot", "cylinder", "spray_bottle", "pear", "cube")
"""Objects that stand high enough to be seen from the side."""
APART = 0.02
"""Least distance between the bounding circles of two objects [m]."""
AWAY = 0.72
"""Distance of the camera from the middle of the table [m]."""
FOCAL, SIZE, NOISE = 600.0, (480, 640), 0.0007
"""Focal length and size of the image [pixels], and standard deviation of the depth along a ray [m]."""
SIDE = 0.6
"""Half the side of the table [m]."""
_BACK = np.arange(0.0, 0.12, 0.01)


def standing(name: str, place: Sequence[float], turn: float) -> TriangleMesh:
    """A library object at rest on the table z = 0, turned about z [rad]."""
    mesh = load_library_object(name)
    R = np.eye(3) if mesh.rest is None else spatial.rotation_from_quaternion(mesh.rest)
    c, s = np.cos(turn), np.sin(turn)
    vertices = mesh.vertices @ (np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ R).T
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    vertices += np.array([*place, 0.0]) - [*(low + high)[:2] / 2, low[2]]
    return TriangleMesh(name=name, vertices=vertices, triangles=mesh.triangles, mass=mesh.mass)


def drawn_scene(rng: np.random.Generator, count: int = 5) -> list[TriangleMesh]:
    """Objects that stand on the table at random places, apart from each other."""
    placed, circles = list[TriangleMesh](), list[tuple[Array, float]]()
    for name in rng.permutation(OBJECTS)[:count].tolist():
        radius = float(np.linalg.norm(standing(name, (0.0, 0.0), 0.0).extents[:2])) / 2
        spread = 0.12
        while True:
            place = rng.uniform(-spread, spread, 2)
            if all(np.linalg.norm(place - other) > radius + r + APART for other, r in circles):
                break
            spread += 0.005
        circles.append((place, radius))
        placed.append(standing(name, place.tolist(), float(rng.uniform(0, 2 * np.pi))))
    return placed


def depth_image(bodies: Sequence[TriangleMesh], camera: Array, rng: np.random.Generator) -> dict[str, Array]:
    """What a depth camera at (3,) [m] that looks at the origin sees: the arrays of a scene's NPZ file."""
    corners = np.array([[-SIDE, -SIDE, 0], [SIDE, -SIDE, 0], [SIDE, SIDE, 0], [-SIDE, SIDE, 0.0]])
    table = TriangleMesh(name="table", vertices=corners, triangles=np.array([[0, 1, 2], [0, 2, 3]]))
    axes, (h, w) = level_axes(-camera), SIZE
    rows, columns = np.indices(SIZE)
    local = np.stack([(columns - w / 2) / FOCAL, (rows - h / 2) / FOCAL, np.ones(SIZE)], axis=-1)
    rays = local.reshape(-1, 3) @ axes
    length = np.linalg.norm(rays, axis=1)
    nearest, labels = np.full(h * w, np.inf), np.zeros(h * w, dtype=np.int64)
    for number, body in enumerate([table, *bodies]):
        hits = RayCaster(body).cast(np.broadcast_to(camera, rays.shape).copy(), rays / length[:, None])
        distance = np.where(hits.triangle >= 0, hits.distance, np.inf)
        labels[distance < nearest] = number
        nearest = np.minimum(nearest, distance)
    seen = np.isfinite(nearest)
    depth = np.zeros(h * w)  # zero is no echo
    depth[seen] = nearest[seen] / length[seen] + rng.normal(0.0, NOISE, int(seen.sum()))
    K = np.array([[FOCAL, 0.0, w / 2], [0.0, FOCAL, h / 2], [0.0, 0.0, 1.0]])
    T = spatial.pose(axes.T, camera)
    return {"depth": depth.reshape(SIZE), "K": K, "T_world_camera": T, "labels": labels.reshape(SIZE)}


def touched(made: Plan, bodies: Sequence[TriangleMesh]) -> list[str]:
    """Names of the bodies that the hand of a plan touches, opened on its way in, opened, or closed."""
    hand, answer = made.hand, made.answer
    assert answer is not None
    result = answer.hand_result
    assert result.pregrasp is not None
    assert result.grasp is not None
    postures = [(result.grasp.palm_pose, result.grasp.q)]
    for back in _BACK:
        palm = np.array(result.pregrasp.palm_pose)
        palm[:3] -= back * answer.way_in
        postures.append((palm, result.pregrasp.q))
    shapes = [shape for palm, q in postures for shape in hand_geometry(hand, palm, q)]
    found = []
    for body in bodies:
        surface = object_collision(body)
        if any(surface.touches(shape) for shape in shapes):
            found.append(body.name)
    return found


def tried(scene: Path, label: int, bodies: Sequence[TriangleMesh], hand: str, task: str) -> dict[str, Any]:
    """Plan for one object of a scene, and try the answer on the true objects."""
    from preshape.planning.verify import pick_until_done

    wanted = bodies[label - 1]
    row: dict[str, Any] = {"object": wanted.name, "answer": False, "touched": [], "picked": False}
    try:
        made = plan(scene, task, hand=hand, mask=label, mass=wanted.mass, memory=":memory:", learn=False)
        row["reason"] = made.decision.reason
        if made.answer is None:
            return row
        row |= {"answer": True, "touched": touched(made, [*bodies[: label - 1], *bodies[label:]])}
        (result,) = pick_until_done(replace(made, mesh=wanted), [made.answer])
    except PreshapeError as error:
        return row | {"reason": str(error)}
    return row | {"picked": result.passed, "reason": result.reason}


def main(words: Sequence[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m hardening.clutter", description="Pick from clutter.")
    parser.add_argument("--long", action="store_true", help="five scenes in place of one")
    parser.add_argument("--hand", default="shadow")
    parser.add_argument("--task", default="lift")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("out/clutter"))
    given = parser.parse_args(words)
    given.out.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    scenes = range(5 if given.long else 1)
    for number in scenes:
        rng = np.random.default_rng([given.seed, number])
        bodies = drawn_scene(rng)
        rise, turn = rng.uniform(0.6, 1.0), rng.uniform(0, 2 * np.pi)
        camera = AWAY * np.array([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)])
        file = given.out / f"scene-{number}.npz"
        np.savez_compressed(file, **depth_image(bodies, camera, rng))
        for label in range(1, 1 + len(bodies)):
            row = tried(file, label, bodies, given.hand, given.task)
            rows.append({"scene": number, **row})
            said = "picked" if row["picked"] else row["reason"]
            beside = f", touches {' and '.join(row['touched'])}" if row["touched"] else ""
            show_progress(f"scene {number}, {row['object']}: {said}{beside}", last=True)
    answers = [row for row in rows if row["answer"]]
    summary = {
        "scenes": len(scenes),
        "objects": len(rows),
        "answered": len(answers),
        "clear_of_neighbours": sum(not row["touched"] for row in answers),
        "picked": sum(row["picked"] for row in answers),
    }
    write_json(given.out / "clutter.json", {**summary, "rows": rows})
    print("; ".join(f"{name.replace('_', ' ')} {number}" for name, number in summary.items()))
    return 1 if any(row["touched"] for row in answers) else 0


if __name__ == "__main__":
    sys.exit(main())
