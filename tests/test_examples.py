"""The examples and the README are run as they stand; the documents' links and commands lead somewhere."""

from __future__ import annotations

import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
EXAMPLES = sorted((ROOT / "examples").glob("[0-9]*.py"))


def test_there_are_examples():
    assert len(EXAMPLES) >= 5
    assert [int(path.name[:2]) for path in EXAMPLES] == list(range(1, len(EXAMPLES) + 1))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs(path, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PRESHAPE_MEMORY", str(tmp_path / "memory.sqlite"))
    runpy.run_path(str(path), run_name="__main__")
    assert capsys.readouterr().out.strip()


def test_four_modes_example_reaches_all_of_them(capsys):
    runpy.run_path(str(ROOT / "examples" / "02_four_modes.py"), run_name="__main__")
    lines = capsys.readouterr().out.splitlines()
    modes = [re.search(r"mode (\d), (\w+)", line) for line in lines]
    seen = [(int(m[1]), m[2]) for m in modes if m]
    assert seen == [(0, "answer"), (3, "answer"), (1, "answer"), (2, "task_correction"), (3, "deadlock")]
    assert any("corrected: answer" in line for line in lines)


def test_readme_python_runs(tmp_path, monkeypatch, capsys):
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert len(blocks) == 1
    monkeypatch.chdir(tmp_path)
    shown = list[str]()
    monkeypatch.setattr("webbrowser.open", shown.append)
    script = tmp_path / "readme.py"
    script.write_text(blocks[0])
    runpy.run_path(str(script))
    assert "plane" in capsys.readouterr().out
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"plan.json", "plan.png", "plan.html"}
    assert len(shown) == 1


def test_readme_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").split()) <= 600


@pytest.mark.parametrize(
    "document", sorted(ROOT.glob("*.md")) + sorted(ROOT.glob("[dh]*/*.md")), ids=lambda p: p.stem
)
def test_links_lead_somewhere(document):
    for target, anchor in re.findall(r"\]\(([^)#]*)#?([^)]*)\)", document.read_text(encoding="utf-8")):
        if "://" not in target:
            linked = document.parent / target if target else document
            assert linked.exists(), f"{document.name} links to {target}"
            if anchor:
                headings = re.findall(r"^#+ (.*)$", linked.read_text(encoding="utf-8"), re.MULTILINE)
                anchors = [re.sub(r"[^\w -]", "", text.lower()).replace(" ", "-") for text in headings]
                assert anchor in anchors, f"{document.name} links to {target}#{anchor}"


def test_module_runs_as_a_program():
    done = subprocess.run(
        [sys.executable, "-m", "preshape", "--version"], capture_output=True, text=True, check=True
    )
    assert re.fullmatch(r"preshape, version \d+\.\d+\.\d+\n", done.stdout)
