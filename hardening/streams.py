"""Closed, full and small standard streams: the right exit code, no traceback, no control sequence of a name.

    python -m hardening.streams [--long] [--out out/streams]

The quick form runs short commands on every stream; the long form adds plans. Each line of the report is one
shell command.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from preshape.files import write_json

from .long_runs import show_progress

CLEAR = "\x1b[2J"
"""A sequence that clears a terminal; it must never be sent because a name holds it."""
TRIANGLE = (
    "solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
)
_OWN = re.compile(r"\x1b\[[0-9;]*m")
"""Colours, which the command line itself sends."""


@dataclass(frozen=True)
class Case:
    """A command, the redirections of its streams, and what must come of it.

    Attributes:
        command: Arguments of ``preshape``; ``{folder}`` is a folder of this run.
        streams: Redirections, as the shell reads them.
        codes: The right exit codes.
        settings: Environment variables.
        has: Text that standard output or standard error must hold.
    """

    command: str
    streams: str
    codes: tuple[int, ...]
    settings: str = ""
    has: str = ""


_PLAN = "plan cube --task lift --memory :memory:"
_HOSTILE = shlex.quote(f"{{folder}}/a{CLEAR}b.stl")
QUICK = (
    Case("tasks", ">&-", (3,), has="standard output cannot be written"),
    Case("tasks --json", ">&-", (3,), has="standard output cannot be written"),
    Case("tasks", "2>&-", (0,), has="lift"),
    Case("tasks", "<&-", (0,), has="lift"),
    Case("tasks", "<&- >&- 2>&-", (3,)),
    Case("tasks", ">/dev/full", (3,), has="No space left"),
    Case("tasks --json", ">/dev/full", (3,), has="No space left"),
    Case("--help", ">/dev/full", (3,), has="No space left"),
    Case("plan nothing --task lift", "2>&-", (2,)),
    Case("plan nothing --task lift", "2>/dev/full", (2,)),
    Case("plan nothing --task lift --json", ">/dev/full", (2, 3)),
    Case("plan nothing --task lift --json", ">/dev/full 2>/dev/full", (2, 3)),
    Case("memory reset --memory {folder}/m.sqlite", "<&-", (2,), has="--yes"),
    Case("tasks", "| head -1", (0,)),
    Case("objects", "", (0,), settings="PYTHONIOENCODING=ascii", has="mug"),
    Case("objects", "", (0,), settings="PYTHONIOENCODING=latin-1", has="mug"),
    Case("objects", "", (0,), settings="LC_ALL=C PYTHONUTF8=0 PYTHONCOERCECLOCALE=0", has="mug"),
    Case(f"plan {_HOSTILE} --task lift", "", (2,), has=r"a\x1b[2Jb"),
    Case("plan {folder}/none --task " + shlex.quote(f"x{CLEAR}"), "", (2,), has=r"\x1b[2J"),
)
LONG = (
    Case(_PLAN, ">&-", (3,), has="standard output cannot be written"),
    Case(_PLAN, "2>&-", (0,), has="Grasp found"),
    Case(_PLAN, ">/dev/full", (3,), has="No space left"),
    Case(_PLAN, "", (0,), settings="PYTHONIOENCODING=ascii", has="Grasp found"),
    Case(_PLAN, "", (0,), settings="PYTHONIOENCODING=latin-1", has="Grasp found"),
    Case(_PLAN, "", (0,), settings="TERM=dumb", has="Grasp found"),
    Case(_PLAN + " --out {folder}/out", ">&-", (3,), has="standard output cannot be written"),
)


def fault(case: Case, folder: Path) -> str:
    """Run a case; returns what was wrong, or nothing.

    Args:
        case: The case.
        folder: A folder for the files of the run.
    """
    command = case.command.replace("{folder}", str(folder))
    line = (
        f"set -o pipefail; {case.settings} {shlex.quote(sys.executable)} -m preshape {command} {case.streams}"
    )
    done = subprocess.run(
        ["bash", "-c", line], check=False, capture_output=True, timeout=300, stdin=subprocess.DEVNULL
    )
    said = (done.stdout + done.stderr).decode("latin-1")
    if "Traceback" in said or "Exception ignored" in said or "internal fault" in said:
        return "traceback"
    if done.returncode not in case.codes:
        return f"exit code {done.returncode}, right is {' or '.join(map(str, case.codes))}"
    if "\x1b" in _OWN.sub("", said):
        return "a control sequence of a name reaches the terminal"
    return "" if case.has in said else f"nothing says {case.has!r}"


def study(cases: tuple[Case, ...]) -> dict[str, Any]:
    """Run cases and report."""
    rows = []
    with tempfile.TemporaryDirectory(prefix="preshape-streams-") as place:
        folder = Path(place)
        (folder / f"a{CLEAR}b.stl").write_text(TRIANGLE)
        for case in cases:
            rows.append({**vars(case), "fault": fault(case, folder)})
            show_progress(f"{len(rows)} of {len(cases)} cases")
    return {"cases": len(rows), "faults": [row for row in rows if row["fault"]], "rows": rows}


def main(arguments: list[str]) -> int:
    """Run from the command line; returns 0 where nothing was wrong, else 1."""
    parser = argparse.ArgumentParser(
        prog="python -m hardening.streams", description="Closed, full and small standard streams."
    )
    parser.add_argument("--long", action="store_true", help="also plans")
    parser.add_argument("--out", type=Path, default=Path("out/streams"), help="folder (default: %(default)s)")
    given = parser.parse_args(arguments)
    if not os.path.exists("/dev/full"):
        print("this system has no /dev/full, so the study cannot run here", file=sys.stderr)
        return 3
    report = study(QUICK + LONG if given.long else QUICK)
    write_json(given.out / "streams.json", report)
    print(f"{report['cases']} cases, {len(report['faults'])} faults")
    for row in report["faults"]:
        print(f"  {row['settings']} preshape {row['command']!a} {row['streams']}: {row['fault']}")
    return int(bool(report["faults"]))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
