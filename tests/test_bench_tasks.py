"""The task benchmark: instances, files of other planners, processes, continuing, and the command."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from preshape.cli.main import run
from preshape.exceptions import InputError, UnknownObject, UnknownTask
from preshape.objects.library import names
from preshape.objects.load import load_object
from preshape.objects.mesh import TriangleMesh
from preshape.physics.grasps import HandPoses
from preshape.physics.hold.report import result_to_json
from preshape.physics.pieces import ConvexPieces
from preshape.physics.protocol import HoldProtocol
from preshape.physics.task.grasps import (
    GivenAnswers,
    given_answers,
    read_task_grasps,
    write_task_grasps,
)
from preshape.physics.task.instances import (
    TaskInstance,
    holdable_scale,
    instance_to_json,
    liquid,
    make_instances,
    suitable,
)
from preshape.physics.task.protocol import TaskProtocol, TaskStatus
from preshape.physics.task.report import TaskReport, result_from_json
from preshape.physics.task.runner import run_tasks
from preshape.planning.request import PlanRequest
from preshape.planning.session import Session
from preshape.tasks import FAMILIES, named_task
from test_physics_run import grasp_set
from test_physics_scene import BOX, CORNERS, HAND, HERE, clamp

UP = np.array([0.0, 0.0, 1.0])
PROTOCOL = TaskProtocol(hold=HoldProtocol(many_contacts=True), duration=0.5, rise=0.1, rest=0.1)
PIECES = {"box": BOX, "bar": ConvexPieces(name="bar", pieces=(CORNERS * [0.03, 0.02, 0.06],))}


def instance(name: str, label: str, scale: float = 1.0) -> TaskInstance:
    task = named_task(label)
    return TaskInstance(
        object_name=name, scale=scale, task=task, cog=np.zeros(3), half_extent=0.03, gravity=task.gravity
    )


def poses(squeeze: float) -> HandPoses:
    return HandPoses(object_pose=HERE, pregrasp=clamp(0.0), grasp=clamp(0.0052), squeeze=clamp(squeeze))


INSTANCES = tuple(
    instance(name, label)
    for name in ("box", "bar")
    for label in ("lift", "lift:+x", "turn:+x", "press", "twist:-z")
)
ANSWERS = GivenAnswers(
    rows=tuple(
        "the planner gave up" if k in (2, 8) else poses(0.0053 if k in (1, 5) else 0.012) for k in range(10)
    )
)


def go(workers: int = 1, **more) -> TaskReport:
    return run_tasks(INSTANCES, HAND, ANSWERS, protocol=PROTOCOL, pieces=PIECES, workers=workers, **more)


def lines(report: TaskReport) -> list[str]:
    return [json.dumps(result_to_json(result)) for result in report.results]


def slabs(*boxes: tuple[list[float], list[float]]) -> TriangleMesh:
    """One mesh of boxes that are given by their corners."""
    unit = load_object("cube")
    corners = (unit.vertices - unit.bounds[0]) / unit.extents
    vertices = [np.array(low) + corners * (np.array(high) - low) for low, high in boxes]
    triangles = [unit.triangles + k * len(corners) for k in range(len(boxes))]
    return TriangleMesh(name="slabs", vertices=np.concatenate(vertices), triangles=np.concatenate(triangles))


def tray(wall: float, hole: float = 0.0) -> TriangleMesh:
    """A tray of 10 x 10 with floor 1, rim 4, one side of height ``wall``, and a hole or slit in the floor."""
    return slabs(
        ([0, 0, 0], [10, 5 - hole, 1]),
        ([0, 5 + hole, 0], [10, 10, 1]),
        ([0, 0, 0], [1, 10, 4]),
        ([9, 0, 0], [10, 10, wall]),
        ([0, 0, 0], [10, 1, 4]),
        ([0, 9, 0], [10, 10, 4]),
    )


class TestInstances:
    @pytest.mark.parametrize("name", names())
    def test_holdable(self, name: str) -> None:
        extents = load_object(name).extents
        scale = holdable_scale(extents)
        _, middle, largest = np.sort(extents * scale)
        assert largest < 0.161
        assert middle < 0.0805
        assert middle > 0.0395 or largest > 0.159
        if 0.04 <= np.sort(extents)[1] <= 0.08 and extents.max() <= 0.16:
            assert scale == 1.0

    def test_liquid_to_the_lowest_rim(self) -> None:
        # 8 × 8 inside; filled from 1 to the lowest wall, of a box 10 × 10 × 4.
        assert liquid(tray(4.0), UP) == pytest.approx(64 * 3 / 400, rel=0.01)
        assert liquid(tray(2.0), UP) == pytest.approx(64 * 1 / 400, rel=0.01)
        assert liquid(tray(4.0), -UP) == 0.0
        assert liquid(tray(4.0), np.array([1.0, 0, 0])) == 0.0
        assert liquid(tray(4.0, hole=0.5), UP) == 0.0

    @pytest.mark.parametrize(
        ("task", "fit", "unfit"),
        [
            ("pour", "mug bowl wine_glass pan", "cube bottle hammer dolphin sphere"),
            ("screw", "bolt nut jar light_bulb bottle", "hammer banana key mug"),
            ("insert", "pen bolt screwdriver", "key plate wrench"),
            ("insert:+x", "key wrench plate", "pen bottle"),
            ("strike", "hammer bottle", "plate cube wrench"),
            ("lever", "wrench spoon box", "sphere mug bottle"),
            ("roll", "sphere apple", "plate hammer"),
            ("roll:+z", "bottle sphere", "wrench"),
            ("lift", "plate key dolphin", ""),
        ],
    )
    def test_where_a_task_suits(self, task: str, fit: str, unfit: str) -> None:
        asked = named_task(task)
        found = [name for name in (fit + " " + unfit).split() if suitable(asked, load_object(name))]
        assert found == fit.split()

    def test_upside_down_nothing_pours(self) -> None:
        mug = load_object("mug")
        over = TriangleMesh(name="over", vertices=mug.vertices * [1, -1, -1], triangles=mug.triangles)
        assert suitable(named_task("pour"), mug)
        assert not suitable(named_task("pour"), over)

    def test_all_families_with_their_default_axis(self) -> None:
        found = make_instances(["mug", "hammer", "bolt", "sphere", "wrench"])
        assert {one.task.label for one in found} == {named_task(name).label for name in FAMILIES}
        assert [one.object_name for one in found] == sorted(
            (one.object_name for one in found), key=["mug", "hammer", "bolt", "sphere", "wrench"].index
        )
        for one in found:
            mesh = load_object(one.object_name, scale=one.scale)
            assert one.half_extent == pytest.approx(mesh.extents.max() / 2)
            assert np.array_equal(one.cog, mesh.cog)
            assert np.array_equal(one.gravity, np.asarray(one.task.gravity))

    def test_some_of_them(self) -> None:
        whole = make_instances(["box", "sphere", "bolt", "key"])
        labels = [(one.object_name, one.task.label) for one in whole]
        some = make_instances(["box", "sphere", "bolt", "key"], seed=5, count=24)
        chosen = [(one.object_name, one.task.label) for one in some]
        assert len(set(chosen)) == 24
        assert chosen == [label for label in labels if label in chosen]  # in their order
        again = make_instances(["box", "sphere", "bolt", "key"], seed=5, count=24)
        assert chosen == [(one.object_name, one.task.label) for one in again]
        other = make_instances(["box", "sphere", "bolt", "key"], seed=6, count=24)
        assert chosen != [(one.object_name, one.task.label) for one in other]
        possible, taken = (Counter(task for _, task in rows) for rows in (labels, chosen))
        fewest = min(taken.values())
        assert all(taken[task] >= min(possible[task], fewest) for task in possible)
        assert max(taken.values()) <= fewest + 1
        assert {one.seed for one in some} == {5}

    def test_gravity_for_all(self) -> None:
        for one in make_instances(["box"], ["lift", "press"], gravity=np.array([0.0, 2.0, 0.0])):
            assert one.motion.gravity == pytest.approx([0, 1, 0])
        for one in make_instances(["box"], gravity=np.zeros(3)):
            assert not one.motion.gravity.any()

    def test_bad_ones(self) -> None:
        with pytest.raises(UnknownObject):
            make_instances(["muug"])
        with pytest.raises(UnknownTask):
            make_instances(["mug"], ["poor"])
        with pytest.raises(InputError, match="no instance"):
            make_instances(["wrench"], ["pour"])
        with pytest.raises(InputError, match="count"):
            make_instances(["mug"], count=0)

    def test_as_json(self) -> None:
        [one] = make_instances(["wrench"], ["lever:-y"])
        document = json.loads(json.dumps(instance_to_json(one, 0.2), allow_nan=False))
        assert document["load"]["force_at_start"] == pytest.approx(one.motion.load(0.0, 0.2)[:3].tolist())
        assert document["motion"]["T_start_goal"] == one.motion.path(1.0).tolist()
        assert document["task"] == "lever:-y"


class TestOtherPlanners:
    def test_file_there_and_back(self, tmp_path: Path) -> None:
        grasps = grasp_set([0.01, 0.02, 0.03])
        write_task_grasps(tmp_path / "g.npz", grasps, ["lift", "push:-x", "Hand-over"])
        again, labels = read_task_grasps(tmp_path / "g.npz")
        assert labels == ("lift:+z", "push:-x", "hand_over:+x")
        assert np.array_equal(again.squeeze, grasps.squeeze)

    @pytest.mark.parametrize(
        ("task", "message"),
        [
            (None, "no array task"),
            (np.array(["lift"]), "must be 2 names"),
            (np.array([1, 2]), "must be 2 names"),
            (np.array(["lift", "lft"]), "row 1: no task 'lft'"),
        ],
    )
    def test_wrong_files(self, tmp_path: Path, task, message: str) -> None:
        write_task_grasps(tmp_path / "g.npz", grasp_set([0.01, 0.02]), ["lift", "lift"])
        with np.load(tmp_path / "g.npz") as stored:
            arrays = {**dict(stored), "task": task}
        np.savez(tmp_path / "g.npz", **{name: array for name, array in arrays.items() if array is not None})
        with pytest.raises(InputError, match=message):
            read_task_grasps(tmp_path / "g.npz")

    def test_whose_answer_is_whose(self) -> None:
        grasps = grasp_set([0.001, 0.002, 0.003, 0.004, 0.005], ["bar", "box", "box", "box", "bar"])
        squeeze = np.array(grasps.squeeze)
        squeeze[4] = np.nan
        scale = np.array([1.0, 1.0, 1.0, 2.0, 1.0])
        labels = ["lift:+z", "lift:+z", "lift:+z", "press:-z", "twist:-z"]
        given = given_answers(INSTANCES, replace(grasps, squeeze=squeeze, scale=scale), labels, HAND)
        found = {k: row for k, row in enumerate(given.rows) if not isinstance(row, str)}
        # The clamp's order is right, left; both move alike.
        assert {k: row.squeeze[7] for k, row in found.items()} == {0: 0.002, 5: 0.001}
        assert given.rows[3] == "the file has no grasp for it at scale 1 (it has one at scale 2)"
        assert given.rows[1] == "the file has no grasp for it at scale 1"
        assert given.rows[9] == "row 4 of the file: squeeze is not finite"
        assert given.unused == 3


class TestRun:
    def test_every_instance_counts(self) -> None:
        report = go()
        by = {r.row: r for r in report.results}
        assert [r.status for r in report.results].count(TaskStatus.NO_ANSWER) == 2
        assert by[2].reason == "the planner gave up"
        assert [by[k].status for k in (0, 3, 6)] == [TaskStatus.DONE] * 3
        assert by[5].status is TaskStatus.LOST  # hardly pressed
        score = report.score()
        assert (score.instances, score.no_answer, score.answered) == (10, 2, 8)
        assert score.rate == pytest.approx(score.passed / 10)
        assert score.passed == sum(r.passed for r in report.results)
        families, objects = report.families(), report.objects()
        assert list(families) == ["lift", "turn", "twist", "press"]  # the families' own order
        for scores in (families, objects):
            assert sum(s.instances for s in scores.values()) == 10
            assert sum(s.passed for s in scores.values()) == score.passed
        assert families["lift"].instances == 4
        assert len(report.failures()) == 10 - score.passed
        json.dumps(report.to_json(), allow_nan=False)

    def test_an_object_that_is_not_there(self) -> None:
        two = [INSTANCES[0], instance("nothing", "lift")]
        report = run_tasks(two, HAND, ANSWERS, protocol=PROTOCOL, pieces=PIECES, workers=1)
        assert [r.status for r in report.results] == [TaskStatus.DONE, TaskStatus.INVALID]
        assert "nothing" in report.results[1].reason
        assert report.score().rate == 0.5

    def test_results_there_and_back(self) -> None:
        for result in go().results:
            planned = replace(result, planned=((0.1, 0.2), (0.3, 0.4), (0.5, 0.6)))
            for one in (result, planned):
                again = result_from_json(json.loads(json.dumps(result_to_json(one))))
                assert result_to_json(again) == result_to_json(one)
                assert again.planned == one.planned

    @pytest.mark.slow
    def test_one_process_or_two(self) -> None:
        seen: list[tuple[int, int]] = []
        two = go(workers=2, progress=lambda *done: seen.append(done))
        assert lines(go()) == lines(two)
        assert {result.status for result in two.results} >= {TaskStatus.DONE, TaskStatus.LOST}
        assert seen[0] == (0, 10)
        assert seen[-1] == (10, 10)

    def test_going_on(self, tmp_path: Path) -> None:
        file = tmp_path / "run.jsonl"

        def stop(done: int, _: int) -> None:
            if done == 4:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            go(checkpoint=file, progress=stop)
        kept = file.read_bytes()
        assert kept.count(b"\n") == 5
        file.write_bytes(kept + b'{"row": 4, "obj')  # as a crash leaves it
        seen: list[int] = []
        resumed = go(checkpoint=file, progress=lambda done, _: seen.append(done))
        assert seen[0] == 4
        assert lines(resumed) == lines(go())
        assert file.read_bytes().count(b"\n") == 11
        other = replace(PROTOCOL, strength=2.0)
        with pytest.raises(InputError, match="belongs to a test of other instances"):
            run_tasks(INSTANCES, HAND, ANSWERS, protocol=other, pieces=PIECES, workers=1, checkpoint=file)
        for content in ("my notes", '{"format": "preshape holds 1", "key": "x"}\n'):
            file.write_text(content)
            with pytest.raises(InputError, match="choose another file"):
                go(checkpoint=file)
            assert file.read_text() == content


class TestCommand:
    @pytest.fixture(autouse=True)
    def own_cache(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("PRESHAPE_CACHE", str(tmp_path / "cache"))

    @pytest.mark.slow
    def test_plan_then_score_what_was_planned(self, tmp_path: Path, capsys) -> None:
        options = ["bench", "tasks", "--objects", "cube", "--tasks", "push,turn", "--workers", "1"]
        assert run([*options, "--out", str(tmp_path / "one"), "--json"]) == 0
        first = json.loads(capsys.readouterr().out)
        assert first["planner"] == "utah_mit, rays"
        assert [row["task"] for row in first["instances"]] == ["push:+x", "turn:+z"]
        assert {row["status"] for row in first["instances"]} <= {s.name.lower() for s in TaskStatus}
        assert first["all"]["answered"] == 2
        assert {Path(file).name for file in first["files"]} == {
            "report.json",
            "report.md",
            "report.html",
            "grasps.npz",
        }
        assert not (tmp_path / "one" / "unfinished.jsonl").exists()
        assert run([*options, "--grasps", str(tmp_path / "one" / "grasps.npz"), "--json"]) == 0
        second = json.loads(capsys.readouterr().out)
        for key in ("all", "families", "objects"):
            assert second[key] == first[key]
        assert second["files"] == []
        assert run([*options, "--grasps", str(tmp_path / "one" / "grasps.npz")]) == 0
        text = capsys.readouterr().out
        assert "By task" in text
        assert "By object" in text
        assert f"{first['all']['passed']} of 2 passed" in text

    @pytest.mark.parametrize(
        ("options", "mass"),
        [
            (["--hand", "shadow"], 0.1),
            (["--hand", "shadow", "--mass", "0.4"], 0.4),
            (["--mass", "0.4"], None),
        ],
    )
    def test_the_mass_is_planned_for(
        self, options: list[str], mass: float | None, capsys, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """The cube's own 0.034 kg is not used, and the ray analyser has no loads."""
        planned_for: list[float | None] = []

        def refuse(_: Session, request: PlanRequest) -> None:
            planned_for.append(request.mass)
            raise InputError("not today")

        monkeypatch.setattr(Session, "run", refuse)
        words = "bench tasks --objects cube --tasks lift --workers 1 --json".split()
        assert run([*words, *options]) == 0
        assert "not today" in capsys.readouterr().out
        assert planned_for == [mass]

    def test_instances_for_others(self, tmp_path: Path, capsys) -> None:
        file = tmp_path / "list.json"
        assert run(["bench", "tasks", "--objects", "mug,bolt", "--write-instances", str(file), "--json"]) == 0
        said = json.loads(capsys.readouterr().out)
        document = json.loads(file.read_text())
        assert said["instances"] == len(document["instances"]) == len(make_instances(["mug", "bolt"]))
        assert document["protocol"]["acceleration"] == 9.8
        for row, entry in enumerate(document["instances"]):
            assert entry["row"] == row
            mesh = load_object(tmp_path / entry["mesh"])
            assert mesh.extents.max() / 2 == pytest.approx(entry["half_extent"])
            assert mesh.cog == pytest.approx(np.array(entry["cog"]), abs=1e-12)

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            (["--gravity", "down"], "--gravity is a direction"),
            (["--gravity", "0,0,0"], "--gravity is a direction"),
            (["--analyser", "magic"], "no analyser 'magic'"),
            (["--hand", "hook"], "hook"),
            (["--objects", "cub"], "did you mean cube"),
            (["--tasks", ","], "--tasks takes names with commas between"),
            (["--count", "0"], "--count must be 1 or more"),
            (["--workers", "0"], "--workers must be 1 or more"),
            (["--seed", "-1"], "--seed must be 0 or more"),
            (["--friction", "-1"], "friction must be at least 0"),
            (["--grasps", "x.npz", "--analyser", "rays"], "leave out --analyser"),
            (["--out", " "], "--out needs a name"),
        ],
    )
    def test_bad_input(self, options: list[str], message: str, capsys) -> None:
        assert run(["bench", "tasks", "--objects", "cube", *options, "--json"]) == 2
        said = json.loads(capsys.readouterr().out)
        assert said["status"] == "error"
        assert message in said["reason"]

    def test_a_missing_file(self, capsys) -> None:
        assert run(["bench", "tasks", "--objects", "cube", "--grasps", "none.npz"]) == 3
        assert "none.npz" in capsys.readouterr().err
