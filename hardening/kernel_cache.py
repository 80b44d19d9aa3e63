"""The cache of compiled kernels is damaged in many ways; every run loads the right kernels all the same.

    python -m hardening.kernel_cache [--long] [--seed 3] [--out out/kernel_cache]

Each run is a process of its own, which loads one module of kernels (with ``--long`` a real hand's plan, with
all of them) from a cache that was cut off, changed in one bit, emptied, replaced by a folder or by other
content, or that cannot be made or written. It must end with exit code 0.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from preshape.files import write_json

from .long_runs import show_progress

LOAD = (
    "from preshape.kernels.cache import load_kernels as load;"
    "from preshape.kernels.closing import warp_clearance as module; load(module, 'cpu');"
    "import os, tempfile; print(*os.listdir(tempfile.gettempdir()))"
)
"""Loads one module, and prints what an interruption would then leave among the temporary files."""
PLAN = (
    "-m",
    "preshape",
    "plan",
    "cube",
    "--task",
    "lift",
    "--hand",
    "leap",
    "--memory",
    ":memory:",
    "--json",
)
COMPILES = "compiling the kernels"


def cut(file: Path, rng: random.Random) -> None:
    """Cut a file off at a random place."""
    os.truncate(file, rng.randrange(file.stat().st_size))


def flip(file: Path, rng: random.Random) -> None:
    """Change one bit in the middle half of a file, which the kernels themselves fill."""
    content = bytearray(file.read_bytes())
    content[rng.randrange(len(content) // 4, 3 * len(content) // 4)] ^= 1 << rng.randrange(8)
    file.write_bytes(content)


def empty(file: Path, rng: random.Random) -> None:
    """Empty a file, as a full disk does."""
    os.truncate(file, 0)


def other(file: Path, rng: random.Random) -> None:
    """Replace a file by random bytes."""
    file.write_bytes(rng.randbytes(4096))


def folder(file: Path, rng: random.Random) -> None:
    """Replace a file by a folder."""
    file.unlink()
    file.mkdir()


DAMAGE: tuple[Callable[[Path, random.Random], None], ...] = (cut, flip, empty, other, folder)


def _run(arguments: tuple[str, ...], cache: Path, temporary: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "WARP_CACHE_PATH": str(cache), "TMPDIR": str(temporary)}
    return subprocess.run(
        [sys.executable, *arguments], check=False, capture_output=True, text=True, env=environment
    )


def study(seed: int, *, times: int, arguments: tuple[str, ...]) -> dict[str, Any]:
    """Damage the cache and run.

    Args:
        seed: Seed of the damage.
        times: How often each kind of damage is done.
        arguments: What Python runs.
    """
    rng = random.Random(seed)
    rows: list[dict[str, Any]] = []
    kinds = [damage for damage in DAMAGE for _ in range(times)]
    with tempfile.TemporaryDirectory(prefix="preshape-cache-") as place:
        whole, temporary, cache = Path(place, "whole"), Path(place, "tmp"), Path(place, "cache")
        temporary.mkdir()

        def check(name: str, where: Path, *, compiles: bool, tells: str = "") -> None:
            done = _run(arguments, where, temporary)
            wrong = ""
            if done.returncode:
                wrong = f"exit code {done.returncode}: {done.stderr.strip()[-200:]}"
            elif (COMPILES in done.stderr) != compiles:
                wrong = "compiled again" if not compiles else "not compiled"
            elif tells not in done.stderr:
                wrong = f"nothing says {tells!r}"
            rows.append({"damage": name, "fault": wrong})
            show_progress(f"{len(rows)} of {len(kinds) + 4} runs")

        check("none, first run", whole, compiles=True)
        check("none", whole, compiles=False)
        for damage in kinds:
            shutil.rmtree(cache, ignore_errors=True)
            shutil.copytree(whole, cache)
            damage(rng.choice(sorted(cache.rglob("*.npz"))), rng)
            # A folder cannot be replaced by a file, so the kernels go to the temporary files, once.
            known = damage is folder and any(temporary.rglob("*.npz"))
            check(damage.__name__, cache, compiles=not known)
        shutil.rmtree(temporary)
        temporary.mkdir()
        nowhere = Path(os.devnull) / "cache"
        check("cannot be made, first run", nowhere, compiles=True, tells="they are kept in")
        check("cannot be made", nowhere, compiles=False, tells="they are kept in")
        leftover = [str(left.name) for left in temporary.iterdir() if not left.name.split("-")[-1].isdigit()]
        rows.append({"damage": "left behind", "fault": ", ".join(leftover)})
    return {"seed": seed, "runs": len(rows) - 1, "faults": [r for r in rows if r["fault"]], "rows": rows}


def main(arguments: list[str]) -> int:
    """Run from the command line; returns 0 where every run was right, else 1."""
    parser = argparse.ArgumentParser(
        prog="python -m hardening.kernel_cache", description="Damage the cache of compiled kernels."
    )
    parser.add_argument("--long", action="store_true", help="plans of a real hand, each damage four times")
    parser.add_argument("--seed", type=int, default=3, help="seed of the damage (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=Path("out/kernel_cache"), help="default: %(default)s")
    given = parser.parse_args(arguments)
    report = study(given.seed, times=4 if given.long else 1, arguments=PLAN if given.long else ("-c", LOAD))
    write_json(given.out / "kernel_cache.json", report)
    print(f"{report['runs']} runs, {len(report['faults'])} faults")
    for row in report["faults"]:
        print(f"  {row['damage']}: {row['fault']}")
    return int(bool(report["faults"]))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
