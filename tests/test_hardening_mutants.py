"""The mutation check: what each operator yields, and what strong and weak tests notice."""

from __future__ import annotations

import json
import re
from pathlib import Path
from textwrap import dedent
from typing import Any

import pytest

pytest.importorskip("hardening.mutants", reason="the folder hardening is not here")

from hardening import mutants
from hardening.mutation_report import KILLED, SAME, SURVIVED, TIMEOUT, UNCOVERED, report
from hardening.mutations import mutations

from preshape.report.markdown import markdown

MODULE = '''
"""A module."""

LIMIT = 2.0


def kept(numbers: list[float], limit: float = LIMIT) -> list[float]:
    """The numbers under a limit, the first one left out."""
    if limit < 0:
        raise ValueError("the limit is negative")
    return [n for n in numbers[1:] if n < limit]


def never() -> int:
    return 3
'''
STRONG = """
import pytest
from small.core import LIMIT, kept


def test_kept():
    assert kept([9.0, 1.0, 1.5, 2.0, 3.0, -1.0]) == [1.0, 1.5, -1.0]
    assert kept([], 0.0) == []
    assert kept([0.0, 0.5, 1.0, -1.0], 1.0) == [0.5, -1.0]
    assert LIMIT == 2.0
    for limit in (-1.0, -0.25):
        with pytest.raises(ValueError, match="negative"):
            kept([], limit)
"""
WEAK = """
from small.core import kept


def test_kept():
    kept([9.0, 1.0, 1.5, 2.0, 3.0, -1.0])
"""

LISTED = "-    return [n for n in numbers[1:] if n < limit]\n+    return None"
LIMIT = "-LIMIT = 2.0\n+LIMIT = 4.0"
RAISED = '-        raise ValueError("the limit is negative")\n+        pass'


def changed(source: str) -> dict[str, set[str]]:
    """Every mutated text by operator, without what surrounds a single line."""
    found: dict[str, set[str]] = {}
    text = dedent(source).strip("\n") + "\n"
    for mutation in mutations(text):
        found.setdefault(mutation.operator, set()).add(mutation.applied(text).rstrip("\n"))
    return found


@pytest.mark.parametrize(
    ("source", "operator", "wanted"),
    [
        ("a < b", "comparison", {"(a <= b)", "(a >= b)"}),
        ("a >= b", "comparison", {"(a > b)", "(a < b)"}),
        ("a == b", "comparison", {"(a != b)"}),
        ("a in b", "comparison", {"(a not in b)"}),
        ("a is None", "comparison", {"(a is not None)"}),
        ("a < b < c", "comparison", {"(a <= b < c)", "(a >= b < c)", "(a < b <= c)", "(a < b >= c)"}),
        ("a + b", "arithmetic", {"(a - b)"}),
        ("a * b", "arithmetic", {"(a / b)"}),
        ("a**b", "arithmetic", {"(a * b)"}),
        ("a & b", "arithmetic", {"(a | b)"}),
        ("a @ b", "arithmetic", set()),
        ("a = 3", "constant", {"a = 4", "a = 2"}),
        ("a = 0", "constant", {"a = 1", "a = (-1)"}),
        ("a = 3.0", "constant", {"a = 6.0", "a = 1.5"}),
        ("a = 0.0", "constant", {"a = 1.0"}),
        ("a = 1e-9", "constant", {"a = 0.0"}),
        ("a = True", "constant", {"a = False"}),
        ("a and b", "and/or", {"(a or b)"}),
        ("a or b", "and/or", {"(a and b)"}),
        ("not a", "sign or not removed", {"(a)"}),
        ("-a", "sign or not removed", {"(a)"}),
        ("if a:\n    b()", "condition negated", {"if (not (a)):\n    b()"}),
        ("b if a else c", "condition negated", {"b if (not (a)) else c"}),
        ("[b for b in c if a]", "condition negated", {"[b for b in c if (not (a))]"}),
        ("if a == b:\n    c()", "condition negated", set()),
        ("a()", "statement removed", {"pass"}),
        ("a.b = c", "statement removed", {"pass"}),
        ("a[0] = c", "statement removed", {"pass"}),
        ("a += c", "statement removed", {"pass"}),
        ("a = b", "statement removed", set()),
        ("a = b\na = c", "statement removed", {"a = b\npass"}),
        ("def f(a):\n    a = c", "statement removed", {"def f(a):\n    pass"}),
        ("def f():\n    return a", "return None", {"def f():\n    return None"}),
        ("def f():\n    return None", "return None", set()),
        ("a[i]", "index", {"a[i + 1]"}),
        ("a[i:]", "index", {"a[i:-1]"}),
        ("a[:i]", "index", {"a[1:i]"}),
        ("a[:, i]", "index", {"a[:, i + 1]"}),
        ("min(a)", "opposite", {"(max)(a)"}),
        ("a.argmax()", "opposite", {"(a.argmin)()"}),
        ("f(a, b=c, d=e)", "argument removed", {"f(a, d=e)", "f(a, b=c)"}),
        ("f(b=c, d=e)", "argument removed", {"f(d=e)", "f(b=c)"}),
        ("f(b=c)", "argument removed", {"f()"}),
        ("a == 'b'", "string", {"a == '?b'"}),
        ("a in ('b', 'c')", "string", {"a in ('?b', 'c')", "a in ('b', '?c')"}),
        ("A = ('b', 'c')", "string", {"A = ('?b', 'c')", "A = ('b', '?c')"}),
        ("A = {'b': 'two words'}", "string", {"A = {'?b': 'two words'}"}),
        ("A = Literal['b']", "string", set()),
        ("def f(a='b', *, c=''):\n    pass", "default", {"def f(a='?b', *, c=''):\n    pass",
                                                         "def f(a='b', *, c='?'):\n    pass"}),
        ("class A:\n    a: str = 'b'", "default", {"class A:\n    a: str = '?b'"}),
    ],
)  # fmt: skip
def test_each_operator_yields_what_it_should(source: str, operator: str, wanted: set[str]) -> None:
    assert changed(source).get(operator, set()) == wanted


@pytest.mark.parametrize(
    "source",
    [
        '"""Two."""',
        "import a.b",
        "assert a < 3",
        "raise_ = f'{a + 1} of {b:.2f}'",
        "a: Literal[1, 2]",
        "@f(1)\nclass A(B, metaclass=C): ...",
        "match a:\n    case 1 | 2: ...",
    ],
)
def test_what_is_no_behaviour_is_left_alone(source: str) -> None:
    assert changed(source) == {}


def test_each_mutant_is_another_program_that_differs_only_where_it_says() -> None:
    text = "x = 'ä'  # ä\n\n\ndef f(a,\n      b=2):\n    return (a +  # ü\n            b) * 3\n"
    found = mutations(text)
    assert len({m.applied(text) for m in found}) == len(found) > 5
    for mutation in found:
        data, other = text.encode(), mutation.applied(text).encode()
        assert other.startswith(data[: mutation.start])
        assert other.endswith(data[mutation.end :])
        assert other != data
        assert mutation.lines[0] <= mutation.line <= mutation.lines[1]
    assert "b=3" in "".join(m.difference(text) for m in found)
    assert {m.lines for m in found if m.line == 5} == {(4, 5)}  # a default belongs to its function's head


@pytest.fixture
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> mutants.Project:
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")  # starts in half the time
    package = tmp_path / "src" / "small"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (package / "core.py").write_text(MODULE)
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_core.py").write_text(STRONG)
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    return mutants.Project(
        root=tmp_path, source="src", package="small", tests=("tests/test_core.py",), equivalent={}
    )


def outcomes(project: mutants.Project, out: Path, *differences: str) -> tuple[dict[str, str], str]:
    """Outcome of some mutants, or of all, and the report."""
    chosen = [
        m for m in mutants.drawn(project, ["core"], None, 0) if m.difference in differences or not differences
    ]
    mutants.study(project, chosen, out, workers=2)
    found = mutants.tested(project, chosen, out)
    assert len(found) == len(chosen)
    return {m.difference: row["outcome"] for m, row in found}, markdown(report(project, found, "Some."))


def test_good_tests_notice_every_mutant_and_sabotaged_tests_do_not(
    small: mutants.Project, tmp_path: Path
) -> None:
    good, page = outcomes(small, tmp_path / "good")
    never = {diff for diff, outcome in good.items() if outcome == UNCOVERED}
    assert never  # nothing runs the body of never()
    assert all("return 3" in diff for diff in never)
    assert {outcome for diff, outcome in good.items() if diff not in never} == {KILLED}
    assert f"| core.py | {len(good)} | {len(good) - len(never)} | 0 | {len(never)} | 0 |" in page

    (tmp_path / "tests" / "test_core.py").write_text(WEAK)
    weak, page = outcomes(small, tmp_path / "weak", LISTED, RAISED)
    assert weak == {LISTED: SURVIVED, RAISED: UNCOVERED}
    assert f"### `src/small/core.py:11` return None\n\n```diff\n{LISTED}\n```" in page
    assert "| all | 2 | 0 | 1 | 1 | 0 | 0.00 |" in page


def test_better_tests_run_the_survivors_again_and_not_what_was_noticed(
    small: mutants.Project, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "tests" / "test_core.py").write_text(WEAK + "    assert kept([0.0, 1.0])\n")
    assert outcomes(small, tmp_path / "out", LISTED, LIMIT)[0] == {
        LISTED: KILLED,
        LIMIT: SURVIVED,
    }
    (tmp_path / "tests" / "test_core.py").write_text(STRONG)
    again: list[str] = []
    run = mutants.Copy.tested

    def noted(copy: mutants.Copy, module: str, text: str, *rest: Any) -> dict[str, Any]:
        again.append(text)
        return run(copy, module, text, *rest)

    monkeypatch.setattr(mutants.Copy, "tested", noted)
    assert set(outcomes(small, tmp_path / "out", LISTED, LIMIT)[0].values()) == {KILLED}
    assert again == [small.modules["core.py"].replace("LIMIT = 2.0", "LIMIT = 4.0")]


def test_an_equivalent_mutant_is_counted_apart_and_its_reason_is_in_the_report(
    small: mutants.Project, tmp_path: Path
) -> None:
    small.equivalent["core.py", 'raise ValueError("the limit is negative")', "pass"] = (
        "No caller asks for less than 0."
    )
    found, page = outcomes(small, tmp_path / "out", LISTED, RAISED)
    assert found == {LISTED: KILLED, RAISED: SAME}
    assert "| all | 2 | 1 | 0 | 0 | 1 | 1.00 |" in page
    assert "No caller asks for less than 0." in page.partition("## Equivalent")[2]


def test_the_command_writes_a_report_and_its_numbers(
    small: mutants.Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert mutants.main(["core", "--count", "2", "--workers", "1", "--out", str(out)], small) == 0
    rows = json.loads((out / "mutants.json").read_text())["mutants"]
    assert [row["module"] for row in rows] == ["core.py"] * 2
    noticed = sum(row["outcome"] == KILLED for row in rows)
    assert f"noticed {noticed} of 2 mutants" in capsys.readouterr().out
    assert "2 mutants of 2, drawn with seed 0." in (out / "mutants.md").read_text()


def test_an_interrupted_run_reports_what_it_has_and_the_same_command_goes_on(
    small: mutants.Project, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, words = (
        mutants.Copy.tested,
        ["core", "--count", "3", "--workers", "1", "--out", str(tmp_path / "out")],
    )
    texts: list[str] = []

    def once(copy: mutants.Copy, module: str, text: str, *rest: Any) -> dict[str, Any]:
        texts.append(text)
        if len(texts) == 2:
            raise KeyboardInterrupt
        return run(copy, module, text, *rest)

    monkeypatch.setattr(mutants.Copy, "tested", once)
    assert mutants.main(words, small) == 130
    page = (tmp_path / "out" / "mutants.md").read_text()
    assert re.search(r"^[12] mutants of 3, drawn with seed 0\.", page, re.M)
    assert mutants.main(words, small) == 0
    assert texts[2:] == texts[1:2]  # only what had no outcome
    assert len(json.loads((tmp_path / "out" / "mutants.json").read_text())["mutants"]) == 3


def test_a_mutant_that_never_ends_is_stopped_and_counts_as_noticed(
    small: mutants.Project, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mutants, "PATIENCE", (1.0, 0.0))
    (tmp_path / "src/small/core.py").write_text(
        "def f():\n    n = 3\n    while n:\n        n -= 1\n    return n\n"
    )
    (tmp_path / "tests/test_core.py").write_text("from small.core import f\n\n\ndef test_f():\n    f()\n")
    chosen = [m for m in mutants.drawn(small, [], None, 0) if m.mutation.operator == "statement removed"]
    mutants.study(small, chosen, tmp_path / "out", workers=1)
    assert [row["outcome"] for _, row in mutants.tested(small, chosen, tmp_path / "out")] == [TIMEOUT]


def test_the_draw_follows_from_its_seed() -> None:
    project = mutants.Project()
    keys = [[m.key for m in mutants.drawn(project, [], 50, seed)] for seed in (0, 0, 1)]
    assert keys[0] == keys[1] != keys[2]
    assert len(set(keys[0])) == 50
    assert {m.module for m in mutants.drawn(project, ["fuzzy", "planes.py"], 50, 0)} == {
        "fuzzy.py",
        "planes.py",
    }


def test_failing_tests_and_unknown_modules_are_refused(
    small: mutants.Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ["--out", str(tmp_path / "out"), "--workers", "1"]
    assert mutants.main(["cor", *out], small) == 2
    assert "no module cor.py; known: __init__.py, core.py" in capsys.readouterr().err
    assert mutants.main(["--count", "0", *out], small) == 2
    (tmp_path / "tests" / "test_core.py").write_text("def test_red():\n    assert False\n")
    assert mutants.main(out, small) == 2
    assert "tests/test_core.py fails without a mutant" in capsys.readouterr().err


def test_every_equivalent_mutant_still_exists() -> None:
    every = {m.change for m in mutants.drawn(mutants.Project(), [], None, 0)}
    assert set(mutants.EQUIVALENT) <= every
