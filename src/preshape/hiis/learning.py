"""The learning element (LE, §3.5): the fuzzy explorer and the incremental learning unit.

Training starts with a simple cube. Every object learnt later adds its experiences to the training
data; the old ones stay, so learning an object does not forget the earlier ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..exceptions import InputError
from ..objects.shape import described
from ..types import KEPT, Array, Attributes, BoolArray, Experience, NetworkWeights, value
from .analyser import Aim, Analyser, Exploration, Grasp, Grip
from .critic import SLACK
from .estimator import INPUT_COUNTS, OUTPUTS, InputKind, encode, inputs
from .fuzzy import FuzzySets, approaching_degrees
from .planes import PLANES
from .training import train

FINE_VALUES: Array = np.linspace(-0.95, 0.95, 64)
"""Approach values that modes 1 and 3 try between the crisp ones [C]."""


MIDDLE_SET = 3
"""Index of the fuzzy set of approach values round the object's middle."""


@value
class Discovery:
    """What the fuzzy explorer found for a task.

    Attributes:
        answer: the best virtual grasp of all, at any approach value.
        taught: the one to learn: the best that a crisp approach value can recall.
        found: everything, best first.
    """

    answer: Grasp
    taught: Grasp
    found: Exploration

    @property
    def summary(self) -> str:
        """What was found, in a sentence."""
        return f"{self.found.summary}; the best is {self.answer.description}"


def explore(
    analyser: Analyser,
    q: Array,
    sets: FuzzySets,
    *,
    enough: float,
    allowed: BoolArray | None = None,
    values: Array | None = None,
) -> Discovery | None:
    """The fuzzy explorer: search all planes, flips, sets and finger counts for the best match (mode 3).

    Crisp approach values are searched for what is taught, and the values between them for the answer
    itself; among equal matches a crisp value wins. The estimator can recall crisp values only, so what is
    taught stays on the answer's plane where a crisp value there is good enough, else moves to the best
    plane on which one is, and stays after all when there is none [C].

    Args:
        analyser: prepared for the object.
        q: (6,) task Q.
        sets: membership functions.
        enough: TFVADI that counts as success.
        allowed: (12,) which planes may be used; all by default.
        values: approach values; crisp ones and those between by default.

    Returns:
        ``None`` when no fingers find the object anywhere.
    """
    found = analyser.explore(q, everywhere(sets, allowed, values))
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
    """The aim at all planes that are allowed, by default with all values that are searched."""
    planes = [p.index for p in PLANES if allowed is None or allowed[p.index - 1]]
    return Aim(planes=planes, values=search_values(sets) if values is None else values)


def _first(mask: BoolArray, otherwise: int) -> int:
    """Index of the first True: the best one, as everything found is in order."""
    return int(np.argmax(mask)) if mask.any() else otherwise


def search_values(sets: FuzzySets) -> Array:
    """Crisp approach values and the finer ones between them, ascending."""
    return np.unique(np.concatenate([sets.crisp(), FINE_VALUES]))


def experiences_of(
    analyser: Analyser, object_name: str, q: Array, discovery: Discovery, sets: FuzzySets, scene: str = ""
) -> list[Experience]:
    """What is worth remembering of a search: (Q, object), (BPT, object), a landmark, and the answer.

    The net wrench found is the *best possible task* (BPT) [P]: a task that this grasp matches as well as
    any can. The landmark is the virtual grasp whose wrench resembles itself most; it serves
    recognition alone, because a pattern that lies between fuzzy sets would not know itself [C].
    The answer is stored beside them where the estimator, which knows crisp approach values only, is taught
    another grasp: asking again must not give a worse answer than the first time [C].
    """
    grasp = discovery.taught
    self_match = approaching_degrees(discovery.found.wrench, discovery.found.wrench, sets).sum(axis=1)
    landmark = discovery.found.grasp(int(np.argmax(np.round(self_match, 9))))
    attributes = described(analyser.mesh)
    lessons = [("task", q, grasp), ("best", grasp.net_wrench, grasp)]
    lessons.append(("landmark", landmark.net_wrench, landmark))
    if discovery.answer.judged > grasp.judged + SLACK:
        lessons.append((KEPT, q, discovery.answer))
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
    """A grasp of an object as what is remembered of it; see :class:`preshape.types.Experience`."""
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
        grip=_remembered(g, analyser.mesh.cog) if isinstance(g, Grip) else None,
        quality=g.quality if isinstance(g, Grip) else None,
        outcome=outcome,
        scene=scene,
    )


def outcomes_of(
    analyser: Analyser, q: Array, tried: Sequence[tuple[Grasp, bool]], sets: FuzzySets, scene: str = ""
) -> list[Experience]:
    """What physics said of grasps for task Q, in the order in which they were tried: held, or lost."""
    attributes, name = described(analyser.mesh), analyser.mesh.name
    return [
        experience_of(analyser, name, "task", q, g, sets, attributes, "held" if held else "lost", scene)
        for g, held in tried
    ]


def held_by(e: Experience) -> bytes:
    """What tells one remembered grasp from another: the real hand's grip, or the virtual grasp's wrench."""
    return (e.wrench if e.grip is None else e.grip).tobytes()


def asked_of(e: Experience) -> tuple[str, str, bytes, bytes, bytes]:
    """Which grasp of which object for which task, to tell whether it is news."""
    return e.scene, e.object_name, e.attributes.extents.tobytes(), e.task.tobytes(), held_by(e)


def _remembered(grip: Grip, cog: Array) -> Array:
    """What is stored of a grip: the palm's pose about the COG, the finger mask, the start posture."""
    place = grip.palm_pose[:3] - cog
    return np.concatenate([place, grip.palm_pose[3:], [float(grip.mask)], grip.start])


def seed_tasks() -> Array:
    """(48, 6) the tasks of the first training: Q1- and Q2-type tasks of the twelve planes, both signs [C].

    For a plane (a, o) and a sign s: Q1 = translations along a and s·o, rotation about s·o; Q2 = the same
    translations, rotation about -a. Table 1 has o = Y, s = +1 and a = X; its Q2, with the rotation about
    +a, is here as the Q1 of the plane that approaches along s·o, so that all 48 are different.
    """
    tasks = []
    for p in PLANES:
        a, o = p.approach_axis, p.opposition_axis
        for sign in (1.0, -1.0):
            move = a + sign * o
            tasks += [_task(move, sign * o), _task(move, -a)]
    return np.array(tasks)


def first_guess(analyser: Analyser, u: float, kind: InputKind, *, seed: int = 0) -> NetworkWeights:
    """Weights for a hand that cannot hold the cube: each seed task on the plane that it was made for [C]."""
    attributes = described(analyser.mesh)
    x = np.array([inputs(q, attributes, u, kind) for q in seed_tasks()])
    y = np.array([encode(p.index, MIDDLE_SET, 3) for p in PLANES for _ in range(4)])
    return train(x, y, start=None, seed=seed)


def seed_experiences(
    analyser: Analyser, sets: FuzzySets, *, enough: float, object_name: str = "cube"
) -> list[Experience]:
    """What the system knows before it has met anything: the cube under the 48 seed tasks (§3.5)."""
    seeds = []
    for q in seed_tasks():
        discovery = explore(analyser, q, sets, enough=enough, values=sets.crisp())
        if discovery is None:
            continue
        first = experiences_of(analyser, object_name, q, discovery, sets)[0]
        seeds.append(replace(first, kind="seed"))
    return seeds


def training_set(
    experiences: Sequence[Experience], u: float, *, kind: InputKind = "paper"
) -> tuple[Array, Array]:
    """Inputs and output bits of all experiences that are trained on.

    Where the same task on the same object was learnt twice, the later one counts; a lesson of free space
    counts before one with a table or boxes, because the estimator does not know the scene. What physics
    refused is not taught, and takes with it what the same grasp had taught of the same task.
    Experiences from before there were shape descriptors teach nothing where the inputs are of kind ``shape``.

    Args:
        experiences: of one hand, in the order in which they were met.
        u: the hand's U [m].
        kind: of the inputs, ``paper`` or ``shape``.

    Returns:
        (n, 13) or (n, 37) inputs and (n, 9) bits.

    Raises:
        InputError: an unknown kind.
    """
    if kind not in INPUT_COUNTS:
        raise InputError(f"no kind of inputs {kind!r}; known: {', '.join(INPUT_COUNTS)}")
    rows: dict[bytes, tuple[Array, Array, bytes]] = {}
    in_scene = set[bytes]()
    for e in experiences:
        if e.kind in ("landmark", KEPT) or (kind == "shape" and e.attributes.shape is None):
            continue
        x = inputs(e.task, e.attributes, u, kind)
        key, bits = np.round(x, 6).tobytes(), encode(e.plane, e.approach_set, e.fingers)
        if e.scene and key in rows and key not in in_scene:
            continue
        if e.outcome != "lost":
            rows[key] = (x, bits, held_by(e))
            (in_scene.add if e.scene else in_scene.discard)(key)
        elif key in rows and rows[key][2] == held_by(e):
            del rows[key]
    if not rows:
        return np.zeros((0, INPUT_COUNTS[kind])), np.zeros((0, OUTPUTS))
    return np.array([x for x, _, _ in rows.values()]), np.array([y for _, y, _ in rows.values()])


def learn(
    experiences: Sequence[Experience],
    u: float,
    start: NetworkWeights | None,
    *,
    seed: int = 0,
    kind: InputKind = "paper",
) -> NetworkWeights:
    """Train the estimator on everything met so far, from the weights it has.

    Args:
        experiences: of one hand, in the order in which they were met.
        u: the hand's U [m].
        start: the weights it has; those of another kind of inputs are of no use and are not continued.
        seed: of fresh weights.
        kind: of the inputs, ``paper`` or ``shape``.

    Raises:
        InputError: an unknown kind, or nothing to train on.
    """
    x, y = training_set(experiences, u, kind=kind)
    if start is not None and start.w1.shape[1] != x.shape[1]:
        start = None
    return train(x, y, start=start, seed=seed)


def _task(move: Array, turn: Array) -> Array:
    t = np.where(np.abs(move) > 0.5, move, 0.1)
    r = np.where(np.abs(turn) > 0.5, 0.8 * turn, 0.05)
    return np.concatenate([t, r])
