"""The plain values that everything else is made of: frozen dataclasses over read-only arrays.

A value is made once, checked at once and never changed:

>>> import numpy as np
>>> frozen_array([1, 2, 3], (3,), "point")
array([1., 2., 3.])
>>> frozen_array([1, 2, np.nan], (3,), "point")
Traceback (most recent call last):
...
preshape.exceptions.InputError: point must be finite, got [ 1.  2. nan]
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any, TypeVar, dataclass_transform

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .exceptions import InputError

Array = NDArray[np.float64]
"""Numbers; the shape stands beside each use."""
IntArray = NDArray[np.int64]
"""Whole numbers, mostly indices."""
BoolArray = NDArray[np.bool_]
"""Yes or no for each."""

FRICTION = 0.6
"""Sliding friction between hand and object that is assumed where nothing else is said, as in the field's tests."""
FIELD_MASS = 0.1
"""Mass of every object in the field's holding tests [kg]."""
GRAVITY = 9.81
"""Acceleration of gravity [m/s²]."""

_T = TypeVar("_T")
_A = TypeVar("_A", bound=NDArray[Any])


@dataclass_transform(frozen_default=True, kw_only_default=True, eq_default=False, field_specifiers=(field,))
def value(cls: type[_T]) -> type[_T]:
    """Make ``cls`` a value: frozen, slotted, keyword-only, compared by identity.

    Copies go through the constructor, so that they are checked and read-only too.
    """
    cls.__reduce__ = rebuilt  # type: ignore[method-assign]
    return dataclass(frozen=True, slots=True, kw_only=True, eq=False)(cls)


def rebuilt(self: Any) -> tuple[Any, ...]:
    """How a value is copied: its fields, through its constructor."""
    return _rebuild, (type(self), {f.name: getattr(self, f.name) for f in fields(self)})


def _rebuild(cls: Callable[..., Any], content: dict[str, Any]) -> Any:
    return cls(**content)


def read_only(array: _A) -> _A:
    """The same array, which can no longer be written."""
    array.setflags(write=False)
    return array


def frozen_array(data: ArrayLike, shape: tuple[int | None, ...], name: str) -> Array:
    """Copy ``data`` to a read-only float64 array after checking it.

    Args:
        data: anything NumPy turns into numbers.
        shape: the wanted shape; ``None`` stands for any length.
        name: what the array is called in the error message.

    Raises:
        InputError: not numbers, another shape, or not finite.
    """
    try:
        array = np.array(data, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} must be numbers, got {data!r:.80}") from error
    if array.shape != shape and (
        array.ndim != len(shape)
        or any(n is not None and n != m for n, m in zip(shape, array.shape, strict=True))
    ):
        wanted = "×".join("n" if n is None else str(n) for n in shape) or "a single number"
        got = "×".join(str(n) for n in array.shape) or "a single number"
        raise InputError(f"{name} must be {wanted} numbers, got {got}")
    if not np.isfinite(array).all():
        raise InputError(f"{name} must be finite, got {array!s:.80}")
    return read_only(array)


def freeze(instance: Any, **fields: Any) -> None:
    """Set fields of a frozen instance; only for use in its own ``__post_init__``."""
    for name, content in fields.items():
        object.__setattr__(instance, name, content)


@value
class Attributes:
    """What the object looks like to the estimator (§2.1, table 2) and to recognition.

    Attributes:
        extents: W, H, D = bounding-box extents along x, y, z [m].
        vertices: number of vertices in the model.
        vertex_normals: number of vertex normals in the model.
        faces: number of faces (polygons) in the model.
        triangles: number of triangles that the faces are cut into.
        area: surface area [m²] (not in the paper; used for recognition only).
        volume: enclosed volume [m³], about the COG where the mesh is open (as area).
        shape: (28,) shape descriptor of :mod:`preshape.objects.shape`, the same however the surface was
            cut into triangles; ``None`` where it is not known.
    """

    extents: Array
    vertices: int
    vertex_normals: int
    faces: int
    triangles: int
    area: float
    volume: float
    shape: Array | None = None

    def __post_init__(self) -> None:
        shape = None if self.shape is None else frozen_array(self.shape, (None,), "shape descriptor")
        freeze(self, extents=frozen_array(self.extents, (3,), "object extents"), shape=shape)


@value
class ContactCoefficients:
    """Scale of each part of a soft-finger contact wrench (§2.3, eq. 11-12).

    Attributes:
        ka: tangential force along the approach axis, per unit normal force.
        ko: tangential force along the transverse axis.
        kn: normal force.
        mn: moment about the inward normal, in units of force times U.

    The defaults are the set behind fig. 16 [P/R].
    """

    ka: float = 0.45
    ko: float = 0.30
    kn: float = 1.0
    mn: float = 0.80

    def __post_init__(self) -> None:
        frozen_array([self.ka, self.ko, self.kn, self.mn], (4,), "contact coefficients")


ANSWER_KIND = "grip"
"""Kind of the experiences that store an answer without teaching the estimator."""


@value
class Experience:
    """One thing the system has met (§3.5): what was asked of which object, and what answered it.

    Attributes:
        kind: ``seed`` (the cube of the first training), ``task`` (the user's Q), ``best`` (the best
            possible task, BPT), ``landmark`` (kept for recognition only, never trained on) or ``grip``
            (how a real hand held the object in mode 0 or 1: tried again, not trained on nor recognised by).
        object_name: the object's name.
        hand: the hand's name; experiences of one hand never serve another.
        attributes: the object's attributes [m].
        task: Q, six numbers (§2.2).
        plane: approach plane index, 1..12.
        flip: whether the thumb stands on the -o side.
        approach_value: v, -1..1 (§3).
        approach_set: index of the fuzzy set of v, 0 = RWD-H … 6 = FWD-H.
        fingers: virtual fingers, thumb included, 2..4.
        wrench: net wrench about the COG, axes x y z, lengths in U.
        match: TFVADI(task, wrench), 0..6.
        created: when, ISO 8601 in UTC; empty until the memory has stored it.
        grip: (8 + j,) how a real hand held the object, j its number of joints: the palm's place about the
            COG [m] and its quaternion wxyz in the object's frame, the fingers that took part (a whole
            number, bit k for the hand's finger k), and the joint angles of the preshape from which the
            fingers closed [rad]; ``None`` for a virtual grasp.
        quality: what the critic judged, 0..6, where that is not ``match``; ``None`` where it is.
        outcome: what physics said of the grip: ``held``, ``lost``, or empty where it was not asked.
        scene: The table and boxes that the lesson was learnt with, as text; empty for free space. Mode 2
            recognises, and mode 0 recalls, only lessons of the present scene.
    """

    kind: str
    object_name: str
    hand: str
    attributes: Attributes
    task: Array
    plane: int
    flip: bool
    approach_value: float
    approach_set: int
    fingers: int
    wrench: Array
    match: float
    created: str = ""
    grip: Array | None = None
    quality: float | None = None
    outcome: str = ""
    scene: str = ""

    def __post_init__(self) -> None:
        freeze(
            self,
            task=frozen_array(self.task, (6,), "task Q"),
            wrench=frozen_array(self.wrench, (6,), "net wrench"),
            grip=None if self.grip is None else frozen_array(self.grip, (None,), "grip"),
        )


@value
class NetworkWeights:
    """The approach estimator's weights, 13-45-9 (fig. 5).

    Attributes:
        w1: (45, 13) hidden weights.
        b1: (45,) hidden biases.
        w2: (9, 45) output weights.
        b2: (9,) output biases.
        mean_square_error: on the training set, over samples and outputs.
        trained_on: number of training samples behind these weights.
        epochs: epochs or iterations that training took.
    """

    w1: Array
    b1: Array
    w2: Array
    b2: Array
    mean_square_error: float
    trained_on: int
    epochs: int

    def __post_init__(self) -> None:
        freeze(
            self,
            w1=frozen_array(self.w1, (None, None), "hidden weights"),
            b1=frozen_array(self.b1, (None,), "hidden biases"),
            w2=frozen_array(self.w2, (None, None), "output weights"),
            b2=frozen_array(self.b2, (None,), "output biases"),
        )
