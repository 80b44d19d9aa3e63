"""The documentation site without Sphinx: leaderboard, gallery, pages that stand alone (CI: `make docs`)."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path

import pytest

from preshape.cli.plan import plan

ROOT = Path(__file__).parent.parent
SMALL = """
# Figures

## Hands

| | shadow | leap |
|---|---|---|
| friction 0.6 | 19/20 (76-99 %) | **20/20** (84-100 %) |

## Others

| hand | passed |
|---|---|
| a | 3 of 4; before 2 |
| b | 90 % |
| c | 0.75 |
| together | 9 of 10 |
"""


@pytest.fixture(scope="module")
def site():
    path = ROOT / "docs" / "make_site.py"
    spec = importlib.util.spec_from_file_location("make_site", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["make_site"] = module
    spec.loader.exec_module(module)
    return module


def test_tables_keep_their_heading_and_every_cell(site) -> None:
    first, second = site.tables(SMALL)
    assert (first.heading, first.columns) == ("Hands", ("", "shadow", "leap"))
    assert first.rows == (("friction 0.6", "19/20 (76-99 %)", "**20/20** (84-100 %)"),)
    assert (second.heading, len(second.rows)) == ("Others", 4)


def test_the_best_is_first_equals_share_a_rank_and_sums_have_none(site) -> None:
    columns, rows = (
        site.ranking(table, value) for table, value in zip(site.tables(SMALL), (None, "passed"), strict=True)
    )
    assert re.findall(r"\| (\d) \| (\w+) ", columns) == [("1", "leap"), ("2", "shadow")]
    assert re.findall(r"\| (\d) \| (\w+) ", rows) == [("1", "b"), ("2", "a"), ("2", "c")]
    assert re.findall(r'value="([\d.]+)"', rows) == ["0.9", "0.75", "0.75"]


def test_every_figure_of_the_leaderboard_stands_in_the_results(site) -> None:
    text = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    page = site.leaderboard(text)
    rows = [line.split("|")[1:-1] for line in page.splitlines() if "<meter" in line]
    assert len(rows) >= 8 * 3 + 3 + 4 + 17 + 17 + 7
    plain = text.replace("*", "")
    assert all(cells[-2].strip() in plain for cells in rows)


def test_a_leaderboard_without_its_table_or_figure_is_an_error(site) -> None:
    text = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    with pytest.raises(site.SiteError, match="0 tables 'Grips of real hands'"):
        site.leaderboard(text.replace("## Grips of real hands", "## Grips"))
    with pytest.raises(site.SiteError, match="no column 'holding, within'"):
        site.leaderboard(text.replace("| holding, within |", "| within |"))
    with pytest.raises(site.SiteError, match="no figure in the cell 'many'"):
        site.figure("many")


def test_gallery_commands_are_read_by_the_command_line(site, monkeypatch) -> None:
    entries = site.gallery_entries((ROOT / "docs" / "site" / "gallery.toml").read_text(encoding="utf-8"))
    hands = {re.search(r"--hand (\S+)|$", entry.words)[1] or "shadow" for entry in entries}
    assert len(entries) >= 10
    assert len(hands) >= 5
    monkeypatch.chdir(ROOT)
    for entry in entries:
        words = entry.command.split()
        assert words[:2] == ["preshape", "plan"]
        assert words[-2:] == ["--out", "out"]
        plan.make_context("plan", words[2:])  # raises where the command line would refuse a word


def test_a_gallery_goes_on_where_it_was_stopped(site, tmp_path: Path, monkeypatch) -> None:
    entries = [site.Entry(name=f"e{i}", title=f"Entry {i}", words=f"mug --seed {i}") for i in range(3)]
    drawn: list[str] = []

    def draw(entry, folder: Path) -> None:
        if len(drawn) == stop:
            raise site.SiteError("stopped")
        drawn.append(entry.name)
        folder.mkdir(parents=True)
        for name, text in (
            ("plan.png", ""),
            ("plan.html", ""),
            ("summary.txt", "a < b\n"),
            ("seconds", "2.00"),
        ):
            (folder / name).write_text(text)

    def page(limit: int | None = None) -> str:
        return site.gallery(entries, tmp_path / "kept", tmp_path, tmp_path, limit)

    monkeypatch.setattr(site, "draw", draw)
    monkeypatch.setattr(site, "state_of_package", lambda: state)
    state, stop = "1", 2
    with pytest.raises(site.SiteError, match="stopped"):
        page()
    stop = -1
    text = page()
    assert drawn == ["e0", "e1", "e2"]
    assert "3 plans shown took 6 s" in text
    assert "a &lt; b" in text
    assert page(limit=0) == text
    state = "2"
    assert page(limit=1).count("Not drawn in this build") == 2
    assert drawn == ["e0", "e1", "e2", "e0"]


def test_a_page_that_loads_from_elsewhere_is_found_and_links_are_not(site, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    page.write_text(
        '<a href="https://example.org">x</a><link rel="stylesheet" href="own.css"><img src="a.png">'
    )
    assert site.loaded_from_elsewhere(page) == []
    page.write_text(
        '<script src="https://example.org/x.js"></script><link href="//example.org/y.css" rel="stylesheet">'
    )
    found = site.loaded_from_elsewhere(page)
    assert found == ["page.html: https://example.org/x.js", "page.html: //example.org/y.css"]


def test_every_document_is_in_the_table_of_contents(site) -> None:
    listed = set(re.findall(r"^(?:docs|examples|hardening)/\S+$", (site.SITE / "index.md").read_text(), re.M))
    there = {f"docs/{path.stem}" for path in (ROOT / "docs").glob("*.md")}
    assert there <= listed


def test_ci_builds_the_site() -> None:
    assert "make docs" in (ROOT / ".ci" / "run").read_text()
