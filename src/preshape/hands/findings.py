"""Faults of a hand's description and model that can be found without moving the hand.

:mod:`preshape.hands.check` adds the faults that appear only in motion. Loading a hand raises the
first finding.
"""

from __future__ import annotations

from typing import Any

from ..exceptions import HandError, InputError, shown
from ..objects.read_text import printable
from ..types import value
from .compiled import CompiledModel
from .couples import (
    Table,
    couple_joints,
    couples_of,
    motors_within,
    per_motor,
    positive,
    with_model_couples,
)
from .description import LONGEST_MESSAGE, direction, finger_from, side_of
from .motors import RIGID

SMALLEST_TIP, LARGEST_TIP = 1e-3, 30e-3
"""Plausible radii of a fingertip [m] [C]."""

LARGEST_ANGLE, LARGEST_LIMIT = 1000.0, 20.0
"""Largest angle that a posture can have, and largest plausible joint limit [rad] [C]."""

LARGEST_U = 0.2
"""Largest plausible U [m] [C]; a larger one means that the file uses another unit."""

LARGEST_SHAPE, SMALLEST_SHAPE = 1.0, 2e-4
"""Range of plausible extents of one shape of a hand [m] [C]; a larger one means that its mesh is in mm."""

LARGEST_OFFSET = 1.5
"""Largest plausible distance of a link from the one that carries it [m] [C]; a robot may have 1 m."""

_NOUNS = {2: "sphere", 3: "capsule", 4: "ellipsoid", 5: "cylinder", 6: "box"}
"""MuJoCo's kinds of shapes, in words."""


DEPTH = 4e-3
"""Largest allowed overlap of two links on the closing path [m]; the closure analyser refuses more."""


@value
class Finding:
    """One fault.

    Attributes:
        code: Kind of fault, one word for programs.
        text: One sentence for people, with the remedy if it is not obvious; always one printable line.
    """

    code: str
    text: str

    def __post_init__(self) -> None:
        # Names come from files; their escape codes must not reach a terminal.
        object.__setattr__(self, "text", printable(self.text, LONGEST_MESSAGE))

    def __str__(self) -> str:
        return self.text


def fingers_of(data: Table) -> list[Table]:
    """The fingers' tables; entries that are not tables are skipped."""
    found = data.get("finger", [])
    return [entry for entry in found if isinstance(entry, dict)] if isinstance(found, list) else []


def joints_of(entry: Table) -> list[str]:
    """Names of a finger's joints; empty if the entry does not list them."""
    joints = entry.get("joints", [])
    return [str(joint) for joint in joints] if isinstance(joints, list) else []


def description_findings(data: Table) -> list[Finding]:
    """Faults that the description alone shows."""
    found = [*_fields(data), *_numbers(data)]
    for entry in fingers_of(data):
        found += _finger(entry, str(entry.get("name", "?")))
    found += _duplicates("finger", [str(entry.get("name", "?")) for entry in fingers_of(data)])
    joints = [joint for entry in fingers_of(data) for joint in joints_of(entry)]
    found += _duplicates("joint", joints)
    if len(fingers_of(data)) < 2:
        found.append(
            Finding(
                code="fingers",
                text="a hand needs at least two [[finger]] tables, the thumb first; "
                f"there are {len(fingers_of(data))}",
            )
        )
    drives = data.get("actuators")
    if isinstance(drives, dict):
        for table in ("gains", "torque_limits"):
            found += _attempt("actuators", _require_positive, drives.get(table, {}), table)
    found += _attempt("couplings", couples_of, data, "it")
    found += _attempt("side", side_of, data, "it")
    return found


def _require_positive(numbers: Any, table: str) -> None:
    """Raise unless the table of numbers by motor has positive numbers only."""
    if not isinstance(numbers, dict):
        raise HandError(f"actuators.{table} must be a table of motors and numbers, got {shown(numbers)}")
    for motor in numbers:
        positive(numbers, motor)


def _attempt(code: str, check: Any, *arguments: Any) -> list[Finding]:
    """The error of a check as a finding, without the placeholder ``it`` for the hand's name."""
    try:
        check(*arguments)
    except (InputError, TypeError, ValueError, KeyError, AttributeError, OverflowError) as error:
        return [Finding(code=code, text=str(error).removeprefix("hand 'it': "))]
    return []


def _fields(data: Table) -> list[Finding]:
    wanted = {
        "name": "a short name",
        "u": "the length of the middle finger's proximal phalanx in metres",
        "finger_pitch": "the distance between neighbouring fingers in metres",
        "palm": "a table with the palm's body and frame",
        "finger": "a [[finger]] table for every finger, the thumb first",
        "actuators": "a table with gain, damping and torque_limit",
    }
    found = [
        Finding(code="missing", text=f"the description lacks {key!r}: {what}")
        for key, what in wanted.items()
        if key not in data
    ]
    tables = {"palm": dict, "actuators": dict, "finger": list}
    for key, kind in tables.items():
        if key in data and not isinstance(data[key], kind):
            found.append(Finding(code="missing", text=f"{key!r} must be {wanted[key]}"))
    nested = {"palm": ("body",), "actuators": ("gain", "damping", "torque_limit")}
    for table, keys in nested.items():
        inside = data.get(table)
        lacking = [key for key in keys if key not in inside] if isinstance(inside, dict) else []
        found += [Finding(code="missing", text=f"[{table}] lacks {key!r}") for key in lacking]
    for entry in fingers_of(data):
        for key in ("name", "joints", "tip_body", "tip_radius"):
            if key not in entry:
                text = f"[[finger]] {entry.get('name', '?')} lacks {key!r}"
                found.append(Finding(code="missing", text=text))
    return found


def _numbers(data: Table) -> list[Finding]:
    found = []
    tables = {"": data, "actuators.": data.get("actuators")}
    for table, key, unit in (
        ("", "u", "m"),
        ("", "finger_pitch", "m"),
        ("", "fingertip_width", "m"),
        ("actuators.", "gain", "N m/rad"),
        ("actuators.", "damping", "N m s/rad"),
        ("actuators.", "torque_limit", "N m"),
    ):
        inside = tables[table]
        if isinstance(inside, dict) and key in inside and not _is_positive(inside[key]):
            what = "U" if key == "u" else f"{table}{key}"
            text = f"{what} must be a positive number of {unit}, got {shown(inside[key])}"
            found.append(Finding(code="not_positive", text=text))
    u = data.get("u")
    if _is_positive(u) and float(u) > LARGEST_U:  # type: ignore[arg-type]
        text = f"U is {float(u):g} m, longer than any finger's phalanx: is it in another unit?"  # type: ignore[arg-type]
        found.append(Finding(code="not_positive", text=text))
    return found


def _finger(entry: Table, name: str) -> list[Finding]:
    radius = entry.get("tip_radius")
    if radius is not None and not _is_positive(radius):
        text = f"the {name}'s tip_radius must be a positive number of m, got {shown(radius)}"
        return [Finding(code="tip_radius", text=text)]
    if radius is not None and not SMALLEST_TIP <= float(radius) <= LARGEST_TIP:
        text = (
            f"the {name}'s tip_radius is {1000 * float(radius):g} mm; a fingertip has "
            f"{1000 * SMALLEST_TIP:g} to {1000 * LARGEST_TIP:g} mm: is it in another unit?"
        )
        return [Finding(code="tip_radius", text=text)]
    if not {"name", "joints", "tip_body", "tip_radius"} <= entry.keys():
        return []
    return _attempt("closing", finger_from, entry)


def _duplicates(noun: str, names: list[str]) -> list[Finding]:
    twice = sorted({name for name in names if names.count(name) > 1})
    return [Finding(code=f"{noun}_twice", text=f"the {noun} {name} is listed twice") for name in twice]


def _is_positive(number: Any) -> bool:
    if isinstance(number, bool) or not isinstance(number, (int, float)):
        return False
    try:
        return 0.0 < float(number) < float("inf")
    except OverflowError:  # an integer beyond the range of a float
        return False


def model_findings(data: Table, model: CompiledModel) -> list[Finding]:
    """Faults that description and model together show."""
    found: list[Finding] = []
    palm = data.get("palm") if isinstance(data.get("palm"), dict) else {}
    assert isinstance(palm, dict)
    bodies = [("the palm", palm.get("body"))]
    sites = [("the palm", palm.get("site"))]
    for entry in fingers_of(data):
        bodies.append((f"the {entry.get('name', '?')}'s tip", entry.get("tip_body")))
        sites.append((f"the {entry.get('name', '?')}'s tip", entry.get("tip_site")))
    bodies.append(("the root", data.get("root")))
    for noun, wanted, there in (("body", bodies, model.bodies), ("site", sites, model.sites)):
        for whose, name in wanted:
            if name is not None and name not in there:
                text = f"the model has no {noun} {name!r}, which the description names for {whose}; "
                text += f"it has {_listed(there)}"
                found.append(Finding(code=f"unknown_{noun}", text=text))
    found += _ignore_findings(data, model)
    found += _frame_findings(data, palm)
    if "root" not in data and len(model.roots) != 1:
        text = f"the model has {len(model.roots)} root bodies ({_listed(model.roots)}): name one as root"
        found.append(Finding(code="roots", text=text))
    return found + _joint_findings(data, model) + _mass_findings(model) + size_findings(model)


def _ignore_findings(data: Table, model: CompiledModel) -> list[Finding]:
    """Entries of ``ignore`` that are no pairs of bodies."""
    pairs = data.get("ignore", [])
    if not isinstance(pairs, list) or not all(isinstance(pair, list) and len(pair) == 2 for pair in pairs):
        text = f"ignore must be a list of pairs of bodies that may overlap, got {shown(pairs)}"
        return [Finding(code="ignore", text=text)]
    return [
        Finding(
            code="unknown_body",
            text=f"the model has no body {name!r}, which ignore names; it has {_listed(model.bodies)}",
        )
        for pair in pairs
        for name in pair
        if name not in model.bodies
    ]


def _frame_findings(data: Table, palm: Table) -> list[Finding]:
    """Frames that are given neither by a site nor by numbers."""
    found = []
    if "body" in palm and "site" not in palm:
        for key in ("points", "faces"):
            if key not in palm:
                text = (
                    "[palm] needs a site, or points and faces as axes of its body ('+z', '-y'); "
                    f"{key} is missing"
                )
                found.append(Finding(code="frame", text=text))
            else:
                found += _attempt("frame", direction, palm[key], f"palm.{key}")
        if {"points", "faces"} <= palm.keys() and not found:
            z, y = (direction(palm[key], key) for key in ("points", "faces"))
            if abs(float(z @ y)) > 1e-6:
                found.append(Finding(code="frame", text="palm.points and palm.faces must be perpendicular"))
    if "pos" in palm:
        found += _attempt("frame", _require_position, palm["pos"], "palm.pos")
    for entry in fingers_of(data):
        if "tip_site" not in entry and "tip_pos" not in entry:
            text = f"the {entry.get('name', '?')} needs a tip_site, or tip_pos in its tip_body's frame"
            found.append(Finding(code="frame", text=text))
        if "tip_pos" in entry:
            found += _attempt("frame", _require_position, entry["tip_pos"], "tip_pos")
        if "tip_points" in entry:
            found += _attempt("frame", direction, entry["tip_points"], "tip_points")
    return found


def _require_position(numbers: Any, label: str) -> None:
    """Raise unless the value is a list of three finite numbers."""

    def finite(x: Any) -> bool:
        return isinstance(x, (int, float)) and (x == 0 or _is_positive(abs(x)))

    if not (isinstance(numbers, list) and len(numbers) == 3 and all(finite(x) for x in numbers)):
        raise HandError(f"{label} must be three numbers in m, got {shown(numbers)}")


def _joint_findings(data: Table, model: CompiledModel) -> list[Finding]:
    found = []
    listed = {joint for entry in fingers_of(data) for joint in joints_of(entry)}
    named = data.get("fixed", [])
    if not isinstance(named, (list, dict)):
        text = f"fixed must be a list of joints, or a table of joints and angles, got {shown(named)}"
        return [Finding(code="unknown_joint", text=text)]
    fixed = {str(joint) for joint in named}
    found += _law_findings(data, fixed, model)
    followers = _followers(data, model) if not found else set()
    inside = model.joints_under(data.get("root"))
    for joint in sorted((listed | fixed) - set(model.joints)):
        text = f"the model has no joint {joint!r}; it has {_listed(model.joints)}"
        found.append(Finding(code="unknown_joint", text=text))
    for joint in inside:
        if joint not in listed | fixed:
            text = f"the joint {joint!r} of the model belongs to no finger: list it, or name it under fixed"
            found.append(Finding(code="joint_left_out", text=text))
    for joint in (joint for joint in inside if joint in listed):
        if joint not in model.hinges:
            text = f"the joint {joint!r} is no hinge; the joints of a finger must be hinges"
            found.append(Finding(code="not_a_hinge", text=text))
            continue
        low, high = model.ranges[joint]
        if not max(abs(low), abs(high)) <= LARGEST_LIMIT:
            degrees = " (degrees?)" if max(abs(low), abs(high)) <= 720 else ""
            text = f"the limits of {joint!r} are no plausible angles in rad: {low:g} to {high:g}{degrees}"
            found.append(Finding(code="limits_missing", text=text))
        elif low > high:
            text = f"the limits of {joint!r} are in the wrong order: {low:g} to {high:g}"
            found.append(Finding(code="limits_reversed", text=text))
        elif low == high and joint not in followers:
            found.append(Finding(code="limits_missing", text=f"the joint {joint!r} has no limits"))
    return found


def _followers(data: Table, model: CompiledModel) -> set[str]:
    """Joints whose limits may follow from a rigid law."""
    return {
        joint
        for couple in (*couples_of(data, "it"), *model.couples)
        if couple["law"] == RIGID
        for joint in couple_joints(couple)[1:]
    }


def _law_findings(data: Table, fixed: set[str], model: CompiledModel) -> list[Finding]:
    """Faults of the model's laws: one cannot be expressed, or is only half of what is listed as fixed."""
    try:
        own = {joint for couple in couples_of(data, "it") for joint in couple_joints(couple)}
        couples = model.couples
    except (InputError, KeyError, TypeError, ValueError, AttributeError) as error:
        return [Finding(code="mimic", text=str(error).removeprefix("hand 'it': "))]
    found = []
    for couple in couples:
        joints = couple_joints(couple)
        held = [joint for joint in joints if joint in fixed]
        if held and len(held) < len(joints) and not own & set(joints):
            free = next(joint for joint in joints if joint not in fixed)
            text = (
                f"the joint {held[0]!r} is fixed, but by the model's law it moves with {free!r}: "
                "fix both, or neither"
            )
            found.append(Finding(code="mimic", text=text))
    listed = {joint for entry in fingers_of(data) for joint in joints_of(entry)}
    limits = [bound for joint in listed & set(model.hinges) for bound in model.ranges[joint]]
    # With limits beyond all measure the motors cannot be computed; these limits are a finding of their own.
    plausible = all(abs(bound) <= LARGEST_LIMIT for bound in limits)
    if not found and plausible and listed <= set(model.hinges) and not description_findings(data):
        found += _drive_findings(with_model_couples(data, couples), model, listed)
    return found


def _drive_findings(data: Table, model: CompiledModel, listed: set[str]) -> list[Finding]:
    """Faults of couples, and of numbers for motors that do not exist."""
    joints = [joint for joint in model.joints if joint in listed]
    try:
        fingers = [finger_from(entry) for entry in data["finger"]]
        motors = motors_within(data, model.ranges, joints, fingers)[1]
    except (InputError, KeyError, TypeError, ValueError, AttributeError) as error:
        return [Finding(code="couplings", text=str(error).removeprefix("hand 'it': "))]
    found, drives = [], data.get("actuators")
    for key, table in (("gain", "gains"), ("torque_limit", "torque_limits")):
        if isinstance(drives, dict):
            names = [motor.name for motor in motors]
            found += _attempt("actuators", per_motor, {**drives, key: 1.0}, key, table, names, "it")
    return found


def size_findings(model: CompiledModel) -> list[Finding]:
    """Shapes and distances too large for a part of a hand, before anything of their size is computed."""
    import mujoco
    import numpy as np

    found, m = [], model.model
    for shape in range(m.ngeom):
        body, kind = m.body(int(m.geom_bodyid[shape])).name, int(m.geom_type[shape])
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = int(m.geom_dataid[shape])
            start, count = int(m.mesh_vertadr[mesh]), int(m.mesh_vertnum[mesh])
            extents = np.ptp(m.mesh_vert[start : start + count], axis=0)
            noun = f"the mesh {m.mesh(mesh).name!r}"
            small = extents.max() < SMALLEST_SHAPE
        else:
            extents = 2 * np.array(m.geom_size[shape])
            noun = f"the {_NOUNS.get(kind, 'shape')}"
            small = False
        if kind in (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD):
            continue
        size = " × ".join(f"{extent:.3g}" for extent in extents if extent > 0)
        if extents.max() > LARGEST_SHAPE:
            text = (
                f"{noun} of the link {body!r} measures {size} m, more than a part of a hand: if it is in "
                'millimetres, give it the scale "0.001 0.001 0.001"'
            )
            found.append(Finding(code="mesh_size", text=text))
        elif small:
            text = f"{noun} of the link {body!r} measures {size} m, too small to be seen: is its scale right?"
            found.append(Finding(code="mesh_size", text=text))
    for body in range(1, m.nbody):
        offset = float(np.linalg.norm(m.body_pos[body]))
        if offset > LARGEST_OFFSET and m.body_parentid[body] > 0:
            carrier = m.body(int(m.body_parentid[body])).name
            text = (
                f"the link {m.body(body).name!r} is {offset:.3g} m from {carrier!r}, which carries "
                "it: is its place in millimetres?"
            )
            found.append(Finding(code="mesh_size", text=text))
    return found


def _mass_findings(model: CompiledModel) -> list[Finding]:
    return [
        Finding(
            code="mass_zero",
            text=f"the moving body {body!r} has no mass: give it a mass, or a shape with a density",
        )
        for body in model.massless
    ]


def _listed(names: Any, count: int = 12) -> str:
    names = list(names) or ["none"]
    return ", ".join(printable(name, 60) for name in names[:count]) + (
        f" and {len(names) - count} more" if len(names) > count else ""
    )


def refuse(found: list[Finding], label: str) -> None:
    """Raise the first finding; do nothing if there is none.

    Raises:
        HandError: There is a finding.
    """
    if found:
        more = f" (and {len(found) - 1} more: preshape hands check {label})" if len(found) > 1 else ""
        raise HandError(f"{label}: {found[0].text}{more}")
