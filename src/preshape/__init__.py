"""Task-oriented grasp planning for multifingered robot hands.

>>> import preshape
>>> plan = preshape.plan("cube", "1 1 .1 .05 .8 .05", memory=":memory:")
>>> plan.grasp.plane.index, plan.decision.mode
(5, 0)

Names are imported when they are first used, so that importing the package is quick.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from ._version import __version__

if TYPE_CHECKING:
    from .exceptions import EnvironmentFailure, InputError, PreshapeError
    from .hands.hand import Hand
    from .hands.load import load_hand
    from .hiis.analyser import Grip, VirtualGrasp
    from .hiis.controller import Controller
    from .hiis.critic import Thresholds
    from .hiis.decision import Decision, Settings, Status
    from .hiis.fuzzy import FuzzySets, tfvadi
    from .memory import Memory
    from .objects.load import load_object
    from .objects.mesh import TriangleMesh
    from .planner import Plan, plan
    from .planning.document import plan_to_json
    from .tasks import Task, parse_task, task_from_displacement, task_from_poses
    from .types import ContactCoefficients

_HOME = {
    "Grip": "hiis.analyser",
    "VirtualGrasp": "hiis.analyser",
    "Controller": "hiis.controller",
    "Thresholds": "hiis.critic",
    "Decision": "hiis.decision",
    "Settings": "hiis.decision",
    "Status": "hiis.decision",
    "EnvironmentFailure": "exceptions",
    "InputError": "exceptions",
    "PreshapeError": "exceptions",
    "FuzzySets": "hiis.fuzzy",
    "tfvadi": "hiis.fuzzy",
    "Hand": "hands.hand",
    "load_hand": "hands.load",
    "plan_to_json": "planning.document",
    "Memory": "memory",
    "load_object": "objects.load",
    "TriangleMesh": "objects.mesh",
    "Plan": "planner",
    "plan": "planner",
    "Task": "tasks",
    "parse_task": "tasks",
    "task_from_displacement": "tasks",
    "task_from_poses": "tasks",
    "ContactCoefficients": "types",
}

__all__ = [
    "ContactCoefficients",
    "Controller",
    "Decision",
    "EnvironmentFailure",
    "FuzzySets",
    "Grip",
    "Hand",
    "InputError",
    "Memory",
    "Plan",
    "PreshapeError",
    "Settings",
    "Status",
    "Task",
    "Thresholds",
    "TriangleMesh",
    "VirtualGrasp",
    "__version__",
    "load_hand",
    "load_object",
    "parse_task",
    "plan",
    "plan_to_json",
    "task_from_displacement",
    "task_from_poses",
    "tfvadi",
]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
