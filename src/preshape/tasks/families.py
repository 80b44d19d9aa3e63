"""Named tasks: families of motions, each along or about a signed axis of the object.

A family's Q is written in three directions [C]: ``a``, the signed axis of the name; ``s``, the side that is
up where the family needs one (+z; +x where ``a`` is ±z); ``u`` = a × s. Presence grades the load [C]: 1.0 in
translation stands for about the object's weight, 0.5 for friction under it, more than 1.0 for more than
it; 0.8 in rotation for a full turning load, 1.0 for a stuck one, 0.4-0.5 for a turn that only goes along with
the translation. Other components are absent (0.1, 0.05).
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from ..exceptions import TaskError, UnknownTask
from ..types import Array, value
from .task import (
    AXES,
    COMPONENTS,
    ROTATION_ABSENT,
    TRANSLATION_ABSENT,
    Task,
    axis_name,
    axis_vector,
    task_from_numbers,
)


@value
class Family:
    """A named kind of task.

    Attributes:
        name: as typed.
        title: for people.
        means: which motion, which load; ``{a}``, ``{s}``, ``{u}`` stand for the directions.
        axis: the default signed axis.
        translation: presence along a, s, u.
        rotation: presence about a, s, u, right-handed.
        up: the direction against gravity: ``a``, ``s``, or ``z`` for the object's own +z whatever the axis.
    """

    name: str
    title: str
    means: str
    axis: str
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    up: Literal["a", "s", "z"] = "z"


_FAMILIES = (
    Family(
        name="lift",
        title="Lift",
        means="Raise the object along {a}, which is up, without turning it. Load: its weight, along -{a}.",
        axis="+z",
        translation=(1.0, 0.0, 0.0),
        up="a",
    ),
    Family(
        name="push",
        title="Push ahead",
        means="Drive the object along {a} against what stands in its way, bearing down lightly (-{s}). "
        "Load: a force along -{a}.",
        axis="+x",
        translation=(1.0, -0.3, 0.0),
        up="s",
    ),
    Family(
        name="pull",
        title="Pull",
        means="Draw the object along {a}, easing it up a little ({s}). Load: a force along -{a}.",
        axis="-x",
        translation=(1.0, 0.3, 0.0),
        up="s",
    ),
    Family(
        name="pour",
        title="Pour",
        means="Tilt the object about the horizontal axis {a} while raising it along {s}, which is up. "
        "Load: the weight, less what has run out, and the torque of what runs.",
        axis="+x",
        translation=(0.0, 0.9, 0.0),
        rotation=(0.8, 0.0, 0.0),
        up="s",
    ),
    Family(
        name="turn",
        title="Turn",
        means="Turn the object right-handed about {a} on the spot. Load: a torque about -{a}.",
        axis="+z",
        rotation=(0.8, 0.0, 0.0),
    ),
    Family(
        name="screw",
        title="Screw in",
        means="Advance the object along {a} while turning it right-handed about {a}. "
        "Load: thread friction, a torque about -{a} and half a weight along -{a}.",
        axis="-z",
        translation=(0.5, 0.0, 0.0),
        rotation=(0.8, 0.0, 0.0),
    ),
    Family(
        name="unscrew",
        title="Unscrew",
        means="Loosen an object that was screwed in along {a}: turn it left-handed about {a} and let it back "
        "out along -{a}. Load: the stuck thread's torque about {a}, little force.",
        axis="-z",
        translation=(-0.3, 0.0, 0.0),
        rotation=(-1.0, 0.0, 0.0),
    ),
    Family(
        name="strike",
        title="Strike",
        means="Swing the object so that its {s} end goes forward and drive it along {a} into a blow. "
        "Load: the impact, a force along -{a} beyond the weight, and its torque about {u}.",
        axis="+x",
        translation=(1.48, 0.0, 0.0),
        rotation=(0.0, 0.0, -0.4),
        up="s",
    ),
    Family(
        name="insert",
        title="Insert",
        means="Advance the object along {a} into a snug hole without turning it. "
        "Load: the hole's friction along -{a}.",
        axis="-z",
        translation=(0.75, 0.0, 0.0),
    ),
    Family(
        name="twist",
        title="Twist",
        means="Turn the object right-handed about {a} against something stiff, as a key in a stuck lock. "
        "Load: a torque about -{a} beyond that of turn.",
        axis="+z",
        rotation=(1.0, 0.0, 0.0),
    ),
    Family(
        name="lever",
        title="Lever",
        means="Pry: turn the object about {a} round a fulcrum on its {u} side, so that its middle moves "
        "across the axis along {s}. Load: a force along -{s} and a torque about -{a}.",
        axis="+y",
        translation=(0.0, 1.0, 0.0),
        rotation=(0.8, 0.0, 0.0),
        up="s",
    ),
    Family(
        name="hand_over",
        title="Hand over",
        means="Carry the object along {a} to another hand, rising along {s}, which is up, without "
        "turning it. Load: its weight.",
        axis="+x",
        translation=(1.0, 0.5, 0.0),
        up="s",
    ),
    Family(
        name="press",
        title="Press",
        means="Press the object along {a} against a surface. Load: the surface, a force along -{a} beyond "
        "the weight.",
        axis="-z",
        translation=(1.25, 0.0, 0.0),
    ),
    Family(
        name="slide",
        title="Slide",
        means="Move the object along {a} over the support that carries it. Load: friction along -{a}, about "
        "half the weight.",
        axis="+x",
        translation=(0.5, 0.0, 0.0),
        up="s",
    ),
    Family(
        name="shake",
        title="Shake",
        means="Shake the object to and fro along {a} while rocking it a little about {u}; Q is the "
        "forward stroke. Load: its inertia, a force along -{a} and a torque about -{u}.",
        axis="+z",
        translation=(1.0, 0.0, 0.0),
        rotation=(0.0, 0.0, 0.4),
    ),
    Family(
        name="roll",
        title="Roll",
        means="Roll the object right-handed about {a} over a support below it, so that it travels along {u}. "
        "Load: a force along -{u} and a torque about -{a}.",
        axis="+y",
        translation=(0.0, 0.0, 1.0),
        rotation=(0.8, 0.0, 0.0),
        up="s",
    ),
    Family(
        name="open",
        title="Swing open",
        means="Draw the object along {a} while it swings wide about {s}, as a handle on a hinged door. "
        "Load: a force along -{a} and the hinge's torque about -{s}.",
        axis="-x",
        translation=(1.0, 0.0, 0.0),
        rotation=(0.0, 0.5, 0.0),
        up="s",
    ),
)
FAMILIES = {family.name: family for family in _FAMILIES}


def family_names() -> tuple[str, ...]:
    """The names of all families."""
    return tuple(FAMILIES)


def directions(axis: str) -> tuple[Array, Array, Array]:
    """The unit vectors a, s, u of a signed axis."""
    a = axis_vector(axis)
    s = axis_vector("+x" if axis[1] == "z" else "+z")
    return a, s, np.cross(a, s)


def _name_of(direction: Array) -> str:
    i = int(np.abs(direction).argmax())
    return f"{'+' if direction[i] > 0 else '-'}{'XYZ'[i]}"


def _task(family: Family, axis: str) -> Task:
    frame = np.array(directions(axis))
    translation, rotation = np.array(family.translation) @ frame, np.array(family.rotation) @ frame
    q = np.concatenate(
        [
            np.where(translation == 0.0, TRANSLATION_ABSENT, translation),
            np.where(rotation == 0.0, ROTATION_ABSENT, rotation),
        ]
    )
    up = {"a": frame[0], "s": frame[1], "z": np.array([0.0, 0.0, 1.0])}[family.up]
    means = family.means
    for letter, direction in zip("asu", frame, strict=True):
        means = means.replace(f"-{{{letter}}}", _name_of(-direction))
        means = means.replace(f"{{{letter}}}", _name_of(direction))
    return Task(name=family.name, q=q, means=means, gravity=0.0 - up, axis=axis)


def named_task(text: str) -> Task:
    """The task of a family, with a signed axis after a colon where another than the default is meant.

    Raises:
        UnknownTask: no such family; lists the nearest.
        TaskError: no such axis.

    >>> named_task("push").label, named_task("turn:-y").describe()
    ('push:+x', 'turning about -Y')
    """
    name, colon, axis = text.partition(":")
    key = "_".join(name.strip().lower().replace("-", " ").replace("_", " ").split())
    if key not in FAMILIES:
        raise UnknownTask(name.strip(), family_names())
    family = FAMILIES[key]
    if not colon:
        return _task(family, family.axis)
    try:
        return _task(family, axis_name(axis))
    except TaskError as error:
        raise TaskError(f"task {text!r}: {error}; write for example {key}:{family.axis}") from error


def all_named_tasks() -> tuple[Task, ...]:
    """Every family along every signed axis; no two have the same Q."""
    return tuple(_task(family, axis) for family in _FAMILIES for axis in AXES)


def parse_task(text: str) -> Task:
    """A task from text: six numbers, or a family's name with or without an axis.

    Raises:
        UnknownTask: no such family; lists the nearest.
        TaskError: neither, or numbers that are not six finite ones.

    >>> parse_task("1,1,.1,.05,.8,.05").describe() == parse_task("1 1 0 0 1 0").describe()
    True
    """
    if not text.strip(" ,\t\r\n"):
        raise TaskError(f"a task is six numbers {' '.join(COMPONENTS)} or a name such as lift, got nothing")
    if any(_is_number(token) for token in text.replace(",", " ").split()):
        return task_from_numbers(text)
    return named_task(text)


def _is_number(token: str) -> bool:
    try:
        float(token)
    except ValueError:
        return False
    return True
