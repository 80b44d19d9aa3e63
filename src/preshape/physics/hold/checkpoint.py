"""Files of results as JSON lines, from which a stopped run continues.

The first line holds a hash of hand, grasps, objects and protocol. Every other line is one result. A last line
that a crash has left incomplete is dropped.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import IO, Any, Generic, Protocol, Self, TypeVar

from ...exceptions import EnvironmentFailure, InputError
from ...files import loads, locked
from .report import result_from_json, result_to_json
from .six_directions import HoldResult

Progress = Callable[[int, int], None]
"""Called with the number of finished grasps or instances, and the total number."""


class _Row(Protocol):
    @property
    def row(self) -> int:
        """Row of the grasp or instance in its run."""


R = TypeVar("R", bound=_Row)


class ResultFile(Generic[R]):
    """An open file of results, used as a context manager; a subclass sets the kind of result.

    Attributes:
        format: Format name in the first line; its last word is the version.
        kind: Content of such a file, for messages.
        subject: What two runs must have in common to share a file, for messages.
        to_json: Turns a result into plain JSON values.
        from_json: Inverse of ``to_json``.
        done: Results by row.

    Args:
        path: The file; created if it does not exist.
        key: Hash of everything that the results depend on.

    Raises:
        InputError: The file has another format, belongs to another test, or is in use.
        EnvironmentFailure: The file cannot be read or written.
    """

    format: str
    kind: str
    subject: str
    to_json: Callable[[R], dict[str, Any]]
    from_json: Callable[[dict[str, Any]], R]

    def __init__(self, path: str | Path, key: str) -> None:
        self.path = Path(path)
        self.done: dict[int, R] = {}
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file: IO[bytes] = self.path.open("a+b")
        except OSError as error:
            raise self._failure(error) from error
        try:
            if not locked(self._file):
                raise InputError(f"{self.path} is in use by another run; wait for it, or choose another file")
            whole = self._read(key)
            self._file.truncate(whole)
            if not whole:
                self._line({"format": self.format, "key": key})
        except OSError as error:
            self._file.close()
            raise self._failure(error) from error
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def add(self, results: Iterable[R]) -> None:
        """Append results; they are on the disk when this returns.

        Raises:
            EnvironmentFailure: The file cannot be written.
        """
        try:
            for result in results:
                self.done[result.row] = result
                self._line(self.to_json(result))
        except OSError as error:
            raise self._failure(error) from error

    def _line(self, document: dict[str, Any]) -> None:
        self._file.write(json.dumps(document, allow_nan=False).encode() + b"\n")
        self._file.flush()
        os.fsync(self._file.fileno())

    def _read(self, key: str) -> int:
        """Read the results into ``done``; returns the number of bytes in complete lines."""
        self._file.seek(0)
        content = self._file.read()
        whole = content.rfind(b"\n") + 1
        lines = content[:whole].splitlines()
        if not lines:
            head = f'{{"format": "{self.format.rpartition(" ")[0]}'.encode()
            if content and not content.startswith(head[: len(content)]):
                raise self._unusable(f"is not a file of {self.kind}")
            return 0
        try:
            first = loads(lines[0])
            if first["format"] != self.format:
                raise self._unusable(f"has the format {first['format']!r}, expected {self.format!r}")
            if first["key"] != key:
                raise self._unusable(f"belongs to a test of other {self.subject}")
            for line in lines[1:]:
                result = self.from_json(loads(line))
                self.done[result.row] = result
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise self._unusable(f"is not a file of {self.kind}, or is damaged") from error
        return whole

    def _unusable(self, reason: str) -> InputError:
        return InputError(f"{self.path} {reason}; choose another file, or remove this one to start again")

    def _failure(self, error: OSError) -> EnvironmentFailure:
        return EnvironmentFailure(f"cannot save results in {self.path}: {error.strerror}")


def result_taker(
    done: dict[int, R], total: int, file: ResultFile[R] | None, progress: Progress | None
) -> Callable[[list[R]], None]:
    """Make a function that adds finished results to ``done`` and to the file, and reports progress.

    Args:
        done: Results so far; their progress is reported immediately.
        total: Total number of results.
        file: File in which results are saved; ``None`` for none.
        progress: Called after each call; ``None`` for none.
    """

    def take(results: list[R]) -> None:
        done.update({result.row: result for result in results})
        if file is not None:
            file.add(results)
        if progress is not None:
            progress(len(done), total)

    take([])
    return take


class Checkpoint(ResultFile[HoldResult]):
    """Results of the holding test."""

    format = "preshape holds 1"
    kind = "holding tests"
    subject = "grasps, objects, hand or settings"
    to_json = staticmethod(result_to_json)
    from_json = staticmethod(result_from_json)
