"""The plan as JSON: the schema holds what is promised, and every output holds to the schema.

``python tests/test_plan_json.py`` writes ``docs/plan.example.json`` anew.
"""

from __future__ import annotations

import copy
import json
import sys
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from preshape.files import dumps
from preshape.hands.load import load_hand
from preshape.hiis.decision import Settings
from preshape.hiis.fuzzy import SET_NAMES
from preshape.hiis.learning import seed_cube
from preshape.hiis.planes import PLANES
from preshape.objects.library import load_library_object
from preshape.planner import plan
from preshape.planning.controllers import layout_of
from preshape.planning.document import (
    GRASP_KEYS,
    plan_schema,
    plan_to_json,
    read_plan,
    request_of,
    version_of,
)
from preshape.planning.hand_simulation import HandStatus
from preshape.planning.plan import Plan
from preshape.planning.request import PlanRequest

EXAMPLE = Path(__file__).parent.parent / "docs" / "plan.example.json"
PROMISED = {
    "schema", "executable", "best", "request", "mass", "mass_source", "heaviest_mass", "way_in",
    "fingers_touching", "missing_motion",
    "status", "reason", "mode", "deadlock", "plane", "flip", "approach_axis", "opposition_axis",
    "transverse_axis", "approach_value", "approach_set", "fingers", "tfvadi", "adi", "net_wrench",
    "stability", "manipulability", "cog", "U", "contacts", "transitions", "hand", "alternatives",
    "seconds", "version",
}  # fmt: skip
LATER = {
    (): ("known", "length_unit", "scene", "rules", "arm", "part"),
    ("request",): (
        "finger_rule",
        "up",
        "rest",
        "hold_on",
        "keep_off",
        "rules",
        "obstacle",
        "arm",
        "arm_tip",
        "mount",
        "base_pose",
    ),
}
"""Keys that were added after version 2 first came out, and where they stand."""
SCHEMA = plan_schema()
OUTPUT = {"$schema": SCHEMA["$schema"], "$ref": f"{SCHEMA['$id']}#/$defs/output"}


def validator(schema: dict = SCHEMA) -> jsonschema.Draft202012Validator:
    from referencing import Registry, Resource

    registry = Registry().with_resource(SCHEMA["$id"], Resource.from_contents(SCHEMA))
    return jsonschema.Draft202012Validator(schema, registry=registry)


def valid(document: object, schema: dict = SCHEMA) -> bool:
    return validator(schema).is_valid(document)


def made(thing="mug", task="pour", **options) -> Plan:
    return plan(thing, task, memory=":memory:", **{"hand": "utah_mit", "table": None, **options})


def example() -> dict:
    """The example: ``preshape plan mug --task pour --hand utah_mit --count 2 --memory :memory: --json``."""
    return plan_to_json(made(count=2))


def corners_only():
    """Two small cubes in opposite corners: no fingers find anything between them."""
    cube = load_library_object("cube")
    small = cube.vertices * 0.2
    return type(cube)(
        name="corners",
        vertices=np.concatenate([small - 0.03, small + 0.03]),
        triangles=np.concatenate([cube.triangles, cube.triangles + len(small)]),
    )


CUBE = seed_cube(layout_of(load_hand("utah_mit")))
"""The cube of the first lesson, which every memory knows."""


@pytest.fixture(scope="module")
def plans() -> dict[str, Plan]:
    strict = Settings.__dataclass_fields__["thresholds"].default_factory
    thresholds = type(strict())
    return {
        "mode 0": made(CUBE, "1 1 .1 .05 .8 .05"),
        "mode 2": made(CUBE, "0 0 0 2 2 2"),  # the cube is known, and no grasp of it does this
        "mode 3": made(count=2),
        "two fingers": made("pen", "insert", learn=False, count=4),
        "deadlock": made("dolphin", settings=Settings(thresholds=thresholds(estimation=5.99))),
        "no grasp": made(corners_only()),
        "scaled": made("apple", "lift", scale=1.5, learn=False),
    }


@pytest.fixture(scope="module")
def documents(plans) -> dict[str, dict]:
    return {name: plan_to_json(p) for name, p in plans.items()}


def test_every_plan_holds_to_the_schema(documents):
    for name, document in documents.items():
        errors = [f"{e.json_path}: {e.message}" for e in validator().iter_errors(document)]
        assert not errors, name
        assert valid(document, OUTPUT), name
        assert json.loads(dumps(document)) == document


def test_the_plans_of_this_test_end_in_every_status(documents):
    statuses = {d["status"] for d in documents.values()}
    assert statuses == {"answer", "task_correction", "deadlock", "no_grasp"}
    assert documents["mode 2"]["offers"]
    assert [a["status"] for a in documents["mode 3"]["alternatives"]] == ["answer"]


def test_every_promised_key_is_there_and_required_and_described():
    assert set(SCHEMA["properties"]) >= PROMISED
    assert set(SCHEMA["required"]) == set(SCHEMA["properties"]) - set(LATER[()])
    assert SCHEMA["additionalProperties"] is False

    def undescribed(node: object, path: str = "") -> list[str]:
        found = []
        if isinstance(node, dict):
            for key, property_ in node.get("properties", {}).items():
                below = f"{path}/{key}"
                if not (property_.get("description") or "$ref" in property_):
                    found.append(below)
                found += undescribed(property_, below)
        return found

    assert not undescribed({"properties": SCHEMA["properties"]})
    for name, definition in SCHEMA["$defs"].items():
        assert definition["description"], name
        assert not undescribed(definition, name)


def test_the_schema_is_one_of_draft_2020_12_and_alternatives_have_its_own_shape():
    assert SCHEMA["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    assert SCHEMA["properties"]["alternatives"]["items"] == {"$ref": "#"}


def test_the_schema_names_what_the_package_names():
    properties, hand = SCHEMA["properties"], SCHEMA["$defs"]["hand"]["properties"]
    assert properties["approach_set"]["enum"] == [*SET_NAMES, None]
    assert hand["status"]["enum"] == [*(status.name.lower() for status in HandStatus), None]
    assert set(GRASP_KEYS) <= set(properties)


# -- the schema refuses what is wrong ------------------------------------------------------------------


def broken(document: dict, *path: str | int, to: object) -> dict:
    changed = copy.deepcopy(document)
    node = changed
    for key in path[:-1]:
        node = node[key]
    node[path[-1]] = to
    return changed


def test_a_missing_key_or_a_new_one_is_refused(documents):
    document = documents["mode 3"]
    for key in set(document) - set(LATER[()]):
        assert not valid({k: v for k, v in document.items() if k != key}), key
    assert not valid({**document, "grasp": 1})
    for part in ("hand", "object", "task", "thresholds", "seconds"):
        assert not valid(broken(document, part, "more", to=1)), part
    for part in ("contacts", "transitions", "alternatives"):
        assert not valid(broken(document, part, 0, "more", to=1)), part


def test_an_answer_without_a_grasp_is_refused_and_so_is_a_grasp_without_an_answer(documents):
    answer = documents["mode 3"]
    for key in GRASP_KEYS:
        assert not valid(broken(answer, key, to=None)), key
        for name in ("mode 2", "deadlock", "no grasp"):
            assert not valid(broken(documents[name], key, to=answer[key])), (name, key)
    for name in ("mode 2", "deadlock", "no grasp"):
        for key in ("contacts", "hand", "alternatives"):
            assert not valid(broken(documents[name], key, to=answer[key])), (name, key)
        assert not valid(broken(answer, "status", to=documents[name]["status"]))


@pytest.mark.parametrize(
    ("path", "to"),
    [
        (["status"], "ok"),
        (["status"], "error"),
        (["reason"], ""),
        (["mode"], 4),
        (["mode"], 2),
        (["deadlock"], True),
        (["plane"], 0),
        (["plane"], 13),
        (["plane"], "5"),
        (["flip"], 1),
        (["approach_axis"], [0, 1]),
        (["approach_axis"], [0, 2, 0]),
        (["approach_value"], 1.5),
        (["approach_set"], "FWD"),
        (["fingers"], 5),
        (["fingers"], 6),
        (["contacts"], []),
        (["tfvadi"], 6.5),
        (["adi"], [1, 1, 1, 1, 1]),
        (["adi", 0], 1.5),
        (["net_wrench"], [0] * 5),
        (["net_wrench", 3], "1"),
        (["stability"], 7),
        (["manipulability"], -1),
        (["cog"], [0, 0]),
        (["U"], 0),
        (["contacts", 0, "point"], [0, 0]),
        (["contacts", 0, "finger"], 1),
        (["transitions"], []),
        (["transitions", 0, "outcome"], "perhaps"),
        (["hand", "grasp", "palm_pose"], [0] * 6),
        (["hand", "grasp"], None),
        (["hand", "status"], "collision"),
        (["hand", "status"], None),
        (["offers"], [{"task": "lift:+z", "q": [0] * 6, "tfvadi": 4.0, "mode": 0}]),
        (["object", "extents"], [0.1, 0, 0.1]),
        (["object", "triangles"], 1.5),
        (["task", "q"], [0] * 7),
        (["thresholds", "estimation"], 7),
        (["seconds", "total"], -1),
        (["version"], "new"),
        (["alternatives", 0, "status"], "error"),
        (["alternatives", 0, "plane"], None),
    ],
)
def test_a_value_out_of_its_range_is_refused(documents, path, to):
    document = documents["mode 3"]
    assert document["hand"]["status"] == "reached"
    assert not valid(broken(document, *path, to=to))


def test_an_error_is_no_plan_and_a_plan_no_error():
    error = {"status": "error", "reason": "no object 'mugg'"}
    assert error == {"status": "error", "reason": "no object 'mugg'"}
    assert valid(error, OUTPUT)
    assert not valid(error)
    for bad in ({"status": "error"}, {**error, "reason": ""}, {**error, "mode": 0}, {"reason": "x"}, {}, []):
        assert not valid(bad, OUTPUT)


# -- what the schema cannot say ------------------------------------------------------------------------


def answers(documents: dict[str, dict]) -> list[dict]:
    own = [d for d in documents.values() if d["status"] == "answer"]
    return own + [a for d in own for a in d["alternatives"]]


def test_the_axes_are_those_of_the_plane_and_right_handed(documents):
    for d in answers(documents):
        p = PLANES[d["plane"] - 1]
        a, o, t = (np.array(d[f"{name}_axis"]) for name in ("approach", "opposition", "transverse"))
        assert a.tolist() == p.approach_axis.tolist()
        assert o.tolist() == p.opposition_axis.tolist()
        assert t.tolist() == np.cross(a, o).tolist()
        assert "-0.0" not in json.dumps([d["approach_axis"], d["opposition_axis"], d["transverse_axis"]])


def test_every_answer_has_a_reason_of_its_own(documents):
    for d in documents.values():
        if d["status"] == "answer":
            assert d["reason"] == d["transitions"][-1]["reason"]
        for other in d.get("alternatives", ()):
            assert f"plane {other['plane']}" in other["reason"]
            assert f"{other['tfvadi']:.2f}" in other["reason"]


def test_the_numbers_of_an_answer_agree_with_each_other(documents):
    for d in answers(documents):
        assert d["tfvadi"] == pytest.approx(sum(d["adi"]))
        assert d["tfvadi"] >= d["thresholds"]["estimation"] - 1e-9
        assert d["stability"] <= d["manipulability"] <= d["fingers"]
        assert d["mode"] == d["transitions"][-1]["mode"]
        s = d["seconds"]
        assert s["load"] + s["prepare"] + s["search"] == pytest.approx(s["total"], abs=1e-5)


def test_the_contacts_lie_on_the_object_in_the_mesh_frame(plans):
    for p in plans.values():
        if p.answer is None:
            continue
        document = plan_to_json(p)
        low, high = p.mesh.bounds
        a, o = np.array(document["approach_axis"]), np.array(document["opposition_axis"])
        thumb_side = -o if document["flip"] else o
        half = np.abs(a) @ p.mesh.extents / 2
        assert document["contacts"][0]["finger"] == "thumb"
        assert document["cog"] == pytest.approx((low + high) / 2)
        for contact, triangle in zip(document["contacts"], p.answer.grasp.contacts.triangles, strict=True):
            point, normal = np.array(contact["point"]), np.array(contact["normal_in"])
            assert (point >= low - 1e-9).all()
            assert (point <= high + 1e-9).all()
            assert np.linalg.norm(normal) == pytest.approx(1)
            facet = p.mesh.normals[triangle]
            assert abs(facet @ (point - p.mesh.corners[triangle, 0])) < 1e-9
            v = a @ (point - p.mesh.cog) / half
            assert v == pytest.approx(document["approach_value"], abs=1e-6)
            outwards = thumb_side if contact["finger"] == "thumb" else -thumb_side
            assert normal @ outwards < 0
        net = sum(np.array(w) for w in p.answer.grasp.contacts.wrenches)
        assert document["net_wrench"] == pytest.approx(net)


def test_a_pose_is_the_palm_s_place_a_unit_quaternion_and_every_joint(documents):
    poses = 0
    for d in answers(documents):
        for moment in ("pregrasp", "grasp", "squeeze", "retracted"):
            pose = d["hand"][moment]
            if pose is not None:
                poses += 1
                assert np.linalg.norm(pose["palm_pose"][3:]) == pytest.approx(1)
                assert np.linalg.norm(np.array(pose["palm_pose"][:3]) - d["cog"]) < 0.5
                assert len(pose["q"]) == len(d["hand"]["joints"])
    assert poses >= 6


def test_scale_is_in_the_numbers(plans, documents):
    plain = load_library_object("apple")
    assert documents["scaled"]["object"]["extents"] == pytest.approx((1.5 * plain.extents).tolist())


# -- the example ---------------------------------------------------------------------------------------


def test_the_example_is_a_real_output():
    """But for the seconds; write it anew where the planner has changed on purpose."""
    stored, now = json.loads(EXAMPLE.read_text(encoding="utf-8")), example()
    assert valid(stored)
    assert set(stored["seconds"]) == set(now["seconds"])

    def compare(a: object, b: object, path: str) -> None:
        if isinstance(a, dict):
            assert isinstance(b, dict), path
            assert a.keys() == b.keys(), path
            for key in a.keys() - {"seconds", "version"}:
                compare(a[key], b[key], f"{path}.{key}")
        elif isinstance(a, list):
            assert isinstance(b, list), path
            assert len(a) == len(b), path
            for i, (x, y) in enumerate(zip(a, b, strict=True)):
                compare(x, y, f"{path}[{i}]")
        elif isinstance(a, float):
            # The hand's posture is found by iteration and may end a little elsewhere on another machine.
            assert b == pytest.approx(a, abs=1e-3 if ".hand" in path else 1e-6), path
        else:
            assert a == b, path

    compare(stored, now, "$")


if __name__ == "__main__":
    EXAMPLE.write_text(dumps(example()) + "\n", encoding="utf-8")
    sys.stdout.write(f"wrote {EXAMPLE}\n")


def test_keys_added_later_are_always_written(documents):
    for document in documents.values():
        for where, keys in LATER.items():
            part = document[where[0]] if where else document
            described = SCHEMA["$defs"][where[0]] if where else SCHEMA
            assert set(keys) <= set(part)
            assert set(part) == set(described["properties"])


def test_a_first_plan_of_version_2_is_valid_and_read(tmp_path):
    # Made by hand: what a plan without an answer has at least, and none of the keys that were added later.
    nothing = dict.fromkeys([*GRASP_KEYS, "way_in", "fingers_touching", "heaviest_mass", "grip"])
    request = {
        "object": {"source": "mug", "unit": "m", "scale": 1.0, "view": None},
        "task": {"name": "lift", "q": [0.1, 0.1, 1, 0.05, 0.05, 0.05], "displacement": None, "axis": "+z",
                 "means": "Raise.", "gravity": [0, 0, -1], "primitives": []},
        "hand": "utah_mit", "analyser": "rays", "mass": None, "friction": 0.6, "table": None, "avoid": [],
        "gravity": [0, 0, -1], "approaches": None, "count": 1, "learn": True, "verify": False, "seed": 0,
        "thresholds": {"estimation": 3.0, "recognition": 5.0},
        "sets": {"corners": [[-1, -1, 0, 0]] * 7, "shape": "triangle"},
        "coefficients": {"ka": 0.45, "ko": 0.3, "kn": 1.0, "mn": 0.8},
        "search": PlanRequest(source="mug", task="lift", hand="utah_mit").to_json()["search"], "memory": None,
    }  # fmt: skip
    document = {
        "schema": 2, "status": "no_grasp", "executable": False, "reason": "no grasp found", "mode": 3,
        "deadlock": False, **nothing, "mass": 0.3, "mass_source": "known", "cog": [0, 0, 0], "U": 0.043,
        "contacts": [], "warnings": [], "missing_motion": "", "verified": None, "cloud": None, "best": None,
        "transitions": [{"mode": 3, "outcome": "no grasp", "reason": "no grasp found"}],
        "hand": {"name": "utah_mit", "joints": ["j"], "status": None, "reason": None, "pregrasp": None,
                 "grasp": None, "squeeze": None, "retracted": None},
        "alternatives": [], "offers": [], "request": request, "version": "0.1.0",
        "object": {"name": "mug", "source": "mug", "extents": [0.1, 0.08, 0.09], "vertices": 8,
                   "vertex_normals": 8, "faces": 12, "triangles": 12},
        "task": {"name": "lift:+z", "q": [0.1, 0.1, 1, 0.05, 0.05, 0.05], "means": "Raise."},
        "thresholds": {"estimation": 3.0, "recognition": 5.0},
        "seconds": {"load": 0.1, "prepare": 0.1, "search": 0.1, "total": 0.3},
    }  # fmt: skip
    assert [f"{e.json_path}: {e.message}" for e in validator().iter_errors(document)] == []
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    asked = request_of(read_plan(path))
    assert (asked.source, asked.settings.finger_rule, asked.asked.label) == ("mug", "up_to", "lift:+z")
    # A document without the key ``schema`` is version 1: it is read, but the schema does not describe it.
    del document["schema"]
    assert not valid(document)
    path.write_text(json.dumps(document), encoding="utf-8")
    assert version_of(read_plan(path)) == 1
