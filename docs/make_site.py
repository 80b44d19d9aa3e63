"""Build the documentation site: `make docs`.

1. The documents, examples and API pages are copied to ``out/docs-source`` with their places in the checkout,
   so that the links which a code host follows are the links of the site.
2. The plans of ``docs/site/gallery.toml`` are made, drawn, and kept in ``out/gallery`` until the package or
   the command changes; a build that was stopped goes on where it was.
3. The leaderboard is made from the tables of ``docs/results.md``.
4. Sphinx writes ``out/docs``. Any warning fails the build, and so does a page that would load something from
   elsewhere.
"""

from __future__ import annotations

import argparse
import hashlib
import html
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
import tomllib
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SITE = ROOT / "docs" / "site"
RESULTS = ROOT / "docs" / "results.md"
COPIED = (
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "LICENSE",
    "docs/*.md",
    "docs/*.json",
    "docs/api/*.rst",
    "docs/pictures/*",
    "hardening/README.md",
    "examples/**/*.*",
    "src/preshape/schema/*.json",
)
"""What the site is made of; the page with all of them is ``docs/site/index.md``."""


MERMAID = "*The diagram as Mermaid text, which code hosts draw:*"
SUMS = ("together", "all")
"""Names of rows that sum up the others, and have no rank."""


class SiteError(Exception):
    """The site cannot be built as it is."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """A plan of the gallery: its name, title, and the words after ``preshape plan``."""

    name: str
    title: str
    words: str

    @property
    def command(self) -> str:
        return f"preshape plan {self.words} --memory :memory: --out out"


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table of a Markdown document: its heading, column names and rows of cells."""

    heading: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Board:
    """Where the figures of a leaderboard stand in ``docs/results.md``.

    Attributes:
        title: Title on the site.
        heading: Heading of the section.
        columns: The first column names of its table; they tell tables of a section apart.
        value: Column to rank the rows by, or None: the columns are ranked, once for each row.
        words: What is measured.
    """

    title: str
    heading: str
    columns: tuple[str, ...]
    value: str | None
    words: str


BOARDS = (
    Board(
        title="Hands: grasps that hold",
        heading="Grips of real hands",
        columns=("", "shadow", "allegro", "leap"),
        value=None,
        words="Share of planned grasps that held in simulated physics, of those tested, with 95 % intervals.",
    ),
    Board(
        title="Hands: the task test",
        heading="Grips of real hands",
        columns=("hand", "passed"),
        value="passed",
        words="Instances whose grasp was executed and moved along the task's motion against the task's load.",
    ),
    Board(
        title="Hands read from their own file",
        heading="Hands",
        columns=("", "answered"),
        value="answered",
        words="Pairs of object and task with an answer, at the objects' own masses.",
    ),
    Board(
        title="Indices: does the grasp hold?",
        heading="Which index predicts success?",
        columns=("index", "holding, all"),
        value="holding, within",
        words="Area under the ROC curve for the six-direction test, within objects (0.5 is chance).",
    ),
    Board(
        title="Indices: does the task succeed?",
        heading="Which index predicts success?",
        columns=("index", "holding, all"),
        value="task, within",
        words="Area under the ROC curve for the task test, within objects.",
    ),
    Board(
        title="Indices among force-closed grasps: does the task succeed?",
        heading="Which index predicts success?",
        columns=("index", "holding, of 824 force closed (494 pass)"),
        value="task, of 824 force closed (594 pass)",
        words="The same among grasps that are force closed already, where the choice is harder.",
    ),
)


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python docs/make_site.py", description="Build the documentation site."
    )
    parser.add_argument(
        "--out", type=Path, default=ROOT / "out", help="folder for docs, docs-source and gallery"
    )
    parser.add_argument(
        "--gallery", type=int, metavar="N", help="make only the first N plans of the gallery anew"
    )
    options = parser.parse_args()
    out = options.out.resolve()
    try:
        build(out, options.gallery)
    except SiteError as error:
        sys.exit(f"docs: {error}")
    print(f"open {out / 'docs' / 'index.html'}")


def build(out: Path, limit: int | None = None) -> None:
    """Build the site in ``out/docs``.

    Args:
        out: Folder of the site, its sources and the gallery's plans.
        limit: Number of gallery plans that may be made anew, from the first; None: all.

    Raises:
        SiteError: A plan of the gallery has no answer, a figure of the leaderboard is not where it should be,
            Sphinx warned, or a page would load something from elsewhere.
    """
    source, built = out / "docs-source", out / "docs"
    shutil.rmtree(source, ignore_errors=True)
    for path in sources():
        target = source / path.relative_to(ROOT)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(path, target)
    for path in (source / "docs").glob("*.md"):
        text = path.read_text(encoding="utf-8").replace(
            "](../README.md", "](../index.md"
        )  # it is the front page
        path.write_text(text.replace("```mermaid", f"{MERMAID}\n\n```mermaid"), encoding="utf-8")
    shutil.copy2(SITE / "index.md", source)
    (source / "leaderboard.md").write_text(leaderboard(RESULTS.read_text(encoding="utf-8")), encoding="utf-8")
    pages = source / "_pages" / "plans"
    pages.mkdir(parents=True)
    (source / "plans").mkdir()
    entries = gallery_entries((SITE / "gallery.toml").read_text(encoding="utf-8"))
    page = gallery(entries, out / "gallery", source / "plans", pages, limit)
    (source / "gallery.md").write_text(page, encoding="utf-8")
    command = [sys.executable, "-m", "sphinx", "--fail-on-warning", "--keep-going", "-q", "-c", str(SITE)]
    shutil.rmtree(built, ignore_errors=True)
    command += [
        "-d",
        str(out / "docs-doctrees"),
        "-D",
        f"html_extra_path={source / '_pages'}",
        str(source),
        str(built),
    ]
    if subprocess.run(command, cwd=ROOT, check=False).returncode:
        raise SiteError("Sphinx warned; see above")
    if loads := [line for path in sorted(built.rglob("*.html")) for line in loaded_from_elsewhere(path)]:
        raise SiteError("pages that need a network:\n  " + "\n  ".join(loads))


def sources() -> list[Path]:
    """The files of the checkout that the site is made of."""
    found = (path for pattern in COPIED for path in ROOT.glob(pattern))
    return sorted(path for path in found if path.is_file() and "__pycache__" not in path.parts)


# The gallery.


def gallery_entries(text: str) -> list[Entry]:
    """The plans that a gallery.toml lists, in its order."""
    return [Entry(name=name, **row) for name, row in tomllib.loads(text).items()]


def state_of_package() -> str:
    """A digest of the package's files: plans that another state of it drew are drawn again."""
    digest = hashlib.sha256()
    for path in sorted((ROOT / "src").rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts and ".egg-info" not in str(path):
            digest.update(str(path.relative_to(ROOT)).encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def gallery(entries: list[Entry], kept: Path, pictures: Path, pages: Path, limit: int | None) -> str:
    """Make the plans that are missing, and write the gallery's page.

    Args:
        entries: The plans.
        kept: Folder where plans are kept between builds.
        pictures: Folder of the site's sources for their pictures.
        pages: Folder of the site for their pages.
        limit: Number of entries that may be made anew, from the first; None: all.

    Returns:
        The page as Markdown. It states how long each plan and its drawing took.

    Raises:
        SiteError: A command has no answer.
    """
    state = state_of_package()
    parts, total, shown = [], 0.0, 0
    for number, entry in enumerate(entries):
        digest = hashlib.sha256(f"{state}\n{entry.command}".encode()).hexdigest()
        folder = kept / f"{entry.name}-{digest[:16]}"
        text = f"## {entry.title}\n\n```console\n{entry.command}\n```\n\n"
        if not folder.is_dir():
            if limit is not None and number >= limit:
                parts.append(text + "Not drawn in this build (`make docs` draws it).\n")
                continue
            print(f"gallery {number + 1}/{len(entries)}: {entry.command}", flush=True)
            draw(entry, folder)
        shutil.copyfile(folder / "plan.png", pictures / f"{entry.name}.png")
        shutil.copyfile(folder / "plan.html", pages / f"{entry.name}.html")
        seconds = float((folder / "seconds").read_text())
        total, shown = total + seconds, shown + 1
        summary = html.escape((folder / "summary.txt").read_text(encoding="utf-8").strip("\n"))
        page = f"plans/{entry.name}.html"
        parts.append(
            f"{text}![{entry.title}: object, hand, contacts and figures]"
            f"(plans/{entry.name}.png){{.gallery}}\n\n"
            f'<p><a href="{page}">Open the plan as a page</a> · planned and drawn in {seconds:.0f} s</p>\n\n'
            "<details><summary>What the command says</summary>\n"
            f"<pre>{summary.replace(chr(10), '&#10;')}</pre>\n</details>\n"
        )
    head = (
        "# Gallery\n\nEvery picture is drawn by preshape itself, by the command above it. The "
        f"{shown} plans shown took {total:.0f} s together, each in its own process with an empty memory.\n\n"
    )
    return head + "\n".join(parts)


def draw(entry: Entry, folder: Path) -> None:
    """Run an entry's command; its files stand in ``folder`` only when all of them are there.

    Raises:
        SiteError: The command has no answer or failed.
    """
    unfinished = folder.with_name(folder.name + ".unfinished")
    shutil.rmtree(unfinished, ignore_errors=True)
    unfinished.mkdir(parents=True)
    words = shlex.split(entry.command)
    words[-1] = str(unfinished)
    start = time.monotonic()
    environment = {**os.environ, "NO_COLOR": "1", "COLUMNS": "100"}
    result = subprocess.run(
        [sys.executable, "-m", *words],
        cwd=ROOT,
        env=environment,
        text=True,
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    if result.returncode:
        raise SiteError(f"{entry.command}: exit code {result.returncode}\n{result.stdout}{result.stderr}")
    summary = result.stdout.replace(str(unfinished), "out")
    (unfinished / "summary.txt").write_text(summary, encoding="utf-8")
    (unfinished / "seconds").write_text(f"{time.monotonic() - start:.2f}")
    unfinished.rename(folder)


# The leaderboard.


def tables(text: str) -> list[Table]:
    """The tables of a Markdown document, with the heading that each stands under."""
    found: list[Table] = []
    heading, block = "", []
    for line in [*text.splitlines(), ""]:
        if line.startswith("|"):
            block.append(tuple(cell.strip() for cell in line.strip()[1:-1].split("|")))
            continue
        if len(block) > 2:
            found.append(Table(heading=heading, columns=block[0], rows=tuple(block[2:])))
        block = []
        if line.startswith("#"):
            heading = line.lstrip("#").strip()
    return found


def figure(cell: str) -> float:
    """The number that a cell begins with: a share (``19/20``, ``24 of 27``), a percentage, or a decimal.

    Raises:
        SiteError: It begins with none.
    """
    plain = cell.replace("*", "").strip()
    if share := re.match(r"(\d+)\s*(?:/|of)\s*(\d+)", plain):
        return int(share[1]) / int(share[2])
    if number := re.match(r"(\d+(?:\.\d+)?)\s*(%?)", plain):
        return float(number[1]) / (100 if number[2] else 1)
    raise SiteError(f"docs/results.md: no figure in the cell '{cell}', which the leaderboard ranks")


def leaderboard(text: str) -> str:
    """The leaderboard's page, from the tables of ``docs/results.md``.

    Raises:
        SiteError: A table, a column or a figure is not where ``BOARDS`` says.
    """
    there = tables(text)
    parts = [
        "# Leaderboard\n\nThe figures are those of [results](docs/results.md), ranked; that page has the "
        "command behind each and its conditions. Another planner is scored on the same inputs by the "
        "[task benchmark](docs/task-benchmark.md).\n"
    ]
    for board in BOARDS:
        fitting = [
            table
            for table in there
            if table.heading == board.heading and table.columns[: len(board.columns)] == board.columns
        ]
        if len(fitting) != 1:
            raise SiteError(
                f"docs/results.md: {len(fitting)} tables '{board.heading}' with the columns {board.columns}, "
                "expected one"
            )
        parts.append(f"## {board.title}\n\n{board.words}\n\n{ranking(fitting[0], board.value)}")
    return "\n".join(parts)


def ranking(table: Table, value: str | None) -> str:
    """A table's rows ranked by a column, or its columns ranked in each row, as Markdown with bars."""
    if value is None:
        parts = []
        for name, *cells in table.rows:
            places = ranked(list(zip(table.columns[1:], cells, strict=True)))
            parts += [f"| {name if place is places[0] else ''} {row(*place)}" for place in places]
        head = "| benchmark | rank | hand | figure | |\n|---|---|---|---|---|\n"
        return head + "\n".join(parts) + "\n"
    if value not in table.columns:
        raise SiteError(f"docs/results.md: '{table.heading}' has no column '{value}'; it has {table.columns}")
    column = table.columns.index(value)
    places = ranked([(cells[0], cells[column]) for cells in table.rows if cells[0] not in SUMS])
    head = f"| rank | {table.columns[0] or 'hand'} | {value} | |\n|---|---|---|---|\n"
    return head + "\n".join(row(*place) for place in places) + "\n"


def ranked(cells: list[tuple[str, str]]) -> list[tuple[int, str, str]]:
    """Rank, name and cell, the best figure first; equal figures have the same rank."""
    order = sorted(cells, key=lambda item: -figure(item[1]))
    values = [figure(cell) for _, cell in order]
    return [
        (1 + values.index(figure(cell)), name.replace("*", ""), cell.replace("*", "")) for name, cell in order
    ]


def row(rank: int, name: str, cell: str) -> str:
    """A row of a ranking, with the figure as a bar."""
    return f'| {rank} | {name} | {cell} | <meter min="0" max="1" value="{figure(cell):.4g}"></meter> |'


# Pages stand alone.


class Loads(HTMLParser):
    """Collects what a page loads from another host; links that a reader follows do not count."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        address = values.get("href") if tag == "link" else None if tag == "a" else values.get("src")
        if address and re.match(r"(https?:)?//", address) and values.get("rel") != "canonical":
            self.found.append(address)


def loaded_from_elsewhere(path: Path) -> list[str]:
    """What a page would load from another host, each as ``page: address``."""
    reader = Loads()
    reader.feed(path.read_text(encoding="utf-8"))
    return [f"{path.name}: {address}" for address in reader.found]


if __name__ == "__main__":
    main()
