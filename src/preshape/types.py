"""Values: frozen dataclasses over read-only arrays.

A value is checked when it is created, and never changes:

>>> import numpy as np
>>> frozen_array([1, 2, 3], (3,), "point")
array([1., 2., 3.])
>>> frozen_array([1, 2, np.nan], (3,), "point")
Traceback (most recent call last):
...
preshape.exceptions.InputError: point must be finite, got [ 1.  2. nan]
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from itertools import repeat
from typing import Any, TypeVar, dataclass_transform

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .exceptions import InputError, shown

Array = NDArray[np.float64]
"""Array of floats; docstrings state its shape."""
IntArray = NDArray[np.int64]
"""Array of integers, mostly indices."""
BoolArray = NDArray[np.bool_]
"""Array of truth values."""

LONGEST_NAME = 255
"""Largest number of characters of a name that is stored, of an object or of a hand."""
FRICTION = 0.6
"""Default sliding friction between hand and object, as in the field's tests."""
FIELD_MASS = 0.1
"""Mass of every object in the field's holding tests [kg]."""
LENGTH_UNIT = 4.0
"""Unit of length in wrenches, torques and printed approach values, in U of the hand: 4U, the largest object
size [R]. The paper's torques fit a cube of 72 mm and fingers 24 mm apart in this unit; in U the cube would
measure 18 mm and the fingers would stand 6 mm apart."""
GRAVITY = 9.81
"""Acceleration of gravity [m/s²]."""
MODES = {0: "known", 1: "searched", 2: "task does not fit", 3: "new"}
"""The paper's execution modes in plain words."""
STEPS = {0: "Recall", 1: "Search", 2: "Recognise", 3: "Explore"}
"""The work of each execution mode."""

_T = TypeVar("_T")
_A = TypeVar("_A", bound=NDArray[Any])


@dataclass_transform(frozen_default=True, kw_only_default=True, eq_default=False, field_specifiers=(field,))
def value(cls: type[_T]) -> type[_T]:
    """Make ``cls`` a value: frozen, slotted, keyword-only, compared by identity.

    A copy goes through the constructor, so it is checked and read-only too.
    """
    cls.__reduce__ = rebuilt  # type: ignore[method-assign]
    return dataclass(frozen=True, slots=True, kw_only=True, eq=False)(cls)


def rebuilt(self: Any) -> tuple[Any, ...]:
    """``__reduce__`` of a value: it is copied by its constructor, with its fields as arguments."""
    return _rebuild, (type(self), {f.name: getattr(self, f.name) for f in fields(self)})


def _rebuild(cls: Callable[..., Any], content: dict[str, Any]) -> Any:
    return cls(**content)


def from_columns(cls: type[_T], columns: Mapping[str, Sequence[Any]]) -> list[_T]:
    """Many values at once, for content that has been checked already: nothing is checked or copied here.

    Args:
        cls: A value's class.
        columns: For each field its content in every value; arrays must be read-only and of float64. Other
            columns are ignored.
    """
    names = [f.name for f in fields(cls)]  # type: ignore[arg-type]
    made = list(map(cls.__new__, repeat(cls, len(columns[names[0]]))))
    for name in names:
        deque(map(getattr(cls, name).__set__, made, columns[name]), maxlen=0)
    return made


def read_only(array: _A) -> _A:
    """Make an array read-only, and return it."""
    array.setflags(write=False)
    return array


def numbers(data: ArrayLike, name: str) -> Array:
    """A float64 copy of numbers of any shape; text, truth values and complex numbers are none.

    Raises:
        InputError: The data are not numbers.
    """
    try:
        given = np.asarray(data)
        if given.dtype.kind in "cbSUmM":  # of a complex number, NumPy would drop the imaginary part
            raise TypeError(f"an array of {given.dtype}")
        return np.array(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} must be numbers, got {shown(data)}") from error


def frozen_array(data: ArrayLike, shape: tuple[int | None, ...], name: str) -> Array:
    """A checked, read-only float64 copy of ``data``.

    Args:
        data: Anything that NumPy converts to numbers.
        shape: Expected shape; ``None`` stands for any length.
        name: Name of the array in messages.

    Raises:
        InputError: The data are not numbers, have another shape, or are not finite.
    """
    array = numbers(data, name)
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


def finite_number(given: object, name: str, wanted: str = "a finite number") -> float:
    """A finite number as a float. Numeric NumPy scalars are numbers; booleans and text are not.

    Args:
        given: What the caller gave.
        name: Its name in the message.
        wanted: What is expected, for the message.

    Raises:
        InputError: It is not a finite number.

    >>> finite_number(np.int64(3), "mass")
    3.0
    """
    try:
        if isinstance(given, int | float | np.integer | np.floating) and not isinstance(given, bool):
            number = float(given)
            if math.isfinite(number):
                return number
    except OverflowError:  # a whole number of hundreds of digits
        pass
    raise InputError(f"{name} must be {wanted}, got {shown(given)}")


def one_of(given: object, noun: str, known: Sequence[str]) -> str:
    """One of the known names as a str.

    Args:
        given: What the caller gave.
        noun: What it names, for the message.
        known: The known names.

    Raises:
        InputError: It is no text, or none of the names.
    """
    if not isinstance(given, str) or given not in known:
        raise InputError(f"no {noun} {shown(given)}; known: {', '.join(known)}")
    return str(given)


def an_instance(given: object, kind: type, name: str) -> None:
    """Refuse a value of another type.

    Raises:
        InputError: It is not an instance of ``kind``.
    """
    if not isinstance(given, kind):
        raise InputError(f"{name} must be a value of {kind.__name__}, got {shown(given)}")


def positive_number(given: object, name: str, wanted: str = "a positive, finite number") -> float:
    """A finite number above zero as a float; see :func:`finite_number`.

    Raises:
        InputError: It is not a positive, finite number.
    """
    number = finite_number(given, name, wanted)
    if not number > 0:
        raise InputError(f"{name} must be {wanted}, got {shown(given)}")
    return number


def whole_number(given: object, name: str, least: int) -> int:
    """A whole number as an int. NumPy integers are whole numbers; booleans and floats are not.

    Raises:
        InputError: It is not a whole number, or is below ``least``.
    """
    if isinstance(given, bool) or not isinstance(given, int | np.integer) or given < least:
        raise InputError(f"{name} must be a whole number of at least {least}, got {shown(given)}")
    return int(given)


def told_apart(*given: float, digits: int = 2) -> tuple[str, ...]:
    """Numbers as text, with as many decimals as are needed that different numbers read differently.

    Args:
        given: The numbers.
        digits: Least number of decimals.

    >>> told_apart(2.9996, 3.0), told_apart(2.5, 3.0)
    (('2.9996', '3.0000'), ('2.50', '3.00'))
    """
    for decimals in range(digits, 18):
        texts = tuple(f"{number:.{decimals}f}" for number in given)
        if len(set(texts)) == len(set(given)):
            return texts
    return tuple(map(repr, given))


ENOUGH = 3.0
"""Quality at which a grip just balances the load, by default also the critic's threshold."""


def quality_text(quality: float, digits: int = 2) -> str:
    """A quality with so many decimals, or more where it would read as just enough and is not.

    >>> quality_text(3.68, 1), quality_text(2.98, 1)
    ('3.7', '2.98')
    """
    return told_apart(quality, ENOUGH, digits=digits)[0]


def two_digits(number: float) -> str:
    """A number of zero or more with one decimal, and at least two significant digits; 1.0 is only 1.

    >>> two_digits(12.34), two_digits(0.034), two_digits(0.0), two_digits(0.997)
    ('12.3', '0.034', '0', '0.997')
    """
    return told_apart(number, 1.0, digits=1)[0] if number >= 0.95 else f"{number:.2g}"


def freeze(instance: Any, **fields: Any) -> None:
    """Set fields of a frozen instance; for its own ``__post_init__`` only."""
    for name, content in fields.items():
        object.__setattr__(instance, name, content)


@value
class Attributes:
    """Attributes of an object for the estimator (§2.1, table 2) and for recognition.

    Attributes:
        extents: (3,) W, H, D, the extents of the bounding box along x, y, z [m].
        vertices: Number of vertices of the model.
        vertex_normals: Number of vertex normals of the model.
        faces: Number of faces (polygons) of the model.
        triangles: Number of triangles that the faces are cut into.
        area: Surface area [m²]; it is not in the paper and serves recognition only.
        volume: Enclosed volume [m³]; holes are closed by cones to the COG. It serves recognition only.
        shape: (28,) shape descriptor of :mod:`preshape.objects.shape`, which does not depend on the
            triangulation; ``None`` if unknown.
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
    """Scales of the parts of a soft-finger contact wrench (§2.3, eq. 11-12).

    Attributes:
        ka: Tangential force along the approach axis, per unit normal force.
        ko: Tangential force along the transverse axis, per unit normal force.
        kn: Normal force.
        mn: Moment about the inward normal, in units of force times 4U.

    The defaults are the set of fig. 16 [P/R].
    """

    ka: float = 0.45
    ko: float = 0.30
    kn: float = 1.0
    mn: float = 0.80

    def __post_init__(self) -> None:
        for f in fields(self):
            freeze(
                self, **{f.name: finite_number(getattr(self, f.name), f"the contact coefficient {f.name}")}
            )


UNIT_NAME = "4U"
"""Name of ``LENGTH_UNIT`` in memories and exports."""
OLD_UNIT_NAME = "U"
"""The unit of length before November 2026."""

ANSWER_KIND = "grip"
"""Kind of the experiences that store an answer without teaching the estimator."""


@value
class Experience:
    """An experience of the system (§3.5): an object, a task, and the grasp that answered it.

    Attributes:
        kind: ``seed`` (the cube of the first training), ``task`` (the user's Q), ``best`` (the best possible
            task, BPT), ``landmark`` (for recognition only, never trained on) or ``grip`` (an answer of a real
            hand in mode 0 or 1: it is recalled, but neither trained on nor used for recognition).
        object_name: Name of the object.
        hand: Name of the hand; experiences of one hand are never used for another.
        attributes: Attributes of the object [m].
        task: (6,) Q of the task (§2.2).
        plane: Approach plane, 1..12.
        flip: Whether the thumb is on the -o side.
        approach_value: Approach value v, -1..1 (§3).
        approach_set: Index of the fuzzy set of v, 0 = RWD-H … 6 = FWD-H.
        fingers: Number of virtual fingers, the thumb included, 2..4.
        wrench: (6,) net wrench about the COG, axes x y z, lengths in ``length_unit``.
        match: TFVADI(task, wrench), 0..6.
        created: Time of storing, ISO 8601 in UTC; empty until stored.
        grip: (8 + j,) grip of a real hand with j joints, ``None`` for a virtual grasp: position of the palm
            relative to the COG [m], quaternion wxyz of the palm in the object's frame, a whole number whose
            bit k is set if finger k closes, and the joint angles of the preshape [rad].
        quality: Score that the critic judged, 0..6; ``None`` if that score is ``match``.
        outcome: Result of the physics test: ``held``, ``lost``, or empty without a test.
        scene: Table, boxes and unusual load that the lesson was learnt with, as text; empty for free space.
            Recognition (mode 2) and recall (mode 0) use only lessons of the same scene.
        length_unit: Unit of length of ``wrench``: ``4U``; ``U`` in lessons of earlier memories, whose wrench
            and match no longer count.
        model: Hash of the real hand's model (:meth:`~preshape.hands.hand.Hand.model_hash`); empty for a
            virtual grasp, and in lessons of earlier memories.
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
    length_unit: str = UNIT_NAME
    model: str = ""

    @property
    def judged(self) -> float:
        """Quality of a grip, or match of a virtual grasp, which is what the critic judged (0..6)."""
        return self.match if self.quality is None else self.quality

    @property
    def outdated(self) -> bool:
        """Whether wrench and match are of an earlier version's unit and contact model, and so are void."""
        return self.length_unit != UNIT_NAME

    def __post_init__(self) -> None:
        freeze(
            self,
            task=frozen_array(self.task, (6,), "task Q"),
            wrench=frozen_array(self.wrench, (6,), "net wrench"),
            grip=None if self.grip is None else frozen_array(self.grip, (None,), "grip"),
        )


@value
class NetworkWeights:
    """Weights of the approach estimator, 13-45-9 (fig. 5).

    Attributes:
        w1: (45, 13) hidden weights.
        b1: (45,) hidden biases.
        w2: (9, 45) output weights.
        b2: (9,) output biases.
        mean_square_error: Mean square error over the samples and outputs of the training set.
        trained_on: Number of training samples.
        epochs: Number of epochs or iterations of the training.
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
