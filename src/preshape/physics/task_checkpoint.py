"""Task results kept while a run goes on: the holding test's file of JSON lines, with task results in it."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from .checkpoint import Checkpoint
from .task_report import result_from_json, result_to_json
from .task_test import TaskResult

FORMAT = "preshape tasks 1"


class TaskCheckpoint(Checkpoint):
    """As :class:`preshape.physics.checkpoint.Checkpoint`, for results of the task test."""

    def __init__(self, path: str | Path, key: str) -> None:
        self.results: dict[int, TaskResult] = {}
        super().__init__(path, key)

    def __enter__(self) -> TaskCheckpoint:
        return self

    def add(self, results: Iterable[TaskResult]) -> None:  # type: ignore[override]
        """Append results; they are on the disk when this returns.

        Raises:
            EnvironmentFailure: the disk is full, or the file is gone.
        """
        try:
            for result in results:
                self.results[result.row] = result
                self._line(result_to_json(result))
        except OSError as error:
            raise self._failure(error) from error

    def _line(self, document: dict[str, Any]) -> None:
        super()._line({**document, "format": FORMAT} if "key" in document else document)

    def _read(self, key: str) -> int:
        """Take in what is there; how many bytes of it are whole lines."""
        self._file.seek(0)
        content = self._file.read()
        whole = content.rfind(b"\n") + 1
        lines = content[:whole].splitlines()
        if not lines:
            if content and not content.startswith(b'{"format": "preshape tasks'[: len(content)]):
                raise self._other("is not a file of task tests")
            return 0
        try:
            head = json.loads(lines[0])
            if head["format"] != FORMAT:
                raise self._other(f"has the format {head['format']!r}, not {FORMAT!r}")
            if head["key"] != key:
                raise self._other("belongs to a test of other instances, grasps, hand or settings")
            for line in lines[1:]:
                result = result_from_json(json.loads(line))
                self.results[result.row] = result
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise self._other("is not a file of task tests, or is damaged") from error
        return whole
