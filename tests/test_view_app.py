"""The app and the report in a real browser: headless Chromium, driven from the outside as a person would."""

from __future__ import annotations

import json
import re
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

import preshape
from preshape.app.link import PlannerLink
from preshape.app.wire_format import decoded
from preshape.objects.load import load_object
from preshape.objects.mesh import TriangleMesh
from preshape.pictures import document_html, document_motion, light_mesh, plan_scene
from preshape.planning.hand_simulation import hand_geometry
from preshape.planning.output import ray_origins
from preshape.planning.request import PlanRequest
from preshape.viewer.canvas import RecordingCanvas
from preshape.viewer.draw import GROUPS, draw_hand, draw_object, draw_plan
from preshape.viewer.hand_motion import STEPS
from preshape.viewer.reduce import MAX_TRIANGLES
from preshape.viewer.words import answers_of
from view_app_page import (
    SMALL,
    Watched,
    answer_buttons,
    box_beside,
    choose,
    keep,
    press,
    saw,
    set_number,
    tab,
    until,
)

pytest_plugins = ("view_app_fixtures",)

BOX = """v 0 0 0
v .06 0 0
v .06 .05 0
v 0 .05 0
v 0 0 .08
v .06 0 .08
v .06 .05 .08
v 0 .05 .08
f 4 3 2 1
f 5 6 7 8
f 1 2 6 5
f 2 3 7 6
f 3 4 8 7
f 4 1 5 8
"""


def test_a_person_plans_reads_corrects_and_teaches(browser, serve, tmp_path: Path) -> None:
    app = serve("hammer")
    context = browser.new_context(viewport=SMALL)
    watched = Watched(context)
    page = watched.page
    with pytest.raises(InvalidStatus), connect(app.replace("http", "ws"), origin="http://elsewhere.example"):
        pass  # a page of another origin may not open the app's socket
    page.goto(app)
    saw(page, "triangles. Press Plan.")

    # a new object: explored and learned
    press(page, "Plan")
    saw(page, "Grasp found")
    saw(page, "new (mode 3)")
    page.get_by_role("button", name="Cancel").wait_for(state="hidden")

    # another answer
    tab(page, "Answers")
    labels = answer_buttons(page)
    assert len(labels) >= 2
    planes = [re.search(r"plane (\d+)", label)[1] for label in labels]
    other = next((i for i, p in enumerate(planes) if p != planes[0]), 1)
    press(page, labels[other])
    tab(page, "Why")
    saw(page, f"{planes[other]}, approach ")
    saw(page, "Task against net wrench")

    # the hand moves with the slider
    time.sleep(0.5)
    keep(page, "app-squeeze")
    closed = page.screenshot()
    set_number(page, "Move hand", "0")
    time.sleep(1.0)
    assert page.screenshot() != closed

    # the same object with a task that does not fit well enough: mode 2 offers others
    tab(page, "Plan")
    choose(page, "Task", "turn")
    page.get_by_text("Thresholds and search").click()
    set_number(page, "good enough", "4")
    press(page, "Plan")
    saw(page, "The known object does not fit this task")
    keep(page, "app-correction")
    page.get_by_role("button", name=re.compile(r"^Try .* instead")).first.click()
    saw(page, "Grasp found")
    assert page.get_by_role("button", name=re.compile(r"^Try .* instead")).count() == 0

    # uploads: a broken one is explained, a good one is planned with, whatever it is called
    files = page.locator("input[type=file]")
    files.set_input_files({"name": "broken.stl", "mimeType": "model/stl", "buffer": b"solid nothing"})
    saw(page, "This does not work")
    assert str(tmp_path) not in page.content()
    nasty = "../../evil <b>name.obj"
    files.set_input_files({"name": nasty, "mimeType": "model/obj", "buffer": BOX.encode()})
    saw(page, "60 × 50 × 80 mm, 12 triangles")
    assert not list(tmp_path.parent.glob("evil*"))
    assert [p.parent.parent.parent for p in tmp_path.rglob("evil*.obj")] == [tmp_path]

    # teach it; a second browser begins anew, has nothing of the first but what is in the memory
    set_number(page, "good enough", "3")
    press(page, "Teach this object and task")
    page.get_by_role("button", name="Cancel").wait_for(state="hidden")
    tab(page, "Memory")
    saw(page, "evil_b_name")
    saw(page, "planes were explored")
    keep(page, "app-memory")
    mine = page.locator(".ps .head").first.text_content()
    second = Watched(browser.new_context(viewport=SMALL))
    second.page.goto(app)
    saw(second.page, "triangles. Press Plan.")
    assert second.page.get_by_text("60 × 50 × 80 mm").count() == 0
    keep(second.page, "app-phone", (390, 844))
    tab(second.page, "Memory")
    saw(second.page, "evil_b_name")
    assert page.locator(".ps .head").first.text_content() == mine

    for one in (watched, second):
        assert one.complaints == []
        assert one.asked
        assert one.strangers() == []
    context.close()


@pytest.fixture(scope="module")
def planned() -> preshape.Plan:
    return preshape.plan("cube", "1 1 .1 .05 .8 .05", memory=":memory:", count=3, hand="utah_mit")


def test_the_report_opens_from_disk_without_a_network(browser, planned, tmp_path: Path) -> None:
    document = preshape.plan_to_json(planned)
    html = document_html(planned.mesh, planned.hand, document, ray_origins(planned))
    assert len(html.encode()) < 5_000_000
    file = tmp_path / "plan.html"
    file.write_text(html, encoding="utf-8")
    context = browser.new_context(viewport=SMALL, offline=True, accept_downloads=True)
    watched = Watched(context)
    page = watched.page
    page.goto(file.as_uri())
    saw(page, "Grasp found")
    saw(page, f"{document['plane']}, approach ")

    # what is drawn is something, and it moves with the slider and turns with the mouse
    def picture() -> bytes:
        time.sleep(0.3)
        return page.locator("#gl").screenshot()

    views = [picture()]
    assert page.locator("#stage").text_content() == "squeeze"
    page.locator("#slider").fill("0")
    assert page.locator("#stage").text_content() == "away"
    views.append(picture())
    page.mouse.move(100, 300)
    page.mouse.down()
    page.mouse.move(180, 330, steps=3)
    page.mouse.up()
    views.append(picture())
    page.locator("tr[data-answer='1']").click()
    other = document["alternatives"][0]
    saw(page, f"{other['plane']}, approach ")
    saw(page, f"{other['tfvadi']:.2f} of 6")
    views.append(picture())
    assert len(set(views)) == 4
    keep(page, "report")
    keep(page, "report-phone", (390, 844))

    with page.expect_download() as downloaded:
        page.locator("#save").click()
    assert json.loads(Path(downloaded.value.path()).read_text(encoding="utf-8")) == document
    assert watched.complaints == []
    assert watched.strangers() == []
    context.close()


def test_a_plan_is_opened_with_its_load_and_scene_in_panel_and_words(browser, serve, tmp_path: Path) -> None:
    document = preshape.plan_to_json(preshape.plan("hammer", "lift", memory=":memory:", hand="utah_mit"))
    request = PlanRequest(
        source="hammer",
        task="lift",
        hand="shadow",
        mass=0.31,
        friction=0.3,
        table=-0.2,
        avoid=[[0.2, 0, 0, 0.3, 0.1, 0.1]],
    )
    file = tmp_path / "plan.json"
    file.write_text(
        json.dumps({**document, "request": request.to_json(), "mass": 0.31, "mass_source": "given"}),
        encoding="utf-8",
    )
    watched = Watched(browser.new_context(viewport=SMALL))
    page = watched.page
    page.goto(serve(str(file), "--task", "lift"))
    saw(page, "Grasp found")
    saw(page, "Planned with 0.31 kg (as given)")
    assert box_beside(page, "mass [kg]").input_value() == "0.31"
    assert box_beside(page, "friction").input_value() == "0.3"
    assert box_beside(page, "table").input_value() == "at a height"
    assert box_beside(page, "height [m]").input_value() == "-0.2"
    assert page.locator("textarea").first.input_value() == "0.2 0.0 0.0 0.3 0.1 0.1"
    choose(page, "Analyser", "rays")
    until(page, lambda: box_beside(page, "mass [kg]").is_disabled())
    assert watched.complaints == []
    page.context.close()


def test_nothing_in_a_name_becomes_part_of_the_page(planned) -> None:
    document = preshape.plan_to_json(planned)
    evil = "</script><script>alert(1)</script>"
    document["object"] = {**document["object"], "name": evil}
    document["hand"] = {**document["hand"], "reason": evil}
    html = document_html(planned.mesh, planned.hand, document, ray_origins(planned))
    assert "<script>alert" not in html.replace(" ", "")
    assert html.count("</script>") == 3


def test_every_group_is_drawn_for_every_answer_and_one_card_for_each_plane(planned) -> None:
    document = preshape.plan_to_json(planned)
    for made, answer in zip((planned.answer, *planned.alternatives), answers_of(document), strict=True):
        rays = made.grasp.ray_origins.tolist()
        scene = plan_scene(document, planned.mesh, None, answer, rays=rays)
        scene = replace(scene, table=-0.05, boxes=[[[0.1, 0.1, 0.1], [0.2, 0.2, 0.2]]])
        drawn = RecordingCanvas()
        draw_object(scene, drawn)
        draw_plan(scene, drawn)
        draw_hand(document_motion(planned.hand, answer), drawn)
        assert {name.partition("/")[0] for name in drawn.solids} == set(GROUPS)
        cards = [name for name in drawn.solids if name.startswith("planes/") and name.endswith("/card")]
        assert len(cards) == 12
        assert sum(drawn.solids[n].alpha > 0.5 for n in cards) == 1
        tips = [n for n in drawn.solids if n.startswith("contacts/") and n.endswith("/point")]
        middles = np.array([drawn.solids[n].vertices.mean(axis=0) for n in tips])
        assert np.allclose(middles, made.grasp.contacts.points, atol=1e-6)
        drawn.remove("planes")
        assert not any(name.startswith("planes") for name in (*drawn.solids, *drawn.labels))
        draw_plan(scene, RecordingCanvas())


def test_the_hand_passes_through_its_planned_poses(planned) -> None:
    answer = preshape.plan_to_json(planned)
    motion = document_motion(planned.hand, answer)
    assert motion.stages == ("away", "open", "closed", "squeeze")
    assert len(motion) == 3 * STEPS + 1
    result = planned.hand_result
    for stage, pose in ((1, result.pregrasp), (2, result.grasp), (3, result.squeeze)):
        links = hand_geometry(planned.hand, pose.palm_pose, pose.q)
        middles = np.array([(link.p0 + link.p1) / 2 for link in links])
        assert np.allclose(motion.poses[stage * STEPS][:, :3, 3], middles, atol=1e-9)
    # it comes along the approach, and no link ever leaps
    way = motion.poses[STEPS][:, :3, 3] - motion.poses[0][:, :3, 3]
    assert np.allclose(way / np.linalg.norm(way, axis=1)[:, None], answer["approach_axis"], atol=1e-9)
    assert np.abs(np.diff(motion.poses[:, :, :3, 3], axis=0)).max() < 0.025


def test_a_large_mesh_is_reduced_for_the_eye_only() -> None:
    n = 260
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, n), np.linspace(0, np.pi, n), indexing="ij")
    points = 0.05 * np.column_stack(
        [(np.cos(u) * np.sin(v)).ravel(), (np.sin(u) * np.sin(v)).ravel(), np.cos(v).ravel()]
    )
    i, j = (a.ravel() for a in np.mgrid[: n - 1, : n - 1])
    a, b, c, d = i * n + j, i * n + j + 1, (i + 1) * n + j, (i + 1) * n + j + 1
    ball = TriangleMesh(
        name="ball",
        vertices=points,
        triangles=np.concatenate([np.column_stack([a, b, c]), np.column_stack([b, d, c])]),
    )
    light = light_mesh(ball)
    assert len(ball.triangles) > 130_000
    assert MAX_TRIANGLES // 2 < len(light.triangles) <= MAX_TRIANGLES
    assert np.allclose(light.extents, ball.extents, rtol=0.02)
    assert np.allclose(np.linalg.norm(light.vertices, axis=1), 0.05, rtol=0.02)
    small = load_object("cube")
    assert light_mesh(small) is small


def test_a_cancelled_planner_answers_the_next_request(tmp_path: Path) -> None:
    heard: list[dict] = []
    news = threading.Condition()

    def hear(reply: dict) -> None:
        with news:
            heard.append(reply)
            news.notify_all()

    def wait(key: str) -> dict:
        with news:
            assert news.wait_for(lambda: any(key in reply for reply in heard), timeout=60), heard
            return next(reply for reply in heard if key in reply)

    link = PlannerLink(hear)
    try:
        # the closing hand's first lesson takes many seconds; it is stopped in its midst
        memory = str(tmp_path / "m.sqlite")
        cube = PlanRequest(source="cube", task="lift", hand="shadow", memory=memory, table=None)
        assert link.ask("plan", request=cube.to_json())
        wait("progress")
        assert not link.ask("load", request=cube.to_json())
        assert link.cancel()
        assert not link.cancel()
        heard.clear()
        assert link.ask("load", request=cube.to_json())
        said = wait("mesh")["mesh"]
        wait("done")
        assert np.array_equal(decoded(said["vertices"], "<f8", 3), load_object("cube").vertices)
        assert not any("document" in reply or "error" in reply for reply in heard)
        assert link.ask("plan", request=replace(cube, source="no such thing").to_json())
        assert "no such thing" in wait("error")["error"]
    finally:
        link.close()
    assert not link.ask("load", request=cube.to_json())
