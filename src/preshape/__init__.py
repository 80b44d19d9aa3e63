"""Task-oriented grasp planning for multifingered robot hands.

>>> import preshape
>>> plan = preshape.plan("cube", "1 1 .1 .05 .8 .05", hand="utah_mit", memory=":memory:")
>>> plan.grasp.plane.index, plan.decision.mode
(5, 0)

Names are imported when they are first used, so that importing the package is quick.
"""

from __future__ import annotations

from ._version import __version__

TYPE_CHECKING = False  # as typing's, which takes longer to import than all the rest
if TYPE_CHECKING:
    import typing

    from .closure.settings import ClosureSettings
    from .exceptions import (
        Cancelled,
        EnvironmentFailure,
        HandError,
        InputError,
        MemoryFileError,
        ObjectError,
        PreshapeError,
        TaskError,
        UnknownHand,
        UnknownName,
        UnknownObject,
        UnknownTask,
    )
    from .hands.hand import Hand
    from .hands.load import load_hand
    from .hiis.analyser import Grasp, Grip, VirtualGrasp
    from .hiis.controller import Controller
    from .hiis.critic import Thresholds
    from .hiis.decision import Decision, Settings, Status
    from .hiis.fuzzy import FuzzySets, tfvadi
    from .memory import Memory
    from .objects.load import load_object
    from .objects.mesh import TriangleMesh
    from .planner import plan
    from .planning.document import plan_to_json
    from .planning.plan import Plan
    from .planning.request import PlanRequest
    from .planning.session import Session
    from .tasks import Task, parse_task, task_from_displacement, task_from_poses
    from .types import ContactCoefficients

_HOME = {
    "Cancelled": "exceptions",
    "ClosureSettings": "closure.settings",
    "ContactCoefficients": "types",
    "Controller": "hiis.controller",
    "Decision": "hiis.decision",
    "EnvironmentFailure": "exceptions",
    "FuzzySets": "hiis.fuzzy",
    "Grasp": "hiis.analyser",
    "Grip": "hiis.analyser",
    "Hand": "hands.hand",
    "HandError": "exceptions",
    "InputError": "exceptions",
    "Memory": "memory",
    "MemoryFileError": "exceptions",
    "ObjectError": "exceptions",
    "Plan": "planning.plan",
    "PlanRequest": "planning.request",
    "PreshapeError": "exceptions",
    "Session": "planning.session",
    "Settings": "hiis.decision",
    "Status": "hiis.decision",
    "Task": "tasks",
    "TaskError": "exceptions",
    "Thresholds": "hiis.critic",
    "TriangleMesh": "objects.mesh",
    "UnknownHand": "exceptions",
    "UnknownName": "exceptions",
    "UnknownObject": "exceptions",
    "UnknownTask": "exceptions",
    "VirtualGrasp": "hiis.analyser",
    "load_hand": "hands.load",
    "load_object": "objects.load",
    "parse_task": "tasks",
    "plan": "planner",
    "plan_to_json": "planning.document",
    "task_from_displacement": "tasks",
    "task_from_poses": "tasks",
    "tfvadi": "hiis.fuzzy",
}

__all__ = [
    "Cancelled",
    "ClosureSettings",
    "ContactCoefficients",
    "Controller",
    "Decision",
    "EnvironmentFailure",
    "FuzzySets",
    "Grasp",
    "Grip",
    "Hand",
    "HandError",
    "InputError",
    "Memory",
    "MemoryFileError",
    "ObjectError",
    "Plan",
    "PlanRequest",
    "PreshapeError",
    "Session",
    "Settings",
    "Status",
    "Task",
    "TaskError",
    "Thresholds",
    "TriangleMesh",
    "UnknownHand",
    "UnknownName",
    "UnknownObject",
    "UnknownTask",
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


def __getattr__(name: str) -> typing.Any:
    if name in _HOME:
        import importlib

        return getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
