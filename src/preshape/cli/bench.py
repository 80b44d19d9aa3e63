"""``preshape bench``: measure grasps, planners and metrics in simulation."""

from __future__ import annotations

import importlib

import click

_BENCHES = {
    "holds": ("bench_holds", "Put grasps to the holding test: six directions and harder."),
    "planner": ("bench_planner", "Plan objects and put the answers to the holding test."),
    "tasks": ("bench_tasks", "Put a planner to the task test: the open benchmark."),
    "indices": ("bench_indices", "Measure how well each grasp metric predicts success."),
}  # fmt: skip


class _Lazy(click.Group):
    """Benches that are imported when they are used."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_BENCHES)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _BENCHES:
            return None
        module = importlib.import_module(f"preshape.cli.{_BENCHES[cmd_name][0]}")
        command: click.Command = getattr(module, cmd_name)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Benches"):
            formatter.write_dl([(name, text) for name, (_, text) in _BENCHES.items()])


@click.group(cls=_Lazy, epilog="Example: preshape bench holds plan.json --probes all")
def bench() -> None:
    """Measure grasps, planners and metrics in simulated physics."""
