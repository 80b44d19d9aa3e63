"""The grasp indices that are compared, and their values for one grasp.

Every index is computed from the planned contacts, with the friction of the physics test. Contacts that arise
only during the squeeze do not enter an index; only the physics tests include them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..closure.demand import HOLD, Demand
from ..closure.search import ClosureSearch
from ..closure.settings import ClosureSettings
from ..hiis.fuzzy import FuzzySets, approaching_degrees
from ..hiis.planes import plane
from ..hiis.wrench import grasp_wrenches, net_wrench, screw_measures
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

NOT_COMPUTED = MetricStatus.NOT_CONVERGED.name
"""Status of an index that could not be computed; the figures of that index then leave the grasp out."""


@value
class Index:
    """One index.

    Attributes:
        name: Name in the files.
        title: Name in reports.
        sign: 1 if larger is better, -1 if smaller is better.
        of_task: Whether the index depends on the task.
        paper: Whether the index is one of the paper's.
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
"""All indices, in the order of the report tables."""

Number = tuple[float | None, str]
"""Value of an index and name of its status; an undefined value is ``None``."""


@value
class IndexInput:
    """The data of one grasp from which the indices are computed; everything is in the mesh frame.

    Attributes:
        points: (n, 3) Contact points, the thumb's first [m].
        normals_in: (n, 3) Inward unit normals.
        centre: (3,) Centre of mass, the reference point of the torques in the metrics [m].
        cog: (3,) Centre of the bounding box, the reference point of the paper's wrenches [m].
        length: Length ℓ that torques are divided by [m].
        length_unit: The unit of length in the paper's wrenches, 4U of the hand [m].
        plane: Approach plane, 1..12.
    """

    points: Array
    normals_in: Array
    centre: Array
    cog: Array
    length: float
    length_unit: float
    plane: int


def index_values(
    grasp: IndexInput,
    q: Array,
    motion: TaskMotion,
    *,
    mass: float,
    press: float,
    settings: ClosureSettings,
    score: Callable[[Demand], float],
) -> dict[str, Number]:
    """Compute every index of one grasp for one task.

    Args:
        grasp: The contacts.
        q: (6,) Q of the task.
        motion: Motion and load of the task.
        mass: Mass of the object [kg].
        press: Sum of the normal forces [N].
        settings: Sliding and torsional friction.
        score: The planner's score of the grasp for a demand, see :func:`planner_score`.
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
        measured = measure()
        found[name] = (measured.number, measured.status.name)
    load = wanted / (mass * GRAVITY)  # the planner states loads in units of the object's weight
    demand = Demand(direction=load, base=-weight / press, load=float(np.linalg.norm(load)))
    found["hold_margin"] = _hold_margin(grasp, settings)
    found["planner"] = (score(demand), MetricStatus.OK.name)
    found |= _paper_indices(grasp, q)
    found["contacts"] = (float(len(grasp.points)), MetricStatus.OK.name)
    return found


def task_wrench(grasp: IndexInput, motion: TaskMotion, mass: float) -> tuple[Array, Array]:
    """The wrench that the hand must apply at the start of the task, and the weight of the object.

    Returns:
        (6,) and (6,): force [N] and torque divided by ℓ [N], about the centre of mass, mesh frame.
    """
    load = motion.load(0.0, mass)
    torque = load[3:] + np.cross(motion.cog - grasp.centre, load[:3])
    wanted = -np.concatenate([load[:3], torque / grasp.length])
    return wanted, np.concatenate([motion.weight(mass), np.zeros(3)])


def _hold_margin(grasp: IndexInput, settings: ClosureSettings) -> Number:
    """Load that one newton of squeeze balances along the weakest axis; torques are divided by ℓ."""
    points, normals, counts = packed_contacts(grasp.points, grasp.normals_in)
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


def packed_contacts(points: Array, normals_in: Array) -> tuple[Array, Array, IntArray]:
    """The contacts of one grasp in the layout of the kernels.

    Returns:
        Points (1, 8, 3) [m], inward normals (1, 8, 3) and number of contacts (1,).
    """
    n = len(points)
    out = np.zeros((2, 1, CONTACTS, 3))
    out[0, 0, :n], out[1, 0, :n] = points, normals_in
    return out[0], out[1], np.array([n])


def planner_score(search: ClosureSearch, grasp: IndexInput, demand: Demand) -> float:
    """The number by which the planner ranks a candidate: the smaller of its task and holding margins."""
    points, normals, counts = packed_contacts(grasp.points, grasp.normals_in)
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
    # This calls the method of the class, because the search of random grasps overrides `score`.
    return float(ClosureSearch.score(search, task, hold, demand)[0])


SIX_LIFTS = tuple(f"lift:{sign}{axis}" for axis in "xyz" for sign in "+-")
"""Tasks that correspond to the six pushes of the holding test: a translation along each signed axis."""


def _paper_indices(grasp: IndexInput, q: Array) -> dict[str, Number]:
    """TFVADI, stability and manipulability, computed as the analyser does."""
    wrenches = grasp_wrenches(
        grasp.points,
        grasp.normals_in,
        plane(grasp.plane),
        cog=grasp.cog,
        length_unit=grasp.length_unit,
        coefficients=ContactCoefficients(),
    )
    net = net_wrench(wrenches)
    sets = FuzzySets()
    asked = np.array([q, *(named_task(name).q for name in SIX_LIFTS)])
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
    """Values of one index over many grasps, negated if smaller is better, so that larger is always better.

    A value that could not be computed is nan. An undefined value is minus infinity, because such a grasp is
    worse than any other; an example is the margin of a grasp that cannot balance the weight.
    """
    out = np.empty(len(rows))
    for k, row in enumerate(rows):
        number, status = row["indices"][index.name]
        undefined = np.nan if status == NOT_COMPUTED else -np.inf
        out[k] = undefined if number is None else index.sign * number
    return out
