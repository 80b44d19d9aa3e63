"""Holding tests of grasp arrays: files, faults, processes, stopping and continuing."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from preshape.exceptions import EnvironmentFailure, InputError
from preshape.objects.load import load_object
from preshape.physics import pool
from preshape.physics.grasps import STAGES, GraspSet, read_grasps, write_grasps
from preshape.physics.hand import PhysicsHand, hand_from_mjcf
from preshape.physics.hold.report import result_from_json, result_to_json
from preshape.physics.hold.runner import perturbed, run_holds
from preshape.physics.hold.six_directions import HoldStatus
from preshape.physics.measures import diversity
from preshape.physics.pieces import ConvexPieces
from preshape.physics.protocol import HoldProtocol
from preshape.planning.grasp_sets import read_grasp_file
from test_physics_scene import BOX, CORNERS, FAST, HAND, HERE, clamp

QUICK = replace(FAST, checks=1)
LONG = ConvexPieces(name="bar", pieces=(CORNERS * [0.03, 0.02, 0.06],))
PIECES = {"box": BOX, "bar": LONG}


def grasp_set(squeezes: list[float], objects: list[str] | None = None) -> GraspSet:
    n = len(squeezes)
    return GraspSet(
        hand="clamp",
        joints=(),
        objects=tuple(objects or ["box"] * n),
        scale=np.ones(n),
        object_pose=np.tile(HERE, (n, 1)),
        pregrasp=np.tile(clamp(0.0), (n, 1)),
        grasp=np.tile(clamp(0.0052), (n, 1)),
        squeeze=np.array([clamp(s) for s in squeezes]),
    )


def lines(report) -> list[str]:
    return [json.dumps(result_to_json(result)) for result in report.results]


class TestFiles:
    def test_npz_there_and_back(self, tmp_path: Path) -> None:
        grasps = replace(grasp_set([0.01, 0.02]), joints=("left", "right"), frame="palm")
        write_grasps(tmp_path / "g.npz", grasps)
        again = read_grasps(tmp_path / "g.npz")
        assert (again.hand, again.joints, again.objects, again.frame) == (
            "clamp",
            ("left", "right"),
            ("box", "box"),
            "palm",
        )
        for name in ("scale", "object_pose", *STAGES):
            assert np.array_equal(getattr(again, name), getattr(grasps, name))

    def test_pickled_arrays_are_refused(self, tmp_path: Path) -> None:
        np.savez(tmp_path / "g.npz", object=np.array([{}], dtype=object), allow_pickle=True)
        with pytest.raises(InputError, match="without pickle"):
            read_grasps(tmp_path / "g.npz")

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"grasp": np.zeros((2, 8))}, r"pregrasp must be 2×8 numbers, got 2×9"),
            ({"squeeze": np.zeros((2, 8))}, r"squeeze must be 2×9 numbers, got 2×8"),
            ({"scale": np.ones(3)}, r"scale must be 2 numbers, got 3"),
            ({"obj_pose": np.ones((2, 6))}, r"obj_pose must be 2×7 numbers, got 2×6"),
            ({"object": np.array([1, 2])}, r"object must be n names"),
            ({"grasp": None}, r"missing arrays grasp; it has"),
        ],
    )
    def test_wrong_shapes_name_the_array(self, tmp_path: Path, change, message: str) -> None:
        write_grasps(tmp_path / "g.npz", grasp_set([0.01, 0.02]))
        with np.load(tmp_path / "g.npz") as stored:
            arrays = {**dict(stored), **change}
        np.savez(tmp_path / "g.npz", **{name: array for name, array in arrays.items() if array is not None})
        with pytest.raises(InputError, match=message):
            read_grasps(tmp_path / "g.npz")

    def test_other_files(self, tmp_path: Path) -> None:
        with pytest.raises(EnvironmentFailure, match="cannot read"):
            read_grasps(tmp_path / "none.npz")
        for content in (b"PK nothing", b"text", b'{"a": 1}', b"[]"):
            (tmp_path / "g").write_bytes(content)
            for read in (read_grasps, read_grasp_file):
                with pytest.raises(InputError):
                    read(tmp_path / "g")

    def test_a_plan_palm_poses_and_joint_order(self, tmp_path: Path) -> None:
        pose = {"palm_pose": [0.0, 0, 0.1, 1, 0, 0, 0], "q": [0.1, 0.2]}
        hand = {"name": "clamp", "joints": ["left", "right"], "reason": "far", **dict.fromkeys(STAGES, pose)}
        extents = (2 * load_object("mug").extents).tolist()
        plan = {"object": {"source": "mug", "extents": extents}, "hand": hand, "alternatives": []}
        plan["alternatives"] = [{"hand": {**hand, "squeeze": None}}]
        (tmp_path / "p.json").write_text(json.dumps(plan))
        grasps = read_grasp_file(tmp_path / "p.json").grasps
        assert grasps.objects == ("mug", "mug")
        assert grasps.scale[0] == pytest.approx(2.0)
        assert [(fault.row, fault.reason) for fault in grasps.faults] == [(1, "the plan has no squeeze: far")]
        T_root_palm = np.eye(4)
        T_root_palm[2, 3] = 0.03
        own = grasps.for_hand(replace(HAND, T_root_palm=T_root_palm))
        assert own.grasp[0] == pytest.approx([0, 0, 0.07, 1, 0, 0, 0, 0.2, 0.1])
        with pytest.raises(InputError, match="the grasps are for the joints left, right"):
            grasps.for_hand(replace(HAND, joints=("left", "unwanted")))

    def test_another_hand_s_width(self) -> None:
        with pytest.raises(InputError, match=r"must be n×8 for the hand clamp \(7 \+ 1 joints\), got n×9"):
            grasp_set([0.01]).for_hand(replace(HAND, joints=("left",)))


class TestRun:
    def test_three_bad_ones_of_many(self) -> None:
        grasps = grasp_set([0.01] * 8, ["box"] * 6 + ["nothing", "box"])
        grasp = np.array(grasps.grasp)
        grasp[2, 8] = np.nan
        pose = np.array(grasps.object_pose)
        pose[5, 3:] = 0.0
        report = run_holds(
            replace(grasps, grasp=grasp, object_pose=pose), HAND, protocol=QUICK, pieces=PIECES, workers=1
        )
        assert [result.status for result in report.results] == [
            HoldStatus.INVALID if row in (2, 5, 6) else HoldStatus.HELD for row in range(8)
        ]
        assert report.figures().tested == 5
        assert report.figures().rate == 1.0
        with pytest.raises(InputError, match="3 of 8 grasps could not be tested") as caught:
            report.raise_for_faults()
        sentence = str(caught.value)
        assert "row 2: grasp is not finite; row 5: obj_pose: the quaternion's length is 0, not 1" in sentence
        assert "row 6: no file or built-in object 'nothing'" in sentence
        assert "the other 5 were" in sentence
        json.dumps(report.to_json(), allow_nan=False)

    @pytest.mark.slow
    def test_one_process_or_two(self) -> None:
        grasps = grasp_set([0.001, 0.006, 0.007, 0.01], ["box", "bar", "box", "bar"])
        protocol = replace(QUICK, position_error=0.001, turn_error=0.01, size_error=0.02, seed=3)
        seen: list[tuple[int, int]] = []
        one = run_holds(grasps, HAND, protocol=protocol, pieces=PIECES, workers=1)
        two = run_holds(
            grasps,
            HAND,
            protocol=protocol,
            pieces=PIECES,
            workers=2,
            progress=lambda *done: seen.append(done),
        )
        assert lines(one) == lines(two)
        assert {result.held for result in one.results} == {True, False}
        assert seen[0] == (0, 4)
        assert seen[-1] == (4, 4)

    def test_a_report_of_one_is_that_row_of_many(self) -> None:
        grasps = grasp_set([0.0053, 0.007, 0.01])
        many = run_holds(grasps, HAND, protocol=QUICK, pieces=PIECES, workers=1)
        last = run_holds(grasp_set([0.01]), HAND, protocol=QUICK, pieces=PIECES, workers=1)
        assert result_to_json(replace(many.results[2], row=0)) == result_to_json(last.results[0])
        for result in many.results:
            assert result_to_json(
                result_from_json(json.loads(json.dumps(result_to_json(result))))
            ) == result_to_json(result)

    def test_stop_early_keeps_the_verdict(self) -> None:
        grasps = grasp_set([0.0053, 0.007, 0.01])
        whole = run_holds(grasps, HAND, protocol=QUICK, pieces=PIECES, workers=1)
        early = run_holds(grasps, HAND, protocol=replace(QUICK, stop_early=True), pieces=PIECES, workers=1)
        assert [result.held for result in whole.results] == [result.held for result in early.results]
        assert len(early.results[0].probes) < len(whole.results[0].probes) == 6


class TestGoingOn:
    def test_after_ctrl_c(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        grasps, file = grasp_set([0.0053 + 0.0003 * k for k in range(20)]), tmp_path / "run.jsonl"

        def stop(done: int, _: int) -> None:
            if done >= 8:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            run_holds(grasps, HAND, protocol=QUICK, pieces=PIECES, workers=1, checkpoint=file, progress=stop)
        kept = file.read_bytes()
        assert kept.count(b"\n") == 9
        file.write_bytes(kept + b'{"row": 9, "sta')  # as a crash leaves it
        seen: list[int] = []
        resumed = run_holds(
            grasps, HAND, protocol=QUICK, pieces=PIECES, workers=1, checkpoint=file,
            progress=lambda done, _: seen.append(done),
        )  # fmt: skip
        assert seen[0] == 8
        assert lines(resumed) == lines(run_holds(grasps, HAND, protocol=QUICK, pieces=PIECES, workers=1))
        assert file.read_bytes().count(b"\n") == 21
        with pytest.raises(InputError, match="belongs to a test of other grasps"):
            run_holds(grasps, HAND, protocol=FAST, pieces=PIECES, workers=1, checkpoint=file)

    def test_other_files_are_not_overwritten(self, tmp_path: Path) -> None:
        file = tmp_path / "notes.txt"
        for content in ("my notes", "my notes\nmore\n", '{"format": "other"}\n'):
            file.write_text(content)
            with pytest.raises(InputError, match="choose another file"):
                run_holds(grasp_set([0.01]), HAND, protocol=QUICK, pieces=PIECES, workers=1, checkpoint=file)
            assert file.read_text() == content

    @pytest.mark.slow
    def test_after_a_kill(self, tmp_path: Path) -> None:
        file, script = tmp_path / "run.jsonl", tmp_path / "run.py"
        script.write_text(
            "from test_physics_run import *\n"
            "if __name__ == '__main__':\n"
            "    run_holds(grasp_set([0.007] * 400), HAND, protocol=FAST, pieces=PIECES, workers=2,"
            f" checkpoint={str(file)!r})\n"
        )
        root = Path(__file__).parent.parent
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(root / "tests"), str(root / "src")])}
        process = subprocess.Popen([sys.executable, str(script)], env=environment, start_new_session=True)
        try:
            deadline = time.monotonic() + 100
            while time.monotonic() < deadline and not (file.exists() and file.read_bytes().count(b"\n") > 9):
                time.sleep(0.05)
        finally:
            process.kill()
            process.wait()
        assert process.returncode == -signal.SIGKILL
        time.sleep(0.2)
        done = [json.loads(line) for line in file.read_bytes().split(b"\n")[1:-1]]
        assert 8 <= len(done) < 400
        deadline = time.monotonic() + 20  # the workers end with their parent
        while time.monotonic() < deadline and _group_lives(process.pid):
            time.sleep(0.1)
        assert not _group_lives(process.pid)
        # What was kept is right: the same grasp tested here gives the same line.
        [alone] = run_holds(grasp_set([0.007]), HAND, protocol=FAST, pieces=PIECES, workers=1).results
        assert {json.dumps({**row, "row": 0}) for row in done} == {json.dumps(result_to_json(alone))}


def _group_lives(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


class TestErrorsAndSets:
    def test_perturbed_by_exactly_what_was_asked(self) -> None:
        grasps = grasp_set([0.01] * 40)
        protocol = HoldProtocol(position_error=0.005, turn_error=0.0873, size_error=0.05, seed=1)
        moved = perturbed(grasps, {"box": BOX}, protocol)
        assert np.linalg.norm(moved.object_pose[:, :3], axis=1) == pytest.approx(np.full(40, 0.005))
        assert 2 * np.arccos(np.abs(moved.object_pose[:, 3])) == pytest.approx(np.full(40, 0.0873))
        assert set(np.round(moved.scale, 12)) == {0.95, 1.05}
        # Errors belong to a row and a seed, not to the set; the hand is where it was.
        few = perturbed(grasp_set([0.01] * 3), {"box": BOX}, protocol)
        assert np.array_equal(few.object_pose, moved.object_pose[:3])
        assert not np.array_equal(
            moved.object_pose, perturbed(grasps, {"box": BOX}, replace(protocol, seed=2)).object_pose
        )
        assert np.array_equal(moved.grasp, grasps.grasp)
        assert perturbed(grasps, {"box": BOX}, HoldProtocol()) is grasps

    def test_diversity(self) -> None:
        rng = np.random.default_rng(0)
        hand = np.tile(clamp(0.0), (50, 1))
        assert diversity(hand, np.tile(HERE, (50, 1))) is None  # all the same
        hand[:, 7] = rng.normal(size=50)
        assert diversity(hand, np.tile(HERE, (50, 1))) == pytest.approx(1.0)
        hand[:, 8] = hand[::-1, 7]
        hand[:, 8] -= hand[:, 7] * (hand[:, 7] @ hand[:, 8]) / (hand[:, 7] @ hand[:, 7])
        shared = diversity(hand, np.tile(HERE, (50, 1)))
        assert shared is not None
        assert 0.5 <= shared < 0.75
        # Where hand and object stand in the world does not matter.
        away = np.tile([1.0, 2, 3, 1, 0, 0, 0], (50, 1))
        hand[:, :3] += [1, 2, 3]
        assert diversity(hand, away) == pytest.approx(shared)


@pytest.mark.slow
class TestPublishedGrasps:
    """Published Shadow grasps, whose verdicts in MuJoCo 4.0.1 are known for the whole set."""

    VERDICTS: ClassVar = {
        41: True,
        54: True,
        115: True,
        135: True,
        146: False,
        168: False,
        213: True,
        237: True,
        249: False,
        280: True,
        326: False,
        353: True,
    }

    def hand(self, reference: Path) -> PhysicsHand:
        path = reference / "hands" / "shadow_hand" / "right_hand.xml"
        return hand_from_mjcf(path, root="rh_wrist", fixed=("rh_WRJ2", "rh_WRJ1"), name="shadow")

    def test_the_hand(self, reference: Path) -> None:
        joints = [
            f"rh_{f}J{k}"
            for f, n in (("FF", 4), ("MF", 4), ("RF", 4), ("LF", 5), ("TH", 5))
            for k in range(n, 0, -1)
        ]
        assert list(self.hand(reference).joints) == joints

    def test_a_dozen(self, reference: Path) -> None:
        folder = reference / "dexgraspbench"
        grasps = read_grasps(folder / "bodex_shadow_grasps.npz")
        assert len(grasps) == 400
        rows = list(self.VERDICTS)
        few = replace(
            grasps,
            objects=tuple(grasps.objects[row] for row in rows),
            **{name: getattr(grasps, name)[rows] for name in ("scale", "object_pose", *STAGES)},
        )
        report = run_holds(
            few,
            self.hand(reference),
            protocol=HoldProtocol(stop_early=True),
            objects=folder / "objects",
            workers=1,
        )
        assert dict(zip(rows, (result.held for result in report.results), strict=True)) == self.VERDICTS


def test_a_process_of_the_pool_has_mujoco_write_no_log_and_stops_after_its_job(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import mujoco

    stop = threading.Event()

    class Asking:
        def test(self, job: int) -> object:
            if job == 2:
                stop.set()
            return mujoco.get_mju_user_warning()

    monkeypatch.setattr(pool, "_tester", Asking())
    monkeypatch.setattr(pool, "_stop", stop)
    before = mujoco.get_mju_user_warning()
    found = pool._run_chunk([1, 2, 3])
    assert len(found) == 2
    assert all(callable(handler) for handler in found)  # without one MuJoCo writes MUJOCO_LOG.TXT
    assert mujoco.get_mju_user_warning() is before
