"""One question to the planner as one value: object, scene, task, hand, search, critic and memory.

Command line, Python, browser, dataset and benches all make a :class:`PlanRequest` and give it to one
:class:`~preshape.planning.session.Session`. plan.json contains the whole request, so a plan can be shown,
simulated, exported and repeated without any further input.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..closure.settings import GRASP_TYPES, ClosureSettings
from ..exceptions import InputError, shown
from ..hands.hand import Hand
from ..hands.load import source_of
from ..hiis.critic import Thresholds
from ..hiis.decision import Settings
from ..hiis.fuzzy import FuzzySets
from ..hiis.planes import allowed_planes
from ..kernels.closing.host import Obstacles
from ..memory.records import SCENE_LENGTH
from ..objects.checks import metres
from ..objects.load import IN_MEMORY, load_object, stored_source
from ..objects.mass import object_mass
from ..objects.mesh import UP_AXES, TriangleMesh
from ..objects.obstacle import obstacle_surface, placed_file, rest_of_scene
from ..objects.parts import PartSurface
from ..objects.resting import upright
from ..tasks import Task, parse_task, task_from_numbers
from ..tasks.task import from_json as task_from_json
from ..tasks.task import to_json as task_to_json
from ..types import (
    FRICTION,
    Array,
    ContactCoefficients,
    freeze,
    frozen_array,
    one_of,
    positive_number,
    value,
    whole_number,
)
from . import request_values as values
from .rules import FOLLOW, MODES, NONE, TaskRules, task_rules
from .standing import AUTO, DEFAULT, Standing, lowest_point, standing

SCHEMA = 2
"""Version of plan.json. Version 1 is a plan without the key ``schema``; it does not contain its request."""
ANALYSERS = ("rays", "closure")
HAND = "shadow"
"""The hand of a request that names none."""
RAY_HAND = "utah_mit"
"""The paper's hand. It defaults to rays and free space, other hands to closure and a table."""
VERIFIED = 6
"""Number of answers that are tested in physics; ``count`` if that is larger."""
ON_CLOUDS = 8
"""Number of answers computed on a point cloud; those with contacts on seen surface are preferred."""
BY_ARM = 12
"""Number of answers computed for an arm, which then leaves out those that it does not reach [C]."""
_SEARCH = (
    "torsion", "friction_share", "bold_share", "press_least", "press_most", "safety", "hold", "at_aim",
    "on_plane", "everywhere", "persistence", "elite", "children", "rounds", "finished", "device", "threads",
)  # fmt: skip
"""The closure settings that belong to the search; friction, mass and obstacles belong to the request."""
_CHOICES = ("approaches", "grasp_type", "count", "learn", "verify")
_PLAIN = (
    "hand", "analyser", "mass", "friction", "table", "avoid", "gravity", "approaches", "count", "learn",
    "verify", "memory",
)  # fmt: skip
"""The fields that stand in JSON as they are."""
_ARM = ("arm", "arm_tip", "mount", "base_pose")
_KINDS: tuple[tuple[str, Any, str], ...] = (
    ("source", str | TriangleMesh, "a file, the name of a library object, or a TriangleMesh"),
    ("hand", str | Hand, "the name of a hand, its description file, or a loaded hand"),
    ("analyser", str | None, f"{' or '.join(ANALYSERS)}, or empty for the hand's default"),
    ("approaches", str | None, "text of approach axes such as +z,-x, or None for all"),
    ("grasp_type", str, f"{', '.join(GRASP_TYPES[:-1])} or {GRASP_TYPES[-1]}"),
    ("cut_table", bool | np.bool_ | None, "True, False or None"),
    ("learn", bool | np.bool_, "True or False"),
    ("verify", bool | np.bool_, "True or False"),
    ("settings", Settings, "a value of Settings"),
    ("search", ClosureSettings, "a value of ClosureSettings"),
    ("memory", str | None, "the path of a file, :memory:, or None for the user's"),
    ("up", str | None, f"one of {', '.join(UP_AXES)}, or None for the file's own"),
)
"""Types of fields, and what the message asks for; :class:`PlanRequest` says what they mean."""
_ALIGNED = 0.9998
"""Cosine of the angle up to which two directions are the same, 1° [C]."""


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
        cut_table: Whether a table in a point cloud is cut off; ``False`` keeps it as part of the object, and
            ``None`` refuses a cloud with a table.
        mask: Which points of a scene are the object's: a file (.npy, .png), or the number of a label in an
            NPZ file; ``None`` if all are. The other points are obstacles.
        mass: Mass of the object [kg]; ``None`` takes the object's own, or an estimate from its volume.
        friction: Friction coefficient between hand and object; ``None`` is the field's 0.6.
        table: ``auto`` for a table that the object rests on, the height of a table along ``up`` above which
            the object is as it is modelled [m], or ``None`` for free space; closure only. ``default`` is
            ``auto`` for a real hand that closure analyses, unless ``gravity`` is stated, and else ``None``.
        avoid: Boxes that the hand stays out of, six numbers each: lower and upper corner in the mesh frame
            [m]. Closure only.
        gravity: (3,) unit direction of gravity along the axes of the task; zeros mean none; ``None`` takes
            the task's. On a table, the task's gravity acts after the lift.
        approaches: Allowed approach axes, such as ``+z,-x``; ``None`` allows all.
        grasp_type: ``power`` for wraps of the whole hand only, ``precision`` for fingertips only, or ``any``.
            Closure only.
        count: Number of different answers; where both kinds of grips exist, both are among them.
        learn: Whether a new object is taught to the memory.
        verify: Whether the best answers go through the holding test in physics; the first that holds is
            the answer.
        settings: Thresholds, membership functions, contact coefficients and the seed.
        search: Size and safety of the closure search. Its friction, mass and obstacles are those of the
            request, unless the request leaves friction or mass open and ``search`` states them.
        memory: The memory's file, ``":memory:"``, or ``None`` for the user's.
        hold_on: Parts that contacts must lie on, any of them: names, half-spaces such as ``z>0.05``, or the
            six numbers of a box (:func:`~preshape.objects.parts.find_part`).
        keep_off: Parts without contacts, and with no link within 3 mm of them.
        rules: ``task`` for the rules of the object and the task too (:mod:`preshape.planning.rules`), or
            ``none`` for what ``hold_on`` and ``keep_off`` say alone.
        up: Axis of the mesh that is up, one of x, y, z, -x, -y, -z. The axes of the task are those of the
            mesh turned upright, so that z is up. ``None`` takes the file's own (y in glTF, else z).
        rest: (4,) quaternion wxyz that turns the mesh frame, as the object lies at rest on a table, to a
            world with z up; ``None`` takes the object's own, or else settles the object.
        arm: URDF of the arm that carries the hand; answers that it does not reach are left out.
        arm_tip: Link of the arm that carries the hand.
        mount: (7,) Pose of the hand's root on that link, xyz [m] and wxyz; ``None`` for the link's own.
        base_pose: (7,) Pose of the arm's base in the world, in which z is up and whose origin is that of the
            mesh frame (``scene.T_world_object`` of the plan), xyz [m] and wxyz.
        obstacle: Meshes or point clouds that the hand stays away from by 3 mm, on its way in too: each
            ``FILE`` or ``FILE@x,y,z,qw,qx,qy,qz``, its pose in the mesh frame [m]. Closure only.

    Raises:
        InputError: An argument that cannot be used; the message says what to change.
    """

    source: str | Path | TriangleMesh
    task: Task | str | Sequence[float]
    hand: str | Hand = HAND
    analyser: str = ""
    unit: str = "m"
    scale: float = 1.0
    view: Sequence[float] | str | None = None
    cut_table: bool | None = None
    mask: str | Path | int | None = None
    mass: float | None = None
    friction: float | None = None
    table: float | str | None = DEFAULT
    avoid: Sequence[Sequence[float]] = ()
    gravity: Sequence[float] | Array | None = None
    approaches: str | None = None
    grasp_type: str = "any"
    count: int = 1
    learn: bool = True
    verify: bool = False
    settings: Settings = field(default_factory=Settings)
    search: ClosureSettings = field(default_factory=ClosureSettings)
    memory: str | None = None
    hold_on: str | Sequence[str] = ()
    keep_off: str | Sequence[str] = ()
    rules: str = FOLLOW
    up: str | None = None
    rest: Sequence[float] | Array | None = None
    obstacle: str | Sequence[str] = ()
    arm: str | Path | None = None
    arm_tip: str | None = None
    mount: Sequence[float] | None = None
    base_pose: Sequence[float] | None = None

    def __post_init__(self) -> None:
        for name in ("source", "hand", "memory"):
            if isinstance(given := getattr(self, name), Path):
                freeze(self, **{name: str(given)})
        for name, kinds, wanted in _KINDS:
            if not isinstance(given := getattr(self, name), kinds):
                raise InputError(f"{name} must be {wanted}, got {shown(given)}")
        task = self.task
        if not isinstance(task, Task):
            task = parse_task(task) if isinstance(task, str) else task_from_numbers(task)
        freeze(self, task=task, analyser=analyser_of(self.analyser, self.hand))
        rests = self.gravity is None and self.analyser == "closure" and not _is_paper_hand(self.hand)
        freeze(self, gravity=task.gravity if self.gravity is None else values.checked_gravity(self.gravity))
        freeze(
            self,
            table=values.checked_table(self.table, AUTO if rests else None),
            avoid=values.checked_boxes(self.avoid),
            view=values.checked_view(self.view),
            learn=bool(self.learn),
            verify=bool(self.verify),
            hold_on=values.checked_parts(self.hold_on, "hold_on"),
            keep_off=values.checked_parts(self.keep_off, "keep_off"),
            rest=values.checked_rest(self.rest),
            obstacle=values.checked_files(self.obstacle),
        )
        one_of(self.rules, "rules", MODES)
        if self.up is not None:
            upright(self.up)
        arm = values.checked_arm(self.arm, self.arm_tip, self.mount, self.base_pose)
        freeze(self, **dict(zip(_ARM, arm, strict=True)))
        if self.cut_table is not None:
            freeze(self, cut_table=bool(self.cut_table))
        allowed_planes(self.approaches)
        metres(self.unit, self.scale)
        freeze(self, scale=float(self.scale))
        in_memory = isinstance(self.source, TriangleMesh)
        if in_memory and (self.unit != "m" or self.scale != 1.0):
            raise InputError("a TriangleMesh is in metres at its final size: unit and scale are for files")
        if in_memory and self.cut_table is not None:
            raise InputError("a TriangleMesh has no points to cut off: cut_table is for files of points")
        if self.mask is not None:
            freeze(self, mask=values.checked_mask(self.mask, self.source, self.cut_table))
        one_of(self.grasp_type, "grasp type", GRASP_TYPES)
        freeze(self, count=whole_number(self.count, "count, the number of answers,", 1))
        for name in ("mass", "friction"):
            if (given := getattr(self, name)) is not None:
                freeze(self, **{name: positive_number(given, name)})
        if self.analyser == "rays":
            values.refuse_what_rays_ignore(self)

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

    def load(self) -> TriangleMesh:
        """The object from its file or from the library; a mesh as it is [m].

        Raises:
            InputError: ``view`` or ``cut_table`` does not fit the file.
            UnknownObject: There is neither a file nor a library object of that name.
            ObjectError: The file cannot be used.
            EnvironmentFailure: The file cannot be read.
        """
        if isinstance(self.source, TriangleMesh):
            return self.source
        return load_object(
            self.source,
            unit=self.unit,
            scale=self.scale,
            view=self.view,
            cut_table=self.cut_table,
            mask=None if self.mask is None else str(self.mask),
        )

    @property
    def stated_mass(self) -> float | None:
        """The mass that the request states [kg], in its own field or in the search settings."""
        return self.search.mass if self.mass is None else self.mass

    @property
    def stated_friction(self) -> float:
        """The friction coefficient that is planned for."""
        return self.search.friction if self.friction is None else self.friction

    @property
    def usual_friction(self) -> bool:
        """Whether the friction is the field's 0.6."""
        # The float32 of 0.6 counts as the float64.
        return abs(self.stated_friction - FRICTION) < 1e-6

    def standing(self, mesh: TriangleMesh) -> Standing:
        """Where the object stands, and the table below it.

        Raises:
            InputError: The table is above the object's lowest point, or gravity was stated and does not point
                into the table.
        """
        stands = standing(mesh, up=self.up, rest=self.rest, table=self.table)
        gravity = np.asarray(self.gravity)
        own = np.array_equal(gravity, np.asarray(self.asked.gravity))
        if stands.table is not None and gravity.any() and not own:
            down = stands.direction(gravity)
            if -down @ stands.up < _ALIGNED:
                raise InputError(
                    f"the gravity {gravity.tolist()} does not point into the table, whose up along the axes "
                    f"of the task is {np.round(stands.upright @ stands.up, 3).tolist()}; leave one out"
                )
        return stands

    def task_gravity(self, mesh: TriangleMesh) -> Array:
        """(3,) direction of the task's gravity in the mesh frame; zeros for none."""
        stands, own = self.standing(mesh), np.asarray(self.asked.gravity)
        if np.array_equal(np.asarray(self.gravity), own):
            return np.asarray(stands.task(self.asked).gravity)
        return stands.direction(np.asarray(self.gravity))

    def obstacles(self, mesh: TriangleMesh) -> Obstacles:
        """Table and boxes as the kernels take them."""
        table = self.standing(mesh).table
        boxes = np.array(self.avoid, dtype=np.float64).reshape(-1, 2, 3)
        return Obstacles(planes=np.zeros((0, 4)) if table is None else table[None], boxes=boxes)

    def obstacle_surfaces(self, mesh: TriangleMesh, beyond: float = 0.0) -> tuple[PartSurface, ...]:
        """The obstacles from files, and the rest of the object's scene, as far as the hand can come near.

        Args:
            mesh: The object.
            beyond: Distance beyond the hand's reach within which they count, too [m].

        Raises:
            ObjectError: A file cannot be used.
            EnvironmentFailure: A file cannot be read.
        """
        near = mesh.bounds + np.array([[-beyond], [beyond]])
        found = [obstacle_surface(placed_file(text), near) for text in self.obstacle]
        found += [rest_of_scene(mesh, near)] if self.analyser == "closure" else []
        return tuple(surface for surface in found if surface is not None)

    def rules_for(self, mesh: TriangleMesh) -> TaskRules:
        """Which parts of the object are held and which stay free.

        Raises:
            InputError: The object has no such part, or a part is to be held and kept off at once.
        """
        stands = self.standing(mesh)
        return task_rules(
            mesh,
            self.asked,
            hold_on=self.hold_on,
            keep_off=self.keep_off,
            follow=self.rules == FOLLOW,
            turn=stands.upright.T,
            table=stands.table,
        )

    def scene(self, mesh: TriangleMesh) -> str:
        """The scene as text, for comparing lessons; empty for free space, the usual load and no rules.

        A mass other than the object's own and a friction other than the default are part of the scene,
        because lessons for another load say nothing certain about this one; so is a grasp type, because a
        lesson of one kind of grips does not say that the other would be worse.
        Heights are relative to the object's lowest point and boxes relative to its COG, rounded to 1 mm. So
        the same object in another file has the same scene, and similar objects on a table share one.

        Rules are part of the scene, because a grip on another part is no answer. The ray analyser has no
        scene besides them.

        A text of more boxes and rules than the memory can store names their number and, in place of them, the
        first 32 digits of the SHA-256 of their text. The boxes consist of whole numbers in sorted order, so
        the text is the same on every platform.
        """
        table, load = [], []
        kind = [] if self.grasp_type == "any" else [f"{self.grasp_type} grips"]
        stands = self.standing(mesh)
        if stands.table is not None:
            under = round(1000 * (lowest_point(mesh, stands.up) - float(stands.table[3])))
            table = [f"table {under} mm under the object"]
            if stands.up[2] < _ALIGNED:
                table = [f"{table[0]}, up {' '.join(f'{100 * x:.0f}' for x in stands.up + 0.0)} %"]
        stated, own = self.stated_mass, object_mass(mesh).kg
        if stated is not None and abs(stated - own) > 0.01 * own:
            load = [f"load {stated:.3g} kg"]
        if not self.usual_friction:
            load.append(f"friction {self.stated_friction:.3g}")
        centre = [*mesh.cog.tolist(), *mesh.cog.tolist()]
        corners = sorted(
            [round(1000 * (x - c)) for x, c in zip(box, centre, strict=True)] for box in self.avoid
        )
        boxes = ["box " + " ".join(map(str, row)) for row in corners]
        around = [np.round(1000 * (p.vertices - mesh.cog)) + 0.0 for p in self.obstacle_surfaces(mesh)]
        boxes += sorted(f"obstacle {hashlib.sha256(places.tobytes()).hexdigest()[:16]}" for places in around)
        rules = sorted(rule.words for rule in self.rules_for(mesh).applied)
        if self.analyser == "rays":
            table, boxes, load = [], [], []
        text = "; ".join([*table, *boxes, *load, *kind, *rules])
        if len(text) <= SCENE_LENGTH:
            return text
        digest = hashlib.sha256("; ".join([*boxes, *rules]).encode()).hexdigest()[:32]
        many = f"{len(boxes)} boxes{f' and {len(rules)} rules' if rules else ''} {digest}"
        return "; ".join([*table, many, *load, *kind])

    def wanted(self, mesh: TriangleMesh, *, by_arm: bool = True) -> int:
        """Number of answers to compute; physics, the seen part of a cloud, or the arm selects among them.

        Args:
            mesh: The object.
            by_arm: Whether to count those among which the arm selects if it does not serve the first ones.
        """
        scan, arm = mesh.scan is not None, by_arm and self.arm is not None
        return max(self.count, VERIFIED * self.verify, ON_CLOUDS * scan, BY_ARM * arm)

    def closure(self, mesh: TriangleMesh, mass: float) -> ClosureSettings:
        """The settings of the closure analyser for this request.

        Args:
            mesh: The object.
            mass: The mass that planning uses [kg].
        """
        wanted, rules = self.wanted(mesh), self.rules_for(mesh).contact
        return replace(
            self.search,
            friction=self.stated_friction,
            mass=mass,
            obstacles=self.obstacles(mesh),
            grasp_type=self.grasp_type,
            both=self.count > 1 and self.grasp_type == "any",
            rules=replace(rules, keep_off=(*rules.keep_off, *self.obstacle_surfaces(mesh))),
            finished=max(self.search.finished, wanted + wanted // 2 + 2),
        )

    def to_json(self) -> dict[str, Any]:
        """The request as plain JSON values; :meth:`from_json` gives the same request back."""
        s = self.settings
        source, scale = stored_source(self.source)
        return {
            "object": {
                "source": source,
                "unit": self.unit,
                "scale": self.scale * scale,
                "view": _listed(self.view),
                "cut_table": self.cut_table,
                "mask": self.mask,
            },
            "task": task_to_json(self.asked),
            "hand": self.hand_name,
            "analyser": self.analyser,
            "mass": self.stated_mass,
            "friction": self.stated_friction,
            "table": self.table,
            "avoid": [list(box) for box in self.avoid],
            "gravity": np.asarray(self.gravity).tolist(),
            **{name: getattr(self, name) for name in _CHOICES},
            "seed": s.seed,
            "thresholds": {"estimation": s.thresholds.estimation, "recognition": s.thresholds.recognition},
            "sets": {"corners": s.sets.corners.tolist(), "shape": s.sets.shape},
            "finger_rule": s.finger_rule,
            "coefficients": {f.name: getattr(s.coefficients, f.name) for f in fields(s.coefficients)},
            "search": {name: getattr(self.search, name) for name in _SEARCH},
            "memory": self.memory,
            **{name: _listed(getattr(self, name)) for name in ("hold_on", "keep_off")},
            "rules": self.rules,
            "up": self.up,
            "rest": None if self.rest is None else np.asarray(self.rest).tolist(),
            **{name: _listed(getattr(self, name)) for name in ("obstacle", *_ARM)},
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any], **changes: Any) -> PlanRequest:
        """The request that :meth:`to_json` wrote.

        Args:
            data: The document.
            changes: Fields of the request that differ from the document, such as another ``source``.

        Raises:
            InputError: The document is not a request, one of its values cannot be used, or its object was a
                mesh in memory and the changes have no ``source``.
        """
        try:
            thing, limits, sets = data["object"], data["thresholds"], data["sets"]
            settings = Settings(
                thresholds=Thresholds(estimation=limits["estimation"], recognition=limits["recognition"]),
                sets=FuzzySets(
                    corners=frozen_array(sets["corners"], (7, 4), "membership functions"), shape=sets["shape"]
                ),
                coefficients=ContactCoefficients(**data["coefficients"]),
                seed=data["seed"],
                finger_rule=data.get("finger_rule", "up_to"),
            )
            # Plans from before there was a larger share of the friction were made without it.
            search = {"bold_share": data["search"]["friction_share"], **data["search"]}
            read: dict[str, Any] = {
                **{name: thing[name] for name in ("source", "unit", "scale", "view")},
                **{name: thing.get(name) for name in ("cut_table", "mask")},
                "task": task_from_json(data["task"]),
                "settings": settings,
                "search": ClosureSettings(**{name: search[name] for name in _SEARCH}),
            }
            read |= {name: data[name] for name in _PLAIN}
            read["grasp_type"] = data.get("grasp_type", "any")
            # Plans from before there were rules were made without any.
            read |= {name: data.get(name, ()) for name in ("hold_on", "keep_off", "obstacle")}
            read["rules"] = data.get("rules", NONE)
            read |= {name: data.get(name) for name in ("up", "rest", *_ARM)}
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise InputError(
                f"this is no request of preshape ({type(error).__name__}: {error!s:.80}); "
                "give a plan.json that preshape plan wrote"
            ) from error
        if "source" not in changes and str(read["source"]).endswith(IN_MEMORY):
            raise InputError(
                f"the object of this request, {shown(read['source'])}, was a mesh in Python, which plan.json "
                "does not contain; give the mesh or its file as source (Plan.save writes its surface beside "
                "plan.json)"
            )
        return cls(**(read | changes))


def _listed(field: Any) -> Any:
    """A tuple as a list, and anything else as it is."""
    return list(field) if isinstance(field, tuple) else field


def analyser_of(analyser: str | None, hand: str | Hand) -> str:
    """Name of the analyser to use.

    Args:
        analyser: The requested analyser; ``None`` or empty selects the hand's default.
        hand: The hand.

    Raises:
        InputError: There is no analyser of that name.
    """
    chosen = analyser or ("rays" if _is_paper_hand(hand) else "closure")
    return one_of(chosen, "analyser", ANALYSERS)


def _is_paper_hand(hand: str | Hand) -> bool:
    return (hand.removesuffix(":right") if isinstance(hand, str) else hand.name) == RAY_HAND
