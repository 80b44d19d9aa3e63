"""Presents a run of the task benchmark as tables and as a report."""

from __future__ import annotations

from ...report import Chapter, Report, Table
from ..hold.tables import ALL, rate_cells, short_name
from ..measures import rate_text
from .instances import TaskInstance
from .protocol import TaskProtocol, TaskResult
from .report import TaskReport, TaskScore

_COLUMNS = ("passed", "%", "95 %", "no answer", "lost", "other")


def task_tables(report: TaskReport) -> tuple[Table, Table]:
    """Scores by task family and by object, with a row for each and one for all."""
    last = (ALL, *_cells(report.score()))
    families = [(name, *_cells(score)) for name, score in report.families().items()]
    objects = [(short_name(name), *_cells(score)) for name, score in report.objects().items()]
    return (
        Table(caption="By task", columns=("task", *_COLUMNS), rows=(*families, last)),
        Table(caption="By object", columns=("object", *_COLUMNS), rows=(*objects, last)),
    )


def failure_table(failures: tuple[TaskResult, ...]) -> Table:
    """The instances that did not pass, with the reason of each."""
    rows = tuple((r.row, short_name(r.object_name), r.task, r.reason) for r in failures)
    return Table(caption="Failures", columns=("row", "object", "task", "reason"), rows=rows)


def task_settings_line(protocol: TaskProtocol, planner: str) -> str:
    """Planner and settings of the test in one line.

    >>> task_settings_line(TaskProtocol(), "shadow, rays")
    'shadow, rays; load 0.98 N on 0.1 kg, friction 0.6'
    """
    hold = protocol.hold
    force = protocol.acceleration * hold.mass * protocol.strength
    return f"{planner}; load {force:g} N on {hold.mass:g} kg, friction {hold.friction:g}"


def rate_line(score: TaskScore) -> str:
    """``5 of 20 passed, 25.0 % (95 %: 11.2 to 46.9 %)``."""
    rate = rate_text(score.rate, score.interval)
    return f"{score.passed} of {score.instances} passed, {rate}" if rate else "nothing was tested"


def task_report(report: TaskReport, protocol: TaskProtocol, planner: str, versions: str) -> Report:
    """The report: both tables, and every instance that did not pass.

    Args:
        report: The results.
        protocol: Settings of the tests.
        planner: Names of the hand and of the planner.
        versions: Sentence that names the versions of the programs.
    """
    return Report(
        title="Task benchmark",
        preface=(
            f"{task_settings_line(protocol, planner)}. {versions}",
            f"{rate_line(report.score())}. `docs/task-benchmark.md` says what is tested and counted.",
        ),
        chapters=(
            Chapter(title="Scores", blocks=task_tables(report)),
            Chapter(title="Failures", blocks=(failure_table(report.failures()),)),
        ),
    )


def object_file(instance: TaskInstance) -> str:
    """File name of the mesh of an instance's object, in the folder that accompanies a list of instances."""
    return f"{short_name(instance.object_name)}.obj"


def _cells(score: TaskScore) -> tuple[str, ...]:
    other = score.penetrating + score.unstable + score.invalid
    return (
        f"{score.passed}/{score.instances}",
        *rate_cells(score.rate, score.interval),
        str(score.no_answer),
        str(score.lost),
        str(other),
    )
