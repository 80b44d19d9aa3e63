"""The couples of a hand's description, and the motors that they and the other joints make."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from ..exceptions import HandError, InputError, shown
from ..types import Array, finite_number
from .hand import Finger
from .motors import ADAPTIVE, RIGID, Motor, adaptive_motor, direct_motor, rigid_motor

Table = dict[str, Any]

COUPLE_KEYS = {RIGID: ("law", "motor", "follow"), ADAPTIVE: ("law", "motor", "sum", "free", "order", "locks")}
"""Keys of a ``[[couple]]`` by its law."""


def positive(data: Table, key: str) -> float:
    """The number of that name, which must be above zero.

    Raises:
        HandError: It is not.
        KeyError, TypeError, ValueError: There is no number of that name.
    """
    number = float(data[key])
    if not (np.isfinite(number) and number > 0):
        raise HandError(f"the hand's {key} must be positive, got {number}")
    return number


def per_motor(drives: Table, key: str, table: str, motors: Sequence[str], name: str) -> Array:
    """(m,) a number for every motor: its entry in ``table``, else the common number of ``key``."""
    values = np.full(len(motors), positive(drives, key))
    for motor in dict(drives.get(table, {})):
        if motor not in motors:
            raise HandError(
                f"hand {name!r}: actuators.{table} names {motor}, which is no motor of the hand; "
                f"its motors are {', '.join(motors)}"
            )
        values[list(motors).index(motor)] = positive(drives[table], motor)
    return values


def couples_of(data: Table, name: str) -> tuple[Table, ...]:
    """The ``[[couple]]`` tables of a description; a pair of ``couplings`` is an adaptive one.

    Raises:
        HandError: One is no table, lacks a key or has an unknown one, or a joint is in two of them.
    """
    couples = data.get("couple", [])
    if not isinstance(couples, list) or not all(isinstance(couple, dict) for couple in couples):
        raise HandError(f"hand {name!r}: couple must be [[couple]] tables")
    pairs = data.get("couplings", [])
    if not isinstance(pairs, list) or any(not isinstance(pair, list) or len(pair) != 2 for pair in pairs):
        raise HandError(f"hand {name!r}: couplings must be pairs of the hand's joints")
    found = [
        *couples,
        *({"law": ADAPTIVE, "motor": str(a), "sum": {str(a): 1.0, str(b): 1.0}} for a, b in pairs),
    ]
    seen: set[str] = set()
    for couple in found:
        law = couple.get("law")
        if law not in COUPLE_KEYS:
            raise HandError(f"hand {name!r}: the law of a couple must be rigid or adaptive, got {shown(law)}")
        for key in couple:
            if key not in COUPLE_KEYS[law]:
                raise HandError(
                    f"hand {name!r}: a {law} couple has no key {shown(key)}; "
                    f"it has {', '.join(COUPLE_KEYS[law])}"
                )
        missing = [key for key in ("motor", "follow" if law == RIGID else "sum") if key not in couple]
        if missing:
            raise HandError(f"hand {name!r}: a {law} couple lacks {missing[0]!r}")
        parts = couple["follow" if law == RIGID else "sum"]
        if not isinstance(parts, dict) or not parts:
            raise HandError(
                f"hand {name!r}: couple {couple['motor']}: name the joints and their numbers in a table"
            )
        for joint in couple_joints(couple):
            if joint in seen:
                raise HandError(f"hand {name!r}: the joint {joint} is in two couples, or twice in one")
            seen.add(joint)
    return tuple(found)


def with_model_couples(data: Table, couples: tuple[Table, ...]) -> Table:
    """The description with the model's own couples for joints of which it has no couple itself.

    Couples all of whose joints are fixed are left out.
    """
    own = couples_of(data, str(data.get("name", "?")))
    taken = {joint for couple in own for joint in couple_joints(couple)}
    listed = {str(joint) for entry in data["finger"] for joint in entry["joints"]}
    more = [c for c in couples if not taken & set(couple_joints(c)) and listed & set(couple_joints(c))]
    return {**{key: item for key, item in data.items() if key != "couplings"}, "couple": [*own, *more]}


def couple_joints(couple: Table) -> tuple[str, ...]:
    """The joints that the motor of a couple moves; with a rigid law the motor's own comes first."""
    if couple["law"] == RIGID:
        return (str(couple["motor"]), *map(str, couple["follow"]))
    return tuple(map(str, couple["sum"]))


def motors_of(
    data: Table, limits: dict[str, Array], fingers: Sequence[Finger], name: str
) -> tuple[Motor, ...]:
    """The motors of a hand, in the order of their first joints.

    Args:
        data: The description, with every couple of the hand.
        limits: (2,) limits of every joint, in the hand's order [rad].
        fingers: The fingers.
        name: Name of the hand.

    Raises:
        HandError: A couple names an unknown joint or has an impossible law, or a motor would close two
        fingers.
    """
    motors: dict[str, Motor] = {}
    for couple in couples_of(data, name):
        joints = couple_joints(couple)
        unknown = [joint for joint in joints if joint not in limits]
        if unknown:
            raise HandError(
                f"hand {name!r}: couple {couple['motor']} names {unknown[0]}, which is no joint of the hand; "
                f"its joints are {', '.join(limits)}"
            )
        motor = couple_motor(couple, limits, name)
        _require_one_finger(motor, fingers, name)
        motors.update(dict.fromkeys(joints, motor))
    every = [motors.get(joint) or direct_motor(joint, bounds) for joint, bounds in limits.items()]
    found = tuple(dict.fromkeys(every))
    names = [motor.name for motor in found]
    if len(set(names)) != len(names):
        twice = next(one for one in names if names.count(one) > 1)
        raise HandError(
            f"hand {name!r}: two motors are called {twice}: give the motor of a couple a name that no other "
            "couple and no joint outside of it has"
        )
    return found


def motors_within(
    data: Table,
    ranges: Mapping[str, tuple[float, float]],
    joints: Sequence[str],
    fingers: Sequence[Finger],
) -> tuple[dict[str, Array], tuple[Motor, ...]]:
    """Limits of the joints of a hand and its motors, before the hand is made.

    A joint without limits of its own that follows another one gets those of its law.

    Args:
        data: The description, with every couple of the hand.
        ranges: Lower and upper limit of the model's joints [rad]; equal if there are none.
        joints: The hand's joints, in the model's order.
        fingers: The fingers.

    Raises:
        HandError: See :func:`motors_of`.
    """
    limits = lawful_limits({joint: ranges[joint] for joint in joints}, couples_of(data, "it"), "it")
    return limits, motors_of(data, limits, fingers, "it")


def lawful_limits(
    ranges: Mapping[str, Sequence[float]], couples: Iterable[Table], name: str
) -> dict[str, Array]:
    """(2,) limits of every joint [rad]; a joint without limits that follows another gets those of its law.

    Args:
        ranges: Lower and upper limit of every joint [rad]; equal if there are none.
        couples: ``[[couple]]`` tables as :func:`couples_of` returns them.
        name: Name of the hand.

    Raises:
        HandError: A law of such a joint has no numbers.
    """
    limits = {joint: np.array(sorted(pair)) for joint, pair in ranges.items()}
    for couple in couples:
        motor = limits.get(str(couple["motor"]))
        if couple["law"] != RIGID or motor is None:
            continue
        for joint, law in couple["follow"].items():
            if joint in limits and not np.ptp(limits[joint]):
                with _read_numbers_of(couple, name):
                    m = np.linspace(motor[0], motor[1], 101)
                    q = np.polynomial.polynomial.polyval(m, _coefficients(law))
                limits[joint] = np.array([q.min(), q.max()])
    return limits


def _coefficients(law: Any) -> Array:
    """The coefficients of a rigid law that is a multiplier or a list of them.

    Raises:
        HandError: It is neither.
    """
    given = [0.0, law] if np.isscalar(law) else law
    if not isinstance(given, Sequence) or isinstance(given, str):
        raise HandError(f"a law is a multiplier or a list of coefficients, got {shown(law)}")
    return np.array([finite_number(c, "each coefficient of a law") for c in given])


@contextmanager
def _read_numbers_of(couple: Table, name: str) -> Iterator[None]:
    """Say whose couple it is when its numbers cannot be used.

    Raises:
        HandError: A law is impossible, or a number is none.
    """
    try:
        yield
    except HandError as error:
        raise HandError(f"hand {name!r}: {error}") from error
    except (InputError, TypeError, ValueError, KeyError, AttributeError) as error:
        raise HandError(
            f"hand {name!r}: couple {couple['motor']}: its numbers cannot be read ({error})"
        ) from error


def couple_motor(couple: Table, limits: dict[str, Array], name: str) -> Motor:
    """The motor of one ``[[couple]]``; joints of which there are no limits are left out.

    Raises:
        HandError: Its law is impossible.
    """
    own = {joint: limits[joint] for joint in limits if joint in couple_joints(couple)}
    with _read_numbers_of(couple, name):
        if couple["law"] == RIGID:
            laws = {str(joint): _coefficients(law) for joint, law in couple["follow"].items()}
            return rigid_motor(str(couple["motor"]), laws, own)
        order = tuple((str(low), str(high)) for low, high in couple.get("order", []))
        odd = [joint for pair in order for joint in pair if joint not in own]
        locks = str(couple.get("locks", ""))
        if odd or (locks and locks not in own):
            raise HandError(f"motor {couple['motor']}: {(odd or [locks])[0]} is none of its joints")
        free = couple.get("free")
        return adaptive_motor(
            str(couple["motor"]),
            {str(joint): finite_number(c, f"the factor of {joint}") for joint, c in couple["sum"].items()},
            own,
            free=None if free is None else np.array(free, dtype=np.float64),
            order=order,
            locks=locks,
        )


def _require_one_finger(motor: Motor, fingers: Sequence[Finger], name: str) -> None:
    """Refuse a motor that would close two fingers together, because fingers close one by one."""
    closed = []
    for finger in fingers:
        columns = [k for k, joint in enumerate(finger.joints) if joint in motor.joints]
        if columns and np.ptp(finger.closing[:, columns], axis=0).any():
            closed.append(finger.name)
    if len(closed) > 1 or (closed and len(_fingers_of(motor, fingers)) > 1):
        raise HandError(
            f"hand {name!r}: the motor {motor.name} closes the {closed[0]} and also moves another finger; "
            "fingers are closed one by one, so this is not supported: let its joints be preshape joints "
            "(constant along closing), or name them under fixed"
        )


def _fingers_of(motor: Motor, fingers: Sequence[Finger]) -> list[str]:
    return [finger.name for finger in fingers if set(finger.joints) & set(motor.joints)]
