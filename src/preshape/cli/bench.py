"""``preshape bench``: measure grasps, planners and metrics in simulated physics."""

from __future__ import annotations

import click

from .lazy import LazyGroup

_BENCHES = {
    "holds": ("bench_holds", "Put grasps to the holding test: pushes from six sides, or harder."),
    "planner": ("bench_planner", "Plan objects and put the answers to the holding test."),
    "hands": ("bench_hands", "Test the same plans on our models of hands and on the published ones."),
    "pick": ("bench_pick", "Plan objects on a table and pick them up in physics."),
    "critic": ("bench_critic", "Measure how probably grips of every margin are picked up."),
    "tasks": ("bench_tasks", "Put a planner to the task test, the open benchmark."),
    "clouds": ("bench_clouds", "Plan on partial views and test on the whole objects."),
    "learning": ("bench_learning", "Measure how much a real hand gains from its memory."),
    "indices": ("bench_indices", "Measure how well each grasp metric predicts success."),
}  # fmt: skip


@click.group(
    cls=LazyGroup,
    commands_of=_BENCHES,
    heading="Benches",
    epilog="Example: preshape bench holds plan.json --probes all",
)
def bench() -> None:
    """Measure grasps, planners and metrics in simulated physics."""
