"""Reading a memory and learning one more lesson, for memories of 20, 200, 2 000 and 20 000 lessons.

The lessons are those of library objects, stretched and with other tasks: real ones of so many objects would
take an hour to explore. CPU time, because these machines are noisy.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from preshape.hiis.estimator import predict
from preshape.hiis.fuzzy import FuzzySets
from preshape.hiis.learning import experiences_of, explore, learn, seed_cube, seed_experiences, training_set
from preshape.hiis.virtual_grasp import RayAnalyser
from preshape.memory import Memory
from preshape.memory.records import EXPERIENCE_COLUMNS, experience_from_row
from preshape.objects.library import entry, load_library_object, names
from preshape.tasks import parse_task
from preshape.types import Experience

from .common import layout, row

DECADES = (20, 200, 2_000, 20_000)
OBJECTS = 24
READ, TRAINED = 0.3, 5.0
"""Targets for the largest memory [s]."""


def run() -> list[dict[str, Any]]:
    everything = lessons(max(DECADES))
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for count in DECADES:
            rows += measured(Path(folder) / f"{count}.sqlite", everything[:count], count == max(DECADES))
    return rows


def measured(path: Path, known: list[Experience], largest: bool) -> list[dict[str, Any]]:
    """One row for reading, one for the training after one more lesson."""
    u, label = layout().u, f"{len(known)} lessons"
    with Memory.open(path) as memory:
        memory.add(known)
    with Memory.open(path, read_only=True) as memory:
        read, seconds = timed(memory.experiences, 3)
        _, singly = timed(lambda: row_by_row(memory), 1)
    weights, first = timed(lambda: learn(read, u, None), 1)
    newest = replace(read[-1], kind="task", task=read[-1].task + 0.3, plane=read[-1].plane % 12 + 1)
    again, next_time = timed(lambda: learn((*read, newest), u, weights), 1)
    x, y = training_set((*read, newest), u)
    right = np.abs(predict(again, x) - y).max(axis=1) < 0.5
    base = f"one row after the other {singly:.2g} s: ratio {singly / seconds:.1f}"
    found = f"{len(x)} samples, {right.mean():.2%} of the codes right; without earlier weights {first:.2g} s"
    return [
        row(f"reading {label}", seconds, "s", READ if largest else None, base, len(read) == len(known)),
        row(
            f"the training after one more than {label}",
            next_time,
            "s",
            TRAINED if largest else None,
            found,
            bool(right[-1]) and bool(right.mean() > 0.99),
        ),
    ]


def row_by_row(memory: Memory) -> list[Experience]:
    """The same experiences, each row checked and converted alone."""
    columns = ", ".join(EXPERIENCE_COLUMNS)
    cursor = memory._connection.execute(f"SELECT {columns} FROM experiences ORDER BY id")
    return [experience_from_row(tuple(cells)) for cells in cursor]


def timed(work: Callable[[], Any], repeats: int) -> tuple[Any, float]:
    """What the work returned, and its least CPU time [s]."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        result = work()
        times.append(time.process_time() - start)
    return result, min(times)


def lessons(count: int) -> list[Experience]:
    """The first lesson, then lessons of stretched library objects with other tasks."""
    sets, hand, rng = FuzzySets(), layout(), np.random.default_rng(1)
    found = seed_experiences(RayAnalyser(seed_cube(hand), hand), sets, enough=3.0)
    groups = []
    for name in names()[:OBJECTS]:
        element = RayAnalyser(load_library_object(name), hand)
        for task in entry(name).tasks[:2]:
            q = parse_task(task).q
            discovery = explore(element, q, sets, enough=3.0)
            if discovery is not None:
                groups.append(experiences_of(element, name, q, discovery, sets))
    number = 0
    while len(found) < count:
        stretch, other = np.exp(rng.uniform(-0.15, 0.15, 3)), rng.normal(0, 0.03, 6)
        for e in groups[number % len(groups)]:
            about = replace(e.attributes, extents=e.attributes.extents * stretch)
            name = f"{e.object_name}-{number}"
            found.append(replace(e, object_name=name, task=e.task + other, attributes=about))
        number += 1
    return found[:count]
