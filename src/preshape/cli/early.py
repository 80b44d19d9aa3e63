"""The first guard of the command line: Ctrl-C and SIGTERM while its modules are still being imported.

It is installed before anything else is imported, so this module imports only what Python has loaded already.
Python's own start, before it, answers a signal with a traceback or ends without a word.
"""

import _signal  # type: ignore[import-not-found]  # ``signal`` also imports ``enum``, which takes 5 ms
import os
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from types import FrameType

EXIT_INTERRUPTED = 130
INTERRUPTED = "interrupted; everything that was acknowledged is kept"


def install() -> None:
    """End this process by the one line and exit code 130 at a signal, until :mod:`.interrupts` takes over."""
    for number in (_signal.SIGINT, _signal.SIGTERM):
        if _signal.getsignal(number) != _signal.SIG_IGN:  # as nohup and shells ask for
            _signal.signal(number, _end)


def tell(out: int, err: int, as_json: bool) -> None:
    """Write the one line, and the error object.

    Args:
        out: Descriptor of standard output.
        err: Descriptor of standard error.
        as_json: Whether the error object is due on standard output.
    """
    if as_json:
        _write(out, f'{{\n  "status": "error",\n  "reason": "{INTERRUPTED}"\n}}\n')
    # On a terminal a bar may be half drawn, with the cursor hidden.
    _write(err, ("\r\x1b[K\x1b[?25h" if os.isatty(err) else "") + INTERRUPTED + "\n")


def _end(number: int, frame: "FrameType | None") -> None:
    tell(1, 2, "--json" in sys.argv[1:])
    os._exit(EXIT_INTERRUPTED)


def _write(number: int, text: str) -> None:
    try:  # noqa: SIM105  (contextlib is not loaded yet)
        os.write(number, text.encode())
    except OSError:
        pass
