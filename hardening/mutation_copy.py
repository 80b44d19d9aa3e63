"""A copy of the source for one test process at a time, with a mutant in it or without."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from importlib.util import cache_from_source
from pathlib import Path
from typing import Any

from .mutation_report import KILLED, SURVIVED, TIMEOUT

STOPPED = -1000
"""In place of the exit code of a process that took too long."""
MEMORY = 8 << 30
"""Data that a test process may allocate [byte]: a mutant may never stop asking."""

_START = (
    f"import resource, sys; resource.setrlimit(resource.RLIMIT_DATA, ({MEMORY}, {MEMORY})); "
    "import pytest; sys.exit(pytest.main(sys.argv[1:]))"
)


class StudyError(Exception):
    """The study cannot begin, because of what was asked or because the tests fail without a mutant."""


class Copy:
    """A copy of the source, in which one mutant after another is put in place and tested."""

    def __init__(self, root: Path, source: str, folder: Path) -> None:
        """Copy the folder ``source`` below ``root`` to ``folder``; the tests run in ``root``."""
        self.root, self.folder = root, folder
        self._process: subprocess.Popen[bytes] | None = None
        shutil.copytree(root / source, folder, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))

    def run(self, tests: Sequence[str], seconds: float, *, before: Sequence[str] = ()) -> tuple[int, str]:
        """Run test files until one fails.

        Args:
            tests: The test files.
            seconds: Time after which the process is stopped.
            before: Words between the interpreter and pytest's arguments.

        Returns:
            Exit code, or :data:`STOPPED` after that time, and the output.
        """
        words = [sys.executable, *(before or ("-c", _START)), *tests]
        words += ["-x", "-q", "--tb=line", "-p", "no:cacheprovider"]
        paths = [str(self.folder), os.environ.get("PYTHONPATH", "")]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
            environment.setdefault(name, "1")
        with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as log:
            self._process = process = subprocess.Popen(
                words, cwd=self.root, env=environment, stdin=subprocess.DEVNULL,
                stdout=log, stderr=subprocess.STDOUT, start_new_session=True,
            )  # fmt: skip
            try:
                code = process.wait(seconds)
            except subprocess.TimeoutExpired:
                code = STOPPED
            finally:
                self.stop()
                process.wait()
            log.seek(0)
            return code, log.read()

    def stop(self) -> None:
        """End the test process and all that it has started."""
        if self._process is not None:
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)

    def tested(self, module: str, text: str, tests: Sequence[str], seconds: float) -> dict[str, Any]:
        """Outcome of the tests with another text of a module.

        Args:
            module: Path of the module below the source.
            text: Its text with a mutant.
            tests: The test files.
            seconds: Time after which their process is stopped.
        """
        file = self.folder / module
        original = file.read_text(encoding="utf-8")
        begin = time.monotonic()
        try:
            self._write(file, text)
            code, output = self.run(tests, seconds)
        finally:
            self._write(file, original)
        if code == 4:  # pytest did not understand its arguments
            raise StudyError(output)
        outcome = {0: SURVIVED, STOPPED: TIMEOUT}.get(code, KILLED)
        by = re.search(r"^(?:FAILED|ERROR) (\S+)", output, re.M)
        spent = round(time.monotonic() - begin, 2)
        return {"outcome": outcome, "by": by[1] if by and outcome == KILLED else "", "seconds": spent}

    @staticmethod
    def _write(file: Path, text: str) -> None:
        file.write_text(text, encoding="utf-8")
        # Python compares time stamps in seconds and sizes, and two mutants may agree in both.
        Path(cache_from_source(str(file))).unlink(missing_ok=True)
