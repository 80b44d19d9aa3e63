"""Task results kept while a run goes on: the holding test's file of JSON lines, with task results in it."""

from __future__ import annotations

from .checkpoint import ResultFile
from .task_report import result_from_json, result_to_json
from .task_test import TaskResult


class TaskCheckpoint(ResultFile[TaskResult]):
    """Results of the task test."""

    format = "preshape tasks 1"
    kind = "task tests"
    of = "instances, grasps, hand or settings"
    to_json = staticmethod(result_to_json)
    from_json = staticmethod(result_from_json)
