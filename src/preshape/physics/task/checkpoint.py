"""Task results kept while a run goes on: the holding test's file of JSON lines, with task results in it."""

from __future__ import annotations

from ..hold.checkpoint import ResultFile
from .protocol import TaskResult
from .report import result_from_json, result_to_json


class TaskCheckpoint(ResultFile[TaskResult]):
    """Results of the task test."""

    format = "preshape tasks 1"
    kind = "task tests"
    of = "instances, grasps, hand or settings"
    to_json = staticmethod(result_to_json)
    from_json = staticmethod(result_from_json)
