"""A run in simulated physics, asked for and played back in a real browser; and the same without one."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal

import numpy as np
import pytest

import preshape
from preshape.app.physics_player import RunPlayer, run_of
from preshape.app.physics_run import answer_run
from preshape.cli.main import run
from preshape.exceptions import InputError
from preshape.pictures import document_motion
from preshape.planning.grasp_sets import planned_for
from preshape.spatial import pose_from_seven
from preshape.viewer.canvas import RecordingCanvas
from view_app_page import SMALL, Watched, box_beside, keep, plan, planners, press, saw, set_number, tab, until

pytest_plugins = ("view_app_fixtures",)

SIX = ["force +x", "force +y", "force +z", "force -x", "force -y", "force -z"]


@pytest.fixture(scope="module")
def planned() -> preshape.Plan:
    return preshape.plan("hammer", "lift", hand="utah_mit", memory=":memory:")


@pytest.fixture(scope="module")
def said(planned) -> dict:
    document = preshape.plan_to_json(planned)
    told: list[tuple[str, float]] = []
    made = answer_run(
        planned.hand,
        planned.mesh,
        document["hand"],
        friction=0.8,
        mass=0.05,
        job=None,
        progress=lambda words, share: told.append((words, share)),
    )
    assert [share for _, share in told] == sorted(share for _, share in told)
    return json.loads(json.dumps(made))


def test_a_run_begins_as_planned_and_has_six_pushes(planned, said) -> None:
    run = run_of(said)
    assert sorted(row["name"] for row in said["rows"]) == SIX
    assert said["note"].startswith("Each push is 0.5 N for 2 s.")
    motion = document_motion(planned.hand, preshape.plan_to_json(planned))
    # the first sample is the pregrasp: every link where the plan draws it
    assert run.stage[0] == "pregrasp"
    assert np.allclose(run.links[0], motion.poses[12], atol=1e-6)
    assert np.allclose(run.object_poses[0], np.eye(4), atol=1e-9)
    # every push pushes the way it is called, and nothing else does
    for k, stage in enumerate(run.stage):
        force = run.load[k, :3]
        if stage.startswith("force"):
            way = np.zeros(3)
            way["xyz".index(stage[-1])] = 1.0 if stage[-2] == "+" else -1.0
            assert np.allclose(force, 0.5 * way)
        else:
            assert not force.any()
    # the table tells what the poses show
    for row in said["rows"]:
        own = [k for k, stage in enumerate(run.stage) if stage == row["name"]]
        moved = max(
            np.linalg.norm(run.object_poses[k][:3, 3] - run.object_poses[own[0] - 1][:3, 3]) for k in own
        )
        assert row["held"] == (row["moved"] <= 0.05 and row["turned"] <= np.radians(15))
        assert moved <= row["moved"] + 0.02


def test_the_player_places_object_hand_and_push_and_puts_them_back(planned, said) -> None:
    run = run_of(said)
    motion = document_motion(planned.hand, preshape.plan_to_json(planned))
    canvas = RecordingCanvas()
    player = RunPlayer(canvas)
    last = len(run) - 1
    player.show(run, motion.links, last, planned.mesh)
    assert np.array_equal(canvas.poses["object"], run.object_poses[last])
    assert np.array_equal(canvas.poses[f"hand/{motion.links[-1]}"], run.links[last][-1])
    # the arrow points along the push, towards the object
    arrow = canvas.solids["push/arrow"].vertices
    way = run.load[last, :3] / np.linalg.norm(run.load[last, :3])
    assert (arrow @ way).max() < 0
    player.show(run, motion.links, 0, planned.mesh)
    assert "push/arrow" not in canvas.solids
    player.show(run, motion.links, last, planned.mesh)
    player.leave()
    assert "push/arrow" not in canvas.solids
    assert np.array_equal(canvas.poses["object"], np.eye(4))


def test_an_answer_without_a_grasp_is_not_simulated(planned) -> None:
    document = preshape.plan_to_json(planned)
    with pytest.raises(InputError, match="nothing to simulate"):
        answer_run(
            planned.hand,
            planned.mesh,
            {**document["hand"], "grasp": None},
            friction=0.6,
            mass=0.1,
            job=None,
            progress=lambda *_: None,
        )


def test_a_run_is_cancelled_asked_for_again_played_and_dropped_with_its_answer(opened, tmp_path) -> None:
    page = opened("hammer").page
    tab(page, "Physics")
    simulate = page.get_by_role("button", name="Simulate this answer")
    assert simulate.is_disabled()
    tab(page, "Plan")
    plan(page)
    tab(page, "Physics")
    rows = page.locator("tr:has(td:text-matches('^force [+-][xyz]$'))")
    cancel = page.get_by_role("button", name="Cancel")

    # a run is cancelled in its midst
    (planner,) = planners(tmp_path)
    os.kill(planner, signal.SIGSTOP)  # however fast the machine is, the run does not end now
    simulate.click()
    cancel.wait_for()
    press(page, "Cancel")
    saw(page, "Everything that was learnt before is kept")
    cancel.wait_for(state="hidden")
    until(page, lambda: planner not in planners(tmp_path))
    assert rows.count() == 0
    assert page.get_by_role("button", name="Play the run").count() == 0

    # the next one works, and is read and played
    simulate.click()
    saw(page, "Each push is 3.5 N for 2 s")
    assert sorted(rows.locator("td:first-child").all_text_contents()) == SIX
    saw(page, "Grasp found")
    cancel.wait_for(state="hidden")
    keep(page, "app-physics")
    scene = page.locator("canvas").first
    shown = scene.screenshot()
    set_number(page, "Moment", "0")
    saw(page, "open before the object")
    until(page, lambda: scene.screenshot() != shown)
    moment = box_beside(page, "Moment")
    press(page, "Play the run")
    saw(page, "push: ")
    until(page, lambda: float(moment.input_value()) == 1.0)

    # another answer has no run yet
    _choose_answer(page, 2)
    tab(page, "Physics")
    until(page, lambda: rows.count() == 0)
    until(page, lambda: page.get_by_role("button", name="Play the run").count() == 0)

    # a run that comes after another answer was chosen is not shown with it
    (planner,) = planners(tmp_path)
    os.kill(planner, signal.SIGSTOP)  # a fast machine would end the run before another answer is chosen
    simulate.click()
    cancel.wait_for()
    _choose_answer(page, 1)
    os.kill(planner, signal.SIGCONT)
    saw(page, "The answer that was simulated is no longer shown")
    tab(page, "Physics")
    assert page.get_by_role("button", name="Play the run").count() == 0


def test_one_press_films_the_whole_job_that_simulate_runs(browser, serve, lesson, tmp_path, capsys) -> None:
    memory = tmp_path / "known.sqlite"
    shutil.copyfile(lesson("allegro"), memory)
    made = preshape.plan("cube", "lift", hand="allegro", memory=memory)
    file = tmp_path / "plan.json"
    file.write_text(json.dumps(preshape.plan_to_json(made)), encoding="utf-8")
    with contextlib.suppress(SystemExit):
        run(["simulate", str(file), "--json"])
    said = json.loads(capsys.readouterr().out)
    assert [row["stage"] for row in said["stages"]][-2:] == ["path", "rest"]  # it did the task

    # the values that the page plays are those of the same motion, in the frame of the planned object
    answer = preshape.plan_to_json(made)
    planned = planned_for(answer)
    sent = json.loads(
        json.dumps(
            answer_run(
                made.hand, made.mesh, answer["hand"],
                friction=planned.friction, mass=planned.mass, job=planned.job, progress=lambda *_: None,
            )
        )
    )  # fmt: skip
    film = run_of(sent)
    assert sent["reason"] == said["reason"]
    assert list(film.stage) == said["series"]["stage"]
    assert np.allclose(film.press, np.sum(said["series"]["normal"], axis=1))
    turn = pose_from_seven(np.array([0.0, 0.0, 0.0, *made.standing.pose[3:]]))
    assert np.allclose(turn @ film.object_poses, pose_from_seven(np.array(said["series"]["object_pose"])))
    assert np.allclose(film.object_poses[0], np.eye(4), atol=1e-3)  # it stands where the plan draws it

    # one press computes it with progress and cancel, and plays it to the end with its verdict
    watched = Watched(browser.new_context(viewport=SMALL))
    page = watched.page
    page.goto(serve(str(file)))
    saw(page, "Grasp found")
    cancel = page.get_by_role("button", name="Cancel")
    cancel.wait_for(state="hidden")
    press(page, "Play the whole job")
    saw(page, "simulating: ")
    assert cancel.count() == 1
    saw(page, "lifting · ")
    saw(page, said["reason"])
    tab(page, "Physics")
    until(page, lambda: float(box_beside(page, "Moment").input_value()) == 1.0)
    saw(page, "holding at the end · ")
    set_number(page, "Moment", "0.9")
    saw(page, "doing the task · ")
    keep(page, "app-film")
    assert watched.complaints == []
    assert watched.strangers() == []
    page.context.close()


def _choose_answer(page, number: int) -> None:
    tab(page, "Answers")
    button = page.get_by_role("button", name=f"{number} · plane")
    button.click()
    button.and_(page.locator("[style*=blue]")).wait_for()
