"""Ways to give a task: numbers, a name, a displacement, a pair of poses, a list of primitive motions."""

import numpy as np

from preshape.spatial import pose_from_seven
from preshape.tasks import (
    Primitive,
    displacement_of,
    named_task,
    parse_task,
    primitives_of,
    task_from_displacement,
    task_from_poses,
    task_from_primitives,
)

print(parse_task("1 1 .1 .05 .8 .05").describe())
print(named_task("screw:-z").means)

quarter_turn = [np.cos(np.pi / 4), 0.0, 0.0, np.sin(np.pi / 4)]  # w x y z
turned = task_from_displacement(rotation=quarter_turn, translation=[0.0, 0.0, -0.01])
print(turned.describe(), turned.q)

start = pose_from_seven([0.4, 0.0, 0.1, 1, 0, 0, 0])
goal = pose_from_seven([0.4, 0.2, 0.3, *quarter_turn])
moved = task_from_poses(start, goal, cog=[0.0, 0.0, 0.0])
print(moved.describe(), moved.q.round(3))

steps = [Primitive(kind="translate", axis="+z", amount=0.1), Primitive(kind="rotate", axis="+x", amount=1.2)]
poured = task_from_primitives(steps)
back = task_from_primitives(primitives_of(poured))
assert np.allclose(displacement_of(back), displacement_of(poured), atol=1e-12)
print(poured.describe(), [(p.kind, round(p.amount, 3)) for p in primitives_of(poured)])
