"""Results kept while a run goes on: JSON lines, so that a run that was stopped goes on where it was.

The first line says what is tested, by a hash of hand, grasps, objects and protocol; each other line is one
result. A line that a crash cut short is dropped.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import IO, Any, Generic, Protocol, Self, TypeVar

from ...exceptions import EnvironmentFailure, InputError
from ...files import locked
from .report import result_from_json, result_to_json
from .six_directions import HoldResult


class _Row(Protocol):
    @property
    def row(self) -> int:
        """Of the grasp or instance in its run."""


R = TypeVar("R", bound=_Row)


class ResultFile(Generic[R]):
    """An open file of one kind of result; a context manager. A subclass says which kind.

    Attributes:
        format: the first line's mark; its last word is the version.
        kind: what such a file holds, for people.
        of: what two runs must share to share a file.
        to_json: a result as plain JSON values.
        from_json: the result again.
        done: results by row.

    Args:
        path: the file; made where it is missing.
        key: hash of what is tested.

    Raises:
        InputError: the file is none of ours, or belongs to another test.
        EnvironmentFailure: it cannot be read or written.
    """

    format: str
    kind: str
    of: str
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
            EnvironmentFailure: the disk is full, or the file is gone.
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
        """Take in what is there; how many bytes of it are whole lines."""
        self._file.seek(0)
        content = self._file.read()
        whole = content.rfind(b"\n") + 1
        lines = content[:whole].splitlines()
        if not lines:
            head = f'{{"format": "{self.format.rpartition(" ")[0]}'.encode()
            if content and not content.startswith(head[: len(content)]):
                raise self._other(f"is not a file of {self.kind}")
            return 0
        try:
            first = json.loads(lines[0])
            if first["format"] != self.format:
                raise self._other(f"has the format {first['format']!r}, not {self.format!r}")
            if first["key"] != key:
                raise self._other(f"belongs to a test of other {self.of}")
            for line in lines[1:]:
                result = self.from_json(json.loads(line))
                self.done[result.row] = result
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise self._other(f"is not a file of {self.kind}, or is damaged") from error
        return whole

    def _other(self, what: str) -> InputError:
        return InputError(f"{self.path} {what}; choose another file, or remove it to begin anew")

    def _failure(self, error: OSError) -> EnvironmentFailure:
        return EnvironmentFailure(f"cannot keep results in {self.path}: {error.strerror}")


class Checkpoint(ResultFile[HoldResult]):
    """Results of the holding test."""

    format = "preshape holds 1"
    kind = "holding tests"
    of = "grasps, objects, hand or settings"
    to_json = staticmethod(result_to_json)
    from_json = staticmethod(result_from_json)
