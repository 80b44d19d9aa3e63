"""Reports as Markdown, HTML and terminal text, and the readings of a plan in words."""

from __future__ import annotations

import copy
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest
from PIL import Image

import preshape
from preshape import pictures
from preshape.app.stage import Stage
from preshape.cli.view import start_of_plan
from preshape.exceptions import EnvironmentFailure, InputError
from preshape.hands.load import load_hand
from preshape.objects.load import load_object
from preshape.objects.mesh import TriangleMesh, box_mesh
from preshape.physics.task.instances import mesh_text
from preshape.pictures import plan_scene
from preshape.planning.request import PlanRequest
from preshape.report import Bullets, Chapter, Figure, Heading, Report, Table, write_report
from preshape.report.markdown import markdown
from preshape.report.page import base_style, html_page
from preshape.report.terminal import print_table, report_console
from preshape.viewer import page, readings
from preshape.viewer import words as plan_words
from preshape.viewer.canvas import RecordingCanvas
from preshape.viewer.draw import draw_plan
from preshape.viewer.plan_scene import approach_arrow


def draw(path: Path) -> None:
    Image.fromarray(np.zeros((2, 3, 3), dtype=np.uint8)).save(path)


PAGE = Report(
    title="Holding test & more",
    preface=(
        "A **strong**, *emphasised*, `code <b>` and <script>alert(1)</script>. "
        "It goes on; 2*3*4 and a_b stay.",
        Figure(file="areas.png", caption="areas", draw=draw),
    ),
    chapters=(
        Chapter(
            title="Shadow: 3 of 4 held",
            blocks=(
                Table(
                    caption="",
                    columns=("object", "held", "%"),
                    rows=(("mug <i>", 3, "75.0"), ("can", 1, None)),
                ),
                Bullets(items=("first item", "second **item** goes on")),
            ),
        ),
    ),
)
MARKDOWN = """# Holding test & more

A **strong**, *emphasised*, `code <b>` and <script>alert(1)</script>. It goes on; 2*3*4 and a_b stay.

![areas](areas.png)

*areas*

## Shadow: 3 of 4 held

| object | held | % |
|---|---|---|
| mug <i> | 3 | 75.0 |
| can | 1 | – |

- first item
- second **item** goes on
"""


class Reader(HTMLParser):
    """A parser that collects tags, attributes and words, and checks that every tag is closed."""

    VOID = ("meta", "link", "img", "br")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: dict[str, list[str]] = {}
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data) -> None:
        if self.open:
            self.words.setdefault(self.open[-1], []).append(data)


def test_a_report_becomes_markdown_and_one_page_that_asks_for_nothing(tmp_path: Path) -> None:
    files = write_report(tmp_path, PAGE)
    assert [file.name for file in files] == ["report.md", "report.html"]
    assert files[0].read_text(encoding="utf-8") == MARKDOWN
    html = files[1].read_text(encoding="utf-8")
    read = Reader(html)
    names = [tag for tag, _ in read.tags]
    assert "script" not in names
    assert "i" not in names
    assert read.words["title"] == ["Holding test & more · preshape"]
    assert read.words["h1"] == ["Holding test & more"]
    assert read.words["h2"] == ["Shadow: 3 of 4 held"]
    assert read.words["strong"] == ["strong", "item"]
    assert read.words["em"] == ["emphasised"]
    assert read.words["code"] == ["code <b>"]
    assert "2*3*4 and a_b stay." in "".join(read.words["p"])
    assert read.words["th"] == ["object", "held", "%"]
    assert read.words["td"] == ["mug <i>", "3", "75.0", "can", "1", "–"]
    assert [a.get("class") for tag, a in read.tags if tag == "td"] == [None, "number", "number"] * 2
    assert ["".join(read.words["li"])] == ["first itemsecond  goes on"]
    images = [a for tag, a in read.tags if tag == "img"]
    assert [a["alt"] for a in images] == ["areas"]
    assert read.words["figcaption"] == ["areas"]  # once, though the Markdown says it beneath as well
    sources = [v for _, a in read.tags for k, v in a.items() if k in ("src", "href")]
    assert sources
    assert all(source.startswith("data:") for source in sources)
    assert "url(" not in html
    policy = next(a["content"] for _, a in read.tags if a.get("http-equiv") == "Content-Security-Policy")
    assert policy.startswith("default-src 'none'")


def test_a_report_s_missing_picture_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(EnvironmentFailure, match=r"areas\.png cannot be read"):
        html_page(PAGE, tmp_path)


def test_a_chapter_with_a_headline_is_listed_and_a_cell_may_have_lines(tmp_path: Path) -> None:
    table = Table(caption="Two *lines*", columns=("a\nb", "c"), rows=(("x\ny", 1.5), ("z|", 2)))
    chapter = Chapter(title="First", name="one", headline="It works.", blocks=(Heading(text="Part"), table))
    empty = Chapter(title="Second", blocks=(Table(caption="", columns=("a",), rows=()),))
    report = Report(title="Two", chapters=(chapter, empty))
    text = markdown(report)
    assert "- **First.** It works.\n\n## First\n\n### Part\n\nTwo *lines*\n\n| a b | c |" in text
    assert "| x · y | 1.50 |\n| z/ | 2 |" in text
    assert "Second.**" not in text
    assert text.endswith("## Second\n\nNone.\n")
    html = html_page(report, tmp_path)
    read = Reader(html)
    assert '<li><a href="#one">First</a>. It works.</li>' in html
    assert '<section id="one">' in html
    assert "<td class=lines>x<br>y</td><td class=number>1.50</td>" in html
    assert read.words["em"] == ["lines"]
    assert "None." in read.words["p"]


def test_a_table_on_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    table = Table(caption="[red]", columns=("object", "held"), rows=(("mug", None), ("all", 7)))
    print_table(report_console(40), table, bold=lambda row: row[0] == "all")
    lines = [line.split() for line in capsys.readouterr().out.splitlines() if line.strip()]
    assert lines[0] == ["[red]"]
    assert lines[1] == ["object", "held"]
    assert lines[-2:] == [["mug", "–"], ["all", "7"]]


def test_reports_and_plans_share_one_style(tmp_path: Path, document: dict, monkeypatch) -> None:
    assert "--ink" in base_style()
    assert base_style() in html_page(Report(title="title", preface=("body",)), tmp_path)
    monkeypatch.setattr(page, "_view", lambda *_: {})
    view = page.PageView(scene=None)
    assert f"<style>{base_style()}" in page.plan_page([view], document)


@pytest.fixture(scope="module")
def document() -> dict:
    return preshape.plan_to_json(preshape.plan("hammer", "lift", memory=":memory:", count=4, hand="utah_mit"))


def words(html: str) -> str:
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", html)).replace("&#x27;", "'")


def test_why_this_plane_names_plane_worth_threshold_and_the_best_other_plane(document) -> None:
    answers = [document, *document["alternatives"]]
    said = words(readings.why(document, answers, 0))
    assert f"plane {document['plane']}" in said
    assert f"match {document['tfvadi']:.2f} of 6, where 3 is enough" in said
    others = [a for a in answers if a["plane"] != document["plane"]]
    assert others
    best = max(others, key=lambda a: a["tfvadi"])
    assert f"The best on another plane: plane {best['plane']}, match {best['tfvadi']:.2f}" in said
    found = {
        mode: words(readings.why({**document, "mode": mode}, answers, 0)).split(":")[0] for mode in (0, 1, 3)
    }
    assert len(set(found.values())) == 3
    assert "all allowed planes were explored" in found[3]
    assert "This is answer 2: plane" in words(readings.why(document, answers, 1))
    text = readings.why(document, answers, 0)
    compared = re.findall(r"<th>(\d+)</th>.*?<td class=\"num\">(.*?)</td>", text)
    assert [int(index) for index, _ in compared] == list(range(1, 13))
    best = {
        a["plane"]: max(plan_words.score(o) for o in answers if o["plane"] == a["plane"]) for a in answers
    }
    assert {int(index): number for index, number in compared if number != "–"} == {
        index: f"{most:.2f}" for index, most in best.items()
    }
    assert text.count("<i style") == len(best)


@pytest.fixture
def gripped(document) -> dict:
    """The plan as a real hand's: of 0.3 kg, friction 0.3, on a table beside a box."""
    made = copy.deepcopy(document)
    forces = [[10.0 * x for x in c["normal_in"]] for c in made["contacts"]]
    grip = {"quality": 5.09, "task_margin": 3.4, "hold_margin": 2.0, "clearance": 0.006, "forces": forces}
    request = {
        **made["request"],
        "analyser": "closure",
        "friction": 0.3,
        "table": "auto",
        "avoid": [[0.2, 0, 0, 0.3, 0.1, 0.1]],
    }
    load = {"mass": 0.31, "mass_source": "given", "heaviest_mass": 0.74}
    lowest = float(load_object("hammer").bounds[0, 2])
    scene = {**made["scene"], "table": [0.0, 0.0, 1.0, lowest]}
    made |= {"tfvadi": 1.74, "grip": grip, "request": request, "scene": scene, "missing_motion": "", **load}
    made["alternatives"] = []
    return made


def test_the_scenery_of_a_plan_is_drawn_as_it_stands(gripped, tmp_path: Path) -> None:
    mesh, file, up = load_object("hammer"), tmp_path / "wall.obj", np.array([0.0, 0.6, 0.8])
    file.write_text(mesh_text(box_mesh("wall", np.array([0.02, 0.3, 0.3]))))
    tilted = {**gripped["scene"], "table": [*up, -0.1], "up": up.tolist()}
    texts = [f"{file}@0.1,0,0,1,0,0,0", f"{file}@9,0,0,1,0,0,0", str(tmp_path / "gone.obj")]
    plan = {**gripped, "scene": tilted, "request": {**gripped["request"], "obstacle": texts}}
    canvas = RecordingCanvas()
    draw_plan(plan_scene(plan, mesh), canvas)
    drawn = {name: solid for name, solid in canvas.solids.items() if name.startswith("scene/")}
    assert set(drawn) == {"scene/table", "scene/table-edge", "scene/box 1", "scene/obstacle 1"}
    assert drawn["scene/obstacle 1"].vertices.mean(axis=0) == pytest.approx([0.1, 0, 0])
    assert drawn["scene/table"].vertices @ up == pytest.approx([-0.1] * 4)
    edge = drawn["scene/table-edge"].vertices @ up + 0.1
    assert np.abs(edge).max() < 0.01  # its border lies in its plane


def test_a_grip_is_told_by_what_decided_it_and_the_paper_s_indices_are_folded_last(document, gripped) -> None:
    said = words(readings.facts(gripped, gripped))
    press = 10 * len(gripped["contacts"])
    order = [
        "quality 5.09 of 6, 3 is enough",
        f"task margin 3.4 × the task's load, for 0.31 kg at a press of {press:.0f} N",
        "hold margin 2.0 ×",
        f"press {press:.1f} N",
        "mass 0.31 kg (as given); this grip holds up to 0.74 kg at its strongest press",
        "friction 0.3, table under the object, 1 box to avoid",
        "clearance 6.0 mm",
        plan_words.way_in_words(gripped),
        f"{gripped['plane']}, {plan_words.plane_words(gripped)}",
    ]
    places = [said.index(part) for part in order]
    assert places == sorted(places)
    assert "TFVADI" not in said
    parts = readings.answer_parts(gripped, [gripped], 0)
    assert all("TFVADI" not in part and "ADI" not in words(part) for part in parts[:2])
    assert parts[-1].startswith("<details><summary>Explain")
    explained = words(parts[-1])
    assert "1.74 of 6; a real hand is not judged by it" in explained
    assert "A real hand is judged by its grip" in explained
    assert "1.74 of 6, 3 is enough" not in words("".join(parts))
    assert "quality 5.09 of 6, where 3 is enough" in words(readings.why(gripped, [gripped], 0))
    assert plan_words.answers_words([gripped])[0].endswith("mm, quality 5.09")
    headline = words(readings.headline(gripped))
    assert f"quality 5.09 of 6 · task margin 3.4 · hold margin 2.0 · press {press:.0f} N" in headline
    # the paper's hand is told by the paper's measure, openly
    open_parts = readings.answer_parts(document, [document], 0)
    assert "match (TFVADI)" in words(open_parts[1])
    assert "A real hand" not in words("".join(open_parts))
    assert not any(part.startswith("<details") for part in open_parts)


def test_a_headline_says_the_mode_in_plain_words_and_what_the_grasp_does_not_give(document) -> None:
    lift = {"missing_motion": "Tz", "task": {**document["task"], "q": [0.1, 0.1, 1, 0.05, 0.05, 0.05]}}
    for given, told in (
        (0.05, "gives nothing along Tz"),
        (-1.16, "opposes Tz"),
        (0.3, "gives too little along Tz"),
        (1.9, "gives too much along Tz"),
    ):
        shown = readings.headline({**document, **lift, "net_wrench": [0, 0, given, 0, 0, 0]})
        assert f"Grasp found, but it {told}" in words(shown)
        assert 'class="head warn"' in shown
    both = {"missing_motion": "Tx and Rz", "task": {"q": [1, 0.1, 0.1, 0.05, 0.05, -0.8]}}
    assert plan_words.missing_words({**both, "net_wrench": [0, 0, 0, 0, 0, 1]}) == (
        "gives nothing along Tx and opposes Rz"
    )
    plain = readings.headline({**document, "missing_motion": ""})
    assert "nothing along" not in plain
    assert 'class="head good"' in plain
    names = {0: "known (mode 0)", 1: "searched (mode 1)", 2: "task does not fit (mode 2)", 3: "new (mode 3)"}
    for mode, name in names.items():
        assert name in words(readings.headline({**document, "mode": mode, "known": True}))
    never_met = words(readings.headline({**document, "mode": 0, "known": False}))
    assert "estimated (mode 0)" in never_met
    assert "known" not in never_met
    failed = {**document, "verified": {"held": False, "tried": 3, "reason": "lost"}}
    assert "No answer held in physics" in words(readings.headline(failed))


@pytest.mark.parametrize(
    ("way", "said"),
    [
        ([0.0, 0.0, -1.0], "comes in along -Z"),
        ([0.0, 0.2, -0.98], "comes in 12° off the -Z axis"),
        ([0.0, 0.8, -0.6], "comes in 37° off the +Y axis, 53° off the plane's approach axis -Z"),
    ],
)
def test_the_way_in_is_the_hand_s_and_the_plane_is_named_where_it_is_another(document, way, said) -> None:
    answer = {**document, "approach_axis": [0.0, 0.0, -1.0], "way_in": way}
    assert plan_words.way_in_words(answer) == said
    cube = load_object("cube")
    start, tip = approach_arrow(plan_scene(document, cube, None, answer))
    assert np.allclose((tip - start) / np.linalg.norm(tip - start), way / np.linalg.norm(way))
    # plans of version 1 state the way in within the grip
    old = {key: value for key, value in answer.items() if key != "way_in"}
    assert plan_words.way_in(old) == [0.0, 0.0, -1.0]
    assert plan_words.way_in({**old, "grip": {"approach": way}}) == way


def test_without_an_answer_the_best_that_was_tried_is_shown_and_said_to_be_not_good_enough(gripped) -> None:
    best = {**gripped, "status": "deadlock", "executable": False}
    nothing = dict.fromkeys(("plane", "grip"))
    plan = {**best, **nothing, "best": best, "reason": "the best grip would hold 0.66 kg, and 6 kg is asked"}
    assert plan_words.answers_of(plan) == [best]
    headline = words(readings.headline(plan))
    assert "Deadlock: no grasp is good enough; the best try is shown" in headline
    assert "would hold 0.66 kg" in headline
    assert "should not be executed" in words(readings.why(plan, [best], 0))
    assert "not good enough" in readings.ranking([best], 0)
    scene = plan_scene(plan, load_object("hammer"), None, best)
    assert scene.plane is not None
    assert scene.reasons[0] == plan["reason"]


def test_picture_page_and_app_draw_the_cones_of_the_planned_friction(
    document, gripped, tmp_path: Path, monkeypatch
) -> None:
    mesh, hand = load_object("hammer"), load_hand("utah_mit")
    for plan, friction in ((gripped, 0.3), (document, 1.0)):
        scenes = []
        monkeypatch.setattr(pictures, "plan_picture", lambda scene, _, scenes=scenes: scenes.append(scene))
        monkeypatch.setattr(
            page, "plan_page", lambda views, _, scenes=scenes: scenes.extend(view.scene for view in views)
        )
        pictures.plan_picture_of(plan, mesh, hand, tmp_path / "plan.png")
        pictures.document_html(mesh, hand, plan)
        stage = Stage(MagicMock(), lambda _: None)
        stage._waiting = True  # no labels to choose
        stage.mesh = mesh
        stage.show(plan, plan_words.answers_of(plan)[0])
        scenes.append(stage.scene)
        assert len(scenes) == 2 + len(plan_words.answers_of(plan))
        for scene in scenes:
            canvas = RecordingCanvas()
            draw_plan(scene, canvas)
            drawn = [s for name, s in canvas.solids.items() if name.endswith("/cone")]
            assert len(drawn) == len(scene.fingers) > 0
            for shape, point, normal in zip(drawn, scene.points, scene.normals_in, strict=True):
                away = shape.vertices - point
                height = away @ -normal
                width = np.linalg.norm(away + height[:, None] * normal, axis=1)
                assert width.max() / height.max() == pytest.approx(friction, rel=0.02)
            assert ("scene/table" in canvas.solids) == (plan is gripped)
            assert ("scene/box 1" in canvas.solids) == (plan is gripped)


def test_every_unusual_word_of_the_readings_is_explained(document) -> None:
    explained = words(readings.glossary())
    shown = words(readings.facts(document, document) + readings.bars(document, document))
    for word in ("approach value", "match (TFVADI)", "stability", "manipulability", "net wrench"):
        assert word in shown
        assert word in explained


@pytest.mark.parametrize("task", ["lift:+z", "1 1 .1 .05 .8 .05"])
@pytest.mark.parametrize("version", [1, 2])
def test_a_plan_is_opened_with_its_own_task(task: str, version: int, tmp_path: Path) -> None:
    plan = preshape.plan("cube", task, memory=":memory:", scale=1.5, hand="utah_mit")
    written = preshape.plan_to_json(plan)
    if version == 1:
        for key in ("schema", "request", "mass", "way_in"):
            del written[key]
    file = tmp_path / "plan.json"
    file.write_text(json.dumps(written), encoding="utf-8")
    start = start_of_plan(file)
    assert np.allclose(start.request.asked.q, plan.decision.task.q)
    assert start.request.source == "cube"
    assert start.request.scale == pytest.approx(1.5)


def test_a_plan_is_opened_with_its_own_request(document, tmp_path: Path) -> None:
    request = PlanRequest(
        source="hammer",
        task="lift",
        hand="shadow",
        mass=0.31,
        friction=0.3,
        table=-0.2,
        avoid=[[0.2, 0, 0, 0.3, 0.1, 0.1]],
        approaches="-z",
        settings=preshape.Settings(thresholds=preshape.Thresholds(estimation=2.5, recognition=4.5), seed=5),
        memory="elsewhere.sqlite",
    )
    file = tmp_path / "plan.json"
    file.write_text(json.dumps({**document, "request": request.to_json()}), encoding="utf-8")
    opened = start_of_plan(file, memory="mine.sqlite").request
    assert opened.to_json() == {**request.to_json(), "memory": "mine.sqlite"}
    changed = start_of_plan(file, "push", mass=0.5, table="none", avoid=()).request
    assert (changed.mass, changed.table, changed.avoid) == (0.5, None, ())
    assert changed.asked.name == "push"
    assert changed.settings.seed == 5
    with pytest.raises(InputError, match="--seed cannot change a plan"):
        start_of_plan(file, seed=3)
    # a plan of version 1 was made for 0.1 kg and friction 0.6 in free space
    old = {key: value for key, value in document.items() if key not in ("schema", "request")}
    forces = [c["normal_in"] for c in old["contacts"]]
    grip = {"quality": 5.09, "task_margin": 3.4, "hold_margin": 2.0, "clearance": 0.006, "forces": forces}
    grip["approach"] = old["approach_axis"]
    file.write_text(json.dumps({**old, "grip": grip}), encoding="utf-8")
    opened = start_of_plan(file).request
    assert (opened.analyser, opened.mass, opened.stated_friction, opened.table) == ("closure", 0.1, 0.6, None)


def test_a_plan_of_a_mesh_in_memory_is_opened_with_the_file_beside_it(tmp_path: Path) -> None:
    cube = load_object("cube")
    part = TriangleMesh(name="mug", vertices=cube.vertices, triangles=cube.triangles)  # no library mug
    preshape.plan(part, "1 1 .1 .05 .8 .05", memory=":memory:", hand="utah_mit").save(tmp_path)
    opened = start_of_plan(tmp_path / "plan.json").request
    assert opened.source == str(tmp_path / "mug-surface.obj")
    assert np.allclose(load_object(opened.source, scale=opened.scale).extents, cube.extents, rtol=1e-5)
