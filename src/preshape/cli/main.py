"""Entry point: the guards of signals and streams, exit codes, and errors printed as one sentence.

Exit codes: 0 an answer · 1 no answer · 2 bad input · 3 an error of files, disk or environment · 130
interrupted by Ctrl-C or SIGTERM.

This module imports little, so that the guard starts early.
"""

from __future__ import annotations

import os
import sys

from . import interrupts, streams
from .early import EXIT_INTERRUPTED, INTERRUPTED

TYPE_CHECKING = False
if TYPE_CHECKING:
    import click


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its code.

    Args:
        arguments: The arguments, for a call from another program, whose signals and streams stay as they are.
            ``None``: this process is the command line, and its arguments are those of the process.
    """
    if arguments is not None:
        sys.exit(run(arguments))
    given = sys.argv[1:]
    streams.prepare()
    interrupts.install("--json" in given)
    code = run(given, forward=True)
    interrupts.finished()
    sys.exit(code)


def run(arguments: list[str], *, forward: bool = False) -> int:
    """Run the command line and return the exit code. No traceback reaches the user.

    Args:
        arguments: The arguments.
        forward: Whether a running server may do the work.
    """
    import click

    from ..exceptions import Cancelled, PreshapeError

    as_json = "--json" in arguments
    try:
        code = None
        if forward:
            from .forward import forwarded

            code = forwarded(arguments)
        return _run(arguments) if code is None else code
    except (KeyboardInterrupt, click.Abort) as stop:
        return _report(str(stop) or INTERRUPTED, EXIT_INTERRUPTED, as_json)
    except Exception as error:
        if isinstance(error, Cancelled):
            return _report(str(error), error.exit_code, as_json)
        if interrupts.swallowed():  # the interrupt has made something else fail
            return _report(INTERRUPTED, EXIT_INTERRUPTED, as_json)
        if isinstance(error, PreshapeError):
            return _report(str(error), error.exit_code, as_json)
        if isinstance(error, click.UsageError):
            return _report(_usage(error), 2, as_json)
        if isinstance(error, OSError | MemoryError):
            reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
            if streams.output_failed():
                reason = f"standard output cannot be written: {reason}; what was learnt and written is kept"
                return _report(reason, 3, False)
            return _report(f"the environment failed: {reason}", 3, as_json)
        if os.environ.get("PRESHAPE_DEBUG"):
            raise
        text = f"{type(error).__name__}: {error}"
        return _report(f"internal fault ({text}); PRESHAPE_DEBUG=1 shows where, please report it", 3, as_json)


def _run(arguments: list[str]) -> int:
    import click

    from .commands import app

    try:
        code = app.main(args=arguments, prog_name="preshape", standalone_mode=False)
        sys.stdout.flush()
        return int(code or 0)
    except click.exceptions.Exit as stop:
        sys.stdout.flush()
        return int(stop.exit_code)
    except (SystemExit, BrokenPipeError) as stop:
        if isinstance(stop, SystemExit) and not stop.code:  # the shell has asked for completions
            sys.stdout.flush()
            return 0
        # The reader has closed the pipe, as `| head` does; click turns the error into SystemExit.
        streams.silence_output()
        return 0


def _usage(error: click.UsageError) -> str:
    text = " ".join(error.format_message().split()).rstrip(".")
    where = f"{error.ctx.command_path} --help" if error.ctx else "preshape --help"
    return f"{text[0].lower()}{text[1:]}; see {where}"


def _report(reason: str, code: int, as_json: bool) -> int:
    import click

    from .printing import emit, say

    told = False
    if as_json:
        try:
            emit({"status": "error", "reason": reason})
            told = True
        except OSError:  # standard output has failed, so the error goes to standard error
            streams.silence_output()
    if code == EXIT_INTERRUPTED:
        say(reason, err=True)
    elif not told:
        click.echo(click.style("error: ", fg="red", bold=True), err=True, nl=False)
        say(reason, err=True)
    return code


if __name__ == "__main__":
    main()
