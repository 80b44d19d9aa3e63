"""The server's end of a browser's planner process: start, ask, cancel."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from typing import IO, Any

from ..exceptions import EnvironmentFailure

Reply = dict[str, Any]


class PlannerLink:
    """One planner process, which is restarted after a cancellation or a crash.

    Args:
        heard: Called with every reply, in order of arrival, on a thread of this link.
        program: Module that the process runs, and its arguments.
    """

    def __init__(
        self, heard: Callable[[Reply], None], program: Sequence[str] = ("preshape.app.worker",)
    ) -> None:
        self._heard, self._program = heard, program
        self._lock = threading.Lock()
        self._process: subprocess.Popen[str] | None = None
        self._listener: threading.Thread | None = None
        self._number = 0
        self._open = True
        self.busy = False

    def start(self) -> None:
        """Start the process if it is not running.

        Raises:
            EnvironmentFailure: The system refuses another process.
        """
        with self._lock:
            self._start()

    def ask(self, do: str, **content: Any) -> int:
        """Send a message; returns its number ``id``, or 0 if the planner is still working on another one.

        A planner that has ended replies with an error.

        Raises:
            EnvironmentFailure: The system refuses another process.
        """
        with self._lock:
            if self.busy or not self._open:
                return 0
            self._start()
            assert self._process is not None
            assert self._process.stdin is not None
            self._number += 1
            self.busy = True
            line = json.dumps({"do": do, "id": self._number, **content}) + "\n"
            # A pipe takes 64 KB at once. A planner that does not read must not keep anybody from cancelling.
            threading.Thread(target=_write, args=(self._process.stdin, line), daemon=True).start()
            return self._number

    def cancel(self) -> bool:
        """Stop the work and prepare for the next message; returns False if there was no work."""
        with self._lock:
            if not self.busy:
                return False
            self.busy = False
            self._number += 1  # so that late replies to the old message are ignored
            self._stop()
            self._start()
        return True

    def close(self) -> None:
        """Stop the process for good."""
        with self._lock:
            self._open = False
            self._stop()
            listener = self._listener
        if listener is not None and listener is not threading.current_thread():
            listener.join(timeout=1)

    def _start(self) -> None:
        if not self._open or (self._process is not None and self._process.poll() is None):
            return
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-m", *self._program],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                encoding="utf-8",
                start_new_session=True,  # only the server receives Ctrl-C
            )
        except OSError as error:
            raise EnvironmentFailure(f"no planner can be started: {error.strerror or error}") from error
        self._listener = threading.Thread(target=self._listen, args=(self._process,), daemon=True)
        self._listener.start()

    def _stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            _close_input(self._process)
            self._process = None

    def _listen(self, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        with process.stdout:
            for line in process.stdout:
                reply: Reply = json.loads(line)
                with self._lock:
                    if process is not self._process or reply.get("id") != self._number:
                        continue
                    if "done" in reply or "error" in reply:
                        self.busy = False
                self._heard(reply)
        with self._lock:
            died = process is self._process and self.busy and self._open
            number = self._number
            if died:
                self.busy = False
                _close_input(process)
                self._process = None
        process.wait()
        if died:
            words = "the planner stopped (too little memory?); it restarts, please try again"
            self._heard({"error": words, "id": number})


def _close_input(process: subprocess.Popen[str]) -> None:
    with contextlib.suppress(OSError):
        if process.stdin is not None:
            process.stdin.close()


def _write(pipe: IO[str], line: str) -> None:
    """Write a line to a planner; if the planner ends, the thread that listens to it says so."""
    with contextlib.suppress(OSError, ValueError):
        pipe.write(line)
        pipe.flush()
