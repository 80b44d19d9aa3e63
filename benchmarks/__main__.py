"""Run the benchmarks and print one table: value, target, and a baseline measured in the same run."""

from __future__ import annotations

import importlib
import os
import platform
import sys
from importlib.metadata import version
from pathlib import Path

from rich.console import Console
from rich.table import Table

MODULES = (
    "bench_explorer",
    "bench_modes",
    "bench_training",
    "bench_learning",
    "bench_memory",
    "bench_load",
    "bench_large",
    "bench_closing",
    "bench_closure",
    "bench_physics",
    "bench_dataset",
    "bench_view",
    "bench_startup",
    "bench_arm",
)


def main(wanted: list[str]) -> int:
    """Run the benchmarks whose names contain one of the words, or all of them.

    Returns:
        0 where all answers were right, 1 where one was wrong, 2 for an unknown name.
    """
    names = [name for name in MODULES if not wanted or any(word in name for word in wanted)]
    if not names:
        print(f"no benchmark matches {' '.join(wanted)}; known: {', '.join(MODULES)}", file=sys.stderr)
        return 2
    console = Console()
    table = Table(title=machine(), title_justify="left", box=None, header_style="bold")
    for heading in ("what", "median", "target", "baseline in the same run", "answer"):
        table.add_column(heading)
    wrong = 0
    for name in names:
        console.print(f"[dim]running {name} ...[/]")
        for row in importlib.import_module(f"benchmarks.{name}").run():
            met = row["target"] is None or row["value"] <= row["target"]
            target = "" if row["target"] is None else f"{row['target']:g} {row['unit']}"
            mark = "" if row["target"] is None else ("[green] met[/]" if met else "[yellow] missed[/]")
            right = "[green]right[/]" if row["ok"] else "[red]WRONG[/]"
            wrong += not row["ok"]
            table.add_row(
                row["name"], f"{row['value']:.3g} {row['unit']}", target + mark, row["baseline"] or "", right
            )
    console.print(table)
    return 1 if wrong else 0


def machine() -> str:
    """Processor, load and versions, for the title of the table."""
    model = next(
        (
            line.split(":")[1].strip()
            for line in Path("/proc/cpuinfo").read_text().splitlines()
            if line.startswith("model name")
        )
        if Path("/proc/cpuinfo").exists()
        else iter(()),
        platform.processor(),
    )
    load = ", ".join(f"{x:.1f}" for x in os.getloadavg())
    packages = ", ".join(
        f"{p} {version(p)}" for p in ("preshape", "numpy", "scipy", "embreex", "mujoco-core")
    )
    return f"{model}, {os.cpu_count()} cores, load {load}; Python {platform.python_version()}; {packages}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
