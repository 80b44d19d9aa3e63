"""A run of the task benchmark as tables, and as a page of Markdown for people."""

from __future__ import annotations

from ..hold.tables import ALL, TextTable, markdown_table, short_name
from .instances import TaskInstance
from .protocol import TaskProtocol, TaskResult
from .report import TaskReport, TaskScore

_COLUMNS = ("passed", "%", "95 %", "no answer", "lost", "other")


def task_tables(report: TaskReport) -> tuple[TextTable, TextTable]:
    """Score a task family and an object: a line for each and one for all."""
    last = (ALL, *_cells(report.score()))
    families = [(name, *_cells(score)) for name, score in report.families().items()]
    objects = [(short_name(name), *_cells(score)) for name, score in report.objects().items()]
    return (
        TextTable(caption="By task", columns=("task", *_COLUMNS), rows=(*families, last)),
        TextTable(caption="By object", columns=("object", *_COLUMNS), rows=(*objects, last)),
    )


def failure_table(failures: tuple[TaskResult, ...]) -> TextTable:
    """What did not pass, and why."""
    rows = tuple((str(r.row), short_name(r.object_name), r.task, r.reason) for r in failures)
    return TextTable(caption="Failures", columns=("row", "object", "task", "why"), rows=rows)


def task_settings_line(protocol: TaskProtocol, who: str) -> str:
    """The test in one line.

    >>> task_settings_line(TaskProtocol(), "shadow, rays")
    'shadow, rays; load 0.98 N on 0.1 kg, friction 0.6'
    """
    hold = protocol.hold
    force = protocol.acceleration * hold.mass * protocol.strength
    return f"{who}; load {force:g} N on {hold.mass:g} kg, friction {hold.friction:g}"


def rate_line(score: TaskScore) -> str:
    """``5 of 20 passed, 25.0 % (95 %: 11.2 to 46.9 %)``."""
    if score.rate is None or score.interval is None:
        return "nothing was tested"
    low, high = (100 * x for x in score.interval)
    counts = f"{score.passed} of {score.instances} passed"
    return f"{counts}, {100 * score.rate:.1f} % (95 %: {low:.1f} to {high:.1f} %)"


def task_markdown(report: TaskReport, protocol: TaskProtocol, who: str, preface: str) -> str:
    """The page: both tables, and every instance that did not pass."""
    page = ["# Task benchmark", "", f"{task_settings_line(protocol, who)}. {preface}", ""]
    page += [f"{rate_line(report.score())}. What is tested and counted: `docs/task-benchmark.md`.", ""]
    for table in (*task_tables(report), failure_table(report.failures())):
        page += [f"## {table.caption}", "", *markdown_table(table), ""]
    return "\n".join(page)


def object_file(instance: TaskInstance) -> str:
    """Name of the mesh file of an instance's object beside a list of instances."""
    return f"{short_name(instance.object_name)}.obj"


def _cells(score: TaskScore) -> tuple[str, ...]:
    percent = "–" if score.rate is None else f"{100 * score.rate:.1f}"
    interval = (
        "–" if score.interval is None else f"{100 * score.interval[0]:.0f}-{100 * score.interval[1]:.0f}"
    )
    other = score.penetrating + score.unstable + score.invalid
    return (
        f"{score.passed}/{score.instances}",
        percent,
        interval,
        str(score.no_answer),
        str(score.lost),
        str(other),
    )
