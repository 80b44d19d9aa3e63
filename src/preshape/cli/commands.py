"""The group of all commands."""

from __future__ import annotations

import click

from .._version import __version__
from .lazy import LazyGroup

_COMMANDS = {
    "plan": ("plan", "Plan a preshape for an object and a task."),
    "learn": ("learn", "Teach objects to the memory, one after the other."),
    "objects": ("lists", "List the built-in objects."),
    "tasks": ("lists", "List the named tasks and what they mean."),
    "hands": ("hands", "List the hands, or check one of your own."),
    "memory": ("memory", "Show, export, import or reset what was learnt."),
    "view": ("view", "Show a plan in the browser and change it."),
    "serve": ("serve", "Answer requests over HTTP, for robots and other programs."),
    "simulate": ("simulate", "Execute a plan in simulated physics and show what happens."),
    "dataset": ("dataset", "Write many grasps as Parquet, on all cores or on a cluster."),
    "bench": ("bench", "Measure grasps, planners and metrics in simulated physics."),
    "export": ("export", "Write a plan for ROS and MoveIt, MuJoCo, or as arrays."),
    "reproduce": ("reproduce", "Reproduce the paper's tables and figures as a report."),
}  # fmt: skip


class CommandsWithSettings(LazyGroup):
    """The group of all commands, whose defaults may be those of the user's file of settings."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The command of the first argument, after the settings have been read.

        Its help needs none, and a file with a fault must not keep anybody from reading it.
        """
        if not ctx.resilient_parsing and not {"-h", "--help"} & set(args):
            from .settings_file import apply_settings

            apply_settings(ctx, args[0])
        return super().resolve_command(ctx, args)


@click.group(
    cls=CommandsWithSettings,
    commands_of=_COMMANDS,
    no_args_is_help=False,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100, "show_default": True},
    epilog="Example: preshape plan mug --task pour",
)
@click.version_option(__version__, prog_name="preshape")
@click.pass_context
def app(context: click.Context) -> None:
    """Task-oriented grasp planning for multifingered robot hands.

    For an object and a task it plans the approach plane, the wrist pose, the preshape, the contacts and the
    squeeze, states the reasons, and learns from the objects that it plans for.
    """
    if context.invoked_subcommand is None:
        click.echo(context.get_help(), err=True)
        context.exit(2)
