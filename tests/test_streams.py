"""Standard streams that are closed, full or small, and names that would act on a terminal or a page."""

from __future__ import annotations

import io
import json
import os
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from hardening import streams as study
from hypothesis import given
from hypothesis import strategies as st

from preshape.cli import streams
from preshape.cli.printing import print_rows, say
from preshape.exceptions import HandError, InputError, ObjectError
from preshape.hands.load import load_hand
from preshape.memory.checks import text
from preshape.objects.library import load_library_object
from preshape.objects.load import load_object
from preshape.planning.summary import summary
from preshape.report.plain import escaped, html_text
from preshape.report.terminal import fact_grid, terminal

HOSTILE = "mug\x1b[2J\x07\x9b31m\u202egpj.\r"
SHOWN = r"mug\x1b[2J\x07\x9b31m\u202egpj.\r"


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
@pytest.mark.parametrize("case", [study.QUICK[k] for k in (1, 4, 5, 6, 9, 12, 14)], ids=str)
def test_a_stream_that_fails_ends_in_the_right_exit_code(case: study.Case, tmp_path: Path) -> None:
    (tmp_path / f"a{study.CLEAR}b.stl").write_text(study.TRIANGLE)
    assert study.fault(case, tmp_path) == ""


@given(st.text())
def test_no_control_character_is_left_and_others_stay(words: str) -> None:
    shown = escaped(words)
    assert all(c in "\n\t" or (ord(c) >= 32 and not 127 <= ord(c) < 160) for c in shown)
    shown.encode()
    assert escaped(shown) == shown
    assert len(shown) >= len(words)


def test_control_characters_are_shown_wherever_text_is_printed(capsys) -> None:
    assert escaped(HOSTILE) == SHOWN
    assert html_text(HOSTILE + "<b>") == SHOWN + "&lt;b&gt;"
    out = io.StringIO()
    terminal(file=out, width=200).print(fact_grid((HOSTILE, HOSTILE)), HOSTILE, f"[bold]{HOSTILE}[/]")
    assert out.getvalue().count(r"\x1b[2J") == 4
    print_rows(("a",), [(HOSTILE,)])
    say(HOSTILE)
    said = out.getvalue() + capsys.readouterr().out
    assert not set(said) & set("\x1b\x07\x9b\u202e\r")


def test_a_name_stays_in_its_line(capsys) -> None:
    print_rows(("object", "best"), [("pen\n\tmug", "3")])
    say("wrote pen\nmug", "and more")
    _, row, *said = capsys.readouterr().out.splitlines()
    assert row.split() == [r"pen\n\tmug", "3"]
    assert said == [r"wrote pen\nmug", "and more"]


def test_a_plan_shows_a_name_and_its_reasons_in_their_lines() -> None:
    plan = json.loads((Path(__file__).parent.parent / "docs" / "plan.example.json").read_text())
    plan["warnings"] = ["a b"]
    console = terminal(file=(out := io.StringIO()), width=200)
    console.print(summary(plan))
    plain = out.getvalue()
    plan["object"]["name"] = "mug\nmass   99 kg"
    plan["transitions"][0]["reason"] += "\nforged"
    plan["warnings"] = ["a\nb"]
    out.truncate(out.seek(0))
    console.print(summary(plan))
    assert len(out.getvalue().splitlines()) == len(plain.splitlines())
    assert r"mug\nmass   99 kg" in out.getvalue()
    assert r"\nforged" in out.getvalue()


@pytest.mark.skipif(sys.platform == "darwin", reason="file names are UTF-8 on this system")
@pytest.mark.parametrize("name", [b"cup\x9b", "tasse \xe9".encode("latin-1")])
def test_a_file_name_of_other_bytes_is_a_name(name: bytes, tmp_path: Path) -> None:
    file = tmp_path / os.fsdecode(name + b".obj")
    file.write_text("v 0 0 0\nv .05 0 0\nv 0 .05 0\nv 0 0 .05\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    mesh = load_object(file)
    assert mesh.name == name.decode("utf-8", "backslashreplace")
    assert text(mesh.name, "object_name")


def test_colours_of_our_own_are_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    out = io.StringIO()
    terminal(file=out, width=80).print(f"[bold red]{HOSTILE}[/]")
    assert out.getvalue().startswith("\x1b[1;31m")
    assert "\x1b[2J" not in out.getvalue()


@pytest.mark.parametrize(
    ("encoding", "shown"),
    [
        ("utf-8", "48 × 48 mm · 3° ✓ é"),
        ("latin-1", "48 × 48 mm · 3° + é"),
        ("ascii", r"48 x 48 mm - 3 deg + \xe9"),
    ],
)
def test_a_terminal_with_few_characters_shows_similar_ones(encoding: str, shown: str) -> None:
    raw = io.BytesIO()
    streams.prepare_encodings()
    stream = io.TextIOWrapper(raw, encoding, errors="preshape")
    stream.write("48 × 48 mm · 3° ✓ é")
    stream.flush()
    assert raw.getvalue().decode(encoding) == shown


def test_names_that_are_stored_have_a_limit() -> None:
    mesh = load_library_object("cube")
    assert replace(mesh, name="n" * 255).name
    with pytest.raises(ObjectError, match="at most 255 characters, got 256"):
        replace(mesh, name="n" * 256)
    with pytest.raises(HandError, match="at most 200 characters, got 201"):
        replace(load_hand("utah_mit"), name="n" * 201)
    assert text("n" * 255, "object_name")
    with pytest.raises(InputError, match="object_name must have at most 255 characters, got 256"):
        text("n" * 256, "object_name")
