"""One question to the planner as one value: object, scene, task, hand, search, critic and memory.

Command line, Python, browser, dataset and benches all make a :class:`PlanRequest` and give it to one
:class:`~preshape.planning.session.Session`. plan.json contains the whole request, so a plan can be shown,
simulated, exported and repeated without any further input.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..closure.settings import ClosureSettings
from ..exceptions import InputError
from ..hands.hand import Hand
from ..hands.load import source_of
from ..hiis.critic import Thresholds
from ..hiis.decision import Settings
from ..hiis.fuzzy import FuzzySets
from ..hiis.planes import allowed_planes
from ..kernels.closing.host import Obstacles
from ..objects.mass import object_mass
from ..objects.mesh import TriangleMesh
from ..tasks import Task, parse_task, task_from_numbers
from ..tasks.task import from_json as task_from_json
from ..tasks.task import to_json as task_to_json
from ..types import FRICTION, Array, ContactCoefficients, freeze, frozen_array, value

SCHEMA = 2
"""Version of plan.json. Version 1 is a plan without the key ``schema``; it does not contain its request."""
ANALYSERS = ("rays", "closure")
RAY_HAND = "utah_mit"
"""The paper's hand. Its default analyser is the paper's; for every other hand the default is closure."""
VERIFIED = 6
"""Number of answers that are tested in physics; ``count`` if that is larger."""
ON_CLOUDS = 8
"""Number of answers computed on a point cloud; those with contacts on seen surface are preferred."""
AUTO = "auto"
"""Value of ``table`` that means a table at the object's lowest point."""
_SEARCH = (
    "torsion", "friction_share", "press_least", "press_most", "safety", "hold", "at_aim", "on_plane",
    "everywhere", "persistence", "elite", "children", "rounds", "finished", "device", "threads",
)  # fmt: skip
"""The closure settings that belong to the search; friction, mass and obstacles belong to the request."""


@value
class PlanRequest:
    """All inputs that determine a plan.

    Attributes:
        source: A mesh or point-cloud file, the name of a library object, or a mesh [m].
        task: What the hand is to do; a name, six numbers or a :class:`~preshape.tasks.Task`.
        hand: A hand's name or description file, or a loaded hand.
        analyser: ``rays`` (the paper's) or ``closure``; empty selects the hand's default.
        unit: Unit of the file: ``m``, ``cm``, ``mm`` or ``in``.
        scale: Factor on the object's size.
        view: Camera position of a point cloud, as three numbers in the cloud's frame and unit, or ``all`` if
            the points show the object from all sides; ``None`` reads the position from the file.
        mass: Mass of the object [kg]; ``None`` takes the object's own, or an estimate from its volume.
        friction: Friction coefficient between hand and object; ``None`` is the field's 0.6.
        table: Height of a table along the mesh frame's z [m], ``auto`` for the object's lowest point, or
            ``None`` for free space. Closure only.
        avoid: Boxes that the hand stays out of, six numbers each: lower and upper corner in the mesh frame
            [m]. Closure only.
        gravity: (3,) unit direction of gravity in the mesh frame; zeros mean none; ``None`` takes the task's.
        approaches: Allowed approach axes, such as ``+z,-x``; ``None`` allows all.
        count: Number of different answers.
        learn: Whether a new object is taught to the memory.
        verify: Whether the best answers go through the holding test in physics; the first that holds is
            the answer.
        settings: Thresholds, membership functions, contact coefficients and the seed.
        search: Size and safety of the closure search. Its friction, mass and obstacles are those of the
            request, unless the request leaves friction or mass open and ``search`` states them.
        memory: The memory's file, ``":memory:"``, or ``None`` for the user's.

    Raises:
        InputError: An argument that cannot be used; the message says what to change.
    """

    source: str | Path | TriangleMesh
    task: Task | str | Sequence[float]
    hand: str | Hand = RAY_HAND
    analyser: str = ""
    unit: str = "m"
    scale: float = 1.0
    view: Sequence[float] | str | None = None
    mass: float | None = None
    friction: float | None = None
    table: float | str | None = None
    avoid: Sequence[Sequence[float]] = ()
    gravity: Sequence[float] | Array | None = None
    approaches: str | None = None
    count: int = 1
    learn: bool = True
    verify: bool = False
    settings: Settings = field(default_factory=Settings)
    search: ClosureSettings = field(default_factory=ClosureSettings)
    memory: str | None = None

    def __post_init__(self) -> None:
        task = self.task
        if not isinstance(task, Task):
            task = parse_task(task) if isinstance(task, str) else task_from_numbers(task)
        boxes = tuple(tuple(_box(box).ravel().tolist()) for box in self.avoid)
        gravity = task.gravity if self.gravity is None else frozen_array(self.gravity, (3,), "gravity")
        freeze(self, task=task, avoid=boxes, gravity=gravity, analyser=analyser_of(self.analyser, self.hand))
        freeze(self, source=str(self.source) if isinstance(self.source, Path) else self.source)
        freeze(self, table=_table(self.table))
        allowed_planes(self.approaches)
        if isinstance(self.source, TriangleMesh) and (self.unit != "m" or self.scale != 1.0):
            raise InputError("a TriangleMesh is in metres at its final size: unit and scale are for files")
        if isinstance(self.count, bool) or not isinstance(self.count, int) or self.count < 1:
            raise InputError(f"count, the number of answers, must be at least 1, got {self.count!r}")
        for name, number in (("mass", self.stated_mass), ("friction", self.stated_friction)):
            real = isinstance(number, int | float | np.number) and not isinstance(number, bool)
            if number is not None and not (real and 0 < number < np.inf):
                raise InputError(f"{name} must be a positive number, got {number!r}")
        if self.analyser == "rays":
            self._refuse_what_rays_ignore()

    def _refuse_what_rays_ignore(self) -> None:
        """Refuse obstacles and loads for the ray analyser, which would ignore them without notice."""
        if self.table is not None or self.avoid:
            raise InputError("a table and boxes to avoid need the closure analyser (--analyser closure)")
        if not self.verify and (self.stated_mass is not None or self.stated_friction != FRICTION):
            raise InputError(
                "friction and mass need the closure analyser (--analyser closure), "
                "or a test in physics (--verify)"
            )

    @property
    def asked(self) -> Task:
        """The task as a :class:`~preshape.tasks.Task`."""
        assert isinstance(self.task, Task)
        return self.task

    @property
    def hand_name(self) -> str:
        """The hand as :func:`~preshape.hands.load.load_hand` takes it."""
        return self.hand.source if isinstance(self.hand, Hand) else source_of(self.hand)

    @property
    def object_name(self) -> str:
        """The object's file or name."""
        return self.source.name if isinstance(self.source, TriangleMesh) else str(self.source)

    @property
    def stated_mass(self) -> float | None:
        """The mass that the request states [kg], in its own field or in the search settings."""
        return self.search.mass if self.mass is None else self.mass

    @property
    def stated_friction(self) -> float:
        """The friction coefficient that is planned for."""
        return self.search.friction if self.friction is None else float(self.friction)

    def table_height(self, mesh: TriangleMesh) -> float | None:
        """Height of the table along z [m]; ``None`` without one.

        Raises:
            InputError: The table is above the object's lowest point.
        """
        if self.table is None:
            return None
        lowest = float(mesh.bounds[0, 2])
        if self.table == AUTO:
            return lowest
        height = float(self.table)
        if height > lowest + 1e-6:
            raise InputError(
                f"the table at z = {height:g} m is above the lowest point of {mesh.name}, {lowest:.4g} m: "
                "the object would stand in it; give a lower height, or --table alone for the lowest point"
            )
        return height

    def obstacles(self, mesh: TriangleMesh) -> Obstacles:
        """Table and boxes as the kernels take them."""
        height = self.table_height(mesh)
        planes = [] if height is None else [[0.0, 0.0, 1.0, height]]
        boxes = np.array(self.avoid, dtype=np.float64).reshape(-1, 2, 3)
        return Obstacles(planes=np.array(planes).reshape(-1, 4), boxes=boxes)

    def scene(self, mesh: TriangleMesh) -> str:
        """The scene as text, for comparing lessons; empty for free space and the usual load.

        A mass other than the object's own and a friction other than the default are part of the scene,
        because lessons for another load say nothing certain about this one.
        Heights are relative to the object's lowest point and boxes relative to its COG, rounded to 1 mm. So
        the same object in another file has the same scene, and similar objects on a table share one.
        """
        parts = []
        height = self.table_height(mesh)
        if height is not None:
            parts.append(f"table {round(1000 * (float(mesh.bounds[0, 2]) - height))} mm under the object")
        for box in sorted(map(tuple, self.avoid)):
            corners = np.round(1000 * (np.array(box).reshape(2, 3) - mesh.cog)).astype(int).ravel() + 0
            parts.append("box " + " ".join(map(str, corners.tolist())))
        stated, own = self.stated_mass, object_mass(mesh).kg
        if stated is not None and abs(stated - own) > 0.01 * own:
            parts.append(f"load {stated:.3g} kg")
        if abs(self.stated_friction - FRICTION) > 1e-9:
            parts.append(f"friction {self.stated_friction:.3g}")
        return "; ".join(parts)

    def wanted(self, mesh: TriangleMesh) -> int:
        """Number of answers to compute; physics, or the seen part of a cloud, selects among them."""
        chosen_from = [self.count, VERIFIED if self.verify else 0, ON_CLOUDS if mesh.scan is not None else 0]
        return max(chosen_from)

    def closure(self, mesh: TriangleMesh, mass: float) -> ClosureSettings:
        """The settings of the closure analyser for this request.

        Args:
            mesh: The object.
            mass: The mass that planning uses [kg].
        """
        wanted = self.wanted(mesh)
        return replace(
            self.search,
            friction=self.stated_friction,
            mass=mass,
            obstacles=self.obstacles(mesh),
            finished=max(self.search.finished, wanted + wanted // 2 + 2),
        )

    def to_json(self) -> dict[str, Any]:
        """The request as plain JSON values; :meth:`from_json` gives the same request back."""
        s, view = self.settings, self.view
        return {
            "object": {
                "source": self.object_name,
                "unit": self.unit,
                "scale": self.scale,
                "view": view if view is None or isinstance(view, str) else [float(x) for x in view],
            },
            "task": task_to_json(self.asked),
            "hand": self.hand_name,
            "analyser": self.analyser,
            "mass": self.stated_mass,
            "friction": self.stated_friction,
            "table": self.table,
            "avoid": [list(box) for box in self.avoid],
            "gravity": np.asarray(self.gravity).tolist(),
            "approaches": self.approaches,
            "count": self.count,
            "learn": self.learn,
            "verify": self.verify,
            "seed": s.seed,
            "thresholds": {"estimation": s.thresholds.estimation, "recognition": s.thresholds.recognition},
            "sets": {"corners": s.sets.corners.tolist(), "shape": s.sets.shape},
            "finger_rule": s.finger_rule,
            "coefficients": {f.name: getattr(s.coefficients, f.name) for f in fields(s.coefficients)},
            "search": {name: getattr(self.search, name) for name in _SEARCH},
            "memory": self.memory,
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any], **changes: Any) -> PlanRequest:
        """The request that :meth:`to_json` wrote.

        Args:
            data: The document.
            changes: Fields of the request that differ from the document, such as another ``source``.

        Raises:
            InputError: The document is not a request, or one of its values cannot be used.
        """
        try:
            thing, limits, sets = data["object"], data["thresholds"], data["sets"]
            settings = Settings(
                thresholds=Thresholds(estimation=limits["estimation"], recognition=limits["recognition"]),
                sets=FuzzySets(
                    corners=frozen_array(sets["corners"], (7, 4), "membership functions"), shape=sets["shape"]
                ),
                coefficients=ContactCoefficients(**data["coefficients"]),
                seed=int(data["seed"]),
                finger_rule=data.get("finger_rule", "up_to"),
            )
            read: dict[str, Any] = {
                "source": str(thing["source"]),
                "unit": str(thing["unit"]),
                "scale": float(thing["scale"]),
                "view": thing["view"],
                "task": task_from_json(data["task"]),
                "hand": str(data["hand"]),
                "settings": settings,
                "search": ClosureSettings(**{name: data["search"][name] for name in _SEARCH}),
            }
            plain = ("analyser", "mass", "friction", "table", "avoid", "gravity", "approaches", "count")
            read |= {name: data[name] for name in (*plain, "learn", "verify", "memory")}
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise InputError(
                f"this is no request of preshape ({type(error).__name__}: {error!s:.80}); "
                "give a plan.json that preshape plan wrote"
            ) from error
        return cls(**(read | changes))


def analyser_of(analyser: str | None, hand: str | Hand) -> str:
    """Name of the analyser to use.

    Args:
        analyser: The requested analyser; ``None`` or empty selects the hand's default.
        hand: The hand.

    Raises:
        InputError: There is no analyser of that name.
    """
    name = hand.removesuffix(":right") if isinstance(hand, str) else hand.name
    chosen = analyser or ("rays" if name == RAY_HAND else "closure")
    if chosen not in ANALYSERS:
        raise InputError(f"no analyser {chosen!r}; known: {', '.join(ANALYSERS)}")
    return chosen


def _box(box: Sequence[float]) -> Array:
    """(2, 3) lower and upper corner [m].

    Raises:
        InputError: There are not six finite numbers, or the lower corner is not below the upper one.
    """
    corners = frozen_array(box, (6,), "a box to avoid")
    if not (corners[:3] < corners[3:]).all():
        raise InputError(f"a box to avoid is its lower corner, then its upper, got {list(box)}")
    return corners.reshape(2, 3)


def _table(table: float | str | None) -> float | str | None:
    """The table as a height [m] or ``auto``; ``None`` and ``none`` are free space.

    Raises:
        InputError: The value is anything else.
    """
    if table is None or (isinstance(table, str) and table.strip().lower() == "none"):
        return None
    if isinstance(table, str) and table.strip().lower() == AUTO:
        return AUTO
    try:
        height = float(table)
    except (TypeError, ValueError):
        height = np.nan
    if not np.isfinite(height):
        raise InputError(f"a table is its height in metres, auto or none, got {table!r}")
    return height
