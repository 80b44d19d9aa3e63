"""Command groups that import a command only when it is used, so that ``--help`` is fast."""

from __future__ import annotations

import difflib
import importlib
from typing import Any

import click

from ..exceptions import shown


class HelpfulGroup(click.Group):
    """A group that answers an unknown command with the nearest ones."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The command of the first argument.

        Raises:
            UsageError: There is no such command.
        """
        name, known = str(args[0]), self.list_commands(ctx)
        if name not in known and not name.startswith("-") and not ctx.resilient_parsing:
            near = difflib.get_close_matches(name.lower(), known, n=2)
            hint = f"did you mean {' or '.join(near)}? Known" if near else "known"
            ctx.fail(f"no such command {shown(name)}; {hint}: {', '.join(known)}")
        return super().resolve_command(ctx, args)


class LazyGroup(HelpfulGroup):
    """A group that stores only the names of its commands and imports them on use.

    Args:
        commands_of: For each command name, the module of ``preshape.cli`` that defines the command under this
            name, and the command's line in the list.
        heading: Heading of the list.
    """

    def __init__(
        self, *args: Any, commands_of: dict[str, tuple[str, str]], heading: str = "Commands", **options: Any
    ) -> None:
        super().__init__(*args, **options)
        self.commands_of, self.heading = commands_of, heading

    def list_commands(self, ctx: click.Context) -> list[str]:
        """The names in the order of the list."""
        return list(self.commands_of)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command."""
        if cmd_name not in self.commands_of:
            return None
        module = importlib.import_module(f"preshape.cli.{self.commands_of[cmd_name][0]}")
        command: click.Command = getattr(module, cmd_name)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list without importing the commands."""
        with formatter.section(self.heading):
            formatter.write_dl([(name, text) for name, (_, text) in self.commands_of.items()])
