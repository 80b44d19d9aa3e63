"""What each index says of one grasp, from its planned contacts; the list of all indices compared.

Every index is computed from the contacts as planned, at the friction of the test; what the hand touches when
it squeezes is for physics to say.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..closure.holding import HOLD
from ..closure.search import ClosureSearch, Demand
from ..closure.settings import ClosureSettings
from ..hiis.fuzzy import FuzzySets, approaching_degrees
from ..hiis.planes import plane
from ..hiis.wrench import contact_wrenches, net_wrench, screw_measures
from ..kernels.closing.host import Closings, Fate
from ..kernels.margin.host import CONTACTS, margins
from ..metrics import (
    Contacts,
    ForceLimits,
    Measure,
    epsilon,
    force_closure,
    isotropy,
    push_residual,
    smallest_singular_value,
    task_margin,
    tdg_gap,
    volume,
)
from ..metrics.results import MetricStatus
from ..physics.task.motion import TaskMotion
from ..tasks import named_task
from ..types import GRAVITY, Array, ContactCoefficients, IntArray, value

UNKNOWN = MetricStatus.NOT_CONVERGED.name
"""The status of a number that could not be computed: the grasp is left out of that index' figures."""


@value
class Index:
    """One index.

    Attributes:
        name: as in the files.
        title: for people.
        sign: 1 where more is better, -1 where less is.
        of_task: whether it looks at the task.
        paper: whether it is one of the paper's.
    """

    name: str
    title: str
    sign: int = 1
    of_task: bool = False
    paper: bool = False


INDICES = (
    Index(name="closed", title="force closure, yes or no"),
    Index(name="closure_margin", title="force closure, margin"),
    Index(name="epsilon_l1", title="epsilon, L1"),
    Index(name="epsilon_linf", title="epsilon, L∞"),
    Index(name="volume", title="volume of the wrench space"),
    Index(name="isotropy", title="isotropy"),
    Index(name="smallest_singular_value", title="smallest singular value"),
    Index(name="gap", title="gap (TDG style)", sign=-1),
    Index(name="push_residual", title="push residual", sign=-1),
    Index(name="hold_margin", title="holding margin"),
    Index(name="task_margin", title="task margin", of_task=True),
    Index(name="planner", title="planner's score", of_task=True),
    Index(name="tfvadi", title="TFVADI of the task", of_task=True, paper=True),
    Index(name="tfvadi_six", title="TFVADI, worst of six directions", paper=True),
    Index(name="stability", title="stability", paper=True),
    Index(name="manipulability", title="manipulability", paper=True),
    Index(name="contacts", title="number of contacts"),
)
"""All indices, in the order of the tables."""

Number = tuple[float | None, str]
"""A number and the name of its status; ``None`` where the status leaves it undefined."""


class Grasp:
    """One grasp as the indices see it.

    Args:
        points: (n, 3) contacts, the thumb's first [m].
        normals_in: (n, 3) inward unit normals.
        centre: (3,) centre of mass, the reference of the metrics' torques [m].
        cog: (3,) centre of the bounding box, the reference of the paper's [m].
        length: ℓ [m].
        u: U of the hand [m].
        plane: approach plane, 1..12.
    """

    def __init__(
        self,
        points: Array,
        normals_in: Array,
        *,
        centre: Array,
        cog: Array,
        length: float,
        u: float,
        plane: int,
    ) -> None:
        self.points, self.normals_in = points, normals_in
        self.centre, self.cog, self.length = centre, cog, length
        self.u, self.plane = u, plane


def index_values(
    grasp: Grasp,
    q: Array,
    motion: TaskMotion,
    *,
    mass: float,
    press: float,
    settings: ClosureSettings,
    score: Callable[[Demand], float],
) -> dict[str, Number]:
    """Every index of one grasp in one task.

    Args:
        grasp: the grasp.
        q: (6,) the task's Q.
        motion: its way and load.
        mass: of the object [kg].
        press: sum of the normal forces [N].
        settings: friction of the test.
        score: what the planner gives the grasp for a demand, see :func:`planner_score`.
    """
    contacts = Contacts(
        positions=grasp.points,
        normals_in=grasp.normals_in,
        friction=settings.friction,
        torsion=settings.torsion,
        reference=grasp.centre,
        length=grasp.length,
    )
    closure = force_closure(contacts)
    wanted, weight = task_wrench(grasp, motion, mass)
    found: dict[str, Number] = {
        "closed": (float(closure.closed), closure.status.name),
        "closure_margin": (closure.margin, closure.status.name),
    }
    measures: tuple[tuple[str, Callable[[], Measure]], ...] = (
        ("epsilon_l1", lambda: epsilon(contacts, "L1")),
        ("epsilon_linf", lambda: epsilon(contacts, "Linf")),
        ("volume", lambda: volume(contacts)),
        ("isotropy", lambda: isotropy(contacts)),
        ("smallest_singular_value", lambda: smallest_singular_value(contacts)),
        ("gap", lambda: tdg_gap(contacts)),
        ("push_residual", lambda: push_residual(contacts)),
        ("task_margin", lambda: task_margin(contacts, wanted, ForceLimits(total=press), load=weight)),
    )
    for name, measure in measures:
        made = measure()
        found[name] = (made.number, made.status.name)
    load = wanted / (mass * GRAVITY)  # in weights, as the planner counts
    demand = Demand(direction=load, base=-weight / press, load=float(np.linalg.norm(load)))
    found["hold_margin"] = _hold_margin(grasp, settings)
    found["planner"] = (score(demand), MetricStatus.OK.name)
    found |= _of_the_paper(grasp, q)
    found["contacts"] = (float(len(grasp.points)), MetricStatus.OK.name)
    return found


def task_wrench(grasp: Grasp, motion: TaskMotion, mass: float) -> tuple[Array, Array]:
    """The wrench that the task asks of the hand, and the weight on the object, at the start.

    Returns:
        (6,) and (6,), force [N] and torque over ℓ [N] about the centre of mass.
    """
    load = motion.load(0.0, mass)
    torque = load[3:] + np.cross(motion.cog - grasp.centre, load[:3])
    wanted = -np.concatenate([load[:3], torque / grasp.length])
    return wanted, np.concatenate([motion.weight(mass), np.zeros(3)])


def _hold_margin(grasp: Grasp, settings: ClosureSettings) -> Number:
    """Strength against pushes and turns in the axes' directions, torques over ℓ, per unit of grip."""
    points, normals, counts = packed(grasp.points, grasp.normals_in)
    found = margins(
        points,
        normals,
        counts,
        wrenches=HOLD,
        friction=settings.friction,
        torsion=settings.torsion,
        length=grasp.length,
        reference=grasp.centre,
        threads=1,
    )
    return float(found.strength[0]), MetricStatus.OK.name


def packed(points: Array, normals_in: Array) -> tuple[Array, Array, IntArray]:
    """The contacts of one grasp as the kernels want them: (1, 8, 3), (1, 8, 3) and (1,)."""
    n = len(points)
    out = np.zeros((2, 1, CONTACTS, 3))
    out[0, 0, :n], out[1, 0, :n] = points, normals_in
    return out[0], out[1], np.array([n])


def planner_score(search: ClosureSearch, grasp: Grasp, demand: Demand) -> float:
    """What the planner ranks a candidate by: the smaller of its margins for task and holding."""
    points, normals, counts = packed(grasp.points, grasp.normals_in)
    fingers = np.zeros((1, CONTACTS))
    closings = Closings(
        fate=np.array([int(Fate.CLOSED)]),
        closing=fingers,
        sphere=fingers.astype(np.int64),
        points=points,
        normals_in=normals,
        counts=counts,
    )
    task, hold = search.strengths(closings, demand)
    # The class' own: a search that judges nothing may be asked too.
    return float(ClosureSearch.score(search, task, hold, demand)[0])


SIX = tuple(f"lift:{sign}{axis}" for axis in "xyz" for sign in "+-")
"""Plain motions along the axes: what the holding test asks for, in the paper's terms."""


def _of_the_paper(grasp: Grasp, q: Array) -> dict[str, Number]:
    """TFVADI, stability and manipulability as the analyser computes them."""
    p = plane(grasp.plane)
    arms = (grasp.points - grasp.cog) / grasp.u
    signs = -np.sign(np.round(arms @ p.transverse_axis, 9))
    signs[0] = -1.0
    wrenches = contact_wrenches(
        arms, grasp.normals_in, p.approach_axis, p.transverse_axis, signs, ContactCoefficients()
    )
    net = net_wrench(wrenches)
    sets = FuzzySets()
    asked = np.array([q, *(named_task(name).q for name in SIX)])
    matches = approaching_degrees(asked, net, sets).sum(axis=-1)
    stability, manipulability = screw_measures(wrenches)
    ok = MetricStatus.OK.name
    return {
        "tfvadi": (float(matches[0]), ok),
        "tfvadi_six": (float(matches[1:].min()), ok),
        "stability": (float(stability), ok),
        "manipulability": (float(manipulability), ok),
    }


def column(rows: Sequence[dict[str, Any]], index: Index) -> Array:
    """One index over grasps, more always better: nan where it could not be computed.

    A number that its status leaves undefined, as the margin of a grasp that does not even hold the weight, is
    worse than any number: minus infinity.
    """
    out = np.empty(len(rows))
    for k, row in enumerate(rows):
        number, status = row["indices"][index.name]
        undefined = np.nan if status == UNKNOWN else -np.inf
        out[k] = undefined if number is None else index.sign * number
    return out
