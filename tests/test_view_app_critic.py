"""The external critic in a real browser: click a plane, play, reject, accept, reset, cancel, come back."""

from __future__ import annotations

import json
import re
from itertools import product
from pathlib import Path

import numpy as np

from preshape.hands.load import load_hand
from preshape.kernels.rays import cast_plain
from preshape.objects.load import load_object
from preshape.objects.mesh import TriangleMesh
from preshape.pictures import document_motion, light_mesh, plan_scene
from preshape.viewer.camera import project
from preshape.viewer.canvas import RecordingCanvas
from preshape.viewer.draw import draw_plan
from preshape.viewer.framing import fitting
from preshape.viewer.words import answers_of
from view_app_page import (
    SMALL,
    Watched,
    answer_buttons,
    box_beside,
    choose,
    in_sight,
    plan,
    planners,
    press,
    saw,
    tab,
    until,
)

pytest_plugins = ("view_app_fixtures",)


def where_a_card_is(page, document: dict, answer: dict, plane: int) -> tuple[float, float]:
    """Pixels of a plane's card while ``answer`` is shown and the camera stands where the app has put it."""
    canvas = page.locator("canvas").first.bounding_box()
    size = round(canvas["width"]), round(canvas["height"])
    mesh = light_mesh(load_object(document["object"]["source"]))
    scene = plan_scene(document, mesh, None, answer)
    camera = fitting(scene, document_motion(load_hand("utah_mit"), answer), size)
    drawn = RecordingCanvas()
    draw_plan(scene, drawn)
    names = list(drawn.solids)
    corners = drawn.solids[f"planes/{plane}/card"].vertices
    edges = [b - a for a in corners for b in corners]
    spans = [max(edges, key=lambda d, axis=axis: abs(d @ axis)) for axis in axes_of(plane)]
    # Cards cross each other and hide each other: the farthest point from the middle counts that is in sight.
    for along, across in sorted(product(np.linspace(-0.42, 0.42, 9), repeat=2), key=lambda a: -np.hypot(*a)):
        aim = corners.mean(axis=0) + along * spans[0] + across * spans[1]
        if f"planes/{plane}/" in first_met(drawn, names, camera.eye, aim):
            x, y = project(camera, aim[None], size)[0]
            return canvas["x"] + float(x), canvas["y"] + float(y)
    raise AssertionError(f"no point of the card of plane {plane} is in sight")


def first_met(drawn: RecordingCanvas, names: list[str], eye: np.ndarray, aim: np.ndarray) -> str:
    """Name of the first solid on the line from the eye through a point."""
    solids = [drawn.solids[name] for name in names]
    starts = np.cumsum([0, *(len(one.vertices) for one in solids)])[:-1]
    triangles = [one.triangles + start for one, start in zip(solids, starts, strict=True)]
    mesh = TriangleMesh(
        name="scene",
        vertices=np.concatenate([one.vertices for one in solids]),
        triangles=np.concatenate(triangles),
    )
    direction = (aim - eye) / np.linalg.norm(aim - eye)
    hit = int(cast_plain(mesh, eye[None], direction[None]).triangle[0])
    ends = np.cumsum([len(one) for one in triangles])
    return names[int(np.searchsorted(ends, hit, side="right"))]


def axes_of(plane: int) -> tuple[np.ndarray, np.ndarray]:
    from preshape.hiis.planes import plane as of

    return of(plane).opposition_axis, of(plane).transverse_axis


def test_a_person_clicks_plays_rejects_accepts_and_comes_back(opened, tmp_path: Path) -> None:
    watched = opened("hammer")
    page = watched.page
    plan(page)
    saw(page, "Grasp found")

    # accepting gives two files: the answer, and a page that opens without the app and without a network
    saved: list = []
    page.on("download", lambda download: saved.append(download))
    press(page, "Accept")
    until(page, lambda: len(saved) == 2)
    saw(page, "Accepted")
    files = {Path(d.suggested_filename).suffix: d for d in saved}
    assert {d.suggested_filename for d in saved} == {"hammer-lift+z.json", "hammer-lift+z.html"}
    document = json.loads(Path(files[".json"].path()).read_text(encoding="utf-8"))
    assert document["status"] == "answer"
    report = tmp_path / "accepted.html"
    files[".html"].save_as(report)
    offline = page.context.browser.new_context(viewport={"width": 700, "height": 500}, offline=True)
    reader = Watched(offline)
    reader.page.goto(report.as_uri())
    saw(reader.page, f"{document['plane']}, approach ")
    assert reader.complaints == []
    assert [url for url in reader.asked if not url.startswith(("file:", "data:", "blob:"))] == []
    offline.close()

    # a click on a card in the scene shows the best answer on that plane
    answers = answers_of(document)
    tab(page, "Answers")
    kept = [int(re.search(r"plane (\d+)", label)[1]) for label in _labels(page)]
    other = next(p for p in kept if p != document["plane"])
    none = next(p for p in range(1, 13) if p not in kept)
    tab(page, "Show")
    press(page, "Look from the front again")
    tab(page, "Why")
    page.wait_for_timeout(1500)  # the camera has arrived
    x, y = where_a_card_is(page, document, answers[0], other)
    page.mouse.click(x, y)
    saw(page, f"{other}, approach ")

    # … or says that there is none
    tab(page, "Answers")
    press(page, _labels(page)[0])
    tab(page, "Why")
    saw(page, f"{document['plane']}, approach ")
    page.wait_for_timeout(500)
    x, y = where_a_card_is(page, document, answers[0], none)
    page.mouse.click(x, y)
    saw(page, "None of the answers lies on this plane")
    saw(page, f"{document['plane']}, approach ")

    # the hand plays from far away to the squeeze
    slider = box_beside(page, "Move hand")
    slider.evaluate(
        "box => { window.seen = []; setInterval(() => window.seen.push(Number(box.value)), 10); }"
    )
    press(page, "Play the grasp")
    page.wait_for_function("Math.min(...window.seen) < 2.5 && window.seen.at(-1) === 3")

    # after a reload, or a lost connection, the page is as it was, and nothing was planned again
    tab(page, "Answers")
    press(page, _labels(page)[1])
    saw(page, "Grasp found")
    told = page.locator(".ps .head").first.inner_text()  # it ends with the seconds that planning took
    names = _labels(page)
    assert len(set(names)) == len(names)
    (planner,) = planners(tmp_path)
    page.reload()
    until(page, lambda: page.locator(".ps .head").first.inner_text() == told)
    tab(page, "Answers")
    assert _labels(page) == names
    chosen = page.get_by_role("button", name=names[1], exact=True)
    chosen.and_(page.locator("[style*=blue]")).wait_for()
    until(page, lambda: len(planners(tmp_path)) == 1)
    assert planner not in planners(tmp_path)

    press(page, names[0])
    page.get_by_role("button", name=names[0], exact=True).and_(page.locator("[style*=blue]")).wait_for()

    # every answer is rejected in turn, then there is none
    for left in range(len(kept), 0, -1):
        assert len(_labels(page)) == left
        first = _labels(page)[0]
        press(page, "Reject")
        until(page, lambda first=first: first not in _labels(page))
    saw(page, "All answers rejected")
    assert page.get_by_role("button", name="Reject").count() == 0

    # whoever comes back finds what was learnt, and the object is recalled and not explored anew
    address = page.url
    page.evaluate("sessionStorage.clear()")  # as in a new tab
    page.goto(address)
    saw(page, "triangles. Press Plan.")
    tab(page, "Memory")
    assert page.locator("tr:has(b:text-is('hammer'))").inner_text().split()[1] == "utah_mit"
    tab(page, "Plan")
    plan(page)
    saw(page, "known (mode 0): a stored grasp")


def _labels(page) -> list[str]:
    found = page.get_by_role("button", name=re.compile(r"^\d · plane"), include_hidden=True)
    return found.all_text_contents()


def test_a_deadlock_waits_for_its_reset_and_a_cancelled_plan_for_the_next(opened) -> None:
    page = opened("cone", "--task", "strike").page  # a task on the command line is planned at once
    saw(page, "Deadlock: no grasp is good enough; the best try is shown")
    page.set_viewport_size({"width": 390, "height": 844})  # on a phone the reason is in sight too
    saw(page, "is below the threshold")
    in_sight(page, page.locator(".ps .head").first)
    page.set_viewport_size(SMALL)
    press(page, "Plan")
    saw(page, "Reset it first")
    press(page, "Reset the deadlock")
    saw(page, "Deadlock reset")
    assert page.get_by_role("button", name="Reset the deadlock").count() == 0

    # a real hand's first lesson takes long: it is cancelled in its midst
    choose(page, "Hand", "shadow")
    press(page, "Plan")
    saw(page, "a hand's first time")
    press(page, "Cancel")
    saw(page, "Everything that was learnt before is kept")
    assert page.get_by_role("button", name="Plan", exact=True).is_enabled()

    choose(page, "Hand", "utah_mit")
    choose(page, "Object", "cube")
    saw(page, "12 triangles. Press Plan.")
    plan(page)
    saw(page, "Grasp found")
    tab(page, "Answers")
    assert answer_buttons(page)
