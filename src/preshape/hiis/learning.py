"""The learning element (LE, §3.5): the fuzzy explorer and the incremental learning unit.

Training starts with a cube. Every object learnt later adds its experiences to the training data. Earlier
experiences stay in the data, so that learning an object does not make the estimator forget others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..memory.limits import usable as weights_usable
from ..objects.mesh import TriangleMesh, box_mesh
from ..objects.shape import described
from ..types import ANSWER_KIND, Array, Attributes, BoolArray, Experience, NetworkWeights, one_of, value
from .analyser import Aim, Analyser, Exploration, FingerRule, Grasp, Grip, HandLayout
from .critic import SLACK
from .estimator import HIDDEN, INPUT_COUNTS, OUTPUTS, InputKind, encode, inputs, inputs_of
from .fuzzy import FuzzySets, approaching_degrees
from .planes import PLANES
from .training import train

FINE_VALUES: Array = np.linspace(-0.95, 0.95, 64)
"""Approach values that modes 1 and 3 try between the crisp ones [C]."""
MIDDLE_SET = 3
"""Index of the fuzzy set for approach values near the object's middle."""


@value
class Discovery:
    """What the fuzzy explorer found for a task.

    Attributes:
        answer: The best grasp, at any approach value.
        taught: The grasp to learn: the best one at a crisp approach value.
        found: All grasps, best first.
    """

    answer: Grasp
    taught: Grasp
    found: Exploration

    @property
    def summary(self) -> str:
        """The result in one sentence."""
        return f"{self.found.summary}; the best is {self.answer.description}"


def explore(
    analyser: Analyser,
    q: Array,
    sets: FuzzySets,
    *,
    enough: float,
    allowed: BoolArray | None = None,
    values: Array | None = None,
    finger_rule: FingerRule = "up_to",
) -> Discovery | None:
    """The fuzzy explorer: search all planes, flips, sets and finger counts for the best match (mode 3).

    The answer may have any approach value; among equal matches a crisp value is preferred. The grasp to teach
    needs a crisp value, because the estimator can give no other. It is the first of these that exists [C]:

    1. the best crisp grasp on the answer's plane, if it is good enough;
    2. the best crisp grasp on the best other plane that has a good enough one;
    3. the best crisp grasp on the answer's plane, although it is not good enough.

    Args:
        analyser: Analyser of the object.
        q: (6,) task Q.
        sets: Membership functions.
        enough: TFVADI or quality that is good enough.
        allowed: (12,) which planes may be used; all by default.
        values: Approach values; by default the crisp ones and those between them.
        finger_rule: Virtual fingers that may be used; see :data:`~preshape.hiis.analyser.FINGER_RULES`.

    Returns:
        The answer and the grasp to teach; ``None`` if no grasp was found.
    """
    found = analyser.explore(q, everywhere(sets, allowed, values)).with_fingers(finger_rule)
    if not len(found):
        return None
    crisp = np.isin(found.value, sets.crisp())
    best = found.match >= found.match[0] - SLACK
    answer = _first(best & crisp, 0)
    recalled = crisp & (found.match >= enough - SLACK)
    home = found.plane[answer]
    if recalled.any() and not (recalled & (found.plane == home)).any():
        home = found.plane[_first(np.isin(found.plane, found.plane[recalled]), answer)]
    taught = _first(crisp & (found.plane == home), answer)
    return Discovery(answer=found.grasp(answer), taught=found.grasp(taught), found=found)


def everywhere(sets: FuzzySets, allowed: BoolArray | None = None, values: Array | None = None) -> Aim:
    """The aim at all allowed planes, by default with all approach values."""
    planes = [p.index for p in PLANES if allowed is None or allowed[p.index - 1]]
    return Aim(planes=planes, values=search_values(sets) if values is None else values)


def _first(mask: BoolArray, otherwise: int) -> int:
    """Index of the first True, or ``otherwise``; grasps are sorted, so the first is the best."""
    return int(np.argmax(mask)) if mask.any() else otherwise


def search_values(sets: FuzzySets) -> Array:
    """Crisp approach values and those between them, ascending."""
    return np.unique(np.concatenate([sets.crisp(), FINE_VALUES]))


def experiences_of(
    analyser: Analyser, object_name: str, q: Array, discovery: Discovery, sets: FuzzySets, scene: str = ""
) -> list[Experience]:
    """The experiences to store after a search: (Q, object), (BPT, object), a landmark, and the answer.

    The net wrench of the grasp is the *best possible task* (BPT) [P]: the task that this grasp matches best.
    The landmark is the grasp whose wrench has the largest TFVADI with itself; it serves recognition only. A
    wrench between fuzzy sets would not do, because its TFVADI with itself is low [C]. The answer is stored as
    well if another grasp is taught, because a repeated request must not get a worse answer [C].
    """
    grasp = discovery.taught
    self_match = approaching_degrees(discovery.found.wrench, discovery.found.wrench, sets).sum(axis=1)
    landmark = discovery.found.grasp(int(np.argmax(np.round(self_match, 9))))
    attributes = described(analyser.mesh)
    lessons = [("task", q, grasp), ("best", grasp.net_wrench, grasp)]
    lessons.append(("landmark", landmark.net_wrench, landmark))
    if discovery.answer.judged > grasp.judged + SLACK:
        lessons.append((ANSWER_KIND, q, discovery.answer))
    return [
        experience_of(analyser, object_name, kind, task, g, sets, attributes, scene=scene)
        for kind, task, g in lessons
    ]


def experience_of(
    analyser: Analyser,
    object_name: str,
    kind: str,
    task: Array,
    g: Grasp,
    sets: FuzzySets,
    attributes: Attributes,
    outcome: str = "",
    scene: str = "",
) -> Experience:
    """The experience of a grasp; see :class:`preshape.types.Experience`."""
    return Experience(
        kind=kind,
        object_name=object_name,
        hand=analyser.layout.name,
        attributes=attributes,
        task=task,
        plane=g.plane.index,
        flip=g.flip,
        approach_value=g.approach_value,
        approach_set=g.approach_set,
        fingers=g.fingers,
        wrench=g.net_wrench,
        match=float(approaching_degrees(task, g.net_wrench, sets).sum()),
        grip=_stored_grip(g, analyser.mesh.cog) if isinstance(g, Grip) else None,
        quality=g.quality if isinstance(g, Grip) else None,
        outcome=outcome,
        scene=scene,
        model=analyser.layout.model,
    )


def outcomes_of(
    analyser: Analyser, q: Array, tried: Sequence[tuple[Grasp, bool]], sets: FuzzySets, scene: str = ""
) -> list[Experience]:
    """Experiences of grasps for task Q with their outcomes in physics, in the order of the tests."""
    attributes, name = described(analyser.mesh), analyser.mesh.name
    return [
        experience_of(analyser, name, "task", q, g, sets, attributes, "held" if held else "lost", scene)
        for g, held in tried
    ]


def grasp_key(e: Experience) -> bytes:
    """Identifies a stored grasp: the grip of a real hand, or the wrench of a virtual grasp."""
    return (e.wrench if e.grip is None else e.grip).tobytes()


def lesson_key(e: Experience) -> tuple[str, str, bytes, bytes, bytes]:
    """Identifies scene, object, task and grasp of an experience."""
    return e.scene, e.object_name, e.attributes.extents.tobytes(), e.task.tobytes(), grasp_key(e)


def _stored_grip(grip: Grip, cog: Array) -> Array:
    """What is stored of a grip: the palm's pose about the COG, the finger mask, the start posture."""
    place = grip.palm_pose[:3] - cog
    return np.concatenate([place, grip.palm_pose[3:], [float(grip.mask)], grip.start])


def seed_tasks() -> Array:
    """(48, 6) the tasks of the first training: Q1- and Q2-type tasks of the twelve planes, both signs [C].

    For a plane (a, o) and a sign s, Q1 has translations along a and s·o and a rotation about s·o. Q2 has the
    same translations and a rotation about -a. Table 1 shows the case a = X, o = Y, s = +1. The paper's Q2
    there, with the rotation about +a, equals the Q1 of the plane that approaches along s·o; the sign used
    here makes all 48 tasks different.
    """
    tasks = []
    for p in PLANES:
        a, o = p.approach_axis, p.opposition_axis
        for sign in (1.0, -1.0):
            move = a + sign * o
            tasks += [_task(move, sign * o), _task(move, -a)]
    return np.array(tasks)


def first_guess(analyser: Analyser, u: float, kind: InputKind, *, seed: int = 0) -> NetworkWeights:
    """Weights for a hand that cannot hold the cube: each seed task on the plane that it belongs to [C]."""
    attributes = described(analyser.mesh)
    x = np.array([inputs(q, attributes, u, kind) for q in seed_tasks()])
    y = np.array([encode(p.index, MIDDLE_SET, 3) for p in PLANES for _ in range(4)])
    return train(x, y, start=None, seed=seed)


SEED_EDGE = 0.42
"""Edge of the first training's cube in 4U (72 mm for ``utah_mit``): the paper's torques fit its half [R]."""


def seed_cube(layout: HandLayout) -> TriangleMesh:
    """The cube of the first training with virtual grasps: a box with an edge of 1.68 U of the hand [m]."""
    return box_mesh("seed_cube", np.full(3, SEED_EDGE * layout.length_unit))


def seed_experiences(
    analyser: Analyser, sets: FuzzySets, *, enough: float, finger_rule: FingerRule = "up_to"
) -> list[Experience]:
    """The first lesson: the analyser's object, a cube, with the 48 seed tasks (§3.5)."""
    seeds = []
    for q in seed_tasks():
        discovery = explore(analyser, q, sets, enough=enough, values=sets.crisp(), finger_rule=finger_rule)
        if discovery is None:
            continue
        first = experiences_of(analyser, analyser.mesh.name, q, discovery, sets)[0]
        seeds.append(replace(first, kind="seed"))
    return seeds


def training_set(
    experiences: Sequence[Experience], u: float, *, kind: InputKind = "paper"
) -> tuple[Array, Array]:
    """Inputs and output bits of the experiences that the estimator is trained on.

    Of several lessons of the same task on the same object, the latest counts. A lesson in free space comes
    before any with a table or boxes, because the estimator does not know the scene. A grasp that lost the
    object in physics is not taught, and earlier lessons of the same task and grasp are dropped. A best
    possible task of an earlier version is left out, because it is a wrench in another unit. For inputs of
    kind ``shape``, experiences without a shape descriptor are left out.

    Args:
        experiences: Experiences of one hand, in the order in which they were stored.
        u: The hand's U [m].
        kind: Kind of the inputs, ``paper`` or ``shape``.

    Returns:
        (n, 13) or (n, 37) inputs and (n, 9) bits.

    Raises:
        InputError: The kind is unknown.
    """
    one_of(kind, "kind of inputs", tuple(INPUT_COUNTS))
    taught = [
        e
        for e in experiences
        if not (e.kind in ("landmark", ANSWER_KIND) or (e.kind == "best" and e.outdated))
        and not (kind == "shape" and e.attributes.shape is None)
    ]
    if not taught:
        return np.zeros((0, INPUT_COUNTS[kind])), np.zeros((0, OUTPUTS))
    x = inputs_of([e.task for e in taught], [e.attributes for e in taught], u, kind)
    rows: dict[bytes, int] = {}
    in_scene = set[bytes]()
    for index, (e, same) in enumerate(zip(taught, np.round(x, 6), strict=True)):
        key = same.tobytes()
        if e.scene and key in rows and key not in in_scene:
            continue
        if e.outcome != "lost":
            rows[key] = index
            (in_scene.add if e.scene else in_scene.discard)(key)
        elif key in rows and grasp_key(taught[rows[key]]) == grasp_key(e):
            del rows[key]
    codes = [(e.plane, e.approach_set, e.fingers) for e in (taught[index] for index in rows.values())]
    bits = {code: encode(*code) for code in set(codes)}
    y = np.array([bits[code] for code in codes]).reshape(-1, OUTPUTS)
    return x[list(rows.values())], y


def usable(weights: NetworkWeights | None, kind: InputKind) -> bool:
    """Whether weights are of the estimator's layers for these inputs, and small enough to be summed."""
    if weights is None:
        return False
    hidden, inner = weights.w1.shape
    fits = (inner, hidden, *weights.w2.shape) == (INPUT_COUNTS[kind], HIDDEN, OUTPUTS, HIDDEN)
    return fits and weights_usable(weights)


def learn(
    experiences: Sequence[Experience],
    u: float,
    start: NetworkWeights | None,
    *,
    seed: int = 0,
    kind: InputKind = "paper",
) -> NetworkWeights:
    """Train the estimator on all experiences, with its current weights as warm start.

    Args:
        experiences: Experiences of one hand, in the order in which they were stored.
        u: The hand's U [m].
        start: The current weights; they are ignored if they are not :func:`usable`.
        seed: Seed of fresh weights.
        kind: Kind of the inputs, ``paper`` or ``shape``.

    Raises:
        InputError: The kind is unknown, or there is nothing to train on.
    """
    x, y = training_set(experiences, u, kind=kind)
    return train(x, y, start=start if usable(start, kind) else None, seed=seed)


def _task(move: Array, turn: Array) -> Array:
    t = np.where(np.abs(move) > 0.5, move, 0.1)
    r = np.where(np.abs(turn) > 0.5, 0.8 * turn, 0.05)
    return np.concatenate([t, r])
