"""Reports as one HTML page, and what a plan's readings say in words."""

from __future__ import annotations

import copy
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import preshape
from preshape.app.panel import SIX
from preshape.cli.view import start_of
from preshape.exceptions import EnvironmentFailure
from preshape.report import Bullets, Chapter, Figure, Heading, Report, Table, write_report
from preshape.report.markdown import markdown
from preshape.report.page import base_style, html_page
from preshape.report.terminal import print_table, report_console
from preshape.viewer import page, readings


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
    """Tags, their attributes, and the words between them; every tag that opens must close."""

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
    return preshape.plan_to_json(preshape.plan("hammer", "lift", memory=":memory:", count=4))


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
    assert "all twelve planes" in found[3]
    assert "another way, number 2" in words(readings.why(document, answers, 1))


def test_a_grip_is_told_by_its_quality_and_never_by_a_match_under_the_threshold(document) -> None:
    gripped = copy.deepcopy(document)
    gripped["tfvadi"] = 1.74
    gripped["grip"] = {"quality": 5.09, "task_margin": 3.4, "hold_margin": 2.0, "clearance": 0.006}
    said = words(readings.facts(gripped, gripped))
    assert "grip's quality 5.09 of 6, 3 is enough" in said
    assert "1.74 of 6; a real hand is not judged by it" in said
    assert "1.74 of 6, 3 is enough" not in said
    assert "A real hand is judged by its grip" in words(readings.bars(gripped, gripped))
    assert "A real hand" not in words(readings.bars(document, document))
    assert "quality 5.09 of 6, where 3 is enough" in words(readings.why(gripped, [gripped], 0))
    assert f"{len(gripped['contacts'])} fingers" in readings.answer_words(gripped)


def test_every_unusual_word_of_the_readings_is_explained(document) -> None:
    explained = words(readings.glossary())
    shown = words(readings.facts(document, document) + readings.bars(document, document))
    for word in ("approach value", "match (TFVADI)", "stability", "manipulability", "net wrench"):
        assert word in shown
        assert word in explained


@pytest.mark.parametrize("task", ["lift:+z", "1 1 .1 .05 .8 .05"])
def test_a_plan_is_opened_with_its_own_task(task: str, tmp_path: Path) -> None:
    plan = preshape.plan("cube", task, memory=":memory:")
    file = tmp_path / "plan.json"
    file.write_text(json.dumps(preshape.plan_to_json(plan)), encoding="utf-8")
    start = start_of(str(file))
    assert np.allclose(preshape.parse_task(start.order.task).q, plan.decision.task.q)
    assert start.order.source == "cube"
    assert SIX not in start.order.task
