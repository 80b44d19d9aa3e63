"""Task results kept while a run goes on: the holding test's file of JSON lines, with task results in it."""

from __future__ import annotations

from typing import Any

from .checkpoint import ResultFile
from .task_report import result_from_json, result_to_json
from .task_test import TaskResult


class TaskCheckpoint(ResultFile[TaskResult]):
    """Results of the task test."""

    format = "preshape tasks 1"
    kind = "task tests"
    of = "instances, grasps, hand or settings"

    def to_json(self, result: TaskResult) -> dict[str, Any]:
        """A result as plain JSON values."""
        return result_to_json(result)

    def from_json(self, document: dict[str, Any]) -> TaskResult:
        """The result again."""
        return result_from_json(document)
