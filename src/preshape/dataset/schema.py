"""The list of a shard's columns, from which the Parquet schema and the documentation are generated.

Frames: ``object`` is the frame of the mesh after scaling. ``object, COG`` has the same axes, with the centre
of the bounding box as reference point; for ``object, COM`` the reference point is the centre of mass. A
*contact list* has one entry for each contact, the thumb's first, in the same order in every column.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from typing import Any

from ..exceptions import EnvironmentFailure
from ..files import loads
from ..physics.protocol import HoldProtocol
from ..types import value
from .index_values import INDICES

FORMAT = "preshape dataset 4"
META = b"preshape"
"""Key of a shard's facts (JSON text) in the Parquet metadata."""
SUM = b"preshape sha256"
"""Key of the file's SHA-256 in the Parquet metadata, computed with ``UNSIGNED`` in its place."""
UNSIGNED = b"0" * 64
DIRECTIONS = tuple(probe.name.removeprefix("force ") for probe in HoldProtocol().loads())
"""Push directions of the holding test; lists with six entries use this order."""


@value
class Column:
    """One column.

    Attributes:
        name: Name of the column.
        kind: Type, a key of :func:`_types`.
        unit: Unit of the numbers; ``1`` for numbers without a unit, empty if the values are not numbers.
        frame: Frame of the coordinates; empty if the values are not coordinates.
        text: Meaning of the column.
        nullable: Whether values may be null.
    """

    name: str
    kind: str
    unit: str
    frame: str
    text: str
    nullable: bool = False


def _column(name: str, kind: str, unit: str, frame: str, text: str) -> Column:
    return Column(
        name=name, kind=kind.rstrip("?"), unit=unit, frame=frame, text=text, nullable=kind.endswith("?")
    )


METRICS = tuple(index for index in INDICES if index.name not in ("closed", "contacts"))
"""Indices with a column ``metric_…``."""
_METRIC_UNITS = {
    "task_margin": "N",
    "stability": "1 (rank)",
    "manipulability": "1 (rank)",
    "tfvadi": "0..6",
    "tfvadi_six": "0..6",
}

COLUMNS = (
    _column("shard", "text", "", "", "name of the shard"),
    _column("row", "int", "1", "", "number within the shard, from 0; ranked grasps: best first"),
    _column("object", "text", "", "", "name of the object"),
    _column("scale", "float", "1", "", "factor on the object's size"),
    _column("hand", "text", "", "", "name of the hand"),
    _column("task", "text", "", "", "label of the task"),
    _column("part", "int", "1", "", "number of the part, from 0"),
    _column("seed", "int", "", "", "seed of every random draw in the shard"),
    _column("ranked", "bool", "", "", "true: an answer of the planner; false: a random grasp"),
    _column("task_q", "six", "1", "object, COG", "Q = [T; R], the net wrench that the task asks for"),
    _column("plane", "int", "1..12", "", "approach plane"),
    _column("approach_axis", "three", "1", "object", "a, the plane's direction of approach"),
    _column("opposition_axis", "three", "1", "object", "o, the axis along which thumb and fingers oppose"),
    _column("flip", "bool", "", "", "whether the thumb stands on the -o side"),
    _column("approach_value", "float", "-1..1", "", "v: 0 at the object's middle along a, 1 at its far face"),
    _column("approach_set", "text", "", "", "fuzzy set with the largest membership of v, RWD-H to FWD-H"),
    _column("virtual_fingers", "int", "2..4", "", "number of virtual fingers, thumb included"),
    _column("fingers", "texts", "", "", "contact list: name of the finger"),
    _column("approach", "three", "1", "object", "direction in which the open hand moves straight in"),
    _column(
        "pregrasp_palm", "seven", "m, 1", "object", "pregrasp: palm pose x y z, w x y z; nothing touches"
    ),
    _column(
        "pregrasp_q", "list", "rad", "", "pregrasp: joint angles, in the order of `joints` in dataset.json"
    ),
    _column("grasp_palm", "seven", "m, 1", "object", "grasp: palm pose; the fingers touch"),
    _column("grasp_q", "list", "rad", "", "grasp: joint angles"),
    _column("squeeze_palm", "seven", "m, 1", "object", "squeeze: palm pose; the fingers press"),
    _column(
        "squeeze_q", "list", "rad", "", "squeeze: joint targets with which the servos press with `forces`"
    ),
    _column("torques", "list", "N m", "", "squeeze: joint torques"),
    _column("contact_points", "points", "m", "object", "contact list: position"),
    _column("contact_normals", "points", "1", "object", "contact list: unit normal into the object"),
    _column("forces", "points", "N", "object", "contact list: force on the object in the squeeze"),
    _column("press", "float", "N", "", "sum of the normal components of `forces`"),
    _column("net_wrench", "six", "1, U", "object, COG", "the paper's net wrench of unit contacts (eq. 14)"),
    _column("adi", "six", "0..1", "", "approaching degree index of each component with the task (eq. 19)"),
    _column("clearance", "float", "m", "", "least distance of the open hand to the object on its way in"),
    _column("quality", "float", "0..6", "", "the critic's measure; 3 is just enough for the load"),
    _column(
        "task_margin", "float", "1", "", "balanced load in the task's direction, in weights of the object"
    ),
    _column(
        "hold_margin", "float", "1", "", "balanced push or turn in any direction, in units of 0.7 weights"
    ),
    _column("metric_closed", "bool?", "", "", "force closure"),
    *(
        _column(
            f"metric_{index.name}",
            "float?",
            _METRIC_UNITS.get(index.name, "1"),
            "object, COM" if not index.paper else "object, COG",
            index.title + ("" if index.sign > 0 else " (less is better)"),
        )
        for index in METRICS
    ),
    _column(
        "metric_status", "statuses", "", "", "status of each metric; the metric may be null if it is not OK"
    ),
    _column("hold_status", "text?", "", "", "holding test: held lost penetrates unstable invalid"),
    _column("hold_reason", "text?", "", "", "holding test: its result in one sentence"),
    _column("held", "bool?", "", "", "whether the grasp held against all six pushes; null: no test"),
    _column(
        "held_directions", "six_bools?", "", "object", f"whether it held a push along {' '.join(DIRECTIONS)}"
    ),
    _column("hold_displacement", "six?", "m", "object", "displacement of the object under each push"),
    _column("hold_rotation", "six?", "rad", "object", "rotation of the object under each push"),
    _column(
        "touching_at_grasp", "int?", "1", "", "parts (fingers, palm) that press after closing to the grasp"
    ),
    _column("touching_at_squeeze", "int?", "1", "", "parts that press after the squeeze"),
    _column("parts_at_grasp", "int?", "1", "", "parts nearer than 2 mm at the grasp pose, before any motion"),
    _column("only_by_squeeze", "bool?", "", "", "held, but fewer than two parts are near at the grasp pose"),
    _column("clean", "bool?", "", "", "held, two parts near, penetration of the object below 1 mm"),
    _column("penetration", "float?", "m", "", "penetration of hand and object at the grasp pose"),
    _column("self_penetration", "float?", "m", "", "penetration of hand links at the grasp pose"),
    _column("contact_distance", "float?", "m", "", "mean distance of the fingers at the grasp pose, ≤ 10 mm"),
    _column("task_suits", "bool", "", "", "whether the task suits the object's shape"),
    _column("task_status", "text?", "", "", "task test: done lost penetrates unstable invalid"),
    _column("task_reason", "text?", "", "", "task test: its result in one sentence"),
    _column(
        "task_done", "bool?", "", "", "whether the grasp kept the object through the task; null: no test"
    ),
    _column("task_progress", "float?", "0..1", "", "share of the motion completed when the test ended"),
    _column("task_displacement", "float?", "m", "", "largest distance of the COG from its path"),
    _column("task_rotation", "float?", "rad", "", "largest angle from the path"),
)
"""All columns, in the order of the file."""


def markdown() -> str:
    """The columns as the table in ``docs/dataset.md``."""
    lines = ["| column | type | unit | frame | meaning |", "|---|---|---|---|---|"]
    for c in COLUMNS:
        kind = _WORDS[c.kind] + (", null" if c.nullable else "")
        lines.append(f"| `{c.name}` | {kind} | {c.unit} | {c.frame} | {c.text} |")
    return "\n".join(lines) + "\n"


_WORDS = {
    "text": "text",
    "texts": "list of text",
    "bool": "bool",
    "int": "int64",
    "float": "float64",
    "three": "3 × float64",
    "six": "6 × float64",
    "seven": "7 × float64",
    "six_bools": "6 × bool",
    "list": "list of float64",
    "points": "list of 3 × float64",
    "statuses": "struct of text",
}


def arrow() -> Any:
    """The module ``pyarrow``.

    Raises:
        EnvironmentFailure: The package is not installed.
    """
    try:
        import pyarrow
    except ImportError as error:
        raise EnvironmentFailure(
            "a dataset is written as Parquet, which needs the package pyarrow; install preshape[dataset]"
        ) from error
    return pyarrow


def _types() -> dict[str, Any]:
    pa = arrow()
    number = pa.float64()
    return {
        "text": pa.string(),
        "texts": pa.list_(pa.string()),
        "bool": pa.bool_(),
        "int": pa.int64(),
        "float": number,
        "three": pa.list_(number, 3),
        "six": pa.list_(number, 6),
        "seven": pa.list_(number, 7),
        "six_bools": pa.list_(pa.bool_(), 6),
        "list": pa.list_(number),
        "points": pa.list_(pa.list_(number, 3)),
        "statuses": pa.struct([pa.field(index.name, pa.string()) for index in INDICES]),
    }


def arrow_schema() -> Any:
    """The columns as a ``pyarrow.Schema``."""
    pa, types = arrow(), _types()
    return pa.schema([pa.field(c.name, types[c.kind], nullable=c.nullable) for c in COLUMNS])


def parquet_bytes(rows: Sequence[dict[str, Any]], facts: dict[str, Any]) -> bytes:
    """The bytes of a shard's file; the same rows and facts give the same bytes.

    Args:
        rows: For each grasp a dictionary of plain values with all columns.
        facts: Facts of the shard for its metadata, plain JSON values.
    """
    pa = arrow()
    import pyarrow.parquet as pq

    text = json.dumps(facts, sort_keys=True, allow_nan=False)
    metadata = {META: text.encode(), SUM: UNSIGNED}
    table = pa.Table.from_pylist(list(rows), schema=arrow_schema().with_metadata(metadata))
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd", write_page_checksum=True)
    content = bytes(sink.getvalue())
    place = _place_of_sum(content)
    digest = hashlib.sha256(content).hexdigest().encode()
    return content[:place] + digest + content[place + len(UNSIGNED) :]


def _place_of_sum(content: bytes) -> int:
    """Where a file's SHA-256 begins: behind its key, which stands last in the file, and a byte or two."""
    behind = content.rfind(SUM) + len(SUM)
    # Thrift writes the value's field header and its length, 64, between the key and the value.
    return behind + content[behind : behind + 4].find(bytes([len(UNSIGNED)])) + 1


def facts_of(content: bytes) -> dict[str, Any] | None:
    """The facts in a shard's file; ``None`` if the content is not a complete, undamaged shard.

    The SHA-256 is compared before Parquet is read: one wrong bit in a length there makes the reader reserve
    up to 16 GB.
    """
    pa = arrow()
    import pyarrow.parquet as pq

    place = _place_of_sum(content)
    stated = content[place : place + len(UNSIGNED)]
    unsigned = content[:place] + UNSIGNED + content[place + len(UNSIGNED) :]
    if stated != hashlib.sha256(unsigned).hexdigest().encode():
        return None
    try:
        found = pq.read_metadata(pa.BufferReader(content))
        facts: dict[str, Any] = loads((found.metadata or {})[META])
        complete = facts["format"] == FORMAT and facts["rows"] == found.num_rows
    except (OSError, ValueError, KeyError, TypeError, pa.ArrowException):
        return None
    return facts if complete else None
