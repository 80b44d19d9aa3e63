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
    from .analyser import VirtualGrasp
    from .controller import Controller
    from .critic import Thresholds
    from .decision import Decision, Settings, Status
    from .exceptions import EnvironmentFailure, InputError, PreshapeError
    from .fuzzy import FuzzySets, tfvadi
    from .hands.model import Hand, load_hand
    from .io import plan_to_json
    from .memory import Memory
    from .objects.load import load_object
    from .objects.mesh import TriangleMesh
    from .planner import Plan, plan
    from .tasks import Task, parse_task, task_from_displacement, task_from_poses
    from .types import ContactCoefficients

_HOME = {
    "VirtualGrasp": "analyser",
    "Controller": "controller",
    "Thresholds": "critic",
    "Decision": "decision",
    "Settings": "decision",
    "Status": "decision",
    "EnvironmentFailure": "exceptions",
    "InputError": "exceptions",
    "PreshapeError": "exceptions",
    "FuzzySets": "fuzzy",
    "tfvadi": "fuzzy",
    "Hand": "hands.model",
    "load_hand": "hands.model",
    "plan_to_json": "io",
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
