"""Checks of the values of a request; each returns the value as the request keeps it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Set
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..exceptions import InputError, shown
from ..objects.mesh import LEAST_LENGTH
from ..objects.obstacle import placed_file
from ..objects.scans.complete import ALL_ROUND
from ..tasks.task import axis_vector
from ..types import LONGEST_NAME, Array, finite_number, frozen_array
from .standing import AUTO, DEFAULT

if TYPE_CHECKING:
    from .request import PlanRequest

FARTHEST = 1e6
"""Largest coordinate of a table or a box to avoid [m]; the kernels count nothing beyond it as solid."""
_REAL_HAND = "a real hand (--hand shadow, leap or allegro) or the closure analyser (--analyser closure)"
_SIX = "six numbers (lower, then upper corner, in metres)"


def _items(given: object, wanted: str) -> tuple[Any, ...]:
    """The items of a sequence or an array.

    Raises:
        InputError: It is neither; the message says what is wanted.
    """
    if not isinstance(given, Iterable) or isinstance(given, str | bytes | Mapping | Set):
        raise InputError(f"{wanted}, got {shown(given)}")
    try:
        return tuple(given)
    except TypeError as error:  # an array without a dimension
        raise InputError(f"{wanted}, got {shown(given)}") from error


def _numbers(given: object, count: int, wanted: str) -> tuple[float, ...]:
    """So many finite numbers.

    Raises:
        InputError: There are more or fewer, or one is not a finite number.
    """
    items = _items(given, wanted)
    if len(items) != count:
        raise InputError(f"{wanted}, got {len(items)} items")
    return tuple(finite_number(item, f"{wanted}; each") for item in items)


def checked_boxes(avoid: object) -> tuple[tuple[float, ...], ...]:
    """The boxes to avoid, six numbers each [m].

    Raises:
        InputError: A box is not six numbers within ``FARTHEST``, or its lower corner is not below its upper.
    """
    boxes = []
    for item in _items(avoid, f"avoid must be a list of boxes, {_SIX} each"):
        box = _numbers(item, 6, f"a box to avoid must be {_SIX}")
        if not all(low < high for low, high in zip(box[:3], box[3:], strict=True)):
            raise InputError(f"a box to avoid is its lower corner, then its upper, got {list(box)}")
        if max(map(abs, box)) > FARTHEST:
            raise InputError(f"a box to avoid is in metres, at most {FARTHEST:g}, got {list(box)}")
        boxes.append(box)
    return tuple(boxes)


def checked_files(given: object) -> tuple[str, ...]:
    """Files of obstacles with their poses; a file gets its absolute path, so that it means the same anywhere.

    Raises:
        InputError: One is no such text.
    """
    if not isinstance(given, str | list | tuple):
        raise InputError(f"obstacle must be texts, each FILE or FILE@x,y,z,qw,qx,qy,qz, got {shown(given)}")
    found = []
    for text in [given] if isinstance(given, str) else given:
        placed = placed_file(text)
        found.append(str(Path(placed.file).absolute()) + text.removeprefix(placed.file))
    return tuple(found)


def checked_mask(mask: object, source: object, cut_table: bool | None) -> str:
    """A mask as text; a file gets its absolute path, so that it means the same anywhere.

    Raises:
        InputError: It is no text, or the object is not a file of points.
    """
    if not isinstance(mask, str | Path | int) or isinstance(mask, bool) or not str(mask).strip():
        raise InputError(f"a mask is a .npy or .png file, or the number of a label, got {shown(mask)}")
    if not isinstance(source, str | Path):
        raise InputError("a TriangleMesh has no points: a mask is for files of points")
    if cut_table is not None:
        raise InputError("with a mask the table is found among the other points: leave cut_table out")
    text = str(mask).strip()
    return text if text.removeprefix("-").isdecimal() else str(Path(text).absolute())


def checked_gravity(gravity: object) -> Array:
    """(3,) direction of gravity; zeros mean none.

    Raises:
        InputError: There are not three numbers, or their length is neither one nor zero.
    """
    wanted = "gravity must be a unit vector of three numbers, or 0 0 0 for none"
    vector = frozen_array(_numbers(gravity, 3, wanted), (3,), "gravity")
    if not vector.any():
        return vector
    length = float(np.linalg.norm(vector))
    if not abs(length - 1.0) < 1e-3:
        raise InputError(f"{wanted}, got the length {length:g}; divide the vector by its length")
    return axis_vector(vector)


def checked_view(view: object) -> tuple[float, ...] | str | None:
    """The camera's position, ``all`` or ``None``.

    Raises:
        InputError: It is anything else.
    """
    if view is None or (isinstance(view, str) and view == ALL_ROUND):
        return view
    return _numbers(view, 3, f"a view must be a camera's position, three numbers, or {ALL_ROUND}")


def checked_rest(rest: object) -> Array | None:
    """(4,) unit quaternion wxyz of the pose at rest.

    Raises:
        InputError: There are not four numbers, or all are zero.
    """
    if rest is None:
        return None
    wanted = "rest must be a quaternion of four numbers, w x y z"
    quaternion = np.array(_numbers(rest, 4, wanted))
    length = float(np.linalg.norm(quaternion))
    if length < LEAST_LENGTH:
        raise InputError(f"{wanted}, got {quaternion.tolist()}")
    # A unit quaternion stays bit for bit, so that files round-trip.
    return frozen_array(quaternion if abs(length - 1.0) < 1e-15 else quaternion / length, (4,), "rest")


def checked_table(table: float | str | None, default: str | None) -> float | str | None:
    """The table as a height [m] or ``auto``; ``None`` and ``none`` are free space.

    Args:
        table: What was asked for.
        default: The table that ``default`` means.

    Raises:
        InputError: The value is anything else.
    """
    wanted = "its height in metres, auto, none or default"
    if isinstance(table, str) and table.strip().lower() == DEFAULT:
        return default
    if table is None or (isinstance(table, str) and table.strip().lower() == "none"):
        return None
    if isinstance(table, str) and table.strip().lower() == AUTO:
        return AUTO
    if isinstance(table, str):
        try:
            table = float(table)
        except ValueError as error:
            raise InputError(f"a table must be {wanted}, got {shown(table)}") from error
    height = finite_number(table, "a table", wanted)
    if abs(height) > FARTHEST:
        raise InputError(f"a table must be {wanted}, at most {FARTHEST:g}, got {height:g}")
    return height


def _box_text(item: Any, wanted: str) -> Any:
    """The six numbers of a box as text; anything but numbers as it is."""
    if isinstance(item, str) or not isinstance(item, Iterable):
        return item
    return " ".join(repr(number) for number in _numbers(item, 6, wanted))


def checked_parts(given: object, name: str) -> tuple[str, ...]:
    """Names or descriptions of parts, each once.

    Raises:
        InputError: It is neither a text nor a list of texts, or one is empty.
    """
    wanted = f"{name} must be texts, each a part's name, a half-space such as z>0.05, or a box of six numbers"
    if not isinstance(given, str | list | tuple):
        raise InputError(f"{wanted}, got {shown(given)}")
    texts = [given] if isinstance(given, str) else [_box_text(item, wanted) for item in given]
    for text in texts:
        if not isinstance(text, str) or not text.strip() or len(text) > LONGEST_NAME:
            raise InputError(f"{wanted}, got {shown(text)}")
    return tuple(dict.fromkeys(text.strip() for text in texts))


def refuse_what_rays_ignore(request: PlanRequest) -> None:
    """Refuse obstacles and loads for the ray analyser, which would ignore them without notice.

    Raises:
        InputError: The request has one of them.
    """
    if request.table is not None or request.avoid or request.obstacle:
        raise InputError(
            f"a table, boxes to avoid and obstacles need {_REAL_HAND}; the analyser of {request.hand_name} "
            "here is rays"
        )
    if request.grasp_type != "any":
        raise InputError(f"a grasp type needs {_REAL_HAND}; {request.hand_name} is analysed by rays here")
    if not request.verify and (request.stated_mass is not None or not request.usual_friction):
        raise InputError(
            f"friction and mass need {_REAL_HAND}, or a test in physics (--verify); "
            f"the analyser of {request.hand_name} here is rays"
        )


def checked_arm(
    arm: object, tip: object, mount: object, base_pose: object
) -> tuple[str | None, str | None, tuple[float, ...] | None, tuple[float, ...] | None]:
    """The arm's file as an absolute path, its tip, and the poses of hand and base; ``None`` without an arm.

    Raises:
        InputError: A part is missing, or is no name or pose.
    """
    others = {"--arm-tip": tip, "--mount": mount, "--base-pose": base_pose}
    if arm is None:
        given = [name for name, part in others.items() if part is not None]
        if given:
            raise InputError(f"{given[0]} belongs to an arm: give its URDF with --arm, or leave it out")
        return None, None, None, None
    for name, text, wanted in (
        ("--arm", arm, "the URDF of an arm"),
        ("--arm-tip", tip, "the name of the link that carries the hand"),
    ):
        if text is None:
            raise InputError(f"--arm needs {name}, {wanted}")
        if not isinstance(text, str | Path) or not str(text).strip():
            raise InputError(f"{name} must be {wanted}, got {shown(text)}")
    if base_pose is None:
        raise InputError(
            '--arm needs --base-pose "x y z qw qx qy qz", the pose of its base in the world, whose z is up '
            "and whose origin is that of the object's file [m]"
        )
    placed = checked_seven((0, 0, 0, 1, 0, 0, 0) if mount is None else mount, "--mount")
    return str(Path(str(arm)).absolute()), str(tip), placed, checked_seven(base_pose, "--base-pose")


def checked_seven(pose: object, name: str) -> tuple[float, ...]:
    """A pose as x y z [m] and unit quaternion w x y z.

    Raises:
        InputError: There are not seven numbers, the position is too far away, or the quaternion has not
            length 1.
    """
    wanted = f"{name} must be seven numbers, x y z in metres and a unit quaternion w x y z"
    seven = _numbers(pose, 7, wanted)
    length = float(np.linalg.norm(seven[3:]))
    if not abs(length - 1.0) < 1e-2:
        advice = ": divide it by that" if length > LEAST_LENGTH else ""
        raise InputError(f"{wanted}; its quaternion has the length {length:.4g}{advice}")
    if max(map(abs, seven[:3])) > FARTHEST:
        raise InputError(f"{wanted}; the position is at most {FARTHEST:g} m away, got {list(seven[:3])}")
    exact = abs(length - 1.0) < 1e-12  # a unit quaternion stays bit for bit, so that files round-trip
    return seven if exact else (*seven[:3], *(x / length for x in seven[3:]))
