"""The pick test: every outcome on a case that is made for it, runs on several cores, and the command."""

from __future__ import annotations

import json
import math
from collections import Counter
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from PIL import Image

from preshape import spatial
from preshape.cli.main import run
from preshape.closure.settings import ClosureSettings
from preshape.exceptions import HandError, InputError
from preshape.hands import load_hand
from preshape.hiis.analyser import Aim
from preshape.objects.load import load_object
from preshape.physics.grasps import STAGES as POSES
from preshape.physics.grasps import HandPoses
from preshape.physics.hand import PhysicsHand, physics_hand, published_hand
from preshape.physics.hold.report import result_to_json
from preshape.physics.pick.doing import JOB_STAGES
from preshape.physics.pick.objects import PickAnswer, PickObject, pick_objects
from preshape.physics.pick.picking import STAGES, pick_test, pick_up, placed_off
from preshape.physics.pick.protocol import FAILURES, PickProtocol, PickResult, PickStatus
from preshape.physics.pick.recording import record_pick
from preshape.physics.pick.report import PickReport, result_from_json
from preshape.physics.pick.runner import pick_scene, run_picks
from preshape.physics.pick.tables import NOT_DONE, failure_table, rate_line
from preshape.physics.pieces import ConvexPieces
from preshape.physics.scene import Scene, build_scene
from preshape.physics.task.motion import task_motion
from preshape.planning.controllers import closure_analyser
from preshape.planning.grasp_sets import palm_grasps, poses_of
from preshape.planning.hand_simulation import execute
from preshape.planning.planned_answers import PlannedPicks
from preshape.planning.request import PlanRequest
from preshape.tasks import named_task
from test_physics_scene import BOX, CLAMP, CORNERS, HAND, HERE, SIDE

STIFF = CLAMP.replace(' forcerange="-0.1 0.1"', "")
PLATES = replace(HAND, mjcf=STIFF)
BALLS = replace(HAND, mjcf=STIFF.replace('type="box" size="0.005 0.04 0.04"', 'type="sphere" size="0.005"'))
RULES = PickProtocol(
    many_contacts=True, settle=0.2, approach=0.4, close=0.3, squeeze=0.2, lift=0.8, hold=0.3, height=0.1
)
DOWN = np.array([0.0, 0.0, -1.0])


def clamped(travel: float, x: float = 0.0, y: float = 0.0, z: float = 0.02) -> np.ndarray:
    """The clamp above the table with both plates moved inwards by ``travel`` [m]; they touch at 5 mm."""
    return np.array([x, y, z, 1, 0, 0, 0, travel, travel])


def grip(squeeze: float = 0.02, where: np.ndarray = HERE, **place: float) -> HandPoses:
    travels = (0.0, 0.0052, squeeze)
    pregrasp, grasp, pressed = (clamped(travel, **place) for travel in travels)
    return HandPoses(pregrasp=pregrasp, grasp=grasp, squeeze=pressed, object_pose=where)


def scene(
    protocol: PickProtocol = RULES, mass: float = 0.1, hand: PhysicsHand = PLATES, table: float = -SIDE[2]
) -> Scene:
    return build_scene(hand, BOX, 1.0, protocol.scene(mass), table=table)


def attempt(
    poses: HandPoses, way_in: np.ndarray = DOWN, protocol: PickProtocol = RULES, **made: object
) -> PickResult:
    return pick_test(scene(protocol, **made), poses, way_in, protocol)  # type: ignore[arg-type]


class TestOutcomes:
    def test_picked(self) -> None:
        stages = Counter[str]()
        highest = 0.0

        def watch(stage: str, data: mujoco.MjData) -> None:
            nonlocal highest
            stages[stage] += 1
            highest = max(highest, float(data.qpos[made.object_address + 2]))

        made = scene()
        result = pick_test(made, grip(), DOWN, RULES, row=3, object_name="box", observer=watch)
        assert (result.status, result.row, result.object_name) == (PickStatus.PICKED, 3, "box")
        assert result.mass == pytest.approx(0.1)
        assert result.touching == 2
        assert result.table_force == 0.0
        assert result.held is not None
        assert result.held.displacement < 0.002
        assert highest == pytest.approx(RULES.height, abs=0.003)
        assert tuple(stages) == STAGES

    def test_a_weak_squeeze_drops_what_is_heavy(self) -> None:
        # 400 N/m times 0.8 mm holds 0.6 · 2 · 0.32 N, less than the weight of 1 kg.
        result = attempt(grip(0.0058), mass=1.0)
        assert result.status is PickStatus.DROPS
        assert attempt(grip(0.03), mass=1.0).picked

    def test_without_friction_it_slips_out(self) -> None:
        result = attempt(grip(), protocol=replace(RULES, friction=0.02))
        assert result.status in (PickStatus.SLIPS, PickStatus.DROPS)
        assert result.pushed is not None

    def test_held_beside_its_weight_it_spins(self) -> None:
        loose = replace(RULES, torsion=0.0005)
        result = attempt(grip(0.06, y=0.015, z=0.0), protocol=loose, hand=BALLS, mass=0.2)
        assert result.status is PickStatus.SPINS
        # Its centre of mass moves 19 mm on the way: with other limits, that is what counts first.
        far = replace(loose, displacement_limit=0.01, rotation_limit=3.0)
        result = attempt(grip(0.06, y=0.015, z=0.0), protocol=far, hand=BALLS, mass=0.2)
        assert result.status is PickStatus.SLIPS
        assert attempt(grip(0.06, z=0.015), protocol=loose, hand=BALLS, mass=0.2).picked

    @pytest.mark.parametrize(
        ("poses", "way_in"),
        [(grip(z=0.0), DOWN), (grip(), -DOWN)],
        ids=["plates reach below the table", "comes from below"],
    )
    def test_hits_the_table(self, poses: HandPoses, way_in: np.ndarray) -> None:
        result = attempt(poses, way_in)
        assert result.status is PickStatus.HITS_TABLE
        assert result.table_force > RULES.table_force
        assert result.held is None

    def test_pushed_away(self) -> None:
        result = attempt(grip(), np.array([1.0, 0.0, 0.0]), replace(RULES, friction=0.1))
        assert result.status is PickStatus.PUSHED
        assert "on the way in" in result.reason
        assert result.pushed is not None
        assert result.pushed.displacement >= RULES.displacement_limit

    def test_pushed_over(self) -> None:
        tall = ConvexPieces(name="tall", pieces=(CORNERS * [0.008, 0.008, 0.06],))
        made = build_scene(PLATES, tall, 1.0, RULES.scene(0.05), table=-0.06)
        result = pick_test(made, grip(z=0.06), np.array([1.0, 0.0, 0.0]), RULES)
        assert result.status is PickStatus.PUSHED
        assert result.pushed is not None
        assert result.pushed.rotation >= RULES.rotation_limit

    def test_an_object_on_its_edge_does_not_rest(self) -> None:
        turn = spatial.rotation_from_vector(np.array([0.0, 0.6, 0.0]))
        where = spatial.seven_from_pose(spatial.pose(turn, np.zeros(3)))
        lowest = float((CORNERS * SIDE @ turn.T)[:, 2].min())
        made = scene(replace(RULES, settle=0.5), table=lowest)
        result = pick_test(made, grip(where=where), DOWN, replace(RULES, settle=0.5))
        assert result.status is PickStatus.DOES_NOT_REST
        assert result.pushed is None

    def test_a_hand_that_misses(self) -> None:
        result = attempt(grip(y=0.08))
        assert result.status is PickStatus.DROPS
        assert "never touched" in result.reason

    def test_the_hand_goes_where_the_object_came_to_rest(self) -> None:
        fallen = np.array([0.0, 0, 0.006, 1, 0, 0, 0])
        above = scene(replace(RULES, settle=0.4))
        # Planned with the object 6 mm above the table; carried along, the hand still grips 20 mm over it.
        result = pick_test(above, grip(where=fallen, z=0.026), DOWN, replace(RULES, settle=0.4))
        assert result.picked
        assert result.settled is not None
        assert result.settled.displacement == pytest.approx(0.006, abs=0.003)  # it bounces


class TestScene:
    def test_gravity_acts_on_the_object_only(self) -> None:
        made = scene()
        data = mujoco.MjData(made.model)
        assert pick_up(made, data, grip(), DOWN, RULES).failure is None
        assert made.model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
        wrenches = np.array(data.xfrc_applied)
        assert wrenches[made.object_body] == pytest.approx([0, 0, -RULES.gravity * made.mass, 0, 0, 0])
        assert not np.delete(wrenches, made.object_body, axis=0).any()

    def test_the_hand_s_own_gains_and_torque_limits(self) -> None:
        leap = load_hand("leap")
        model = build_scene(physics_hand(leap), BOX, 1.0, RULES.scene(0.1), table=0.0).model
        assert model.actuator_gainprm[:, 0] == pytest.approx(np.full(16, leap.actuator_gain))
        assert model.actuator_forcelimited.all()
        assert model.actuator_forcerange[:, 1] == pytest.approx(leap.torque_limits)
        assert model.opt.timestep == 0.002

    def test_errors_are_drawn_by_seed_and_row(self) -> None:
        rules = replace(RULES, position_error=0.005, turn_error=math.radians(5.0), seed=2)
        pose, centre = (
            spatial.pose_from_seven(np.array([0.1, 0.2, 0.3, 1, 0, 0, 0])),
            np.array([0.01, 0, 0.02]),
        )
        seen = [placed_off(pose, centre, rules, row) for row in range(6)]
        for off in seen:
            moved = spatial.transform_points(off @ pose, centre) - spatial.transform_points(pose, centre)
            assert np.linalg.norm(moved) == pytest.approx(0.005)
            assert moved[2] == pytest.approx(0.0, abs=1e-12)
            assert np.abs(spatial.vector_from_rotation(off[:3, :3])) == pytest.approx([0, 0, math.radians(5)])
        assert len({off[:2, 3].tobytes() for off in seen}) == 6
        assert np.array_equal(seen[4], placed_off(pose, centre, rules, 4))
        assert not np.array_equal(seen[4], placed_off(pose, centre, replace(rules, seed=3), 4))
        assert np.allclose(placed_off(pose, centre, RULES, 0), np.eye(4))

    def test_the_hand_does_not_see_the_error(self) -> None:
        off = replace(RULES, position_error=0.004, seed=1)
        result = attempt(grip(), protocol=off)
        assert result.pushed is not None
        assert 0.001 < result.pushed.displacement < 0.005  # the plates push it back between them

    @pytest.mark.parametrize(
        "change", [{"lift": 0.0}, {"way_in": -0.1}, {"look_steps": 0}, {"friction": -1.0}, {"hold": math.nan}]
    )
    def test_bad_settings(self, change: dict[str, float]) -> None:
        with pytest.raises(InputError, match=next(iter(change))):
            replace(RULES, **change)

    @pytest.mark.parametrize(
        ("name", "folder"), [("leap", "leap_hand"), ("allegro", "wonik_allegro"), ("shadow", "shadow_hand")]
    )
    def test_a_published_model_stands_where_ours_does(self, name: str, folder: str, reference: Path) -> None:
        hand = load_hand(name)
        theirs = published_hand(hand, reference / "hands" / folder / "right_hand.xml")
        one = palm_grasps(
            hand,
            ["box"],
            [1.0],
            {s: np.array([[*HERE, *hand.at(0.3)]]) for s in ("pregrasp", "grasp", "squeeze")},
        )
        places = []
        for model in (physics_hand(hand), theirs):
            made = build_scene(model, BOX, 1.0, RULES.scene(0.1))
            data = mujoco.MjData(made.model)
            whole = one.for_hand(model).poses(0).grasp
            data.qpos[made.root_address : made.root_address + 7] = whole[:7]
            data.qpos[made.joint_address] = whole[7:]
            mujoco.mj_kinematics(made.model, data)
            # The axes of the last joints are the same points of the hand in both models.
            joints = [made.model.joint(f"hand/{finger.joints[-1]}").id for finger in hand.fingers]
            places.append(np.array(data.xanchor[joints]))
        assert np.abs(places[0] - places[1]).max() < 0.004

    def test_no_published_model(self) -> None:
        with pytest.raises(HandError, match="leap"):
            published_hand(load_hand("utah_mit"), "right_hand.xml")


class Given:
    """Answers that are made here; some objects have none."""

    digest = "given"

    def answer(self, thing: PickObject) -> PickAnswer | str:
        if thing.name == "unknown":
            return "too wide for the hand"
        return PickAnswer(poses=grip(0.0058 if thing.seed else 0.02), way_in=(0.0, 0.0, -1.0))


def cut(name: str) -> ConvexPieces:
    if name == "sheet":
        raise InputError("sheet: the object encloses no volume")
    return BOX


THINGS = (
    PickObject(name="box", mass=0.1),
    PickObject(name="unknown", mass=0.1),
    PickObject(name="heavy", mass=1.0, seed=1),
    PickObject(name="sheet", mass=0.1),
    PickObject(name="again", mass=0.2),
)
OFF = replace(RULES, position_error=0.002, turn_error=0.05)


def go(workers: int = 1, things: tuple[PickObject, ...] = THINGS, **more: object) -> PickReport:
    return run_picks(things, PLATES, Given(), cut=cut, protocol=OFF, workers=workers, **more)  # type: ignore[arg-type]


def lines(report: PickReport) -> list[str]:
    return [json.dumps(result_to_json(result)) for result in report.results]


class TestRuns:
    def test_one_process_or_two_or_stopped(self, tmp_path: Path) -> None:
        whole = go()
        statuses = [result.status.name for result in whole.results]
        assert statuses == ["PICKED", "NO_ANSWER", "DROPS", "INVALID", "PICKED"]
        assert lines(go(workers=2)) == lines(whole)

        class Stop(Exception):
            pass

        def stop(done: int, of: int) -> None:
            if done == 3:
                raise Stop

        kept = tmp_path / "kept.jsonl"
        with pytest.raises(Stop):
            go(checkpoint=kept, progress=stop)
        assert len(kept.read_text().splitlines()) == 4
        told: list[int] = []
        assert lines(go(checkpoint=kept, progress=lambda done, of: told.append(done))) == lines(whole)
        assert told == [3, 4, 5]
        with pytest.raises(InputError, match="other objects, planner, hand or settings"):
            go(things=THINGS[:4], checkpoint=kept)

    def test_results_there_and_back_and_counted(self) -> None:
        report = go()
        for result in report.results:
            text = json.dumps(result_to_json(result))
            assert json.dumps(result_to_json(result_from_json(json.loads(text)))) == text
        score = report.score()
        assert (score.objects, score.answered, score.picked) == (5, 4, 2)
        assert score.rate == 0.5
        assert score.overall == 0.4
        assert sum(score.causes.values()) == len(report.failures()) == 3
        assert set(score.causes) == {cause.name.lower() for cause in FAILURES}
        assert len(report.planned_grasps()) == 4

    def test_a_recording_is_the_same_test(self) -> None:
        [result] = go(things=THINGS[:1]).results
        assert result.turn == (1, 0, 0, 0)
        made = pick_scene(PLATES, BOX, THINGS[0], result.turn, OFF)
        recording = record_pick(made, result, OFF)
        assert result_to_json(recording.result) == result_to_json(result)
        assert recording.stages == STAGES
        assert recording.normal[recording.span("hold"), 1:].min() > 0.5
        heights = recording.object_pose[:, 2]
        assert heights[-1] - heights[0] == pytest.approx(OFF.height, abs=0.003)

    def test_objects_with_their_masses(self) -> None:
        own, stated, all_alike = (
            pick_objects(["mug", "cube", "mug"], **more)  # type: ignore[arg-type]
            for more in ({}, {"masses": {"cube": 0.5}}, {"mass": 0.2})
        )
        assert [thing.name for thing in own] == ["mug", "cube"]
        assert [thing.mass for thing in own] == [load_object("mug").mass, load_object("cube").mass]
        assert [thing.mass for thing in stated] == [load_object("mug").mass, 0.5]
        assert [thing.mass for thing in all_alike] == [0.2, 0.2]


@pytest.fixture(scope="module")
def leap_on_box() -> PickAnswer:
    """A grip of the LEAP hand on the box on a table, without the cube's lesson before."""
    hand, mesh = load_hand("leap"), load_object("box")
    small = ClosureSettings(everywhere=3000, persistence=0, rounds=2, elite=16)
    request = PlanRequest(source=mesh, task="lift", hand=hand, table="auto", search=small)
    analyser = closure_analyser(request, hand, mesh)
    found = analyser.explore(request.asked.q, Aim(planes=range(1, 13), values=np.linspace(-0.8, 0.8, 9)))
    grasp = found.grasp()
    result = execute(hand, mesh, grasp, seed=0)
    own = physics_hand(hand)
    poses = palm_grasps(hand, ["box"], [1.0], poses_of([result])).for_hand(own).poses(0)
    return PickAnswer(poses=poses, way_in=tuple(grasp.approach.tolist()))


class TestCommand:
    def test_a_box_by_the_leap_hand(
        self,
        leap_on_box: PickAnswer,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        """The box is picked; moved 5 cm aside, the same grasp fails and is drawn."""

        def answer(self: PlannedPicks, thing: PickObject) -> PickAnswer | str:
            if thing.name == "mug":
                return "too wide for the hand"
            if thing.name == "box":
                return leap_on_box
            aside = {
                stage: getattr(leap_on_box.poses, stage) + np.array([0.05, 0.05, *np.zeros(21)])
                for stage in POSES
            }
            return replace(leap_on_box, poses=replace(leap_on_box.poses, **aside))

        monkeypatch.setattr(PlannedPicks, "answer", answer)
        words = "bench pick box mug domino --hand leap --workers 1 --json --out".split()
        assert run([*words, str(tmp_path)]) == 0
        told = json.loads(capsys.readouterr().out)
        assert [row["status"] for row in told["objects"]][:2] == ["picked", "no_answer"]
        assert told["objects"][0]["mass"] == pytest.approx(load_object("box").mass)
        assert told["objects"][2]["status"] != "picked"
        assert (told["all"]["objects"], told["all"]["answered"], told["all"]["picked"]) == (3, 2, 1)
        assert told["pictures"] == ["failed-002-domino.png"]
        picture = np.asarray(Image.open(tmp_path / told["pictures"][0]))
        assert picture.shape[1] == 1400
        assert picture.std() > 20
        assert not (tmp_path / "unfinished.jsonl").exists()
        said = (tmp_path / "report.md").read_text(encoding="utf-8")
        assert "1 of 2 answered were picked up" in said
        assert "failed-002-domino.png" in said
        report = {k: v for k, v in told.items() if k != "files"}
        assert json.loads((tmp_path / "report.json").read_text()) == report

    @pytest.mark.parametrize(
        ("words", "said"),
        [
            ("cube --mass heavy", "--mass takes a number of kilograms or own"),
            ("cube --friction -1", "friction"),
            ("cube --masses {file}", "expected masses such as"),
            ("cube --hand leap --model {file}", "MuJoCo"),
            ("cube --hand utah_mit --model {file}", "no published model is known"),
            ("cub", "cube"),
            ("cube --workers 0", "--workers must be 1 or more"),
            ("cube --out ''", "--out needs a folder"),
        ],
    )
    def test_bad_input(
        self, words: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        file = tmp_path / "bad.json"
        file.write_text("[1, 2]")
        given = [w.replace("{file}", str(file)).replace("''", "") for w in words.split()]
        assert run(["bench", "pick", *given, "--json"]) == 2
        document = json.loads(capsys.readouterr().out)
        assert document["status"] == "error"
        assert said in document["reason"]


LIFT = task_motion(named_task("lift"), [0.0, 0.0, 0.0], 0.03)
DOING = replace(RULES, do=True, turn=0.5)


class TestDoing:
    def test_a_lifted_box_is_lifted_on(self) -> None:
        seen = Counter[str]()
        made = scene(DOING)

        def watch(stage: str, data: mujoco.MjData) -> None:
            seen[stage] += 1

        result = pick_test(made, grip(), DOWN, DOING, work=LIFT, observer=watch)
        assert result.picked
        assert result.job is not None
        assert (result.job.done, result.done, result.job.progress) == (True, True, 1.0)
        assert result.job.displacement is not None
        assert result.job.displacement < 0.005
        assert tuple(seen) == (*STAGES, *JOB_STAGES[1:])  # gravity is the task's already
        assert "then it moved the object along the task's motion" in result.reason
        assert pick_test(scene(), grip(), DOWN, RULES, work=LIFT).job is None

    def test_the_hand_turns_the_object_to_the_task_s_gravity_and_the_table_is_gone(self) -> None:
        sideways = task_motion(named_task("lift:+x"), [0.0, 0.0, 0.0], 0.03)
        made = scene(DOING)
        turned: list[np.ndarray] = []
        heights: list[float] = []

        def watch(stage: str, data: mujoco.MjData) -> None:
            at = made.object_address
            if stage == "turn":
                turned.append(spatial.pose_from_seven(np.array(data.qpos[at : at + 7]))[2, :3])
            if stage in JOB_STAGES:
                assert data.xfrc_applied[made.object_body, 2] < 0
            heights.append(float(data.qpos[at + 2]))

        result = pick_test(made, grip(0.04), DOWN, DOING, work=sideways, observer=watch)
        assert result.done, result.reason
        assert turned[0] == pytest.approx([0, 0, 1], abs=0.1)
        assert turned[-1] == pytest.approx([1, 0, 0], abs=0.05)  # its +x is up
        # Up along +x by 0.1 m, after the lift by 0.1 m.
        assert heights[-1] == pytest.approx(0.2, abs=0.01)
        down = task_motion(named_task("press"), [0.0, 0.0, 0.0], 0.03)  # to where the table was
        assert pick_test(made, grip(0.04), DOWN, replace(DOING, height=0.03), work=down).done
        table = made.model.geom("table")
        assert table.contype[0] == table.conaffinity[0] == 1  # the scene itself is as it was

    def test_what_is_held_too_loosely_for_the_job_is_picked_but_not_done(self) -> None:
        loose = grip(0.0068)  # 400 N/m times 1.8 mm: 0.86 N of friction on 0.05 kg, whose weight is 0.49 N
        assert attempt(loose, protocol=DOING, mass=0.05).picked
        result = pick_test(scene(DOING, mass=0.05), loose, DOWN, DOING, work=LIFT)
        assert result.picked
        assert result.job is not None
        assert not result.job.done
        assert not result.done
        assert result.job.reason.startswith("lost the object")

    def test_not_done_what_was_not_picked(self) -> None:
        result = pick_test(scene(DOING, mass=1.0), grip(0.0058), DOWN, DOING, work=LIFT)
        assert (result.picked, result.done, result.job) == (False, False, None)

    def test_results_with_a_job_there_and_back_counted_and_told(self) -> None:
        class Working(Given):
            def answer(self, thing: PickObject) -> PickAnswer | str:
                found = super().answer(thing)
                weak = thing.name == "again"
                if isinstance(found, str):
                    return found
                return replace(found, work=LIFT, poses=grip(0.0068) if weak else found.poses)

        things = (*THINGS[:2], replace(THINGS[4], mass=0.05))
        report = run_picks(things, PLATES, Working(), cut=cut, protocol=DOING, workers=1)
        score = report.score()
        assert (score.picked, score.done) == (2, 1)
        assert score.done_rate == 0.5
        assert [r.object_name for r in report.failures()] == ["unknown", "again"]
        for result in report.results:
            text = json.dumps(result_to_json(result))
            assert json.dumps(result_to_json(result_from_json(json.loads(text)))) == text
        assert "done with 1 of the 2, 50.0 %" in rate_line(score)
        assert [row[1] for row in failure_table(report.failures()).rows] == ["no answer", NOT_DONE]
        assert go().score().done is None
        again = record_pick(
            pick_scene(PLATES, BOX, things[0], (1.0, 0, 0, 0), DOING), report.results[0], DOING, work=LIFT
        )
        assert again.stages == (*STAGES, *JOB_STAGES[1:])
        assert result_to_json(again.result) == result_to_json(report.results[0])


class TestAtRest:
    def test_an_object_lies_as_it_was_planned_for(self) -> None:
        turn = spatial.rotation_from_vector(np.array([0.0, np.pi / 2, 0.0]))  # its -x is up
        T = spatial.pose(turn, np.zeros(3))
        lying = replace(grip(z=SIDE[0] - SIDE[2] + 0.02), object_pose=HERE)
        # The same grasp as before in the world, stated in the frame of the object.
        own = replace(lying.moved(spatial.inverse(T)), object_pose=HERE)
        quaternion = tuple(spatial.quaternion_from_rotation(turn).tolist())
        answer = PickAnswer(poses=own, way_in=tuple((DOWN @ turn).tolist()), turn=quaternion)
        poses, way_in = answer.in_world()
        assert way_in == pytest.approx(DOWN)
        assert poses.grasp == pytest.approx(lying.grasp)
        made = pick_scene(PLATES, BOX, THINGS[0], quaternion, RULES)
        assert made.model.geom("table").pos[2] == pytest.approx(-SIDE[0])
        result = pick_test(made, poses, way_in, RULES)
        assert result.settled is not None
        assert result.settled.rotation < 0.05
        assert result.turn == pytest.approx(quaternion)
        assert result.way_in == pytest.approx(answer.way_in)
        assert np.array(result.planned) == pytest.approx(np.array(own.rows()))
