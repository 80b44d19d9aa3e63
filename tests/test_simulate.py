"""``preshape simulate``: recordings obey mechanics, and table, filmstrip and GIF show them."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import PIL.Image
import pytest

from preshape import spatial
from preshape.cli.main import run
from preshape.cli.simulate_film import film_of
from preshape.exceptions import InputError
from preshape.physics.grasps import GraspSet, write_grasps
from preshape.physics.hold.recording import APPROACH, PRESSES, Recording, record_hold
from preshape.physics.hold.six_directions import HoldStatus, hold_test
from preshape.physics.protocol import HoldProtocol
from preshape.physics.scene import Scene, build_scene
from preshape.viewer.animation import animation, chosen_frames
from preshape.viewer.film import Film
from preshape.viewer.filmstrip import MAX_KEY_FRAMES, filmstrip, filmstrip_image, key_frames
from test_physics_scene import BOX, FAST, HAND, HERE, SIDE, clamp, grasp_of

EXAMPLE = Path(__file__).parent.parent / "docs" / "plan.example.json"
FINGERS = ("palm", "thumb", "index")


def scene_of(protocol: HoldProtocol = FAST) -> Scene:
    return build_scene(HAND, BOX, 1.0, protocol)


def record(squeeze: float = 0.01, protocol: HoldProtocol = FAST, **options) -> Recording:
    return record_hold(
        scene_of(protocol), grasp_of(clamp(0.0), clamp(0.0052), clamp(squeeze)), protocol, **options
    )


@pytest.fixture(scope="module")
def held() -> Recording:
    return record(parts=FINGERS)


@pytest.fixture(scope="module")
def lost() -> Recording:
    """The plates stop before the box, so nothing touches it."""
    return record_hold(scene_of(), grasp_of(clamp(0.0), clamp(0.002), clamp(0.003)), FAST)


@pytest.fixture(scope="module")
def film(held: Recording) -> Film:
    return film_of(held, scene_of(), HoldProtocol())


class TestRecording:
    def test_the_verdict_is_that_of_the_test_alone(self, held: Recording) -> None:
        alone = hold_test(scene_of(), grasp_of(clamp(0.0), clamp(0.0052), clamp(0.01)), FAST)
        assert held.result.status is alone.status is HoldStatus.HELD
        for seen, known in zip(held.result.probes, alone.probes, strict=True):
            assert (seen.name, seen.displacement, seen.rotation) == (
                known.name,
                known.displacement,
                known.rotation,
            )

    def test_stages_and_times(self, held: Recording) -> None:
        assert held.stages == (*APPROACH, *(probe.name for probe in FAST.loads()))
        assert (np.diff(held.times) > 0).all()
        assert held.times[0] == 0.0
        for before, after in pairwise(held.stages):
            assert held.span(before).stop == held.span(after).start
        seconds = FAST.timestep * FAST.check_steps * FAST.checks
        approach = 2 * FAST.timestep * FAST.stage_steps * FAST.stages
        assert held.times[-1] == pytest.approx(approach + 6 * seconds)
        with pytest.raises(InputError, match="no stage 'lift' in the recording; known: pregrasp, grasp"):
            held.span("lift")

    def test_at_rest_the_fingers_balance_the_load(self, held: Recording) -> None:
        loads = {probe.name: probe.wrench for probe in FAST.loads()}
        for name, wrench in loads.items():
            last = held.span(name).stop - 1
            assert held.load[last] == pytest.approx(wrench)
            assert held.forces[last].sum(axis=0) == pytest.approx(-wrench[:3], abs=2e-3)
        assert not held.load[held.span("squeeze")].any()

    def test_always_force_is_mass_times_acceleration(self) -> None:
        protocol = replace(FAST, mass=0.4, checks=1)
        scene = scene_of(protocol)
        speed = int(scene.model.joint("object").dofadr[0])
        seen: list[np.ndarray] = []
        poses = grasp_of(clamp(0.0), clamp(0.0052), clamp(0.01))
        hold_test(
            scene, poses, protocol,
            observer=lambda _, data: seen.append(data.qacc[speed : speed + 3].copy()),
        )  # fmt: skip
        recording = record_hold(scene, poses, protocol)
        net = recording.forces.sum(axis=1) + recording.load[:, :3]
        assert np.abs(net).max() > 0.05  # something moves: the balance above is no accident
        assert net[1:] == pytest.approx(0.4 * np.array(seen), abs=1e-6)

    def test_normal_and_tangential_are_the_parts_of_the_force(self, held: Recording) -> None:
        # The plates press along x: their normal force is the force's x, friction the rest of it.
        pressing = held.normal > PRESSES
        assert pressing.any(axis=0).tolist() == [False, True, True]
        assert np.abs(held.forces[..., 0])[pressing] == pytest.approx(held.normal[pressing], rel=2e-3)
        across = np.linalg.norm(held.forces[..., 1:], axis=-1)
        assert across[pressing] == pytest.approx(held.tangential[pressing], abs=5e-3)
        assert (held.tangential <= FAST.friction * held.normal * (1 + 1e-3) + 1e-6).all()
        assert not held.forces[~pressing].any()
        # Each pushes towards the other, from its own face.
        last = held.span("squeeze").stop - 1
        sides = held.points[last, 1:, 0]
        assert np.abs(sides) == pytest.approx([SIDE[0], SIDE[0]], abs=1e-3)
        assert (np.sign(held.forces[last, 1:, 0]) == -np.sign(sides)).all()

    def test_a_servo_at_rest_carries_what_it_presses_with(self, held: Recording) -> None:
        # The joints slide along x: torque is force there. Order: HAND.joints is (right, left).
        last = held.span("force +y").stop - 1
        assert held.torques[last] == pytest.approx(held.normal[last, 1:][::-1], rel=1e-2)

    def test_gap_shrinks_from_5_mm_to_a_touch(self, held: Recording) -> None:
        assert held.gap[0] == pytest.approx(0.005, abs=1e-5)
        way = held.gap[held.span("grasp")]
        assert (np.diff(way)[:4] < 0).all()
        assert -0.001 < held.gap[held.span("squeeze").stop - 1] < 0.0

    def test_untouched_slips_nothing_and_is_pushed_away(self, lost: Recording) -> None:
        assert lost.result.status is HoldStatus.LOST
        for stage in ("squeeze", "force +y", "force -y"):
            span = lost.span(stage)
            assert not lost.slip[span].any()
            assert not lost.forces[span].any()
            assert not lost.normal[span].any()
            assert (lost.gap[span] > 0).all()
        assert lost.moved("squeeze") == (0.0, 0.0)

    def test_what_sticks_does_not_slip(self, held: Recording) -> None:
        firm = held.slip[held.span("force +y")]
        assert firm.max() < 2e-5
        assert not held.slip[:, 0].any()

    def test_slip_is_the_way_of_a_finger_over_the_object(self) -> None:
        # Friction of nearly nothing: pushed along y the box slides out between plates that stay.
        protocol = replace(FAST, friction=0.005, torsion=0.0, checks=10)
        recording = record(0.006, protocol, probes=["force +y"])
        span = recording.span("force +y")
        way = recording.object_pose[span, 1] - recording.object_pose[recording.span("squeeze").stop - 1, 1]
        pressing = (recording.normal[span, 1:] > 0).all(axis=1)
        assert way[pressing].max() > 0.01
        assert not pressing.all()  # it leaves them: what it does then is no slip
        for finger in (1, 2):
            slip = recording.slip[span, finger]
            assert slip[pressing] == pytest.approx(way[pressing], rel=0.02, abs=1e-5)
            assert (slip[~pressing] == slip[pressing][-1]).all()

    def test_turning_hand_and_object_together_changes_nothing(self, held: Recording) -> None:
        T = spatial.pose(spatial.rotation_from_vector([0.0, 0.0, np.pi / 2]), [0.3, -0.2, 0.1])

        def moved(posture: np.ndarray) -> np.ndarray:
            seven = spatial.seven_from_pose(T @ spatial.pose_from_seven(posture[:7]))
            return np.concatenate([seven, posture[7:]])

        there = record_hold(
            scene_of(), grasp_of(*(moved(p) for p in (clamp(0.0), clamp(0.0052), clamp(0.01), HERE))), FAST
        )
        span = held.span("squeeze")
        assert there.normal[span] == pytest.approx(held.normal[span], rel=0.05, abs=0.05)
        assert there.forces[span.stop - 1] @ T[:3, :3] == pytest.approx(held.forces[span.stop - 1], abs=0.05)

    def test_only_the_probes_asked_for(self, held: Recording) -> None:
        few = record(probes=["force -z"])
        assert few.stages == (*APPROACH, "force -z")
        assert len(few.result.probes) == 6
        same = held.span("force -z")
        assert few.normal[few.span("force -z")] == pytest.approx(held.normal[same], abs=1e-9)
        assert few.slip[few.span("force -z")] == pytest.approx(held.slip[same], abs=1e-12)
        with pytest.raises(InputError, match=r"no probe 'lift' in the test; known: force \+x"):
            record(probes=["lift"])
        with pytest.raises(InputError, match="a palm and 2 fingers, got 1 names"):
            record(parts=["palm"])

    def test_the_ladder_is_not_recorded_twice(self) -> None:
        protocol = replace(FAST, checks=1, ladder=True, ladder_rungs=1)
        assert len(record(protocol=protocol)) == len(record(protocol=replace(protocol, ladder=False)))

    def test_a_pregrasp_that_cuts_in_is_one_sample(self) -> None:
        recording = record_hold(scene_of(), grasp_of(*[clamp(0.02)] * 3), FAST)
        assert recording.result.status is HoldStatus.PENETRATES
        assert recording.stages == ("pregrasp",)
        picture = filmstrip_image(film_of(recording, scene_of(), HoldProtocol()), width=600)
        assert picture.shape[1] == 600


class TestPictures:
    def test_key_frames_go_from_the_pregrasp_to_the_last_push(self, film: Film) -> None:
        frames = key_frames(film)
        names = [film.stage_at(frame).name for frame in frames]
        assert names == ["pregrasp", "squeeze", *(probe.name for probe in FAST.loads())]
        assert len(frames) == MAX_KEY_FRAMES
        assert frames == sorted(set(frames))

    def test_of_many_probes_those_that_were_lost_are_shown(self) -> None:
        recording = record(0.0055, replace(FAST, probes="all", checks=1))
        film = film_of(recording, scene_of(), HoldProtocol())
        assert len(film.stages) == 3 + 28
        worse = replace(film, stages=(*film.stages[:30], replace(film.stages[30], passed=False)))
        frames = key_frames(worse)
        assert len(frames) == MAX_KEY_FRAMES
        assert worse.stage_at(frames[-1]).name == worse.stages[30].name

    def test_the_object_is_drawn_where_it_is(self, film: Film) -> None:
        later = film.stages[3].stop - 1
        [box] = [k for k, own in enumerate(film.is_object) if own]
        drawn = film.shapes(later)[box].vertices
        shift = film.poses[later, box, :3, 3] - film.poses[0, box, :3, 3]
        assert drawn.mean(axis=0) - film.shapes(0)[box].vertices.mean(axis=0) == pytest.approx(
            shift, abs=1e-5
        )
        assert np.sort(np.abs(film.shapes(0)[box].vertices), axis=0)[-1] == pytest.approx(SIDE, abs=1e-6)

    def test_the_load_is_an_arrow_outside_the_object_along_the_force(self, film: Film) -> None:
        frame = film.stages[3].stop - 1  # force +x
        stroke = film.load_arrow(frame, film.load[frame])
        assert stroke is not None
        start, tip = stroke
        assert (tip - start) / np.linalg.norm(tip - start) == pytest.approx([1, 0, 0])
        assert start[0] > SIDE[0]
        assert film.load_arrow(0, film.load[0]) is None
        assert len(film.shapes(frame)) == len(film.shapes(0)) + 1

    def test_filmstrip_is_written_whole_and_its_frames_differ(self, film: Film, tmp_path: Path) -> None:
        filmstrip(film, tmp_path / "strip.png", width=480)
        with PIL.Image.open(tmp_path / "strip.png") as picture:
            assert picture.size[0] == 480
            assert np.asarray(picture).std() > 10
        assert [path.name for path in tmp_path.iterdir()] == ["strip.png"]
        camera = film.camera(np.array([0]), 1.0)
        first, second = (film.picture(f, camera, (90, 90), samples=1) for f in (0, film.stages[2].stop - 1))
        assert (np.abs(first.astype(int) - second).max(axis=2) > 20).sum() > 30
        assert np.array_equal(first, film.picture(0, camera, (90, 90), samples=1))

    def test_gif_has_the_chosen_frames_at_12_a_second(self, film: Film) -> None:
        told: list[tuple[int, int]] = []
        short = cut(film, 2)
        content = animation(short, side=120, progress=lambda *done: told.append(done))
        count = len(chosen_frames(short))
        assert told == [(k, count) for k in range(1, count + 1)]
        with PIL.Image.open(io.BytesIO(content)) as gif:
            assert gif.n_frames == count
            assert gif.info["loop"] == 0
            times, looks = [], []
            for frame in range(count):
                gif.seek(frame)
                times.append(gif.info["duration"])
                looks.append(np.asarray(gif.convert("RGB")).astype(int))
        assert set(times[:-1]) == {80}
        assert times[-1] == 1200
        assert all((np.abs(a - b) > 8).any() for a, b in pairwise(looks))
        with pytest.raises(InputError, match="120 pixels wide or more"):
            animation(short, side=20)

    def test_chosen_frames_are_few_and_cover_every_stage(self, film: Film) -> None:
        frames = chosen_frames(film)
        assert len(frames) <= 96
        assert (np.diff(frames) > 0).all()
        assert {film.stage_at(int(f)).name for f in frames} == {stage.name for stage in film.stages}

    def test_a_film_is_checked(self, film: Film) -> None:
        with pytest.raises(InputError, match="follow each other"):
            replace(film, stages=film.stages[1:])
        with pytest.raises(InputError, match="film: slip must be"):
            replace(film, slip=film.slip[1:])
        with pytest.raises(InputError, match="needs an object"):
            replace(film, is_object=(False,) * len(film.solids))


def cut(film: Film, stages: int) -> Film:
    """The first stages of a film."""
    kept = film.stages[:stages]
    n = kept[-1].stop
    arrays = {
        k: getattr(film, k)[:n] for k in ("times", "poses", "load", "load_point", "normal_force", "slip")
    }
    return replace(film, stages=kept, **arrays)


def planned_with(folder: Path, *, mass: float | None = None, **request: object) -> Path:
    """The example plan as if it had been made for another mass or request."""
    document = json.loads(EXAMPLE.read_text())
    document["request"] |= request
    document["mass"] = mass or document["mass"]
    file = folder / "changed.json"
    file.write_text(json.dumps(document))
    return file


def without_answer(document: dict) -> dict:
    """A plan whose answer is refused by the critic: its grasp is only the best that was found."""
    hand = {**document["hand"], "reason": None, **dict.fromkeys(("pregrasp", "grasp", "squeeze"))}
    refused = {"status": "deadlock", "reason": "too weak", "plane": None, "executable": False}
    best = {**document, "status": "deadlock", "executable": False, "alternatives": []}
    return {**document, **refused, "hand": hand, "alternatives": [], "best": best}


class TestCommand:
    def test_the_example_plan(self, capsys: pytest.CaptureFixture[str]) -> None:
        code = run(["simulate", str(EXAMPLE), "--json"])
        document = json.loads(capsys.readouterr().out)
        assert code == (0 if document["status"] == "held" else 1)
        assert document["hand"] == "utah_mit"
        assert document["parts"] == ["palm", "thumb", "index", "middle", "ring"]
        stages = {row["stage"]: row for row in document["stages"]}
        assert list(stages) == [*APPROACH, *(f"force {s}{a}" for s in "+-" for a in "xyz")]
        assert stages["squeeze"]["largest_force"] > 0.1
        assert stages["pregrasp"]["touching"] == []
        series = document["series"]
        assert max(max(row) for row in series["normal"]) == max(r["largest_force"] for r in stages.values())
        assert len({len(series[name]) for name in series}) == 1
        verdicts = [row["held"] for row in stages.values()]
        assert verdicts[:3] == [None] * 3
        assert all(verdicts[3:]) == (document["status"] == "held")

    def test_the_table(self, capsys: pytest.CaptureFixture[str]) -> None:
        code = run(["simulate", str(EXAMPLE), "--answer", "1"])
        out = capsys.readouterr().out
        assert all(f"force {sign}{axis}" in out for sign in "+-" for axis in "xyz")
        assert ("Held: " in out) == (code == 0)
        assert ("Not held: " in out) == (code == 1)

    def test_pictures(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        from preshape.viewer import animation as moving
        from preshape.viewer import filmstrip as still

        monkeypatch.setattr("preshape.viewer.film.VIEWS", 1)
        small = moving.animation
        monkeypatch.setattr(moving, "animation", lambda film, **o: small(cut(film, 1), **{**o, "side": 120}))
        page = still.filmstrip
        monkeypatch.setattr(still, "filmstrip", lambda film, path: page(cut(film, 2), path, width=300))
        run(["simulate", str(EXAMPLE), "--out", str(tmp_path / "new" / "folder"), "--json"])
        files = [Path(name) for name in json.loads(capsys.readouterr().out)["files"]]
        assert [file.name for file in files] == ["filmstrip.png", "run.gif"]
        assert sorted(path.name for path in files[0].parent.iterdir()) == ["filmstrip.png", "run.gif"]
        with PIL.Image.open(files[1]) as gif:
            assert gif.format == "GIF"

    def test_a_row_of_an_array(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        from preshape.physics.grasps import STAGES
        from preshape.planning.grasp_sets import read_grasp_file

        plan = read_grasp_file(EXAMPLE).grasps
        write_grasps(tmp_path / "g.npz", plan)
        run(["simulate", str(EXAMPLE), "--answer", "1", "--json"])
        by_answer = json.loads(capsys.readouterr().out)
        run(["simulate", str(tmp_path / "g.npz"), "--row", "1", "--mass", str(by_answer["mass"]), "--json"])
        by_row = json.loads(capsys.readouterr().out)
        assert by_row["series"] == by_answer["series"]
        assert by_row["row"] == 1
        run(["simulate", str(tmp_path / "g.npz"), "--json"])  # arrays do not say their load
        plain = json.loads(capsys.readouterr().out)
        assert (plain["mass"], plain["friction"]) == (0.1, 0.6)
        nameless = GraspSet(
            hand="", joints=(), objects=plan.objects, scale=plan.scale, object_pose=plan.object_pose,
            frame="palm", **{stage: getattr(plan, stage) for stage in STAGES},
        )  # fmt: skip
        write_grasps(tmp_path / "n.npz", nameless)
        assert run(["simulate", str(tmp_path / "n.npz")]) == 2
        assert "give --hand" in capsys.readouterr().err

    def test_the_load_is_the_plan_s_own(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        """A plan for 0.25 kg and friction 0.5 is tested with these unless options set others."""
        file = planned_with(tmp_path, mass=0.25, friction=0.5)
        runs = []
        for options in ([], ["--mass", "0.25", "--friction", "0.5"], ["--mass", "0.1", "--friction", "0.6"]):
            run(["simulate", str(file), *options, "--json"])
            runs.append(json.loads(capsys.readouterr().out))
        assert [(r["mass"], r["friction"]) for r in runs] == [(0.25, 0.5), (0.25, 0.5), (0.1, 0.6)]
        assert runs[0]["series"] == runs[1]["series"] != runs[2]["series"]
        run(["simulate", str(file)])
        assert "simulated with 0.25 kg and friction 0.5" in capsys.readouterr().out

    def test_a_plan_of_the_first_version(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        document = json.loads(EXAMPLE.read_text())
        for key in ("schema", "request", "mass", "mass_source"):
            del document[key]
        (tmp_path / "plan.json").write_text(json.dumps(document))
        run(["simulate", str(tmp_path / "plan.json"), "--json"])
        told = json.loads(capsys.readouterr().out)
        assert (told["mass"], told["friction"], told["warnings"]) == (0.1, 0.6, [])

    def test_a_table_is_left_out_and_said(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        box = [1.0, 1.0, 1.0, 2.0, 2.0, 2.0]
        run(["simulate", str(planned_with(tmp_path, table="auto")), "--json"])
        assert json.loads(capsys.readouterr().out)["warnings"] == ["the table is left out of this test"]
        run(["simulate", str(planned_with(tmp_path, table=0.0, avoid=[box, box]))])
        assert "the table and 2 boxes are left out of this test" in capsys.readouterr().out

    def test_the_best_grasp_of_a_plan_without_an_answer(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        file = tmp_path / "plan.json"
        file.write_text(json.dumps(without_answer(json.loads(EXAMPLE.read_text()))))
        assert run(["simulate", str(file), "--json"]) == 2
        reason = json.loads(capsys.readouterr().out)["reason"]
        assert "too weak; --best takes the best grasp that was found" in reason
        run(["simulate", str(EXAMPLE), "--json"])
        answer = json.loads(capsys.readouterr().out)
        run(["simulate", str(file), "--best", "--json"])
        best = json.loads(capsys.readouterr().out)
        assert best["series"] == answer["series"]

    def test_plain_friction_matters(self, capsys: pytest.CaptureFixture[str]) -> None:
        slips = []
        for friction in ("0.05", "1.5"):
            run(["simulate", str(EXAMPLE), "--friction", friction, "--json"])
            rows = json.loads(capsys.readouterr().out)["stages"]
            slips.append(sum(bool(row["held"]) for row in rows))
        assert slips[0] < slips[1]

    @pytest.mark.parametrize(
        ("options", "code", "message"),
        [
            (["--mass", "0"], 2, "mass must be above 0"),
            (["--friction", "-1"], 2, "friction must be at least 0"),
            (["--probes", "seven"], 2, "no probe set 'seven'; known: six, all"),
            (["--answer", "9"], 2, "--answer must be 0 to "),
            (["--answer", "-1"], 2, "--answer must be 0 to "),
            (["--answer", "0", "--row", "0"], 2, "not both"),
            (["--hand", "nobody"], 2, "no hand 'nobody'"),
            (["--hand", "shadow"], 2, "the grasps are for the joints"),
            (["--out", " "], 2, "--out needs a folder"),
            (["--objects", "no/such/folder"], 3, "no folder"),
        ],
    )
    def test_bad_options(
        self, options: list[str], code: int, message: str, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert run(["simulate", str(EXAMPLE), *options, "--json"]) == code
        reply = json.loads(capsys.readouterr().out)
        assert reply["status"] == "error"
        assert message in reply["reason"]

    def test_bad_files(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        file = tmp_path / "plan.json"
        for content in ("{}", "[]", "text", '{"object": 1}'):
            file.write_text(content)
            assert run(["simulate", str(file)]) == 2
            assert "error: " in capsys.readouterr().err
        assert run(["simulate", str(tmp_path / "none.json")]) == 3

    def test_a_plan_without_a_posture(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        plan = json.loads(EXAMPLE.read_text())
        plan["hand"] |= {"pregrasp": None, "grasp": None, "squeeze": None, "reason": "too far"}
        (tmp_path / "plan.json").write_text(json.dumps(plan))
        assert run(["simulate", str(tmp_path / "plan.json")]) == 2
        error = " ".join(capsys.readouterr().err.split())
        assert "answer 0 cannot be simulated: the plan has no pregrasp: too far; --answer 1 can" in error
