"""Figs. 17-18: odd cases, preshapes that the hand cannot take (§4.7). The experiments and their sampler.

Five hundred experiments in twenty sessions of twenty-five [C]. Session k belongs to the seed (seed, k), from
which everything below follows:

* a system that knows the cube only, its network trained from fresh weights of that session's seed;
* for each experiment, independently: an object of the library, uniformly; a scale, uniformly among those of
  0.5, 0.6 … 1.4 with which no extent of the object is over 4U; a task, uniformly among all named tasks
  (17 families along or about six signed axes); a seed for the hand simulation;
* the experiments are run one after the other. The system answers by whatever mode; what mode 3 learns stays
  until the end of the session. A deadlock is reset.

An answer's plane, thumb side and contacts go to the hand simulation. Refused objects, objects without a
virtual grasp, deadlocks and requests for task correction are counted separately: no preshape was estimated
there.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ..exceptions import ObjectError
from ..files import write_json
from ..hiis.controller import Controller
from ..hiis.decision import Settings, Status
from ..hiis.virtual_grasp import MAX_EXTENT
from ..objects.library import load_library_object, names
from ..planning.hand_simulation import HandStatus, execute
from ..tasks import all_named_tasks
from .bench import Bench, Data
from .values import Progress

SCALES = tuple(round(0.5 + 0.1 * k, 1) for k in range(10))
SESSIONS, EACH = 20, 25
QUICK_SESSIONS, QUICK_EACH = 2, 10

REFUSED = "refused"


def measure(bench: Bench, part: Path, progress: Progress) -> Data:
    """Run all experiments; what is done is in ``part`` after every session."""
    sessions, each = (QUICK_SESSIONS, QUICK_EACH) if bench.quick else (SESSIONS, EACH)
    rows: list[Data] = _begun(part)
    largest = {name: float(load_library_object(name).extents.max()) for name in names()}
    limit = MAX_EXTENT * bench.layout.u * (1 + 1e-9)
    fitting = {name: [s for s in SCALES if s * size <= limit] for name, size in largest.items()}
    objects = [name for name in names() if fitting[name]]
    for session in range(len(rows) // each, sessions):
        rng = np.random.default_rng([bench.seed, session])
        controller = bench.controller(Settings(seed=bench.seed + session))
        for i in range(each):
            n = session * each + i
            progress(n / (sessions * each), f"odd cases: experiment {n + 1} of {sessions * each}")
            name = objects[int(rng.integers(len(objects)))]
            scale = fitting[name][int(rng.integers(len(fitting[name])))]
            task = int(rng.integers(len(all_named_tasks())))
            hand_seed = int(rng.integers(2**31))
            row = {"number": n + 1, "object": name, "scale": scale, "hand_seed": hand_seed}
            rows.append(row | _experiment(bench, controller, row, task))
        write_json(part, rows)
    return {"sessions": sessions, "each": each, "seed": bench.seed, "rows": rows}


def _begun(part: Path) -> list[Data]:
    """The experiments of an interrupted run."""
    try:
        begun: list[Data] = json.loads(part.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return []
    return begun


def _experiment(bench: Bench, controller: Controller, drawn: Data, task_index: int) -> Data:
    """One object, one scale, one task: what the system says and what the hand makes of it."""
    task = all_named_tasks()[task_index]
    mesh = load_library_object(drawn["object"], scale=drawn["scale"])
    try:
        element = controller.prepare(mesh)
    except ObjectError as error:
        return {"task": task.label, "outcome": REFUSED, "reason": str(error), "mode": None, "hand": None}
    decision = controller.run(element, task)
    controller.reset()
    result: dict[str, Any] = {
        "task": task.label,
        "outcome": decision.status.value,
        "reason": decision.reason,
        "mode": decision.mode,
        "hand": None,
    }
    if decision.status is Status.ANSWER and decision.grasp is not None:
        grasp = decision.grasp
        hand = execute(bench.hand, mesh, grasp, seed=drawn["hand_seed"])
        result |= {
            "steps": [[t.mode, t.outcome, t.reason] for t in decision.transitions],
            "plane": grasp.plane.index,
            "flip": grasp.flip,
            "value": grasp.approach_value,
            "fingers": grasp.fingers,
            "tfvadi": round(grasp.tfvadi, 6),
            "hand": hand.status.name,
            "hand_reason": hand.reason,
        }
    return result


def preshapes(data: Data) -> list[Data]:
    """The experiments with an estimated preshape."""
    return [row for row in data["rows"] if row["hand"] is not None]


def is_odd(row: Data) -> bool:
    """Whether the fingers were retracted."""
    return row["hand"] not in (None, HandStatus.REACHED.name)
