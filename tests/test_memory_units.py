"""Memories of earlier versions, whose net wrenches had another unit, and what stays of them."""

from __future__ import annotations

import json
import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from preshape.exceptions import InputError
from preshape.hands.load import load_hand
from preshape.hiis.controller import Controller
from preshape.hiis.learning import seed_cube
from preshape.hiis.virtual_grasp import RayAnalyser
from preshape.memory import SCHEMA_VERSION, Memory
from preshape.memory.records import OLD_SCENE
from preshape.objects.library import load_library_object
from preshape.objects.mesh import TriangleMesh
from preshape.planning.controllers import layout_of
from preshape.planning.request import PlanRequest
from preshape.planning.session import Session
from preshape.tasks import parse_task
from preshape.types import FIELD_MASS, OLD_UNIT_NAME, UNIT_NAME, Array, Experience

LAYOUT = layout_of(load_hand("utah_mit"))
LATER = {
    1: ("area", "volume"),
    2: ("shape", "grip", "quality", "outcome"),
    3: ("scene",),
    4: ("length_unit",),
    5: ("model",),
}
"""For each version, the columns that the next one added."""
WRENCH = np.array([1.35, 1.0, -0.3, -0.6, 2.9, 1.4])
"""A net wrench with lengths in U: its torques are about four times those of today."""


def written_by(path: Path, version: int, lessons: list[Experience]) -> None:
    """A file as that version wrote it: today's, without what came later, and with weights."""
    with Memory.open(path) as memory:
        memory.add(lessons)
        memory.save_weights("utah_mit", Controller(Memory.open(":memory:"), LAYOUT).weights)
    connection = sqlite3.connect(path, isolation_level=None)
    for name in (name for since, names in LATER.items() if since >= version for name in names):
        connection.execute(f"ALTER TABLE experiences DROP COLUMN {name}")
    connection.execute(f"PRAGMA user_version = {version}")
    connection.close()


@pytest.fixture(scope="module")
def mug_lessons() -> list[Experience]:
    """The lessons of the mug, and one of the first lesson, as an earlier version would have stored them."""
    with Memory.open(":memory:") as memory:
        controller = Controller(memory, LAYOUT)
        controller.teach(load_library_object("mug"), parse_task("pour"))
        found = memory.experiences()
    wanted = [found[0], *(e for e in found if e.object_name == "mug")]
    return [replace(e, wrench=WRENCH, match=1.5, task=e.task if e.kind != "best" else WRENCH) for e in wanted]


def grip_lesson(like: Experience) -> Experience:
    palm = np.array([0.01, -0.02, 0.09, 0.5, -0.5, 0.5, -0.5, 3.0, 0.3, 0.1])
    return replace(like, hand="shadow+closure", grip=palm, quality=3.4, kind="task")


@pytest.mark.parametrize("version", [1, 2, 3, 4])
def test_an_older_memory_opens_keeps_a_backup_and_answers(
    version: int, mug_lessons: list[Experience], tmp_path: Path
) -> None:
    path = tmp_path / "memory.sqlite"
    written_by(path, version, mug_lessons)
    mug = load_library_object("mug")
    with Memory.open(path) as memory:
        assert memory.statistics().version == SCHEMA_VERSION
        assert memory.weights("utah_mit") is None  # trained again
        old = memory.experiences()
        assert {e.kind for e in old} >= {"task", "best", "landmark"}
        assert not any(e.kind == "seed" for e in old)  # learnt again with the cube of the paper's size
        assert all(e.length_unit == OLD_UNIT_NAME and e.outdated for e in old)
        kept = [(e.kind, e.plane, e.flip, e.approach_value, e.fingers) for e in old]

        controller = Controller(memory, LAYOUT)
        seeds = [e for e in memory.experiences() if e.kind == "seed"]
        assert len(seeds) == 48
        assert {e.object_name for e in seeds} == {"seed_cube"}
        decision = controller.run(mug, parse_task("pour"))
        assert decision.grasp is not None
        now = [e for e in memory.experiences() if e.object_name == "mug"]
        if version == 1:  # it stored neither area nor volume: the mesh cannot be known as this very object
            return
        assert [(e.kind, e.plane, e.flip, e.approach_value, e.fingers) for e in now] == kept
        assert not any(e.outdated for e in now)
        pa = RayAnalyser(mug, LAYOUT)
        for e in now:
            (grasp,) = pa.recall(e.task, [e])
            assert np.allclose(e.wrench, grasp.net_wrench, atol=1e-12)
            assert e.match == pytest.approx(grasp.tfvadi, abs=1e-12)
            assert np.allclose(
                e.task, e.wrench if e.kind in ("best", "landmark") else parse_task("pour").q, atol=1e-12
            )
        assert Controller(memory, LAYOUT).weights.w1.tolist() == controller.weights.w1.tolist()
    assert (tmp_path / f"memory.sqlite.v{version}-backup").exists()


def test_reading_only_works_out_again_without_writing(mug_lessons: list[Experience], tmp_path: Path) -> None:
    path = tmp_path / "memory.sqlite"
    written_by(path, 4, mug_lessons)
    before = path.read_bytes()
    with Memory.open(path, read_only=True) as memory:
        decision = Controller(memory, LAYOUT).run(load_library_object("mug"), parse_task("pour"))
    assert decision.grasp is not None
    assert path.read_bytes() == before
    with Memory.open(path) as memory:
        controller = Controller(memory, LAYOUT)
        controller.run(load_library_object("mug"), parse_task("pour"), may_learn=False)
        assert all(e.outdated for e in memory.experiences() if e.object_name == "mug")
        assert not any(e.outdated for e in controller.experiences if e.object_name == "mug")


def test_what_is_void_teaches_and_recognises_nothing(mug_lessons: list[Experience]) -> None:
    """The wrench of an earlier version is neither a task for the estimator nor a pattern for recognition."""
    from preshape.hiis.critic import recognise
    from preshape.hiis.fuzzy import FuzzySets
    from preshape.hiis.learning import training_set

    old = [replace(e, length_unit=OLD_UNIT_NAME) for e in mug_lessons if e.kind != "seed"]
    x, _ = training_set(old, LAYOUT.u)
    assert np.allclose(x[:, :6], parse_task("pour").q)
    mug = RayAnalyser(load_library_object("mug"), LAYOUT)
    assert recognise(mug, old, 0.0, FuzzySets()).candidates == 0
    assert recognise(mug, mug_lessons, 0.0, FuzzySets()).candidates > 0


@pytest.mark.parametrize("version", [3, 4])
def test_grips_of_real_hands_stay_as_they_are(
    version: int, mug_lessons: list[Experience], tmp_path: Path
) -> None:
    path = tmp_path / "memory.sqlite"
    lesson = grip_lesson(mug_lessons[1])
    seed = replace(lesson, kind="seed", object_name="cube")
    written_by(path, version, [lesson, seed])
    with Memory.open(path) as memory:
        first, second = memory.experiences()
    for kept, stored in ((first, lesson), (second, seed)):
        assert kept.grip is not None
        assert np.array_equal(kept.grip, stored.grip)
        assert (kept.plane, kept.quality, kept.kind) == (stored.plane, stored.quality, stored.kind)
    # Older versions planned at one mass; a request for the object's own mass does not rely on it.
    assert first.scene == (OLD_SCENE if version == 3 else "")
    assert second.scene == ""


def test_the_scene_of_old_lessons_is_that_of_a_request_at_their_mass() -> None:
    hammer = load_library_object("hammer")
    asked = PlanRequest(source="hammer", task=parse_task("lift"), hand="shadow", mass=FIELD_MASS, table=None)
    assert asked.scene(hammer) == OLD_SCENE


def test_an_older_export_is_imported_without_its_weights_and_first_lesson(
    mug_lessons: list[Experience], tmp_path: Path
) -> None:
    document = tmp_path / "export.json"
    with Memory.open(":memory:") as memory:
        controller = Controller(memory, LAYOUT)
        memory.add(mug_lessons)
        memory.save_weights("utah_mit", controller.weights)
        memory.export(document)
    content = json.loads(document.read_text())
    assert {e["length_unit"] for e in content["experiences"]} == {UNIT_NAME}
    content["version"] = 3
    for e in content["experiences"]:
        del e["length_unit"], e["model"]
    document.write_text(json.dumps(content))
    with Memory.open(":memory:") as memory:
        assert memory.import_(document) == sum(e.kind != "seed" for e in mug_lessons)
        assert memory.weights("utah_mit") is None
        assert all(e.outdated for e in memory.experiences())
        assert (
            Controller(memory, LAYOUT).run(load_library_object("mug"), parse_task("pour")).grasp is not None
        )


def test_a_unit_that_does_not_exist_is_refused(mug_lessons: list[Experience]) -> None:
    with Memory.open(":memory:") as memory, pytest.raises(InputError, match="length_unit must be 4U or U"):
        memory.add([replace(mug_lessons[0], length_unit="m")])


def test_replacing_touches_the_named_lessons_only(mug_lessons: list[Experience]) -> None:
    with Memory.open(":memory:") as memory:
        memory.add(mug_lessons)
        old = memory.experiences()
        new = replace(old[1], match=2.5)
        assert memory.replace([(old[1], new), (replace(old[2], match=0.25), new)]) == 1
        now = memory.experiences()
        assert now[1].match == 2.5
        untouched: list[tuple[float, Array]] = [(e.match, e.wrench) for k, e in enumerate(now) if k != 1]
        assert [m for m, _ in untouched] == [e.match for k, e in enumerate(old) if k != 1]
        assert memory.count() == len(old)


def test_a_plan_says_its_unit_of_length() -> None:
    from preshape.planning.document import plan_to_json

    with Session(":memory:") as session:
        request = PlanRequest(source=seed_cube(LAYOUT), task=parse_task("lift"), hand="utah_mit")
        document = plan_to_json(session.run(request))
    assert document["length_unit"] == pytest.approx(4 * LAYOUT.u)
    assert document["request"]["finger_rule"] == "up_to"


def test_weights_of_more_samples_are_replaced_only_while_they_are_those_that_were_read() -> None:
    with Memory.open(":memory:") as memory:
        many = replace(Controller(memory, LAYOUT).weights, trained_on=90)
        few, other = replace(many, trained_on=50, epochs=7), replace(many, trained_on=91)
        assert memory.save_weights("utah_mit", many)
        assert not memory.save_weights("utah_mit", few)
        assert memory.save_weights("utah_mit", few, instead_of=many)
        assert memory.weights("utah_mit").epochs == 7
        memory.save_weights("utah_mit", other)
        assert not memory.save_weights("utah_mit", few, instead_of=many)  # another process has learnt
        assert memory.weights("utah_mit").trained_on == 91


def test_after_a_lost_lesson_the_hand_is_not_trained_again_at_a_start(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The training set has shrunk; the weights of fewer samples are stored with the lesson."""
    from preshape.hiis import knowledge

    with Memory.open(":memory:") as memory:
        controller = Controller(memory, LAYOUT)
        pa, task = RayAnalyser(load_library_object("mug"), LAYOUT), parse_task("pour")
        controller.teach(pa, task)
        (lesson,) = (e for e in memory.experiences() if e.kind == "task")
        (taught,) = pa.recall(task.q, [lesson])
        controller.knowledge.learn_outcomes(pa, task, [(taught, False)])
        trained: list[int] = []

        def counted(lessons: tuple[Experience, ...], *args: object, **more: object) -> object:
            trained.append(len(lessons))
            return learn(lessons, *args, **more)

        learn = knowledge.learn
        monkeypatch.setattr(knowledge, "learn", counted)
        for may_store in (False, True, True):
            again = Controller(memory, LAYOUT, may_store=may_store)
            assert again.weights.w1.tobytes() == controller.weights.w1.tobytes()
        assert trained == []


class Bare:
    """An element of an object that no finger meets."""

    def __init__(self) -> None:
        corners = np.array(
            [[-1, -1, -1], [-0.98, -1, -1], [-1, -0.98, -1], [1, 1, 1], [0.98, 1, 1], [1, 0.98, 1]]
        )
        mesh = TriangleMesh(
            name="crumbs", vertices=0.05 * corners, triangles=np.array([[0, 1, 2], [3, 4, 5]])
        )
        self._element = RayAnalyser(mesh, LAYOUT)

    def __getattr__(self, name: str) -> object:
        return getattr(self._element, name)


def test_a_hand_that_cannot_hold_the_cube_gets_a_first_guess_and_still_learns(
    mug_lessons: list[Experience],
) -> None:
    with Memory.open(":memory:") as memory:
        c = Controller(memory, LAYOUT, prepare_seed=lambda mesh: Bare())
        assert c.experiences == ()
        assert memory.count() == 0
        assert c.weights.trained_on == 48
        assert c.teach(load_library_object("mug"), parse_task("pour")).grasp is not None
        assert memory.count() > 0
        # With lessons of its own, the hand is trained on these.
        assert Controller(memory, LAYOUT, prepare_seed=lambda mesh: Bare()).weights.trained_on < 48
    with Memory.open(":memory:") as memory:
        memory.add([replace(e, length_unit=OLD_UNIT_NAME) for e in mug_lessons if e.kind != "seed"])
        c = Controller(memory, LAYOUT, prepare_seed=lambda mesh: Bare())
        assert {e.object_name for e in c.experiences} == {"mug"}
        assert c.weights.trained_on == 1
