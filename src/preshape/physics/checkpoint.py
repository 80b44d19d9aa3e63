"""Results kept while a run goes on: JSON lines, so that a run that was stopped goes on where it was.

The first line says what is tested, by a hash of hand, grasps, objects and protocol; each other line is one
result. A line that a crash cut short is dropped.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import IO, Any

from ..exceptions import EnvironmentFailure, InputError
from .report import result_from_json, result_to_json
from .six_directions import HoldResult

FORMAT = "preshape holds 1"


class Checkpoint:
    """An open file of results; a context manager.

    Args:
        path: the file; made where it is missing.
        key: hash of what is tested.

    Raises:
        InputError: the file is none of ours, or belongs to another test.
        EnvironmentFailure: it cannot be read or written.
    """

    def __init__(self, path: str | Path, key: str) -> None:
        self.path = Path(path)
        self.done: dict[int, HoldResult] = {}
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file: IO[bytes] = self.path.open("a+b")
        except OSError as error:
            raise self._failure(error) from error
        try:
            if not _locked(self._file):
                raise InputError(f"{self.path} is in use by another run; wait for it, or choose another file")
            whole = self._read(key)
            self._file.truncate(whole)
            if not whole:
                self._line({"format": FORMAT, "key": key})
        except OSError as error:
            self._file.close()
            raise self._failure(error) from error
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> Checkpoint:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def add(self, results: Iterable[HoldResult]) -> None:
        """Append results; they are on the disk when this returns.

        Raises:
            EnvironmentFailure: the disk is full, or the file is gone.
        """
        try:
            for result in results:
                self.done[result.row] = result
                self._line(result_to_json(result))
        except OSError as error:
            raise self._failure(error) from error

    def _line(self, document: dict[str, Any]) -> None:
        self._file.write(json.dumps(document, allow_nan=False).encode() + b"\n")
        self._file.flush()
        os.fsync(self._file.fileno())

    def _read(self, key: str) -> int:
        """Take in what is there; how many bytes of it are whole lines."""
        self._file.seek(0)
        content = self._file.read()
        whole = content.rfind(b"\n") + 1
        lines = content[:whole].splitlines()
        if not lines:
            if content and not content.startswith(b'{"format": "preshape holds'[: len(content)]):
                raise self._other("is not a file of holding tests")
            return 0
        try:
            head = json.loads(lines[0])
            if head["format"] != FORMAT:
                raise self._other(f"has the format {head['format']!r}, not {FORMAT!r}")
            if head["key"] != key:
                raise self._other("belongs to a test of other grasps, objects, hand or settings")
            for line in lines[1:]:
                result = result_from_json(json.loads(line))
                self.done[result.row] = result
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise self._other("is not a file of holding tests, or is damaged") from error
        return whole

    def _other(self, what: str) -> InputError:
        return InputError(f"{self.path} {what}; choose another file, or remove it to begin anew")

    def _failure(self, error: OSError) -> EnvironmentFailure:
        return EnvironmentFailure(f"cannot keep results in {self.path}: {error.strerror}")


def _locked(file: IO[bytes]) -> bool:
    """Take the file for this process; it is free again when it is closed, however the process ends."""
    try:
        import fcntl
    except ImportError:  # a system without such locks
        return True
    try:
        fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without them
        return True
    return True
