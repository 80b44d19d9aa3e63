"""The four modes: which one answers, how they follow each other, recognition, deadlock, offers."""

from __future__ import annotations

import re
import shutil
import struct
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from preshape.exceptions import InputError, ObjectError
from preshape.hands.load import load_hand
from preshape.hiis.controller import OFFERS, Controller
from preshape.hiis.critic import Thresholds, Verdict
from preshape.hiis.decision import Decision, Settings, Status
from preshape.hiis.learning import seed_cube
from preshape.hiis.planes import allowed_planes
from preshape.hiis.virtual_grasp import RayAnalyser
from preshape.memory import Memory
from preshape.objects.library import entry, load_library_object, names
from preshape.objects.load import load_object
from preshape.objects.mesh import TriangleMesh
from preshape.planning.controllers import layout_of
from preshape.tasks import Task, parse_task

LAYOUT = layout_of(load_hand("utah_mit"))
Q1 = "1 1 .1 .05 .8 .05"
BOX_TRIANGLES = [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4]]
BOX_TRIANGLES += [[2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]]
CUBE = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)]) / 2

KNOWN = {"mug": ("pour", "lift"), "bowl": ("lift",), "pen": ("insert",), "hammer": ("strike", "lift")}
"""What the memory of most tests has been taught, beside the cube of the first lesson."""

HUGE = 5.99
"""An estimation threshold that no grasp in these tests meets: modes 0 and 1 fail."""


@cache
def prepared(name: str) -> RayAnalyser:
    mesh = seed_cube(LAYOUT) if name == "seed_cube" else load_library_object(name)
    return RayAnalyser(mesh, LAYOUT)


def boxes(*parts, name="boxes") -> TriangleMesh:
    """Boxes (extents, centre) as one mesh."""
    vertices = np.concatenate([CUBE * np.array(extents) + centre for extents, centre in parts])
    triangles = np.concatenate([np.array(BOX_TRIANGLES) + 8 * k for k in range(len(parts))])
    return TriangleMesh(name=name, vertices=vertices, triangles=triangles)


def corners_only() -> TriangleMesh:
    """Two small cubes in opposite corners of a box: fingers and thumb aim at its empty middle."""
    return boxes(([0.008] * 3, [0.03] * 3), ([0.008] * 3, [-0.03] * 3), name="corners")


def settings(estimation: float = 3.0, recognition: float = 5.0, seed: int = 0) -> Settings:
    return Settings(thresholds=Thresholds(estimation=estimation, recognition=recognition), seed=seed)


@pytest.fixture(scope="module")
def taught(tmp_path_factory) -> Path:
    """A memory file that knows the cube and the objects of ``KNOWN``."""
    path = tmp_path_factory.mktemp("memory") / "taught.sqlite"
    with Memory.open(path) as memory:
        c = Controller(memory, LAYOUT)
        for name, tasks in KNOWN.items():
            for task in tasks:
                assert c.teach(prepared(name), parse_task(task)).status is Status.ANSWER
    return path


@pytest.fixture
def fresh(taught, tmp_path) -> Path:
    """A copy of it, to be changed."""
    return Path(shutil.copy(taught, tmp_path / "fresh.sqlite"))


def reading(path: Path, **thresholds: float) -> Controller:
    return Controller(Memory.open(path, read_only=True), LAYOUT, settings=settings(**thresholds))


def ask(c: Controller, thing, task: str | Task, **options) -> Decision:
    c.reset()
    return c.run(thing, parse_task(task) if isinstance(task, str) else task, **options)


def without_offers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Looking for tasks that fit takes long, longest where there is none."""
    monkeypatch.setattr(Controller, "_offers", lambda *args: ())


# -- a grid of inputs ----------------------------------------------------------------------------------

OBJECTS = ("seed_cube", "mug", "pen", "hammer", "apple", "dolphin", "corners")
TASKS = ("lift", "pour", "strike", "turn:-y", Q1, "0 0 0 0 0 0", "-30 0.3 -0.3 0.8 -0.8 1e3")
THRESHOLDS = (0.0, 3.0, 3.5, 3.9, 4.2, 5.0, 6.0)

SEQUENCE = re.compile(
    r"(0:reward"
    r"|0:penalty 1:reward"
    r"|0:penalty 1:penalty 2:known"
    r"|0:penalty 1:penalty 2:unknown 3:(no grasp|explored( 3:learned)? 3:(reward|deadlock)))"
)


def sequence(decision: Decision) -> str:
    return " ".join(f"{t.mode}:{t.outcome}" for t in decision.transitions)


@pytest.fixture(scope="module")
def grid(taught) -> dict[tuple[str, str, float], Decision]:
    decisions = {}
    corners = RayAnalyser(corners_only(), LAYOUT)
    with pytest.MonkeyPatch.context() as patch:
        without_offers(patch)
        for threshold in THRESHOLDS:
            c = reading(taught, estimation=threshold)
            for name in OBJECTS:
                pa = corners if name == "corners" else prepared(name)
                for task in TASKS:
                    decisions[name, task, threshold] = ask(c, pa, task, may_learn=False)
    return decisions


def test_every_run_takes_one_consistent_way_through_the_modes(grid):
    for key, d in grid.items():
        assert SEQUENCE.fullmatch(sequence(d)), (key, sequence(d))
        assert d.mode == d.transitions[-1].mode
        assert d.reason == d.transitions[-1].reason
        assert all(t.reason for t in d.transitions)
        last = d.transitions[-1].outcome
        assert d.status is {
            "reward": Status.ANSWER,
            "known": Status.CORRECTION,
            "no grasp": Status.NO_GRASP,
            "deadlock": Status.DEADLOCK,
        }.get(last), (key, last)
        assert (d.grasp is not None) == (d.status is Status.ANSWER)
        assert d.deadlock == (d.status is Status.DEADLOCK)
        assert (d.estimate is None) == (d.mode == 3)
        assert not d.offers or d.status is Status.CORRECTION


def test_each_mode_and_each_status_is_reached(grid):
    assert {d.mode for d in grid.values() if d.status is Status.ANSWER} == {0, 1, 3}
    assert {d.status for d in grid.values()} == set(Status)


def test_known_objects_never_reach_mode_3_and_unknown_ones_never_mode_2(grid):
    for (name, _, _), d in grid.items():
        assert d.mode != (3 if name in KNOWN or name == "seed_cube" else 2), (name, sequence(d))


def test_an_answer_meets_the_estimation_threshold(grid):
    for (name, task, threshold), d in grid.items():
        if d.grasp is not None:
            assert d.grasp.tfvadi >= threshold - 1e-9, (name, task, threshold)
            assert d.grasp.tfvadi == pytest.approx(float(d.grasp.adi.sum()))
            assert d.best is d.grasp


def test_a_deadlock_reports_the_best_grasp_and_that_it_is_not_good_enough(grid):
    deadlocks = [(key, d) for key, d in grid.items() if d.status is Status.DEADLOCK]
    for (_, _, threshold), d in deadlocks:
        assert d.best is not None
        assert d.best.tfvadi < threshold - 1e-9


def test_mode_1_keeps_the_estimated_plane_and_never_does_worse_than_mode_0(grid):
    answered = [d for d in grid.values() if d.grasp is not None and d.mode in (0, 1)]
    for d in answered:
        if d.reason.startswith("known:"):  # the memory held a better one than the search found
            found = float(d.reason.rpartition("found ")[2])
            assert d.grasp.judged > found - 0.005
            continue
        assert d.grasp.plane.index == d.estimate.plane
        if d.mode == 0:
            assert d.grasp.approach_set == d.estimate.approach_set
            assert d.grasp.fingers <= d.estimate.fingers


def test_raising_the_threshold_never_lowers_the_mode(grid):
    """As in fig. 15, on a memory that stays as it is."""
    rises = 0
    for name in OBJECTS:
        for task in TASKS:
            modes = [grid[name, task, threshold].mode for threshold in THRESHOLDS]
            assert modes == sorted(modes), (name, task, modes)
            rises += len(set(modes)) == 3
    assert rises, "no task of the grid moves from mode 0 to 1 to 2 or 3"


def test_the_same_question_has_the_same_answer(grid, taught):
    again = ask(reading(taught), prepared("hammer"), "pour", may_learn=False)
    before = grid["hammer", "pour", 3.0]
    assert sequence(again) == sequence(before)
    assert [t.reason for t in again.transitions] == [t.reason for t in before.transitions]


# -- recognition: the same object, exported anew ---------------------------------------------------------


def write_obj(path: Path, mesh: TriangleMesh) -> Path:
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in mesh.vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in mesh.triangles + 1]
    path.write_text("\n".join(lines) + "\n")
    return path


def write_stl(path: Path, mesh: TriangleMesh) -> Path:
    """Binary STL: single precision, every triangle with its own three vertices."""
    row = np.zeros(len(mesh.triangles), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("", "<u2")])
    row["normal"], row["corners"] = mesh.normals, mesh.corners
    path.write_bytes(bytes(80) + struct.pack("<I", len(row)) + row.tobytes())
    return path


def subdivided(mesh: TriangleMesh) -> TriangleMesh:
    """Every triangle cut into four; no vertex shared, another order."""
    a, b, c = (mesh.corners[:, i] for i in range(3))
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = [np.stack(corners, axis=1) for corners in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    corners = np.concatenate(parts)[::-1]
    return TriangleMesh(
        name="subdivided",
        vertices=corners.reshape(-1, 3),
        triangles=np.arange(3 * len(corners)).reshape(-1, 3),
    )


def decimated(mesh: TriangleMesh) -> TriangleMesh:
    """Fewer triangles, the surface within a tenth of a millimetre."""
    import manifold3d

    solid = manifold3d.Manifold(
        manifold3d.Mesh(
            vert_properties=np.asarray(mesh.vertices, dtype=np.float32),
            tri_verts=np.asarray(mesh.triangles, dtype=np.uint32),
        )
    )
    less = solid.simplify(1e-4).to_mesh()
    return TriangleMesh(name="decimated", vertices=less.vert_properties[:, :3], triangles=less.tri_verts)


def moved(mesh: TriangleMesh) -> TriangleMesh:
    """Exported about another origin."""
    return replace(mesh, name="moved", vertices=mesh.vertices + np.array([0.31, -0.17, 0.05]))


def mode_2(c: Controller, mesh: TriangleMesh) -> Decision:
    """Ask for what no grasp can do: the object is known, or it comes to mode 3."""
    assert c.settings.thresholds.estimation == HUGE
    return ask(c, c.prepare(mesh), "lift", may_learn=False)


@pytest.fixture(scope="module")
def library_memories(tmp_path_factory) -> dict[str, Path]:
    """For each library object a memory that has met it once, with its first task."""
    folder = tmp_path_factory.mktemp("each")
    empty = folder / "empty.sqlite"
    with Memory.open(empty) as memory:
        Controller(memory, LAYOUT)
    paths = {}
    for name in names():
        paths[name] = Path(shutil.copy(empty, folder / f"{name}.sqlite"))
        with Memory.open(paths[name]) as memory:
            Controller(memory, LAYOUT).teach(prepared(name), parse_task(entry(name).tasks[0]))
    return paths


@pytest.fixture(scope="module")
def critics(library_memories) -> dict[str, Controller]:
    return {name: reading(path, estimation=HUGE) for name, path in library_memories.items()}


@pytest.mark.parametrize("name", names())
def test_the_same_object_exported_anew_is_known(name, critics, tmp_path, monkeypatch):
    without_offers(monkeypatch)
    mesh = prepared(name).mesh
    variants = {
        "OBJ": lambda: load_object(write_obj(tmp_path / "again.obj", mesh)),
        "STL": lambda: load_object(write_stl(tmp_path / "again.stl", mesh)),
        "subdivided": lambda: subdivided(mesh),
        "moved": lambda: moved(mesh),
        "decimated": lambda: decimated(mesh),
        "inside out": lambda: replace(mesh, triangles=mesh.triangles[:, ::-1]),
    }
    reasons = {}
    # Objects take turns: each is met in three of the six ways, and in each way twenty objects are met.
    for variant in np.roll(list(variants), names().index(name))[:3]:
        decision = mode_2(critics[name], variants[variant]())
        if decision.transitions[2].outcome != "known":
            reasons[variant] = decision.transitions[2].reason
        else:
            assert name in decision.transitions[2].reason
    assert not reasons


def test_in_millimetres_it_is_still_the_same_object(critics, tmp_path, monkeypatch):
    without_offers(monkeypatch)
    mesh = prepared("mug").mesh
    path = write_obj(tmp_path / "mm.obj", replace(mesh, vertices=mesh.vertices * 1000))
    assert mode_2(critics["mug"], load_object(path, unit="mm")).status is Status.CORRECTION
    smaller = load_object(path, unit="mm", scale=0.9)
    assert mode_2(critics["mug"], smaller).transitions[2].outcome == "unknown"


def test_no_library_object_is_taken_for_another(critics, monkeypatch):
    without_offers(monkeypatch)
    for taught_one, c in critics.items():
        for other in names():
            if other not in (taught_one, "cube"):  # every memory knows the cube
                outcome = c._mode_2(prepared(other)).verdict
                assert not outcome.reward, (other, "taken for", taught_one, outcome.reason)


def prism(corners: int, extents) -> TriangleMesh:
    """An upright prism over a regular polygon, stretched to the extents."""
    angle = 2 * np.pi * np.arange(corners) / corners
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ring = (ring - ring.min(axis=0)) / np.ptp(ring, axis=0) - 0.5
    low, high = (np.column_stack([ring, np.full(corners, z)]) for z in (-0.5, 0.5))
    vertices = np.concatenate([low, high, [[0, 0, -0.5], [0, 0, 0.5]]]) * extents
    i, j = np.arange(corners), (np.arange(corners) + 1) % corners
    bottom, top = np.full(corners, 2 * corners), np.full(corners, 2 * corners + 1)
    triangles = np.concatenate(
        [
            np.stack([i, j, corners + j], axis=1),
            np.stack([i, corners + j, corners + i], axis=1),
            np.stack([j, i, bottom], axis=1),
            np.stack([corners + i, corners + j, top], axis=1),
        ]
    )
    return TriangleMesh(name=f"prism {corners}", vertices=vertices, triangles=triangles)


def cone(corners: int, extents) -> TriangleMesh:
    """An upright cone with the extents."""
    whole = prism(corners, extents)
    vertices = whole.vertices.copy()
    vertices[corners : 2 * corners, :2] *= 1e-3
    return replace(whole, name="cone", vertices=vertices)


EXTENTS = [0.06, 0.06, 0.09]
ALIKE = {
    "box": boxes((EXTENTS, [0, 0, 0]), name="box"),
    "cylinder": prism(64, EXTENTS),
    "three-sided": prism(3, EXTENTS),
    "cone": cone(64, EXTENTS),
    "ball": replace(
        load_library_object("sphere"),
        name="ball",
        vertices=load_library_object("sphere").vertices
        / load_library_object("sphere").extents
        * np.array(EXTENTS),
    ),
    "frame": boxes(
        ([0.06, 0.06, 0.01], [0, 0, 0.04]),
        ([0.06, 0.06, 0.01], [0, 0, -0.04]),
        ([0.01, 0.06, 0.07], [0.025, 0, 0]),
        name="frame",
    ),
}


@pytest.mark.parametrize("known", ALIKE)
def test_a_different_object_of_equal_extents_is_unknown(known, tmp_path):
    with Memory.open(tmp_path / "one.sqlite") as memory:
        Controller(memory, LAYOUT).teach(ALIKE[known], parse_task("lift"))
        c = Controller(memory, LAYOUT, settings=settings(estimation=HUGE))
        for name, mesh in ALIKE.items():
            assert mesh.extents == pytest.approx(EXTENTS)
            decision = ask(c, mesh, "lift", may_learn=False)
            outcome = decision.transitions[2].outcome
            assert outcome == ("known" if name == known else "unknown"), (name, sequence(decision))


def test_a_library_object_and_the_box_around_it_are_not_one_another(tmp_path):
    with Memory.open(tmp_path / "boxes.sqlite") as memory:
        c = Controller(memory, LAYOUT, settings=settings(estimation=HUGE))
        for name in ("mug", "pen", "banana"):
            c.teach(boxes((prepared(name).mesh.extents, [0, 0, 0]), name="box"), parse_task("lift"))
            decision = ask(c, prepared(name), "lift", may_learn=False)
            assert decision.transitions[2].outcome == "unknown", name


# -- task correction -------------------------------------------------------------------------------------


def test_every_offered_task_is_answered_as_offered(taught):
    c = reading(taught)
    corrections = 0
    for name in ("cube", *KNOWN):
        for task in ("turn", "0 0 0 0 0 0", "0.1 0.1 0.1 2 2 2", "slide:-z", "-1 0.5 0.3 -0.8 0.4 0.3"):
            decision = ask(c, prepared(name), task, may_learn=False)
            if decision.status is not Status.CORRECTION:
                continue
            corrections += 1
            assert len(decision.offers) <= OFFERS
            distances = [offer.distance for offer in decision.offers]
            assert distances == sorted(distances)
            for offer in decision.offers:
                assert offer.distance == pytest.approx(np.linalg.norm(offer.task.q - decision.task.q))
                answer = ask(c, prepared(name), offer.task.label, may_learn=False)
                assert (answer.status, answer.mode) == (Status.ANSWER, offer.mode)
                assert answer.grasp.tfvadi == pytest.approx(offer.match, abs=1e-12)
    assert corrections >= 5


def unfit(c: Controller, name: str, **options) -> tuple[str, Decision]:
    """A task that the controller, which knows the object, says not to fit; which one depends on training."""
    for task in ("turn", "turn:-y", "0.1 0.1 0.1 2 2 2", "-1 0.5 0.3 -0.8 0.4 0.3", "0 0 0 0 0 0"):
        decision = ask(c, prepared(name), task, may_learn=False, **options)
        if decision.status is Status.CORRECTION:
            return task, decision
    raise AssertionError(f"every task fits the {name}")


def test_offers_keep_to_the_allowed_approaches(taught):
    c = reading(taught)
    allowed = allowed_planes("+z")
    _, decision = unfit(c, "mug", approaches="+z")
    assert decision.offers
    for offer in decision.offers:
        answer = ask(c, prepared("mug"), offer.task, may_learn=False, approaches="+z")
        assert answer.mode == offer.mode
        assert allowed[answer.grasp.plane.index - 1]


def test_a_known_object_is_not_learnt_again_when_its_task_does_not_fit(fresh):
    with Memory.open(fresh) as memory:
        c = Controller(memory, LAYOUT)
        before = memory.count()
        task, _ = unfit(c, "mug")
        assert ask(c, prepared("mug"), task).status is Status.CORRECTION
        assert memory.count() == before
        # Meta control may teach it all the same.
        assert c.teach(prepared("mug"), parse_task(task)).mode == 3
        assert memory.count() > before


# -- mode 3 and deadlock -----------------------------------------------------------------------------------


def test_an_unknown_object_is_explored_learnt_and_then_answered_from_memory(fresh):
    with Memory.open(fresh) as memory:
        c = Controller(memory, LAYOUT)
        first = ask(c, prepared("dolphin"), "pour")
        assert sequence(first) == ("0:penalty 1:penalty 2:unknown 3:explored 3:learned 3:reward"), sequence(
            first
        )
        kinds = [e.kind for e in memory.experiences() if e.object_name == "dolphin"]
        assert kinds.count("task") == kinds.count("best") == 1
        second = ask(c, prepared("dolphin"), "pour")
        assert (second.mode, second.status) == (0, Status.ANSWER)
    with Memory.open(fresh, read_only=True) as memory:
        later = ask(Controller(memory, LAYOUT), prepared("dolphin"), "pour")
        assert (later.mode, later.status) == (0, Status.ANSWER)
        assert later.grasp.net_wrench == pytest.approx(second.grasp.net_wrench)


def test_a_deadlock_is_reported_and_nothing_runs_until_meta_control_resets_it(fresh):
    with Memory.open(fresh) as memory:
        c = Controller(memory, LAYOUT, settings=settings(estimation=HUGE))
        decision = c.run(prepared("apple"), parse_task("lift"))
        assert decision.status is Status.DEADLOCK
        assert decision.deadlock
        assert c.deadlock
        assert sequence(decision).endswith("3:learned 3:deadlock")
        for name in ("apple", "cube"):
            with pytest.raises(InputError, match="reset"):
                c.run(prepared(name), parse_task("lift"))
        c.reset()
        assert not c.deadlock
        after = c.run(prepared("apple"), parse_task("lift"))
        assert after.transitions[0].mode == 0
        # It was learnt in spite of the deadlock, so now it is known.
        assert after.status is Status.CORRECTION


def test_a_deadlock_without_learning_comes_again(taught):
    c = reading(taught, estimation=HUGE)
    for _ in range(2):
        decision = ask(c, prepared("apple"), "lift", may_learn=False)
        assert decision.status is Status.DEADLOCK
        assert "3:learned" not in sequence(decision)


def test_no_grasp_is_a_result_and_not_a_deadlock(fresh):
    with Memory.open(fresh) as memory:
        c = Controller(memory, LAYOUT)
        before = memory.count()
        decision = c.run(corners_only(), parse_task("lift"))
        assert (decision.status, decision.mode, decision.deadlock) == (Status.NO_GRASP, 3, False)
        assert decision.best is None
        assert not c.deadlock
        assert memory.count() == before
        assert c.run(prepared("mug"), parse_task("pour")).status is Status.ANSWER


def test_an_object_over_4_u_is_refused_and_the_controller_goes_on(taught):
    c = reading(taught)
    with pytest.raises(ObjectError, match="4U"):
        c.run(boxes(([0.2, 0.05, 0.05], [0, 0, 0])), parse_task("lift"))
    assert c.run(prepared("mug"), parse_task("pour")).mode == 0


# -- may_learn ---------------------------------------------------------------------------------------------


def test_without_learning_the_memory_stays_byte_for_byte(fresh):
    before = fresh.read_bytes()
    with Memory.open(fresh) as memory:
        c = Controller(memory, LAYOUT)
        modes = {
            ask(c, prepared(n), t, may_learn=False).mode
            for n in ("seed_cube", "mug", "apple", "dolphin")
            for t in TASKS
        }
        modes.add(ask(c, prepared("apple"), "lift", may_learn=False, approaches="-z", count=3).mode)
        assert modes >= {0, 2, 3}
        assert memory.count() == len(c.experiences)
    assert fresh.read_bytes() == before
    assert [p.name for p in fresh.parent.iterdir()] == [fresh.name]


def test_a_read_only_memory_is_not_taught_and_still_answers(fresh):
    before = fresh.read_bytes()
    with Memory.open(fresh, read_only=True) as memory:
        decision = ask(Controller(memory, LAYOUT), prepared("dolphin"), "pour")
    assert sequence(decision) == "0:penalty 1:penalty 2:unknown 3:explored 3:reward"
    assert fresh.read_bytes() == before


# -- allowed approaches and alternatives ---------------------------------------------------------------------


def test_the_allowed_approaches_bind_every_mode_and_every_alternative(taught, monkeypatch):
    without_offers(monkeypatch)
    modes = set()
    for approaches in ("+z", "-x,+y", "-z,-y"):
        allowed = allowed_planes(approaches)
        for threshold in (1.5, 3.0):
            c = reading(taught, estimation=threshold)
            for name in ("cube", "mug", "apple", "dolphin"):
                for task in ("lift", "pour", "strike", Q1):
                    decision = ask(c, prepared(name), task, approaches=approaches, count=4, may_learn=False)
                    for grasp in (decision.best, decision.grasp, *decision.alternatives):
                        assert grasp is None or allowed[grasp.plane.index - 1]
                    if decision.estimate is not None:
                        assert allowed[decision.estimate.plane - 1]
                    if decision.grasp is not None:
                        modes.add(decision.mode)
    assert modes == {0, 1, 3}


def test_what_stands_in_the_way_does_not_become_what_is_known(fresh):
    """A run with few approaches allowed teaches what a run with all of them would have taught."""
    with Memory.open(fresh) as memory, Memory.open(":memory:") as free:
        before = memory.count()
        restricted = ask(Controller(memory, LAYOUT), prepared("bottle"), "lift", approaches="-x")
        taught = Controller(free, LAYOUT).teach(prepared("bottle"), parse_task("lift"))
        new = memory.experiences()[before:]
        unhindered = [e for e in free.experiences() if e.object_name == "bottle"]
        again = ask(Controller(memory, LAYOUT), prepared("bottle"), "lift")
    assert restricted.status is Status.DEADLOCK
    assert taught.status is Status.ANSWER
    assert [(e.kind, e.plane, e.fingers) for e in new] == [(e.kind, e.plane, e.fingers) for e in unhindered]
    assert again.status is Status.ANSWER


@pytest.mark.parametrize("bad", ["", ",", "up", "+z,sideways", "z"])
def test_an_approach_that_is_no_axis_is_refused(bad, taught):
    with pytest.raises(InputError, match="ax"):
        reading(taught).run(prepared("cube"), parse_task("lift"), approaches=bad)


def test_alternatives_differ_meet_the_threshold_and_stand_in_order(taught):
    most = 0
    for threshold in (2.0, 3.0, 4.0):
        c = reading(taught, estimation=threshold)
        for name in ("cube", "mug", "apple"):
            for task in ("lift", Q1):
                decision = ask(c, prepared(name), task, count=6, may_learn=False)
                if decision.grasp is None:
                    assert not decision.alternatives
                    continue
                everything = (decision.grasp, *decision.alternatives)
                ways = [(g.plane.index, g.flip, g.fingers) for g in everything]
                assert len(set(ways)) == len(ways) <= 6
                assert all(g.tfvadi >= threshold - 1e-9 for g in everything)
                matches = [round(g.tfvadi, 9) for g in decision.alternatives]
                assert matches == sorted(matches, reverse=True)
                most = max(most, len(ways))
    assert most == 6


def test_one_answer_has_no_alternatives_and_none_is_refused(taught):
    c = reading(taught)
    assert ask(c, prepared("mug"), "pour").alternatives == ()
    for bad in (0, -1):
        with pytest.raises(InputError, match="at least 1"):
            ask(c, prepared("mug"), "pour", count=bad)


# -- two controllers on one file -----------------------------------------------------------------------------


def test_two_controllers_learn_into_one_file_and_nothing_is_lost(fresh):
    with Memory.open(fresh) as one, Memory.open(fresh) as two:
        a, b = Controller(one, LAYOUT), Controller(two, LAYOUT)
        before = one.count()
        lessons = [(a, "apple", "twist"), (b, "key", "turn"), (a, "nut", "screw"), (b, "bottle", "lift")]
        for added, (c, name, task) in enumerate(lessons, start=1):
            assert c.teach(prepared(name), parse_task(task)).status is Status.ANSWER
            assert {e.object_name for e in one.experiences()} >= {n for _, n, _ in lessons[:added]}
        assert one.count() == two.count() > before
    with Memory.open(fresh) as memory:
        c = Controller(memory, LAYOUT)
        assert {e.object_name for e in c.experiences} == {
            "seed_cube",
            *KNOWN,
            "apple",
            "key",
            "nut",
            "bottle",
        }
        for _, name, task in lessons:
            assert ask(c, prepared(name), task, may_learn=False).mode == 0, name
        for name, tasks in KNOWN.items():
            for task in tasks:
                assert ask(c, prepared(name), task, may_learn=False).mode <= 1, (name, task)
        weights = memory.weights(LAYOUT.name)
        assert weights is not None
        assert weights.trained_on == c.weights.trained_on
        assert weights.w1.tolist() == c.weights.w1.tolist()


@pytest.mark.parametrize("held", [True, False])
def test_the_last_reason_judges_the_grasp_that_is_given(held: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """The self-test may find another grasp than the one that was explored, which is the answer."""
    with Memory.open(":memory:") as memory:
        controller = Controller(memory, LAYOUT)
        told = Verdict(reward=held, match=3.01, reason="self-test at mode 0: TFVADI 3.01")
        monkeypatch.setattr(controller, "_self_test", lambda *_: (None, told))
        decision = controller.teach(prepared("bottle"), parse_task("lift"))
    assert decision.status is (Status.ANSWER if held else Status.DEADLOCK)
    assert decision.best is not None
    assert decision.best.judged > 3.1
    assert decision.reason.startswith(f"TFVADI {decision.best.judged:.2f} meets the threshold 3.00")
    assert "self-test at mode 0: TFVADI 3.01" in decision.reason
