"""Grasps as arrays: the input of the physics tests.

An ``.npz`` without pickle holds one grasp in each row:

===========  ===========  ==================================================================
array        shape        content
===========  ===========  ==================================================================
object       (n,) text    name of the object
scale        (n,)         factor on the object's size
obj_pose     (n, 7)       object in the world: x y z [m], quaternion w x y z
pregrasp     (n, 7 + j)   hand's root in the world, as obj_pose, then j joint angles [rad]
grasp        (n, 7 + j)   the same, with the fingers in contact
squeeze      (n, 7 + j)   the same, as targets at which the fingers press
joints       (j,) text    optional: joint names; default the hand's order
frame        text         optional: ``root`` (default) or ``palm``, the frame of the hand poses
hand         text         optional: name of the hand
===========  ===========  ==================================================================

A row that cannot be tested (its numbers are not finite, a quaternion is not of unit length, or the scale is
bad) is recorded as a *fault*; the other rows are tested. Plans are read by
:func:`preshape.planning.grasp_sets.read_grasp_file`.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from .. import spatial
from ..exceptions import EnvironmentFailure, InputError, shown
from ..files import MOST_OF_ARRAYS, arrays_in, read_file, write_whole
from ..objects.read_text import printable
from ..types import Array, freeze, frozen_array, value
from .hand import PhysicsHand

STAGES = ("pregrasp", "grasp", "squeeze")
FRAMES = ("root", "palm")


@value
class HandPoses:
    """One grasp: the poses of the hand, and that of the object.

    Attributes:
        pregrasp: (7 + j) root pose x y z w x y z in the world [m] and joint angles in the hand's order [rad].
        grasp: (7 + j) the same, with the fingers in contact.
        squeeze: (7 + j) the same, as targets at which the fingers press.
        object_pose: (7,) pose of the object in the world.
    """

    pregrasp: Array
    grasp: Array
    squeeze: Array
    object_pose: Array

    def __post_init__(self) -> None:
        for name in (*STAGES, "object_pose"):
            freeze(self, **{name: frozen_array(getattr(self, name), (None,), name)})

    def rows(self) -> tuple[tuple[float, ...], ...]:
        """Pregrasp, grasp and squeeze as plain numbers."""
        return tuple(tuple(getattr(self, stage).tolist()) for stage in STAGES)

    def moved(self, T: Array) -> HandPoses:
        """The same grasp in another frame, by T (4, 4) from this frame to that one [m]."""

        def at(row: Array) -> Array:
            return np.append(spatial.seven_from_pose(T @ spatial.pose_from_seven(row[:7])), row[7:])

        return HandPoses(**{name: at(getattr(self, name)) for name in (*STAGES, "object_pose")})


@value
class Fault:
    """Why one grasp cannot be tested.

    Attributes:
        row: Row of the grasp.
        reason: One sentence, without the row.
    """

    row: int
    reason: str


@value
class GraspSet:
    """Grasps of one hand on any objects.

    Attributes:
        hand: Name or file that the hand is loaded from; empty if unknown.
        joints: Joint names in the order of the angles; empty for the hand's own order.
        objects: (n,) names of the objects.
        scale: (n,) factor on each object's size.
        object_pose: (n, 7) pose of the object in the world [m], with unit quaternions wxyz.
        pregrasp: (n, 7 + j) pose of the hand in the world [m] and joint angles [rad].
        grasp: (n, 7 + j) the same, with the fingers in contact.
        squeeze: (n, 7 + j) the same, as targets at which the fingers press.
        frame: Frame of the hand whose poses are given, ``root`` or ``palm``.
        faults: Rows that cannot be tested; their numbers are set to zero.
        origin: File and row of each grasp if the grasps come from several files; otherwise empty.

    Raises:
        InputError: An array has the wrong shape; the message names it.
    """

    hand: str
    joints: tuple[str, ...]
    objects: tuple[str, ...]
    scale: Array
    object_pose: Array
    pregrasp: Array
    grasp: Array
    squeeze: Array
    frame: str = "root"
    faults: tuple[Fault, ...] = ()
    origin: tuple[tuple[str, int], ...] = ()

    def __post_init__(self) -> None:
        if self.frame not in FRAMES:
            raise InputError(f"no frame {shown(self.frame)}; known: {', '.join(FRAMES)}")
        count = len(self.objects)
        if len(self.origin) not in (0, count):
            raise InputError(f"origin must name {count} rows, got {len(self.origin)}")
        width = np.shape(self.grasp)[1] if np.ndim(self.grasp) == 2 else 7 + len(self.joints)
        if self.joints:
            width = 7 + len(self.joints)
        arrays = {"scale": _array(self.scale, "scale", (count,))}
        arrays["object_pose"] = _array(self.object_pose, "obj_pose", (count, 7))
        for stage in STAGES:
            arrays[stage] = _array(getattr(self, stage), stage, (count, max(7, width)))
        faults = {fault.row: fault.reason for fault in self.faults}
        for row in range(count):
            reason = _fault({name: array[row] for name, array in arrays.items()})
            if reason:
                faults.setdefault(row, reason)
        for name, array in arrays.items():
            array[list(faults)] = 0.0
            if array.ndim == 2:
                norm = np.linalg.norm(array[:, 3:7], axis=1, keepdims=True)
                array[:, 3:7] /= np.where(norm > 0, norm, 1.0)
            array.setflags(write=False)
            freeze(self, **{name: array})
        listed = tuple(Fault(row=row, reason=faults[row]) for row in sorted(faults))
        freeze(self, faults=listed, objects=tuple(str(name) for name in self.objects))

    def __len__(self) -> int:
        return len(self.objects)

    def rows(self, rows: Sequence[int]) -> GraspSet:
        """Some of the grasps, in the order of ``rows``."""
        chosen = list(rows)
        reasons = {fault.row: fault.reason for fault in self.faults}
        arrays = ("scale", "object_pose", *STAGES)
        return replace(
            self,
            objects=tuple(self.objects[row] for row in chosen),
            faults=tuple(Fault(row=k, reason=reasons[row]) for k, row in enumerate(chosen) if row in reasons),
            origin=tuple(self.origin[row] for row in chosen) if self.origin else (),
            **{name: getattr(self, name)[chosen] for name in arrays},
        )

    def poses(self, row: int) -> HandPoses:
        """The poses of one grasp; take them from the result of :meth:`for_hand`."""
        return HandPoses(
            object_pose=self.object_pose[row], **{stage: getattr(self, stage)[row] for stage in STAGES}
        )

    def for_hand(self, hand: PhysicsHand) -> GraspSet:
        """The same grasps with poses of the root and in the joint order of ``hand``.

        Raises:
            InputError: The grasps have other joints than the hand.
        """
        width = self.grasp.shape[1] - 7
        if self.joints and set(self.joints) != set(hand.joints):
            raise InputError(
                f"the grasps are for the joints {', '.join(self.joints)}; "
                f"the hand {hand.name} has {', '.join(hand.joints)}"
            )
        if width != len(hand.joints):
            raise InputError(
                f"pregrasp, grasp and squeeze must be n×{7 + len(hand.joints)} for the hand {hand.name} "
                f"(7 + {len(hand.joints)} joints), got n×{7 + width}"
            )
        order = [self.joints.index(j) for j in hand.joints] if self.joints else list(range(width))
        T_palm_root = spatial.inverse(hand.T_root_palm)
        stages: dict[str, Any] = {}
        for stage in STAGES:
            whole = np.array(getattr(self, stage))
            angles = whole[:, 7:][:, order]
            seven = whole[:, :7]
            if self.frame == "palm":
                sound = np.linalg.norm(seven[:, 3:7], axis=1) > 0
                T = spatial.pose_from_seven(seven[sound]) @ T_palm_root
                seven[sound] = spatial.seven_from_pose(T)
            stages[stage] = np.concatenate([seven, angles], axis=1)
        return GraspSet(
            hand=hand.source,
            joints=hand.joints,
            objects=self.objects,
            scale=self.scale,
            object_pose=self.object_pose,
            frame="root",
            faults=self.faults,
            origin=self.origin,
            **stages,
        )


def joined(sets: Sequence[tuple[str, GraspSet]], hand: PhysicsHand) -> GraspSet:
    """Join the grasps of several files into one set that records the file and row of each.

    Args:
        sets: Name and grasps of each file.
        hand: The hand of all grasps.

    Raises:
        InputError: The grasps of a file are for another hand; the message names the file.
    """
    own = []
    for name, grasps in sets:
        try:
            own.append(grasps.for_hand(hand))
        except InputError as error:
            raise InputError(f"{name}: {error}") from error
    starts = np.cumsum([0, *map(len, own)])
    stages: dict[str, Any] = {
        stage: np.concatenate([getattr(grasps, stage) for grasps in own]) for stage in STAGES
    }
    return GraspSet(
        hand=hand.source,
        joints=hand.joints,
        objects=tuple(name for grasps in own for name in grasps.objects),
        scale=np.concatenate([grasps.scale for grasps in own]),
        object_pose=np.concatenate([grasps.object_pose for grasps in own]),
        faults=tuple(
            Fault(row=int(start) + fault.row, reason=fault.reason)
            for start, grasps in zip(starts, own, strict=False)
            for fault in grasps.faults
        ),
        origin=tuple((name, row) for name, grasps in sets for row in range(len(grasps))),
        **stages,
    )


def planned_set(hand: PhysicsHand, results: Sequence[Any]) -> GraspSet:
    """The grasps that were planned for the results of a run, with each object at the origin.

    Args:
        hand: Their hand.
        results: Results with ``object_name``, ``scale`` and ``planned``, a row for each stage.
    """
    rows = len(results)
    poses = np.array([result.planned for result in results]).reshape(rows, len(STAGES), 7 + len(hand.joints))
    stages: dict[str, Any] = {stage: poses[:, k] for k, stage in enumerate(STAGES)}
    return GraspSet(
        hand=hand.source,
        joints=hand.joints,
        objects=tuple(result.object_name for result in results),
        scale=np.array([result.scale for result in results]),
        object_pose=np.tile([0.0, 0, 0, 1, 0, 0, 0], (rows, 1)),
        **stages,
    )


def read_grasps(path: str | Path) -> GraspSet:
    """Read grasp arrays from an npz.

    Raises:
        InputError: The file is not an npz of grasps; an array is missing or has the wrong shape.
        EnvironmentFailure: The file cannot be read.
    """
    path = Path(path)
    try:
        content = read_file(path, MOST_OF_ARRAYS, "grasp file")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise EnvironmentFailure(f"cannot read {path}: {reason}") from error
    if content[:2] != b"PK":
        raise InputError(f"{path}: not an npz of grasps, which docs/grasp-file.md describes")
    return _read_npz(path, content)


def write_grasps(path: str | Path, grasps: GraspSet) -> None:
    """Write grasps as npz (see the module), whole or not at all.

    Raises:
        EnvironmentFailure: The file cannot be written.
    """
    arrays: dict[str, Any] = {
        "object": np.array(grasps.objects, dtype=np.str_),
        "scale": grasps.scale,
        "obj_pose": grasps.object_pose,
        **{stage: getattr(grasps, stage) for stage in STAGES},
        "frame": np.array(grasps.frame),
        "hand": np.array(grasps.hand),
    }
    if grasps.joints:
        arrays["joints"] = np.array(grasps.joints, dtype=np.str_)

    def write(target: Path) -> None:
        with target.open("wb") as stream:
            np.savez_compressed(stream, **arrays)

    write_whole(Path(path), write)


def _read_npz(path: Path, content: bytes) -> GraspSet:
    try:
        with warnings.catch_warnings(action="ignore"):  # NumPy warns about old formats, which are read
            arrays = arrays_in(content)
    except ValueError as error:
        raise InputError(
            f"{path}: expected an npz without pickle, this is another file or a damaged one "
            f"({printable(error)})"
        ) from error
    missing = [name for name in ("object", "scale", "obj_pose", *STAGES) if name not in arrays]
    if missing:
        raise InputError(
            f"{path}: missing arrays {', '.join(missing)}; it has {printable(sorted(arrays), 400)}"
        )
    others = [name for name, array in arrays.items() if not isinstance(array, np.ndarray)]
    if others:
        raise InputError(
            f"{path}: {printable(', '.join(map(repr, others)))} cannot be read as arrays; use numpy.savez"
        )
    names = arrays["object"]
    if names.ndim != 1 or names.dtype.kind not in "US":
        raise InputError(
            f"{path}: object must be n names as text, got {names.dtype} with shape {names.shape}"
        )
    try:
        return GraspSet(
            hand=_word(arrays, "hand", ""),
            joints=_words(arrays.get("joints", ())),
            objects=_words(names),
            scale=arrays["scale"],
            object_pose=arrays["obj_pose"],
            pregrasp=arrays["pregrasp"],
            grasp=arrays["grasp"],
            squeeze=arrays["squeeze"],
            frame=_word(arrays, "frame", "root"),
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _words(array: Any) -> tuple[str, ...]:
    try:
        words = np.asarray(array).ravel().tolist()
    except SystemError as error:  # code points that do not exist
        raise InputError(f"a text array is damaged ({printable(error)}); write the file again") from error
    return tuple(word.decode(errors="replace") if isinstance(word, bytes) else str(word) for word in words)


def _word(arrays: dict[str, Any], name: str, default: str) -> str:
    if name not in arrays:
        return default
    words = _words(arrays[name])
    if len(words) != 1:
        raise InputError(f"{name} must be one word, got {len(words)}")
    return words[0]


def _array(data: Any, name: str, shape: tuple[int, ...]) -> Array:
    """A float64 copy with the wanted shape; its numbers need not be finite."""
    try:
        array = np.array(data, dtype=np.float64)
    except (TypeError, ValueError, OverflowError, SystemError) as error:
        got = data.dtype if isinstance(data, np.ndarray) else printable(repr(data))
        raise InputError(f"{name} must be numbers, got {got}") from error
    if array.shape != shape:
        wanted, got = ("×".join(map(str, s)) or "a single number" for s in (shape, array.shape))
        raise InputError(f"{name} must be {wanted} numbers, got {got}")
    return array


def _fault(row: dict[str, Array]) -> str:
    """Why a row cannot be tested; empty if it can."""
    for name, numbers in row.items():
        key = "obj_pose" if name == "object_pose" else name
        if not np.isfinite(numbers).all():
            return f"{key} is not finite"
        if name == "scale":
            if not numbers > 0:
                return f"scale must be positive, got {float(numbers):g}"
        else:
            with np.errstate(over="ignore"):  # an infinite length is not 1 either
                length = float(np.linalg.norm(numbers[3:7]))
            if abs(length - 1.0) > 0.01:
                return f"{key}: the quaternion's length is {length:.3g}, not 1"
    return ""
