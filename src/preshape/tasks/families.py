"""Named tasks: families of motions along or about a signed axis of the object.

The Q of a family is given along three directions [C]: ``a`` is the signed axis of the name; ``s`` is the side
direction (+z, or +x if ``a`` is ±z), which is up in some families; ``u`` is a × s. Presences express the load
[C]. In translation, 1.0 means a load of about the object's weight, 0.5 the friction that this weight causes,
and more than 1.0 a load above the weight. In rotation, 0.8 means a full torque, 1.0 the torque of a stuck
thread, and 0.4 to 0.5 a rotation that only accompanies the translation. All other components are absent (0.1
in translation, 0.05 in rotation).
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from ..exceptions import TaskError, UnknownTask, shown
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
        name: Name for parsing.
        title: Name for display.
        means: Motion and load; ``{a}``, ``{s}``, ``{u}`` stand for the directions.
        axis: Default signed axis.
        translation: Presences along a, s, u.
        rotation: Presences about a, s, u, right-handed.
        up: Direction against gravity: ``a``, ``s``, or ``z`` for the object's +z with every axis.
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
        means="Push the object along {a} against a resistance, pressing it down lightly (-{s}). "
        "Load: a force along -{a}.",
        axis="+x",
        translation=(1.0, -0.3, 0.0),
        up="s",
    ),
    Family(
        name="pull",
        title="Pull",
        means="Pull the object along {a}, raising it slightly ({s}). Load: a force along -{a}.",
        axis="-x",
        translation=(1.0, 0.3, 0.0),
        up="s",
    ),
    Family(
        name="pour",
        title="Pour",
        means="Tilt the object about the horizontal axis {a} while raising it along {s}, which is up. "
        "Load: the weight, which the poured liquid reduces, and the torque of the flowing liquid.",
        axis="+x",
        translation=(0.0, 0.9, 0.0),
        rotation=(0.8, 0.0, 0.0),
        up="s",
    ),
    Family(
        name="turn",
        title="Turn",
        means="Turn the object right-handed about {a} in place. Load: a torque about -{a}.",
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
        means="Loosen an object that was screwed in along {a}: turn it left-handed about {a} while it moves "
        "out along -{a}. Load: the torque of the stuck thread about {a}, and little force.",
        axis="-z",
        translation=(-0.3, 0.0, 0.0),
        rotation=(-1.0, 0.0, 0.0),
    ),
    Family(
        name="strike",
        title="Strike",
        means="Swing the object so that its {s} end leads, and strike along {a}. "
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
        "Load: the friction of the hole along -{a}.",
        axis="-z",
        translation=(0.75, 0.0, 0.0),
    ),
    Family(
        name="twist",
        title="Twist",
        means="Turn the object right-handed about {a} against a stiff resistance, as a key in a stuck lock. "
        "Load: a torque about -{a} larger than that of turn.",
        axis="+z",
        rotation=(1.0, 0.0, 0.0),
    ),
    Family(
        name="lever",
        title="Lever",
        means="Pry: turn the object about {a} around a fulcrum on its {u} side, so that its centre moves "
        "along {s}. Load: a force along -{s} and a torque about -{a}.",
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
        means="Press the object along {a} against a surface. Load: the force of the surface along -{a}, "
        "larger than the weight.",
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
        means="Shake the object back and forth along {a} while rocking it slightly about {u}; Q is the "
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
        means="Pull the object along {a} while it swings about a distant axis along {s}, as the handle of a "
        "door. Load: a force along -{a} and the torque of the hinge about -{s}.",
        axis="-x",
        translation=(1.0, 0.0, 0.0),
        rotation=(0.0, 0.5, 0.0),
        up="s",
    ),
)
FAMILIES = {family.name: family for family in _FAMILIES}

OTHER_NAMES = {
    "pick": "lift", "pick_up": "lift", "grasp": "lift", "grab": "lift", "hold": "lift", "carry": "lift",
    "place": "lift", "put_down": "lift", "hammer": "strike", "hit": "strike", "rotate": "turn",
    "tighten": "screw", "loosen": "unscrew", "pry": "lever", "wipe": "slide", "squeeze": "press",
    "give": "hand_over", "pass": "hand_over",
}  # fmt: skip
"""Words that people use for a task, and the family that moves and loads the object so."""


def family_names() -> tuple[str, ...]:
    """The names of all families."""
    return tuple(FAMILIES)


def directions(axis: str) -> tuple[Array, Array, Array]:
    """The unit vectors a, s, u for a signed axis."""
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
    """The task of a family, or of another word for it; a signed axis after a colon replaces the default axis.

    Raises:
        UnknownTask: There is no such family; the message lists the nearest names.
        TaskError: There is no such axis.

    >>> named_task("push").label, named_task("turn:-y").describe()
    ('push:+x', 'turning about -Y')
    >>> named_task("pick up").label
    'lift:+z'
    """
    if not isinstance(text, str):
        raise TaskError(f"the name of a task must be text, got {shown(text)}")
    name, colon, axis = text.partition(":")
    key = "_".join(name.strip().lower().replace("-", " ").replace("_", " ").split())
    key = OTHER_NAMES.get(key, key)
    if key not in FAMILIES:
        raise UnknownTask(name.strip(), family_names())
    family = FAMILIES[key]
    if not colon:
        return _task(family, family.axis)
    try:
        return _task(family, axis_name(axis))
    except TaskError as error:
        raise TaskError(f"task {shown(text)}: {error}; write for example {key}:{family.axis}") from error


def all_named_tasks() -> tuple[Task, ...]:
    """The tasks of every family along every signed axis; no two of them have the same Q."""
    return tuple(_task(family, axis) for family in _FAMILIES for axis in AXES)


def parse_task(text: str) -> Task:
    """A task from text: six numbers, or the name of a family with or without an axis.

    Raises:
        UnknownTask: There is no such family; the message lists the nearest names.
        TaskError: The text is empty, names no axis, or holds numbers that are not six finite ones.

    >>> parse_task("1,1,.1,.05,.8,.05").describe() == parse_task("1 1 0 0 1 0").describe()
    True
    """
    if isinstance(text, str) and not text.strip(" ,\t\r\n"):
        raise TaskError(f"a task is six numbers {' '.join(COMPONENTS)} or a name such as lift, got nothing")
    if isinstance(text, str) and any(_is_number(token) for token in text.replace(",", " ").split()):
        return task_from_numbers(text)
    return named_task(text)


def _is_number(token: str) -> bool:
    try:
        float(token)
    except ValueError:
        return False
    return True
