"""Requests and sessions: masses, scenes, what is known, and what a plan says when there is no answer."""

from __future__ import annotations

import json
import shutil
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import preshape
from preshape.cli.main import run
from preshape.closure.settings import ClosureSettings
from preshape.exceptions import Cancelled, InputError, ObjectError
from preshape.hiis.analyser import Aim, Grip
from preshape.hiis.critic import Thresholds
from preshape.hiis.decision import Settings, Status
from preshape.memory import Memory
from preshape.memory.records import SCENE_LENGTH
from preshape.objects.library import entry, load_library_object, names
from preshape.objects.mass import object_mass
from preshape.objects.mesh import TriangleMesh
from preshape.planning.controllers import CLOSURE_SUFFIX
from preshape.planning.document import plan_to_json, planned_load, read_plan, request_of
from preshape.planning.hand_simulation import execute
from preshape.planning.request import PlanRequest
from preshape.planning.session import Session
from preshape.planning.summary import summary_text
from preshape.tasks.task import COMPONENTS
from preshape.viewer.words import scene_words

QUICK = ClosureSettings(
    everywhere=300, on_plane=120, at_aim=60, wraps=600, persistence=0, rounds=1, elite=8, finished=3
)
CAREFUL = replace(QUICK, bold_share=QUICK.friction_share)
"""A search that never counts on more of the friction."""
DATA = Path(__file__).parent / "data"
pytestmark = pytest.mark.usefixtures("small_pictures")


@pytest.fixture
def session(lesson: Callable[[str], Path], tmp_path: Path) -> Iterator[Session]:
    """A session whose memory has the first lesson of the Shadow."""
    with Session(shutil.copy(lesson("shadow"), tmp_path / "memory.sqlite")) as one:
        yield one


def asked(name: Any = "box", task: Any = "lift", **changes: Any) -> PlanRequest:
    given = {"hand": "shadow", "search": QUICK, "table": None, **changes}
    return PlanRequest(**{"source": name, "task": task, **given})


# -- the request ----------------------------------------------------------------------------------------


def test_a_request_survives_its_json() -> None:
    request = asked(
        "mug", [1, 0.2, 0, 0.3, 0, 0], table=-0.2, avoid=[[0, 0, 0, 1, 1, 1]], mass=0.2, friction=0.5,
        count=3, approaches="+z", view="all", verify=True, learn=False, settings=Settings(seed=4),
        gravity=[0, 0, 0], memory="here.sqlite",
    )  # fmt: skip
    document = json.loads(json.dumps(request.to_json()))
    assert PlanRequest.from_json(document).to_json() == request.to_json()
    assert PlanRequest.from_json(document, source="pear").to_json()["object"]["source"] == "pear"


@pytest.mark.parametrize("missing", ["object", "thresholds", "search", "mass", "table"])
def test_a_request_with_a_key_missing_is_refused(missing: str) -> None:
    document = asked().to_json()
    del document[missing]
    with pytest.raises(InputError, match="no request of preshape"):
        PlanRequest.from_json(document)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"count": 0}, "at least 1"),
        ({"table": "high"}, "height in metres, auto, none or default"),
        ({"table": float("nan")}, "height in metres"),
        ({"avoid": [[0, 0, 0, 1, 1]]}, "a box to avoid"),
        ({"avoid": [[0, 0, 0, 1, 1, -1]]}, "lower corner"),
        ({"analyser": "magic"}, "known: rays, closure"),
        ({"hand": "utah_mit", "table": "auto"}, "closure analyser"),
        ({"hand": "utah_mit", "mass": 0.2}, "--verify"),
        ({"hand": "utah_mit", "friction": 0.2}, "--verify"),
        ({"approaches": "up"}, "axis"),
        ({"source": load_library_object("cube"), "scale": 2.0}, "for files"),
    ],
)
def test_a_request_that_cannot_be_served_is_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        asked(**{"search": ClosureSettings(), **changes})


def test_a_table_may_be_low_and_never_above_the_lowest_point() -> None:
    mug = load_library_object("mug")
    lowest = float(mug.bounds[0, 2])
    assert len(asked(table="none").obstacles(mug)) == 0
    for table, height in (("auto", lowest), (lowest - 0.05, lowest - 0.05)):
        plane = asked(table=table).obstacles(mug).planes
        assert plane == pytest.approx(np.array([[0.0, 0.0, 1.0, height]]), abs=1e-9)
    with pytest.raises(InputError, match="would stand in it"):
        asked(table=lowest + 0.01).obstacles(mug)


@pytest.mark.parametrize(
    ("words", "table"),
    [
        ("--table -0.05 --task lift", -0.05),
        ("--table=-0.05 --task lift", -0.05),
        ("--table -.05 --task lift", -0.05),
        ("--table --task lift", "auto"),  # without a number it leaves the next option alone
    ],
)
def test_a_table_reaches_the_request(
    words: str, table: float | str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found: list[PlanRequest] = []

    def refuse(_: Session, request: PlanRequest) -> None:
        found.append(request)
        raise InputError("not today")

    monkeypatch.setattr(Session, "run", refuse)
    assert run(["plan", "box", "--hand", "shadow", "--memory", ":memory:", "--json", *words.split()]) == 2
    assert "not today" in capsys.readouterr().out
    assert [(request.table, request.asked.name) for request in found] == [(table, "lift")]


def test_a_box_out_of_reach_is_told(session: Session) -> None:
    far = session.run(asked(avoid=[[5, 5, 5, 6, 6, 6], [0.04, -0.1, -0.1, 0.2, 0.1, 0.1]]))
    assert len(far.warnings) == 1
    assert "out of the hand's reach" in far.warnings[0]
    assert far.warnings[0] in plan_to_json(far)["warnings"]


GRID = [
    [x / 50 - 0.2, y / 50 - 0.2, -0.4, x / 50 - 0.19, y / 50 - 0.19, -0.38]
    for x in range(20)
    for y in range(10)
]
"""200 boxes under the object, out of the hand's way."""


def test_the_scene_of_many_boxes_is_a_digest_that_is_the_same_everywhere() -> None:
    mug = load_library_object("mug")
    scene = asked(avoid=GRID, table="auto", mass=0.5).scene(mug)
    assert scene == "table 0 mm under the object; 200 boxes 2e096fa4bf54228b692b95aa2609c0eb; load 0.5 kg"
    assert asked(avoid=GRID[::-1], table="auto", mass=0.5).scene(mug) == scene
    assert asked(avoid=[*GRID[1:], [*GRID[0][:5], -0.37]], table="auto", mass=0.5).scene(mug) != scene
    assert asked(avoid=GRID[1:], table="auto", mass=0.5).scene(mug) != scene
    shift = np.array([0.3, -0.2, 0.1])
    moved = TriangleMesh(name="mug", vertices=mug.vertices + shift, triangles=mug.triangles, mass=0.3)
    there = (np.array(GRID).reshape(-1, 2, 3) + shift).reshape(-1, 6)
    assert asked(avoid=there, table="auto", mass=0.5).scene(moved) == scene
    # A text that the memory can store stays as it always was, so that its lessons are found again.
    few = asked(avoid=GRID[:100]).scene(mug)
    assert few.startswith("box -200 -200 -400 -190 -190 -380; box ")
    assert few.count("box ") == 100
    assert max(len(asked(avoid=GRID[:k]).scene(mug)) for k in range(100, 200)) <= SCENE_LENGTH


def test_lessons_among_many_boxes_are_found_again(tmp_path: Path) -> None:
    request = asked("box", "lift", avoid=GRID)
    with Session(tmp_path / "m.sqlite") as session:
        first = session.teach(request)
        assert first.decision.mode == 3
        again = session.run(request)
    assert again.decision.mode == 0
    assert again.decision.reason.startswith("known:")
    with Memory.open(tmp_path / "m.sqlite", read_only=True) as store:
        lessons = [e for e in store.experiences() if e.object_name == "box"]
    assert {e.scene for e in lessons} == {request.scene(first.mesh)}


# -- the mass -------------------------------------------------------------------------------------------


def test_an_object_is_planned_at_its_own_mass(session: Session) -> None:
    dumbbell = session.run(asked("dumbbell", "lift"))
    assert dumbbell.mass.kg == entry("dumbbell").mass == 1.0
    document = plan_to_json(dumbbell)
    assert (document["mass"], document["mass_source"]) == (1.0, "known")
    assert "1 kg (the object's own mass)" in str(dumbbell)


def test_a_mass_is_given_known_or_estimated_in_that_order() -> None:
    mug = load_library_object("mug")
    nameless = replace_mass(mug, None)
    assert (object_mass(mug, 0.2).kg, object_mass(mug, 0.2).source) == (0.2, "given")
    assert (object_mass(mug).kg, object_mass(mug).source) == (0.3, "known")
    # The mug's solid is 117 cm³ of china: as much water is 0.117 kg; a tenth of the size would be 0.1 g.
    assert object_mass(nameless).kg == pytest.approx(1000 * mug.volume)
    assert object_mass(nameless).source == "volume"
    small = TriangleMesh(name="small", vertices=0.3 * mug.vertices, triangles=mug.triangles)
    assert object_mass(small).kg == 0.1
    turned = TriangleMesh(name="inside out", vertices=mug.vertices, triangles=mug.triangles[:, ::-1])
    assert object_mass(turned).kg == pytest.approx(1000 * mug.volume)


def replace_mass(mesh: TriangleMesh, mass: float | None) -> TriangleMesh:
    return TriangleMesh(name=mesh.name, vertices=mesh.vertices, triangles=mesh.triangles, mass=mass)


@pytest.mark.parametrize(("mass", "word"), [(50.0, "denser"), (1e-5, "lighter")])
def test_an_absurd_density_names_the_unit(mass: float, word: str) -> None:
    warning = object_mass(load_library_object("mug"), mass).warning
    assert word in warning
    assert "kilograms" in warning
    assert not object_mass(load_library_object("mug"), 0.3).warning


def test_an_absurd_density_is_told_whatever_the_mass_comes_from() -> None:
    mug = load_library_object("mug")

    def warned(size: float, mass: float | None = None, given: float | None = None) -> str:
        mesh = TriangleMesh(name="part", vertices=size * mug.vertices, triangles=mug.triangles, mass=mass)
        return object_mass(mesh, given).warning

    assert not warned(1.0)
    assert not warned(0.5)  # 15 cm³ at the least mass of 0.1 kg is as dense as steel
    assert "the assumed mass of 0.1 kg" in warned(0.01)
    assert "check the unit of the file: --scale 100" in warned(0.01)
    assert "denser" in warned(0.01)
    assert "filled with water weighs" in warned(10.0)  # 117 kg
    assert not warned(9.0)
    assert "check the mass of the object" in warned(1.0, mass=1e4)
    assert "lighter" in warned(1.0, mass=1e-5)
    assert not warned(1.0, mass=0.3)
    assert "check --mass" in warned(1.0, mass=0.3, given=1e4)
    assert not any(object_mass(load_library_object(name)).warning for name in names())
    tiny = TriangleMesh(name="tiny", vertices=0.05 * mug.vertices, triangles=mug.triangles)
    plan = preshape.plan(tiny, "lift", hand="utah_mit", memory=":memory:")
    assert "denser than any metal" in plan.warnings[0]
    assert plan.warnings[0] in plan_to_json(plan)["warnings"]


def test_a_sheet_has_at_least_the_density_of_its_box() -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0.5], [1, 1, 0.5], [0, 1, 0]])
    for size, word in ((0.1, ""), (0.001, "denser")):
        sheet = TriangleMesh(name="sheet", vertices=size * corners, triangles=[[0, 1, 2], [2, 3, 0]])
        assert word in object_mass(sheet).warning
        assert bool(object_mass(sheet).warning) == bool(word)
        assert not object_mass(sheet, 1e-12).warning  # nobody can say how light the body is


@pytest.mark.parametrize("mass", [0, -1, float("nan"), float("inf"), True, "1"])
def test_a_mass_that_is_none_is_refused(mass: Any) -> None:
    with pytest.raises(InputError, match="positive number of kilograms"):
        object_mass(load_library_object("mug"), mass)


@pytest.mark.parametrize(("name", "task"), [("box", "lift"), ("bolt", "screw")])
def test_the_heaviest_mass_is_where_the_grip_stops_being_good_enough(
    session: Session, name: str, task: str
) -> None:
    plan = session.run(asked(name, task, learn=False, search=CAREFUL))
    assert plan.answer is not None
    heaviest = plan.answer.heaviest
    assert heaviest is not None
    assert heaviest >= plan.mass.kg * 0.98
    q = plan.request.asked.q
    stored = session.prepare(plan.request).element
    lesson = grip_lesson(plan, stored.layout.name)
    for factor, enough in ((0.93, True), (1.07, False)):
        request = asked(name, task, learn=False, mass=heaviest * factor, search=CAREFUL)
        heavier = session.prepare(request).element
        heavier.explore(q, Aim(values=plan.settings.sets.crisp()))  # all was looked at: no better one waits
        again = heavier.recall(q, [lesson])
        good = bool(again) and again[0].judged >= 3.0 - 1e-9
        assert good == enough, (factor, heaviest, [g.judged for g in again])


def grip_lesson(plan: preshape.Plan, hand: str) -> Any:
    from preshape.hiis.learning import experience_of
    from preshape.objects.shape import described

    assert isinstance(plan.grasp, Grip)

    class Prepared:
        mesh, layout = plan.mesh, type("Layout", (), {"name": hand, "model": ""})

    sets = plan.settings.sets
    return experience_of(
        Prepared(), plan.mesh.name, "task", plan.request.asked.q, plan.grasp, sets, described(plan.mesh)
    )


# -- what is known --------------------------------------------------------------------------------------


def test_learn_teaches_a_real_hand_what_plan_recalls(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    memory = str(tmp_path / "m.sqlite")
    assert run(["learn", "box", "--task", "lift", "--hand", "allegro", "--memory", memory]) == 0
    with Memory.open(memory, read_only=True) as store:
        kinds = {e.kind for e in store.experiences(hand="allegro" + CLOSURE_SUFFIX) if e.object_name == "box"}
        assert {"task", "best"} <= kinds
        assert not [e for e in store.experiences(hand="allegro") if e.object_name == "box"]
    capsys.readouterr()
    assert run(["plan", "box", "--task", "lift", "--hand", "allegro", "--memory", memory, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["mode"] == 0


def test_what_is_known_is_known_for_a_scene(tmp_path: Path) -> None:
    memory = tmp_path / "m.sqlite"
    on_table = asked("cube", "lift", table="auto", search=ClosureSettings())
    with Session(memory) as session:
        first = session.run(on_table)  # the cube was taught in free air, by the first lesson of all
        assert first.decision.mode == 3
        again = session.run(on_table)
        assert again.decision.mode == 0
        free = session.run(asked("cube", "lift", search=ClosureSettings()))
        assert free.decision.mode != 2
    with Memory.open(memory, read_only=True) as store:
        scenes = {e.scene for e in store.experiences() if e.kind == "task" and e.object_name == "cube"}
    assert "table 0 mm under the object" in scenes


PAIRS = [(name, task) for name in names() for task in entry(name).tasks]


@pytest.fixture(scope="module")
def asked_twice() -> list[tuple[preshape.Plan, preshape.Plan]]:
    """The answers of rays for every task of every object, and those for the same requests at once after."""
    made, results = [], {}

    def executed(hand: Any, mesh: Any, grasp: Any, **more: Any) -> Any:
        """The hand's simulation takes longest: one in ten is real, and stands for those after it."""
        contacts = len(grasp.contacts.points)
        if contacts not in results or len(made) % 10 == 0:
            results[contacts] = execute(hand, mesh, grasp, **more)
        return results[contacts]

    with Session(":memory:") as one, pytest.MonkeyPatch.context() as patch:
        patch.setattr("preshape.planning.session.execute", executed)
        for name, task in PAIRS:
            request = PlanRequest(source=name, task=task, hand="utah_mit")
            made.append((one.run(request), one.run(request)))
    return made


def test_asking_again_never_gives_a_worse_answer_with_rays(
    asked_twice: list[tuple[preshape.Plan, preshape.Plan]],
) -> None:
    worse, improved = [], 0
    for first, again in asked_twice:
        if first.grasp is None:
            continue
        if again.grasp is None or again.grasp.judged < first.grasp.judged - 1e-9:
            worse.append((first.request, first.grasp.judged, again.grasp and again.grasp.judged))
        improved += again.decision.reason.startswith("known:")
    assert not worse
    assert improved  # the estimator alone would have answered worse


def test_an_answer_of_rays_without_the_motion_says_so(
    asked_twice: list[tuple[preshape.Plan, preshape.Plan]],
) -> None:
    found = []
    for plan, _ in asked_twice:
        if plan.answer is not None:
            missing = plan_to_json(plan)["missing_motion"]
            found.append(missing)
            share = np.abs(plan.request.asked.q) / [1, 1, 1, 0.8, 0.8, 0.8]
            largest = share >= share.max() - 1e-9
            assert bool(missing) == bool((plan.answer.grasp.adi[largest] <= 1e-9).all())
            headline = str(plan).splitlines()[0]
            assert ("Grasp found, but it" in headline) == bool(missing)
            asked, given = plan.request.asked.q, plan.answer.grasp.net_wrench
            opposed = [COMPONENTS[k] for k in np.flatnonzero((asked * given < 0) & (np.abs(given) > 0.1))]
            if missing in opposed:
                assert f"opposes {missing}" in headline
                assert any(
                    "the grasp opposes it with" in warning for warning in plan_to_json(plan)["warnings"]
                )
    assert 0 < sum(map(bool, found)) < len(found) / 2


@pytest.mark.parametrize("name", ["box", "mug", "bottle", "bolt", "pear", "key", "pan", "sphere"])
def test_asking_again_never_gives_a_worse_grip(session: Session, name: str) -> None:
    for k, changes in enumerate(({}, {"table": "auto"}, {"approaches": "-z"})):
        task = entry(name).tasks[k % min(2, len(entry(name).tasks))]
        request = asked(name, task, **changes)
        first, again = session.run(request), session.run(request)
        if first.grasp is not None:
            assert again.grasp is not None, (task, again.decision.reason)
            # A wrap is closed again from a little outside, and stops within its tolerance.
            assert again.grasp.judged >= first.grasp.judged - 2e-2, task


def test_a_session_answers_as_if_each_request_were_its_first(tmp_path: Path) -> None:
    requests = [
        asked("box", "lift"),
        asked("box", "lift", table="auto"),
        asked("mug", "pour", mass=0.1),
        PlanRequest(source="mug", task="pour", hand="utah_mit"),
        asked("box", "lift", friction=1.0),
        asked("mug", "pour"),
    ]

    def plain(plan: preshape.Plan) -> str:
        document = plan_to_json(plan)
        for one in (document, document["best"] or document):
            one.pop("seconds", None)
        return json.dumps(document, sort_keys=True)

    together, apart = tmp_path / "one.sqlite", tmp_path / "two.sqlite"
    with Session(together) as session:
        found = [plain(session.run(request)) for request in requests]
    each = []
    for request in requests:
        with Session(apart) as session:
            each.append(plain(session.run(request)))
    assert found == each


# -- without an answer ----------------------------------------------------------------------------------


def test_a_deadlock_names_mass_shortfall_and_remedy_and_carries_the_best(
    session: Session, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = session.run(asked("mug", "lift", mass=3.0, search=CAREFUL))
    assert plan.decision.status in (Status.DEADLOCK, Status.NO_GRASP)
    assert plan.answer is None
    assert plan.best is not None
    document = plan_to_json(plan)
    assert document["executable"] is False
    assert document["best"]["executable"] is False
    assert document["best"]["hand"]["squeeze"]["q"]
    assert document["best"]["heaviest_mass"] < 3.0
    for word in ("3.00 kg", "--mass", "--friction"):
        assert word in document["reason"]
    assert "the best that was found" in str(plan)
    monkeypatch.setattr(Session, "run", lambda self, request: plan)
    words = ["plan", "mug", "--task", "lift", "--hand", "shadow", "--mass", "3", "--memory", ":memory:"]
    assert run([*words, "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["best"]["executable"] is False


def test_an_answer_is_known_only_if_the_object_was_met_before() -> None:
    with Session(":memory:") as one:
        first = one.run(PlanRequest(source="box", task="lift", learn=False, hand="utah_mit"))
        one.teach(PlanRequest(source="box", task="lift", hand="utah_mit"))
        again = one.run(PlanRequest(source="box", task="lift", hand="utah_mit"))
        scaled = one.run(PlanRequest(source="box", task="lift", scale=0.9, learn=False, hand="utah_mit"))
        assert [made.known for made in (first, again, scaled)] == [False, True, False]
        assert again.decision.mode == 0
        assert "known (mode 0)" in str(again)
        assert plan_to_json(again)["known"] is True
        never_met = [made for made in (first, scaled) if made.decision.mode == 0]
        for other in names()[:12]:
            made = one.run(PlanRequest(source=other, task="lift", learn=False, hand="utah_mit"))
            never_met += [made] * (made.decision.mode == 0 and not made.known)
        assert never_met
        assert all("estimated (mode 0)" in str(made) for made in never_met)


def test_a_summary_states_the_scene_of_a_test_in_physics_and_explains_quality(session: Session) -> None:
    loaded = PlanRequest(source="cube", task="lift", friction=0.45, verify=True, hand="utah_mit")
    untested = replace(loaded, verify=False, friction=None)
    scenes = [scene_words({"request": request.to_json()}) for request in (loaded, untested)]
    assert scenes == ["friction 0.45", ""]
    gripped = session.run(asked("box", "lift", mass=0.2))
    plain, explained = (summary_text(gripped, explain=explain, width=160) for explain in (False, True))
    assert "2^-m" in explained
    assert "2^-m" not in plain
    assert "for 0.2 kg at a press of" in plain


def test_where_nothing_touches_there_is_no_best(session: Session) -> None:
    block = TriangleMesh(
        name="block",
        vertices=10.0 * load_library_object("cube").vertices,
        triangles=load_library_object("cube").triangles,
    )
    plan = session.run(asked(block, "lift"))
    assert plan.decision.status is Status.NO_GRASP
    assert plan.best is None
    assert plan_to_json(plan)["best"] is None


# -- plans as files -------------------------------------------------------------------------------------


def test_a_plan_of_version_1_is_read_with_its_old_assumptions() -> None:
    for file, analyser in (("plan_version_1.json", "rays"), ("shadow_mug_lift.json", "closure")):
        document = read_plan(DATA / file)
        assert "schema" not in document
        request = request_of(document)
        assert (request.analyser, request.table, request.avoid) == (analyser, None, ())
        assert planned_load(document) == (0.1, 0.6)


def old(plan: preshape.Plan) -> dict[str, Any]:
    """The plan as version 1 had it, without its request."""
    new = ("schema", "request", "mass", "mass_source", "heaviest_mass", "best", "way_in")
    document = json.loads(json.dumps(plan_to_json(plan)))
    return {key: content for key, content in document.items() if key not in new}


@pytest.mark.parametrize(
    ("hand", "analyser", "changes"),
    [
        ("shadow", "rays", {}),
        ("shadow", "rays", {"settings": Settings(thresholds=Thresholds(estimation=6.0))}),
        ("shadow", "closure", {}),
        ("utah_mit", "closure", {}),
        ("utah_mit", "closure", {"mass": 3.0}),
        ("utah_mit", "rays", {}),
    ],
)
def test_a_plan_of_version_1_shows_which_analyser_made_it(
    hand: str, analyser: str, changes: dict[str, Any], session: Session
) -> None:
    search = {"search": ClosureSettings()} if analyser == "rays" else {}
    plan = session.run(asked("box", "lift", hand=hand, analyser=analyser, learn=False, **search, **changes))
    assert (plan.answer is None) == bool(changes)
    request = request_of(old(plan))
    assert (request.analyser, request.mass) == (analyser, 0.1 if analyser == "closure" else None)


def test_a_plan_of_version_1_with_nothing_to_tell_is_the_hand_s() -> None:
    document = json.loads((DATA / "plan_version_1.json").read_text())
    document |= {"plane": None, "alternatives": [], "hand": {**document["hand"], "name": "shadow"}}
    silent = [{"mode": 2, "outcome": "unknown", "reason": "no known object has its size and shape"}]
    assert request_of({**document, "transitions": silent}).analyser == "closure"
    tried = [{"mode": 0, "outcome": "penalty", "reason": "no virtual grasp: of 208 hands tried, 32 close"}]
    document["hand"]["name"] = "utah_mit"
    assert request_of({**document, "transitions": silent}).analyser == "rays"
    assert request_of({**document, "transitions": tried}).analyser == "closure"


def test_a_plan_of_a_newer_version_is_refused(tmp_path: Path) -> None:
    document = json.loads((DATA / "plan_version_1.json").read_text())
    file = tmp_path / "plan.json"
    file.write_text(json.dumps({**document, "schema": 3}))
    with pytest.raises(InputError, match="newer than the 2 known here"):
        read_plan(file)


def test_a_plan_holds_its_load_and_scene(session: Session) -> None:
    plan = session.run(asked("mug", "lift", mass=0.25, friction=0.8, table="auto"))
    document = json.loads(json.dumps(plan_to_json(plan)))
    assert planned_load(document) == (0.25, 0.8)
    assert request_of(document).to_json() == plan.request.to_json()


# -- as pleasant as trimesh -----------------------------------------------------------------------------


def test_a_plan_shows_itself(session: Session, tmp_path: Path) -> None:
    plan = session.run(asked("box", "lift"))
    assert "\n" not in repr(plan)
    assert repr(plan).startswith("<Plan box, lift:+z, shadow: plane ")
    assert "margins" in str(plan)
    assert "TFVADI" not in str(plan).split("recall (0)")[0]
    html = plan._repr_html_()
    assert "data:image/png;base64," in html
    assert "margins" in html
    files = plan.save(tmp_path / "new" / "out")
    assert [file.name for file in files] == ["plan.json", "plan.png", "plan.html"]
    assert all(file.stat().st_size > 1000 for file in files)


def test_a_trimesh_is_an_object(tmp_path: Path) -> None:
    import trimesh

    box = trimesh.creation.box(extents=(40, 60, 50))
    kept = box.vertices.copy()
    plan = preshape.plan(
        box, "lift", hand="leap", unit="mm", mass=0.2, memory=":memory:", closure=QUICK, table=None
    )
    assert plan.mesh.extents == pytest.approx([0.04, 0.06, 0.05])
    assert plan.mass.kg == 0.2
    assert (box.vertices == kept).all()
    *_, surface = plan.save(tmp_path)
    document = read_plan(tmp_path / "plan.json")
    assert document["object"]["source"] == surface.name
    assert preshape.load_object(surface).extents == pytest.approx(plan.mesh.extents)
    with pytest.raises(ObjectError, match="refers to vertex"):
        preshape.plan(
            trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 9]], process=False),
            "lift",
            hand="utah_mit",
        )
    with pytest.raises(InputError, match=r"trimesh\.Trimesh"):
        preshape.plan(3, "lift", hand="utah_mit")  # type: ignore[arg-type]


def test_a_session_can_be_watched_and_cancelled() -> None:
    told: list[tuple[str, float]] = []
    stop = threading.Event()
    with Session(":memory:", progress=lambda words, share: told.append((words, share)), cancel=stop) as one:
        one.run(PlanRequest(source="cube", task="lift", hand="utah_mit"))
        shares = [share for _, share in told]
        assert shares == sorted(shares)
        stop.set()
        with pytest.raises(Cancelled):
            one.run(PlanRequest(source="cube", task="lift", hand="utah_mit"))
