"""Figs. 17-18: the experiments on odd cases, which are preshapes that the hand cannot take (§4.7).

There are 20 runs of 25 experiments each, 500 in all [C]. Run k has the seed (seed, k), which determines every
random draw in these steps:

1. Make a system that knows only the cube; the initial weights of its network depend on the run's seed.
2. For each experiment, draw independently and uniformly: a library object; a scale out of 0.5, 0.6 … 1.4 with
   which no extent of the object exceeds 4U; a named task (17 families along or about six signed axes); a seed
   of the hand simulation.
3. Run the experiments one after the other on the same system. Any mode may answer. What mode 3 learns is kept
   until the end of the run. A deadlock is reset.
4. Give the answer's plane, thumb side and contacts to the hand simulation.

Refused objects, objects without a virtual grasp, deadlocks and requests for task correction give no preshape
and are counted separately.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..exceptions import ObjectError
from ..files import loads, write_json
from ..hiis.analyser import FingerRule
from ..hiis.decision import Settings, Status
from ..objects.library import load_library_object, names
from ..planning.hand_simulation import HandStatus, execute
from ..planning.session import Session
from ..tasks import Task, all_named_tasks
from ..types import LENGTH_UNIT
from .experiment import Progress
from .setup import Data, Setup

SCALES = tuple(round(0.5 + 0.1 * k, 1) for k in range(10))
RUNS, EACH = 20, 25
QUICK_RUNS, QUICK_EACH = 2, 10

REFUSED = "refused"


def measure(setup: Setup, part: Path, progress: Progress, finger_rule: FingerRule = "up_to") -> Data:
    """Run all experiments; after every run, the finished ones are stored in ``part``."""
    return setup.once(("odd cases", finger_rule), lambda: _measure(setup, part, progress, finger_rule))


def _measure(setup: Setup, part: Path, progress: Progress, finger_rule: FingerRule) -> Data:
    runs, each = (QUICK_RUNS, QUICK_EACH) if setup.quick else (RUNS, EACH)
    rows = _stored(part)
    largest = {name: float(load_library_object(name).extents.max()) for name in names()}
    limit = LENGTH_UNIT * setup.hand.u * (1 + 1e-9)
    fitting = {name: [s for s in SCALES if s * size <= limit] for name, size in largest.items()}
    objects = [name for name in names() if fitting[name]]
    tasks = all_named_tasks()
    for run in range(len(rows) // each, runs):
        rng = np.random.default_rng([setup.seed, run])
        settings = Settings(seed=setup.seed + run, finger_rule=finger_rule)
        system = setup.system(settings.seed, finger_rule)
        for i in range(each):
            number = run * each + i
            progress(number / (runs * each), f"odd cases: experiment {number + 1} of {runs * each}")
            name = objects[int(rng.integers(len(objects)))]
            scale = fitting[name][int(rng.integers(len(fitting[name])))]
            task = tasks[int(rng.integers(len(tasks)))]
            hand_seed = int(rng.integers(2**31))
            row = {"number": number + 1, "object": name, "scale": scale, "hand_seed": hand_seed}
            rows.append(row | _experiment(setup, system, settings, row, task))
        write_json(part, rows)
    return {"sessions": runs, "each": each, "seed": setup.seed, "rows": rows}


def _stored(part: Path) -> list[Data]:
    """The finished experiments of an interrupted measurement."""
    try:
        rows: list[Data] = loads(part.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return []
    return rows


def _experiment(setup: Setup, system: Session, settings: Settings, drawn: Data, task: Task) -> Data:
    """One task on one object at one scale: the system's answer, and the result of the hand simulation."""
    try:
        ready = setup.prepare(system, drawn["object"], task, scale=drawn["scale"], settings=settings)
    except ObjectError as error:
        return {"task": task.label, "outcome": REFUSED, "reason": str(error), "mode": None, "hand": None}
    decision = ready.controller.run(ready.element, task)
    ready.controller.reset()
    result: Data = {
        "task": task.label,
        "outcome": decision.status.value,
        "reason": decision.reason,
        "mode": decision.mode,
        "hand": None,
    }
    if decision.status is Status.ANSWER and decision.grasp is not None:
        grasp = decision.grasp
        hand = execute(setup.hand, ready.mesh, grasp, seed=drawn["hand_seed"])
        result |= {
            "steps": [[step.mode, step.outcome, step.reason] for step in decision.transitions],
            "plane": grasp.plane.index,
            "flip": grasp.flip,
            "value": grasp.approach_value,
            "fingers": grasp.fingers,
            "tfvadi": round(grasp.tfvadi, 6),
            "hand": hand.status.name,
            "hand_reason": hand.reason,
        }
    return result


def with_preshape(data: Data) -> list[Data]:
    """The experiments with an estimated preshape."""
    return [row for row in data["rows"] if row["hand"] is not None]


def is_odd(row: Data) -> bool:
    """Whether the fingers were retracted."""
    return row["hand"] not in (None, HandStatus.REACHED.name)
