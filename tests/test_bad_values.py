"""Every public value and function refuses what it cannot use by an error of preshape, in a short sentence."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np
import pytest

import preshape
from preshape.dataset.settings import DatasetSettings
from preshape.exceptions import PreshapeError
from preshape.hiis.analyser import HandLayout
from preshape.kernels.closing.host import Obstacles
from preshape.physics.protocol import HoldProtocol
from preshape.physics.task.protocol import TaskProtocol
from preshape.planning.document import plan_to_json
from preshape.tasks import (
    Primitive,
    named_task,
    task_from_numbers,
    task_from_primitives,
)

LONG = "lift " * 2000
NAN, INF = float("nan"), float("inf")
JUNK: list[Any] = [
    None, True, False, -1, 0, 3, 10**400, 1.5, NAN, INF, 1j, np.complex128(1 + 1j), "", "x", "\0", LONG, b"x",
    [], [1], [[]], ["x"] * 6, [1j] * 6, [NAN] * 6, [None] * 3, {}, {"a": 1}, {1}, range(6), object(), int,
    np.zeros(6), np.zeros((2, 3)), np.array(1.0), np.array([1j] * 6), np.array(["x"] * 6), np.zeros(6, bool),
    np.array([], float), np.bool_(True), np.str_("x"), np.int64(-3), np.float32(NAN),
    np.array([object()] * 6), np.zeros(0), np.datetime64("2020-01-01"),
]  # fmt: skip


def _session() -> preshape.Session:
    return preshape.Session(":memory:")


GOOD: dict[type, dict[str, Any]] = {
    preshape.ClosureSettings: {},
    preshape.ContactCoefficients: {},
    preshape.FuzzySets: {},
    preshape.PlanRequest: {"source": "mug", "task": "lift", "hand": "shadow"},
    preshape.Settings: {},
    preshape.Task: {"name": "custom", "q": np.ones(6)},
    preshape.Thresholds: {},
    preshape.TriangleMesh: {"name": "thing", "vertices": np.eye(3), "triangles": [[0, 1, 2]]},
    Primitive: {"kind": "translate", "axis": "+z", "amount": 0.1},
    HandLayout: {"name": "thing", "u": 0.04, "finger_pitch": 0.02, "fingertip_width": 0.01},
    Obstacles: {},
    HoldProtocol: {},
    TaskProtocol: {},
    DatasetSettings: {},
}
CALLS: dict[str, Callable[[Any], Any]] = {
    "Session.run": lambda x: _session().run(x),
    "Session.teach": lambda x: _session().teach(x),
    "plan_to_json": plan_to_json,
    "tfvadi wrench": lambda x: preshape.tfvadi([np.ones(6), np.ones(6)], x),
    "tfvadi sets": lambda x: preshape.tfvadi(np.ones(6), np.ones(6), sets=x),
    "parse_task": preshape.parse_task,
    "named_task": named_task,
    "task_from_numbers": task_from_numbers,
    "one number": lambda junk: task_from_numbers([0, 0, 1, 0, 0, junk]),
    "task_from_displacement": preshape.task_from_displacement,
    "its rotation": lambda junk: preshape.task_from_displacement(rotation=junk),
    "task_from_poses": lambda junk: preshape.task_from_poses(np.eye(4), junk, np.zeros(3)),
    "its COG": lambda junk: preshape.task_from_poses(np.eye(4), np.eye(4), junk),
    "task_from_primitives": task_from_primitives,
    "tfvadi": lambda junk: preshape.tfvadi(junk, np.ones(6)),
    "membership": preshape.FuzzySets().membership,
    "changed": preshape.FuzzySets().changed,
    "a set": lambda junk: preshape.FuzzySets().changed({"ZERO": junk}),
    "load_object": preshape.load_object,
    "its unit": lambda junk: preshape.load_object("mug", unit=junk),
    "its scale": lambda junk: preshape.load_object("mug", scale=junk),
    "load_hand": preshape.load_hand,
    "memory": lambda junk: preshape.Memory.open(junk) if not isinstance(junk, str) else None,
}


def refused(call: Callable[[], Any]) -> str | None:
    """The message of a refusal, ``None`` without one. Any other error and any warning fail the test."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            call()
        except PreshapeError as error:
            return str(error)
    return None


CASES = [
    pytest.param(kind, field.name, id=f"{kind.__name__}-{field.name}")
    for kind in GOOD
    for field in fields(kind)
]


@pytest.mark.parametrize(("kind", "name"), CASES)
def test_a_value_refuses_what_it_cannot_use(kind: type, name: str) -> None:
    for junk in JUNK:
        message = refused(lambda junk=junk: kind(**{**GOOD[kind], name: junk}))
        assert message is None or 10 < len(message) < 400, (junk, message)


@pytest.mark.parametrize("name", CALLS)
def test_a_function_refuses_what_it_cannot_use(name: str) -> None:
    for junk in JUNK:
        message = refused(lambda junk=junk: CALLS[name](junk))
        assert message is None or 10 < len(message) < 450, (junk, message)


def test_every_value_at_the_top_level_is_tried() -> None:
    results = {
        "Decision",
        "Grasp",
        "Grip",
        "Hand",
        "Plan",
        "VirtualGrasp",
    }  # made by preshape, not by callers
    values = {name for name in preshape.__all__ if hasattr(getattr(preshape, name), "__dataclass_fields__")}
    assert values - results == {kind.__name__ for kind in GOOD if kind.__name__ in preshape.__all__}


REFUSALS: list[tuple[Callable[..., Any], dict[str, Any], str]] = [
    (preshape.FuzzySets, {"shape": np.zeros(6)}, "no fuzzy set shape array.*; known: trapezoid, triangle"),
    (preshape.Settings, {"finger_rule": np.zeros(2)}, "no finger rule array.*; known: up_to, all"),
    (preshape.Settings, {"seed": -1}, "seed must be a whole number of at least 0, got -1"),
    (preshape.Settings, {"thresholds": 3.0}, "must be a value of Thresholds, got 3.0"),
    (task_from_numbers, {"values": [0, 0, np.complex128(1 + 1j), 0, 0, 0]}, r"number 3 \(Tz\) is np.complex"),
    (task_from_numbers, {"values": np.ones(6) * 1j}, r"number 1 \(Tx\) is"),
    (preshape.Task, {"name": "x", "q": ["1"] * 6}, "task Q must be numbers, got"),
    (preshape.Task, {"name": 5, "q": np.ones(6)}, "of a task must be text"),
    (HoldProtocol, {"stages": 1.5}, "stages must be a whole number of at least 1, got 1.5"),
]


@pytest.mark.parametrize(("make", "given", "words"), REFUSALS)
def test_what_is_refused_is_named(make: Callable[..., Any], given: dict[str, Any], words: str) -> None:
    with pytest.raises(PreshapeError, match=words):
        make(**given)


@pytest.mark.parametrize("name", ["task", "analyser", "approaches", "hand", "thing", "unit", "table"])
def test_a_long_text_is_not_repeated_whole(name: str) -> None:
    asked = {"thing": "mug", "task": "lift", "memory": ":memory:", "learn": False, name: LONG}
    message = refused(lambda: preshape.plan(**asked))
    assert message
    assert "..." in message
    assert len(message) < 450


@pytest.mark.parametrize("folder", [None, 3, "", "a\0b", "\ud800", ["x"], b"x"])
def test_a_folder_that_is_no_path_is_refused(folder: Any) -> None:
    plan = preshape.plan("cube", "lift", memory=":memory:", learn=False, hand="utah_mit")
    assert "folder must be a path" in refused(lambda: plan.save(folder))
