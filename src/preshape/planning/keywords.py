"""A request from plain JSON: the keywords of :func:`preshape.plan`, or the ``request`` of a plan.json."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..closure.settings import ClosureSettings
from ..exceptions import InputError, UnknownKey, shown
from ..hiis.critic import Thresholds
from ..hiis.decision import Settings
from ..tasks.task import from_json as task_from_json
from .request import PlanRequest

_OF_SETTINGS = ("seed", "estimation_threshold", "recognition_threshold")
_SAME = (
    "hand", "analyser", "unit", "scale", "view", "cut_table", "mass", "friction", "table", "avoid",
    "obstacle", "gravity", "approaches", "grasp_type", "count", "learn", "verify", "hold_on", "keep_off",
    "rules", "up", "rest", "mask", "arm", "arm_tip", "mount", "base_pose",
)  # fmt: skip
KEYWORDS = ("object", "task", *_SAME, *_OF_SETTINGS, "search")
"""The keys of a request in its short form."""


def request_from_keywords(data: object, **changes: Any) -> PlanRequest:
    """The request in a JSON object.

    Args:
        data: Either the short form, whose keys are ``KEYWORDS`` and of which only ``object`` and ``task`` are
            needed, or the long form, which is the ``request`` of a plan.json.
        changes: Fields of the request that differ from the object, such as the memory.

    Raises:
        InputError: It is neither, or a value cannot be used; the message says what to change.

    >>> request_from_keywords({"object": "mug", "task": "pour", "hand": "shadow"}).analyser
    'closure'
    """
    if not isinstance(data, Mapping):
        raise InputError(f"a request is a JSON object with the keys object and task, got {shown(data)}")
    if isinstance(data.get("object"), Mapping):
        return PlanRequest.from_json(data, **changes)
    for key in data:
        if key not in KEYWORDS:
            raise UnknownKey(key, KEYWORDS)
    for key in ("object", "task"):
        if key not in data:
            raise InputError(f"a request needs the key {key}; its keys are {', '.join(KEYWORDS)}")
    if not isinstance(data["object"], str):
        raise InputError(f"object must be the name of an object, got {shown(data['object'])}")
    task, search = data["task"], data.get("search", {})
    limits = Thresholds(
        **{name: data[key] for name in ("estimation", "recognition") if (key := f"{name}_threshold") in data}
    )
    try:
        closure = ClosureSettings(**search)
    except TypeError as error:
        raise InputError(
            f"search must be an object with settings of the search, got {shown(search)}"
        ) from error
    return PlanRequest(
        **{
            "source": data["object"],
            "task": task_from_json(task) if isinstance(task, Mapping) else task,
            "settings": Settings(thresholds=limits, seed=data.get("seed", 0)),
            "search": closure,
            **{name: data[name] for name in _SAME if name in data},
            **changes,
        }
    )
