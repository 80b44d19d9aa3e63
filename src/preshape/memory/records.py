"""Experiences and weights as plain fields: one set of checks for everything stored, read or imported.

*Fields* are JSON values with the names of :class:`~preshape.types.Experience`,
:class:`~preshape.types.Attributes` and :class:`~preshape.types.NetworkWeights`; an unknown value is ``None``.
A *row* has the same values as columns of the table. All numbers are IEEE doubles, so that a value is read
back bit for bit.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..exceptions import InputError, shown
from ..objects.shape import LENGTH as SHAPE_LENGTH
from ..types import (
    FIELD_MASS,
    LONGEST_NAME,
    OLD_UNIT_NAME,
    UNIT_NAME,
    Array,
    Attributes,
    Experience,
    NetworkWeights,
)
from .checks import (
    LONGEST_GRIP,
    LONGEST_TIME,
    MODEL_LENGTH,
    exactly,
    grip,
    is_model,
    is_unicode,
    number,
    numbers,
    text,
    utc,
    vector,
    whole,
)
from .limits import weights_within, within

KINDS = ("seed", "task", "best", "landmark", "grip")
OUTCOMES = ("", "held", "lost")
SINCE_LENGTH_UNIT = 4
"""Format version of exports since which wrenches have lengths in 4U."""
OLD_SCENE = f"load {FIELD_MASS:.3g} kg"
"""Scene of older lessons of real hands, which did not know the mass: all were planned at this load."""
SCENE_LENGTH = 4000
"""Largest number of characters of a scene description."""

EXPERIENCE_COLUMNS = (
    *("hand", "kind", "object_name", "extent_x", "extent_y", "extent_z"),
    *("vertices", "vertex_normals", "faces", "triangles"),
    *("task_tx", "task_ty", "task_tz", "task_rx", "task_ry", "task_rz"),
    *("plane", "flip", "approach_value", "approach_set", "fingers"),
    *("wrench_fx", "wrench_fy", "wrench_fz", "wrench_mx", "wrench_my", "wrench_mz"),
    *("match", "created", "area", "volume", "shape", "grip", "quality", "outcome", "scene", "length_unit"),
    "model",
)
LONGEST_CELLS = {
    **dict.fromkeys(("hand", "object_name"), 4 * LONGEST_NAME),
    **dict.fromkeys(("kind", "created", "outcome", "length_unit"), 4 * LONGEST_TIME),
    "scene": 4 * SCENE_LENGTH,
    "model": 4 * MODEL_LENGTH,
    **dict.fromkeys(("shape", "grip"), 8 * LONGEST_GRIP),
}
"""For each column of texts or arrays the size of the largest cell that can be right [bytes]."""
WEIGHT_COLUMNS = (
    *("hand", "inputs", "hidden", "outputs", "w1", "b1", "w2", "b2"),
    *("mean_square_error", "trained_on", "epochs"),
)
_ATTRIBUTES = ("extents", "vertices", "vertex_normals", "faces", "triangles", "area", "volume", "shape")
_EXPERIENCE = (
    *("kind", "object_name", "hand", "attributes", "task", "plane", "flip", "approach_value"),
    *("approach_set", "fingers", "wrench", "match", "created", "grip", "quality", "outcome", "scene"),
    *("length_unit", "model"),
)
_SINCE: dict[int, dict[str, Any]] = {
    2: {"grip": None, "quality": None, "outcome": ""},
    3: {"scene": ""},
    SINCE_LENGTH_UNIT: {"length_unit": OLD_UNIT_NAME},
    5: {"model": ""},
}
"""For each format version, the fields that it added, with their values for older documents."""
_WEIGHTS = ("hand", "w1", "b1", "w2", "b2", "mean_square_error", "trained_on", "epochs")
MATCH_LIMITS = (-1e-9, 6.0 + 1e-9)
"""Least and largest match and quality: 0..6, with slack for rounding."""

Row = tuple[Any, ...]


def experience_fields(experience: Experience) -> dict[str, Any]:
    """Fields of an experience, in the order of the export."""
    fields: dict[str, Any] = {name: getattr(experience, name) for name in _EXPERIENCE}
    attributes = {name: getattr(experience.attributes, name) for name in _ATTRIBUTES}
    attributes["extents"] = experience.attributes.extents.tolist()
    attributes["shape"] = _listed(experience.attributes.shape)
    fields["attributes"] = attributes
    fields["grip"] = _listed(experience.grip)
    fields["task"], fields["wrench"] = experience.task.tolist(), experience.wrench.tolist()
    fields["flip"] = bool(experience.flip)
    return fields


def older_experience_from(fields: object, version: int) -> Experience:
    """The experience in a document of any format version.

    Args:
        fields: The fields of one experience.
        version: Format version of the document; fields that later versions added get their defaults.

    Raises:
        InputError: See :func:`experience_from`.
    """
    later: dict[str, Any] = {}
    for since, added in _SINCE.items():
        later |= added if since > version else {}
    found = exactly(fields, [name for name in _EXPERIENCE if name not in later], "an experience")
    shape = found["attributes"]
    if version < 2:
        shape = exactly(shape, [name for name in _ATTRIBUTES if name != "shape"], "attributes")
        shape = {**shape, "shape": None}
    if version < 3 and later.get("grip", found.get("grip")) is not None and found["kind"] != "seed":
        later["scene"] = OLD_SCENE
    experience = experience_from({**found, **later, "attributes": shape})
    within(experience)
    return experience


def experience_from(fields: object) -> Experience:
    """The experience with these fields; all of them are checked.

    Raises:
        InputError: A field is missing, unknown, of another type or out of range.
    """
    found = exactly(fields, _EXPERIENCE, "an experience")
    shape = exactly(found["attributes"], _ATTRIBUTES, "attributes")
    described, held, quality = shape["shape"], found["grip"], found["quality"]
    if found["kind"] not in KINDS:
        raise InputError(f"kind must be one of {', '.join(KINDS)}, got {shown(found['kind'])}")
    if not isinstance(found["flip"], bool):
        raise InputError(f"flip must be true or false, got {shown(found['flip'])}")
    if not (isinstance(found["outcome"], str) and found["outcome"] in OUTCOMES):
        raise InputError(f"outcome must be empty, held or lost, got {shown(found['outcome'])}")
    scene = found["scene"]
    if not (isinstance(scene, str) and len(scene) <= SCENE_LENGTH and is_unicode(scene)):
        raise InputError(f"scene must be text of at most {SCENE_LENGTH} characters, got {shown(scene)}")
    if found["length_unit"] not in (UNIT_NAME, OLD_UNIT_NAME):
        units = f"{UNIT_NAME} or {OLD_UNIT_NAME}"
        raise InputError(f"length_unit must be {units}, got {shown(found['length_unit'])}")
    if not is_model(found["model"]):
        digits = f"{MODEL_LENGTH} lower-case hexadecimal digits"
        raise InputError(f"model must be empty or {digits}, got {shown(found['model'])}")
    extents = numbers(shape["extents"], "object extents")
    if any(extent < 0.0 for extent in extents):
        raise InputError(f"object extents must not be below 0, got {shown(extents)}")
    return Experience(
        kind=found["kind"],
        object_name=text(found["object_name"], "object_name"),
        hand=text(found["hand"], "hand"),
        attributes=Attributes(
            extents=extents,  # type: ignore[arg-type]
            vertices=whole(shape["vertices"], "vertices"),
            vertex_normals=whole(shape["vertex_normals"], "vertex_normals"),
            faces=whole(shape["faces"], "faces"),
            triangles=whole(shape["triangles"], "triangles"),
            area=number(shape["area"], "area"),
            volume=number(shape["volume"], "volume"),
            shape=None if described is None else vector(described, "shape", SHAPE_LENGTH),
        ),
        task=numbers(found["task"], "task Q"),  # type: ignore[arg-type]
        plane=whole(found["plane"], "plane", 1, 12),
        flip=found["flip"],
        approach_value=number(found["approach_value"], "approach_value", -1.0, 1.0),
        approach_set=whole(found["approach_set"], "approach_set", 0, 6),
        fingers=whole(found["fingers"], "fingers", 2, 4),
        wrench=numbers(found["wrench"], "net wrench"),  # type: ignore[arg-type]
        match=number(found["match"], "match", *MATCH_LIMITS),
        created=utc(found["created"]),
        grip=None if held is None else grip(held),
        quality=None if quality is None else number(quality, "quality", *MATCH_LIMITS),
        outcome=found["outcome"],
        scene=scene,
        length_unit=found["length_unit"],
        model=found["model"],
    )


def experience_row(experience: Experience, created: str) -> Row:
    """The row of an experience, in the order of ``EXPERIENCE_COLUMNS``.

    Args:
        experience: The experience.
        created: ISO 8601 time in UTC; used if the experience has no time of its own.

    Raises:
        InputError: A field is of another type or out of range.
    """
    fields = experience_fields(experience)
    fields["created"] = fields["created"] or created
    checked = experience_from(fields)
    within(checked)
    shape = checked.attributes
    return (
        *(checked.hand, checked.kind, checked.object_name, *shape.extents.tolist()),
        *(shape.vertices, shape.vertex_normals, shape.faces, shape.triangles),
        *checked.task.tolist(),
        *(checked.plane, int(checked.flip), checked.approach_value, checked.approach_set, checked.fingers),
        *checked.wrench.tolist(),
        *(checked.match, checked.created, shape.area, shape.volume),
        *(_optional_blob(shape.shape), _optional_blob(checked.grip), checked.quality),
        *(checked.outcome or None, checked.scene, checked.length_unit, checked.model),
    )


def experience_from_row(row: Row) -> Experience:
    """The experience in a row of ``EXPERIENCE_COLUMNS``; all fields are checked.

    Raises:
        InputError: The row has a value that :func:`experience_row` would not have written.
    """
    cell = dict(zip(EXPERIENCE_COLUMNS, row, strict=True))
    fields = {name: cell[name] for name in _EXPERIENCE if name in cell}
    fields["attributes"] = {name: cell[name] for name in _ATTRIBUTES if name in cell}
    fields["attributes"]["extents"] = [cell[f"extent_{axis}"] for axis in "xyz"]
    fields["task"] = [cell[f"task_{axis}"] for axis in ("tx", "ty", "tz", "rx", "ry", "rz")]
    fields["wrench"] = [cell[f"wrench_{axis}"] for axis in ("fx", "fy", "fz", "mx", "my", "mz")]
    fields["flip"] = {0: False, 1: True}.get(cell["flip"], cell["flip"])
    fields["attributes"]["shape"] = _optional_array(cell["shape"], "shape")
    fields["grip"] = _optional_array(cell["grip"], "grip")
    fields["outcome"] = "" if cell["outcome"] is None else cell["outcome"]
    return experience_from(fields)


def superseded(experience: Experience) -> bool:
    """Whether an experience is an earlier version's first lesson with virtual grasps.

    Its cube had half the paper's size and its grasps the earlier contact model, so the first lesson is learnt
    again. Everything that a user taught stays.
    """
    return experience.kind == "seed" and experience.grip is None and experience.outdated


def weights_fields(hand: str, weights: NetworkWeights) -> dict[str, Any]:
    """Fields of a hand's weights, in the order of the export."""
    fields: dict[str, Any] = {"hand": hand}
    for name in _WEIGHTS[1:]:
        content = getattr(weights, name)
        fields[name] = content.tolist() if isinstance(content, np.ndarray) else content
    return fields


def weights_from(fields: object) -> tuple[str, NetworkWeights]:
    """The hand and the weights with these fields; all of them are checked.

    Raises:
        InputError: A field is missing, unknown or of another type, or the layers do not fit together.
    """
    found = exactly(fields, _WEIGHTS, "weights")
    weights = NetworkWeights(
        w1=numbers(found["w1"], "hidden weights", 2),  # type: ignore[arg-type]
        b1=numbers(found["b1"], "hidden biases"),  # type: ignore[arg-type]
        w2=numbers(found["w2"], "output weights", 2),  # type: ignore[arg-type]
        b2=numbers(found["b2"], "output biases"),  # type: ignore[arg-type]
        mean_square_error=number(found["mean_square_error"], "mean_square_error"),
        trained_on=whole(found["trained_on"], "trained_on"),
        epochs=whole(found["epochs"], "epochs"),
    )
    layers(weights)
    weights_within(weights)
    return text(found["hand"], "hand"), weights


def layers(weights: NetworkWeights) -> tuple[int, int, int]:
    """Number of inputs, hidden units and outputs.

    Raises:
        InputError: The layers do not fit together, or one is empty.
    """
    (hidden, inputs), outputs = weights.w1.shape, weights.b2.shape[0]
    if weights.b1.shape != (hidden,) or weights.w2.shape != (outputs, hidden) or not weights.w1.size:
        shapes = ", ".join(str(a.shape) for a in (weights.w1, weights.b1, weights.w2, weights.b2))
        raise InputError(f"weights must be (h, i), (h,), (o, h), (o,), got {shapes}")
    return inputs, hidden, outputs


def weights_row(hand: str, weights: NetworkWeights) -> Row:
    """The row of a hand's weights, with arrays as little-endian float64 in row-major order.

    Raises:
        InputError: The layers do not fit together, or a number is out of range.
    """
    weights_within(weights)
    return (
        text(hand, "hand"),
        *layers(weights),
        *(packed(weights.w1), packed(weights.b1), packed(weights.w2), packed(weights.b2)),
        number(weights.mean_square_error, "mean_square_error"),
        whole(weights.trained_on, "trained_on"),
        whole(weights.epochs, "epochs"),
    )


def weights_from_row(row: Row) -> NetworkWeights:
    """The weights in a row of ``WEIGHT_COLUMNS``; shapes and numbers are checked.

    Raises:
        InputError: An array does not have the length of its shape, or a number is not finite.
    """
    cell = dict(zip(WEIGHT_COLUMNS, row, strict=True))
    text(cell["hand"], "hand")
    inputs, hidden, outputs = (whole(cell[name], name, 1) for name in ("inputs", "hidden", "outputs"))
    return NetworkWeights(
        w1=_array(cell["w1"], (hidden, inputs), "w1"),
        b1=_array(cell["b1"], (hidden,), "b1"),
        w2=_array(cell["w2"], (outputs, hidden), "w2"),
        b2=_array(cell["b2"], (outputs,), "b2"),
        mean_square_error=number(cell["mean_square_error"], "mean_square_error"),
        trained_on=whole(cell["trained_on"], "trained_on"),
        epochs=whole(cell["epochs"], "epochs"),
    )


def packed(array: Array) -> bytes:
    """The cell of an array: its little-endian float64 numbers in row-major order."""
    return array.astype("<f8").tobytes()


def _listed(array: Array | None) -> list[float] | None:
    return None if array is None else array.tolist()


def _optional_blob(array: Array | None) -> bytes | None:
    return None if array is None else packed(array)


def _optional_array(blob: object, name: str) -> Array | None:
    """An array of any length from a cell; ``None`` for NULL."""
    if blob is None:
        return None
    if not isinstance(blob, bytes) or len(blob) % 8:
        got = f"{len(blob)} bytes" if isinstance(blob, bytes) else f"{shown(blob)}"
        raise InputError(f"{name} must be a whole number of 8-byte numbers, got {got}")
    return np.frombuffer(blob, dtype="<f8").astype(np.float64)


def _array(blob: object, shape: tuple[int, ...], name: str) -> Array:
    length = 8 * math.prod(shape)
    if not isinstance(blob, bytes) or len(blob) != length:
        got = f"{len(blob)} bytes" if isinstance(blob, bytes) else f"{shown(blob)}"
        raise InputError(f"{name} must be {length} bytes for the shape {shape}, got {got}")
    array = np.frombuffer(blob, dtype="<f8").reshape(shape).astype(np.float64)
    if not np.isfinite(array).all():
        raise InputError(f"{name} must be finite")
    return array
