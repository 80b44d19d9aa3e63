"""Every argument of a request: what is refused, by which sentence, and what NumPy may give."""

from __future__ import annotations

import copy
import inspect
import json
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import preshape
from preshape.closure.settings import ClosureSettings
from preshape.exceptions import InputError
from preshape.hiis.decision import Settings
from preshape.objects.library import load_library_object
from preshape.objects.load import mesh_from
from preshape.objects.mass import object_mass
from preshape.objects.mesh import TriangleMesh
from preshape.planning.request import PlanRequest
from preshape.planning.session import Session
from preshape.types import ContactCoefficients

HUGE = 10**400
NAN, INF = float("nan"), float("inf")
BOX = [0.1, 0.1, 0.1, 0.2, 0.2, 0.2]
JUNK: list[Any] = [
    None, True, False, 0, -1, 5, 1.5, NAN, INF, HUGE, 1j, "", "x", "\0", "1", b"x", [], {}, {"a": 1}, {1, 2},
    [1], [[]], [None], "xyz", object(), int, np.array(1.0), np.array([1.0, 2.0]), np.zeros((2, 3)),
    np.array([1j, 0, 0]), np.float32(0.5), np.int64(2), np.bool_(True), np.str_("x"), [HUGE] * 3, [NAN] * 3,
    [1j] * 3, [[1, 2], [3]], range(6), ["1"] * 6, [True] * 6,
]  # fmt: skip

REFUSED: dict[str, list[tuple[Any, str]]] = {
    "source": [(None, "TriangleMesh"), (5, "TriangleMesh"), (["mug"], "TriangleMesh")],
    "task": [(None, "six numbers"), (5, "six numbers"), ([1, 2], "six numbers"), ([NAN] * 6, "finite"),
             ({}, "six numbers"), ("fly", "lift")],
    "hand": [(None, "hand"), (5, "hand"), (["shadow"], "hand")],
    "analyser": [("magic", "rays, closure"), (5, "rays or closure"), (np.zeros(2), "rays or closure")],
    "unit": [("yard", "known: m"), (5, "known: m"), (["m"], "known: m"), (None, "known: m")],
    "scale": [(0, "scale"), (-1.0, "scale"), (NAN, "scale"), ("2", "scale"), (HUGE, "scale"), (1j, "scale"),
              (True, "scale"), (None, "scale")],
    "mask": [(True, "a mask is"), ("", "a mask is"), ([1], "a mask is"), (1.5, "a mask is")],
    "cut_table": [(1, "True, False or None"), ("yes", "True, False or None")],
    "view": [("left", "camera"), (5, "camera"), ([1, 2], "camera"), ([1, 2, NAN], "camera"), ({}, "camera")],
    "mass": [(0, "mass"), (-1.0, "mass"), (NAN, "mass"), ("1", "mass"), (True, "mass"), (HUGE, "mass"),
             ([1.0], "mass")],
    "friction": [(0, "friction"), (-1.0, "friction"), (INF, "friction"), ("1", "friction"), (1j, "friction")],
    "table": [("high", "none or default"), (NAN, "none or default"), (True, "none or default"),
              ([0.0], "none or default"), (HUGE, "none or default"), (1e9, "at most")],
    "avoid": [(5, "list of boxes"), ("x", "six numbers"), (None, "list of boxes"), ([5], "six numbers"),
              (BOX, "six numbers"), ([BOX[:5]], "six numbers"), ([[*BOX[:5], "a"]], "six numbers"),
              ([[*BOX[:5], NAN]], "finite"), ([BOX[::-1]], "lower corner"), ([[*BOX[:5], 1e9]], "at most")],
    "gravity": [(5, "unit vector"), ([0, 0], "unit vector"), ([0, 0, -9.81], "divide the vector"),
                ("down", "unit vector"), ([0, 0, NAN], "unit vector"), (0, "unit vector"),
                ([0, 0, 1j], "unit vector"), ([0, 0, 1e-9], "divide the vector")],
    "approaches": [(5, "approach axes"), ("up", "axis"), (["+z"], "approach axes"), ("", "approaches")],
    "grasp_type": [("strong", "any, power"), (5, "any, power"), (None, "any, power"), ("", "any, power")],
    "count": [("x", "count"), (0, "count"), (-1, "count"), (1.0, "count"), (True, "count"), (None, "count")],
    "learn": [("no", "learn"), (0, "learn"), (None, "learn")],
    "verify": [("no", "verify"), (1, "verify"), (None, "verify")],
    "settings": [(5, "Settings"), ({}, "Settings")],
    "search": [(5, "ClosureSettings"), ({}, "ClosureSettings")],
    "memory": [(5, "memory"), (["m.sqlite"], "memory"), (b"m.sqlite", "memory")],
    "obstacle": [(5, "obstacle"), ([5], "obstacle"), ("", "obstacle"), (None, "obstacle"),
                 ("a.obj@1,2,3", "obstacle"), ("a.obj@0,0,0,2,0,0,0", "length 2"),
                 ("@0,0,0,1,0,0,0", "obstacle")],
    "hold_on": [(5, "a part's name"), ([5], "a part's name"), ("", "a part's name"), (["a", " "], "a part's"),
                (None, "a part's name"), ({}, "a part's name"), ("x" * 300, "a part's name")],
    "keep_off": [(5, "a part's name"), ([b"x"], "a part's name"), ([""], "a part's name")],
    "rules": [("all", "task, none"), (None, "task, none"), (5, "task, none"), (True, "task, none")],
    "up": [(5, "one of x, y, z"), ("+z", "one of x, y"), ("", "one of x, y"), (["y"], "one of x, y")],
    "rest": [(5, "quaternion"), ([1, 0, 0], "quaternion"), ([0, 0, 0, 0], "quaternion"),
             ("wxyz", "quaternion"), ([1, 0, 0, NAN], "finite")],
    "arm": [(5, "URDF"), ("", "URDF"), (["a.urdf"], "URDF"), ("a.urdf", "link that carries the hand")],
    "arm_tip": [("tip", "belongs to an arm"), (5, "belongs to an arm")],
    "mount": [([0, 0, 0, 1, 0, 0, 0], "belongs to an arm"), ("x", "belongs to an arm")],
    "base_pose": [([0, 0, 0, 1, 0, 0, 0], "belongs to an arm"), (5, "belongs to an arm")],
}  # fmt: skip
"""For each field of a request, values that are refused, and a word of the sentence."""

CASES = [pytest.param(name, bad, word, id=f"{name}-{k}") for name, rows in REFUSED.items()
         for k, (bad, word) in enumerate(rows)]  # fmt: skip
RENAMED = {"source": "thing", "search": "closure"}
ASKED: dict[str, Any] = {"source": "mug", "task": "lift", "hand": "shadow"}


def request(**changes: Any) -> PlanRequest:
    return PlanRequest(**(ASKED | changes))


def test_no_field_is_left_out() -> None:
    assert set(REFUSED) == {field.name for field in fields(PlanRequest)}
    asked = {RENAMED.get(name, name) for name in REFUSED} - {"gravity"} | {"seed"}
    assert asked == set(inspect.signature(preshape.plan).parameters)


@pytest.mark.parametrize(("name", "bad", "word"), CASES)
def test_a_request_refuses_a_bad_value(name: str, bad: Any, word: str) -> None:
    with pytest.raises(InputError, match=word) as error:
        request(**{name: bad})
    assert len(str(error.value)) < 400


@pytest.mark.parametrize(("name", "bad", "word"), [case for case in CASES if case.values[0] != "gravity"])
def test_plan_refuses_a_bad_value(name: str, bad: Any, word: str) -> None:
    if (bad is None and name == "memory") or (name == "search" and bad is None):
        pytest.skip("None is the default")
    if name == "source":
        word = "trimesh"
    arguments = ASKED | {"memory": ":memory:", name: bad}
    with pytest.raises(InputError, match=word):
        preshape.plan(**{RENAMED.get(key, key): content for key, content in arguments.items()})


@pytest.mark.parametrize("seed", [-1, 1.5, "x", None, True, NAN, [1]])
@pytest.mark.parametrize("settings", [None, Settings(seed=3)])
def test_a_bad_seed_is_refused(seed: Any, settings: Settings | None) -> None:
    with pytest.raises(InputError, match="seed must be a whole number of at least 0, got"):
        preshape.plan("mug", "lift", seed=seed, settings=settings, memory=":memory:", hand="utah_mit")


@pytest.mark.parametrize("name", list(REFUSED))
def test_any_value_is_used_or_refused(name: str) -> None:
    for junk in JUNK:
        try:
            made = request(**{name: junk})
        except InputError:
            continue
        document = json.loads(json.dumps(made.to_json(), allow_nan=False))
        assert PlanRequest.from_json(document).to_json() == document


def places(part: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Every node of a JSON document but one of each list of numbers."""
    yield path
    if isinstance(part, dict):
        for key, content in part.items():
            yield from places(content, (*path, key))
    elif isinstance(part, list) and part:
        yield from places(part[0], (*path, 0))


IN_JSON: list[Any] = [
    None, True, 0, -1, 1.5, NAN, INF, HUGE, "", "x", "\0", [], {}, [1], [[]], {"a": 1}, [None] * 3,
    [HUGE] * 6,
]  # fmt: skip


def test_any_json_is_a_request_or_refused() -> None:
    good = json.loads(
        json.dumps(request(avoid=[BOX], view=[0, 0, 1], mass=0.2, table=-0.2, approaches="+z").to_json())
    )
    refused = 0
    for path in places(good):
        for junk in IN_JSON:
            document = copy.deepcopy(good)
            part = document
            for key in path[:-1]:
                part = part[key]
            if path:
                part[path[-1]] = junk
            else:
                document = junk
            try:
                made = PlanRequest.from_json(document)
            except InputError:
                refused += 1
                continue
            assert json.loads(json.dumps(made.to_json(), allow_nan=False))
    assert refused > 500


@pytest.mark.parametrize(
    ("name", "bad", "word"),
    [
        ("seed", 1.5, "seed"), ("seed", -1, "seed"), ("seed", "3", "seed"), ("hand", 5, "hand"),
        ("count", "x", "count"), ("count", 2.0, "count"), ("mass", "1", "mass"), ("learn", 1, "learn"),
        ("memory", 5, "memory"), ("avoid", 5, "list of boxes"), ("gravity", [0, 0, 2], "unit vector"),
    ],
)  # fmt: skip
def test_json_is_read_without_conversion(name: str, bad: Any, word: str) -> None:
    with pytest.raises(InputError, match=word):
        PlanRequest.from_json(request().to_json() | {name: bad})


@pytest.mark.parametrize(
    ("name", "given", "want"),
    [
        ("mass", np.float32(0.25), 0.25), ("mass", np.int64(1), 1.0), ("friction", np.float32(0.5), 0.5),
        ("scale", np.float32(0.5), 0.5), ("scale", np.int16(2), 2.0), ("count", np.int64(3), 3),
        ("count", np.uint8(3), 3), ("table", np.float32(-0.5), -0.5), ("learn", np.bool_(False), False),
        ("verify", np.bool_(True), True), ("avoid", np.array([BOX]), [BOX]),
        ("avoid", [tuple(map(np.float64, BOX))], [BOX]), ("view", np.array([1, 2, 3]), [1.0, 2.0, 3.0]),
        ("gravity", np.array([0, -1, 0]), [0.0, -1.0, 0.0]), ("gravity", (0, 0, 0), [0.0, 0.0, 0.0]),
        ("memory", Path("m.sqlite"), "m.sqlite"), ("settings", Settings(seed=np.int64(4)), 4),
        ("analyser", None, "closure"), ("hand", Path("leap"), "leap"),
    ],
)  # fmt: skip
def test_numpy_and_paths_are_values(name: str, given: Any, want: Any) -> None:
    document = json.loads(json.dumps(request(**{name: given}).to_json()))
    key = {"settings": "seed"}.get(name, name)
    found = document["object"][key] if name in ("scale", "view") else document[key]
    assert found == want
    assert type(found) is type(want)


def test_a_gravity_is_of_length_one_to_the_last_bit() -> None:
    tilted = np.array([1.0, 2.0, 2.0], dtype=np.float32) / np.float32(3)
    held = request(gravity=tilted)
    assert np.linalg.norm(held.gravity) == pytest.approx(1.0, abs=1e-15)
    assert request(gravity=held.gravity).to_json() == held.to_json()


def test_the_search_and_the_coefficients_take_numpy_and_name_what_they_refuse() -> None:
    search = ClosureSettings(threads=np.int64(2), elite=np.int32(8), safety=np.float32(1.5))
    settings = Settings(coefficients=ContactCoefficients(ka=np.float32(0.5)))
    assert json.dumps(request(search=search, settings=settings).to_json())
    for bad in ({"safety": HUGE}, {"safety": 1j}, {"elite": 8.0}, {"threads": "2"}, {"obstacles": 5}):
        with pytest.raises(InputError, match=next(iter(bad))):
            ClosureSettings(**bad)
    for junk in ("0.4", None, NAN, [1.0]):
        with pytest.raises(InputError, match="coefficient ko must be a finite number"):
            ContactCoefficients(ko=junk)


def test_a_float32_friction_of_the_default_is_the_default() -> None:
    assert request(hand="utah_mit", friction=np.float32(0.6)).analyser == "rays"


def test_a_session_names_a_memory_that_is_none() -> None:
    with pytest.raises(InputError, match="memory must be a file"):
        Session(5)  # type: ignore[arg-type]


def test_a_mass_of_numpy_is_planned_for() -> None:
    assert object_mass(load_library_object("mug"), np.float32(0.25)).kg == 0.25


@pytest.mark.parametrize(
    "faces", ["x", [[0, 1]], [[0, 1, 1.5]], [], [[0, 1, 9]], [[0, 1, 2**70]], [["a"] * 3]]
)
def test_a_mesh_of_another_library_is_checked(faces: Any) -> None:
    other = SimpleNamespace(vertices=np.eye(3), faces=faces, metadata=None)
    with pytest.raises(InputError, match="mesh"):
        mesh_from(other)


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"name": ""}, "name"), ({"name": " "}, "name"), ({"name": 5}, "name"), ({"name": "\ud800"}, "name"),
        ({"mass": -1.0}, "mass"), ({"mass": "1"}, "mass"), ({"mass": NAN}, "mass"), ({"scale": 0}, "scale"),
    ],
)  # fmt: skip
def test_a_mesh_that_no_plan_could_use_is_refused(changes: dict[str, Any], word: str) -> None:
    cube = load_library_object("cube")
    with pytest.raises(InputError, match=word):
        TriangleMesh(**{"name": "part", "vertices": cube.vertices, "triangles": cube.triangles, **changes})
