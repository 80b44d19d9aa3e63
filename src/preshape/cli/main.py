"""Entry point: the commands, the exit codes, and errors printed as one sentence.

Exit codes: 0 an answer · 1 no answer · 2 bad input · 3 an error of files, disk or environment · 130
interrupted.
"""

from __future__ import annotations

import os
import sys

import click

from .._version import __version__
from ..exceptions import PreshapeError
from .lazy import LazyGroup
from .printing import emit

_COMMANDS = {
    "plan": ("plan", "Plan a preshape for an object and a task."),
    "learn": ("learn", "Teach objects to the memory, one after the other."),
    "objects": ("lists", "List the built-in objects."),
    "tasks": ("lists", "List the named tasks and what they mean."),
    "hands": ("hands", "List the hands, or check one of your own."),
    "memory": ("memory", "Show, export, import or reset what was learnt."),
    "view": ("view", "Show a plan in the browser and change it."),
    "simulate": ("simulate", "Execute a plan in simulated physics and show what happens."),
    "dataset": ("dataset", "Write many grasps as Parquet, on all cores or on a cluster."),
    "bench": ("bench", "Measure grasps, planners and metrics in simulated physics."),
    "export": ("export", "Write a plan for ROS and MoveIt, MuJoCo, or as arrays."),
    "reproduce": ("reproduce", "Reproduce the paper's tables and figures as a report."),
}  # fmt: skip

EXIT_INTERRUPTED = 130


@click.group(
    cls=LazyGroup,
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


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its code."""
    given = sys.argv[1:] if arguments is None else arguments
    sys.exit(run(given))


def run(arguments: list[str]) -> int:
    """Run the command line and return the exit code. No traceback reaches the user."""
    as_json = "--json" in arguments
    try:
        code = _run(arguments)
    except PreshapeError as error:
        return _report(str(error), error.exit_code, as_json)
    except click.UsageError as error:
        return _report(_usage(error), 2, as_json)
    except (KeyboardInterrupt, click.Abort):
        click.echo("interrupted; everything that was acknowledged is kept", err=True)
        return EXIT_INTERRUPTED
    except (OSError, MemoryError) as error:
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        return _report(f"the environment failed: {reason}", 3, as_json)
    except Exception as error:
        if os.environ.get("PRESHAPE_DEBUG"):
            raise
        text = f"{type(error).__name__}: {error}"
        return _report(f"internal fault ({text}); PRESHAPE_DEBUG=1 shows where, please report it", 3, as_json)
    return code


def _run(arguments: list[str]) -> int:
    try:
        code = app.main(args=arguments, prog_name="preshape", standalone_mode=False)
        sys.stdout.flush()
        return int(code or 0)
    except click.exceptions.Exit as stop:
        return int(stop.exit_code)
    except (SystemExit, BrokenPipeError):
        # The reader has closed the pipe, as `| head` does; click turns the error into SystemExit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _usage(error: click.UsageError) -> str:
    text = error.format_message().rstrip(".")
    where = f"{error.ctx.command_path} --help" if error.ctx else "preshape --help"
    return f"{text[0].lower()}{text[1:]}; see {where}"


def _report(reason: str, code: int, as_json: bool) -> int:
    if as_json:
        try:
            emit({"status": "error", "reason": reason})
            sys.stdout.flush()
            return code
        except OSError:  # standard output has failed, so the error goes to standard error
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    click.echo(click.style("error: ", fg="red", bold=True) + reason, err=True)
    return code


if __name__ == "__main__":
    main()
