"""The columns of a shard: name, kind, unit, frame and meaning, in one list; Parquet is made from it.

Frames: ``object`` is the mesh's own after scale, ``object, COG`` its axes about the centre of the bounding
box, ``object, COM`` about the centre of mass. A *contact list* has the thumb's contact first, and the same
order in every column.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from ..exceptions import EnvironmentFailure
from ..physics.protocol import HoldProtocol
from ..types import value
from .index_values import INDICES

FORMAT = "preshape dataset 1"
META = b"preshape"
"""Key of the file's own facts, a JSON text, among the metadata of a shard."""
DIRECTIONS = tuple(probe.name.removeprefix("force ") for probe in HoldProtocol().loads())
"""Order of the lists of six."""


@value
class Column:
    """One column.

    Attributes:
        name: its name.
        kind: a key of :func:`_types`.
        unit: of its numbers, ``1`` without one, empty for what is no number.
        frame: of its coordinates, or empty.
        text: what it means.
        nullable: whether it may be null.
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
"""Indices that have a column ``metric_…``."""
_METRIC_UNITS = {
    "task_margin": "N",
    "stability": "1 (rank)",
    "manipulability": "1 (rank)",
    "tfvadi": "0..6",
    "tfvadi_six": "0..6",
}

COLUMNS = (
    _column("shard", "text", "", "", "name of the shard"),
    _column("row", "int", "1", "", "number within the shard, from 0; of ranked grasps the best first"),
    _column("object", "text", "", "", "name of the object"),
    _column("scale", "float", "1", "", "factor on its size"),
    _column("hand", "text", "", "", "name of the hand"),
    _column("task", "text", "", "", "label of the task"),
    _column("part", "int", "1", "", "number of the part, from 0"),
    _column("seed", "int", "", "", "of everything random in the shard"),
    _column("ranked", "bool", "", "", "the planner's answer; false: closed at random, whatever it is worth"),
    _column("task_q", "six", "1", "object, COG", "Q = [T; R], what the task asks for"),
    _column("plane", "int", "1..12", "", "approach plane"),
    _column("approach_axis", "three", "1", "object", "a, the plane's direction of approach"),
    _column("opposition_axis", "three", "1", "object", "o, along which thumb and fingers oppose"),
    _column("flip", "bool", "", "", "the thumb stands on the -o side"),
    _column("approach_value", "float", "-1..1", "", "v: 0 the object's middle along a, 1 its far face"),
    _column("approach_set", "text", "", "", "fuzzy set that v belongs to most, RWD-H to FWD-H"),
    _column("virtual_fingers", "int", "2..4", "", "virtual fingers, the thumb included"),
    _column("fingers", "texts", "", "", "contact list: name of the finger"),
    _column("approach", "three", "1", "object", "direction in which the opened hand moves straight in"),
    _column("pregrasp_palm", "seven", "m, 1", "object", "palm pose x y z, w x y z: opened, clear"),
    _column("pregrasp_q", "list", "rad", "", "joint angles of it, in the order of `joints` in dataset.json"),
    _column("grasp_palm", "seven", "m, 1", "object", "palm pose where the fingers touch"),
    _column("grasp_q", "list", "rad", "", "joint angles of it"),
    _column("squeeze_palm", "seven", "m, 1", "object", "palm pose where the hand presses"),
    _column("squeeze_q", "list", "rad", "", "targets of the joints' servos that press with `forces`"),
    _column("torques", "list", "N m", "", "joint torques of the squeeze"),
    _column("contact_points", "points", "m", "object", "contact list: where the finger touches"),
    _column("contact_normals", "points", "1", "object", "contact list: unit normals into the object"),
    _column(
        "forces", "points", "N", "object", "contact list: what the contact does to the object, squeezing"
    ),
    _column("press", "float", "N", "", "sum of the normal parts of `forces`"),
    _column("net_wrench", "six", "1, U", "object, COG", "the paper's net wrench of unit contacts (eq. 14)"),
    _column("adi", "six", "0..1", "", "approaching degree index of each component with the task (eq. 19)"),
    _column("clearance", "float", "m", "", "least distance to the object, opened and on the way in"),
    _column("quality", "float", "0..6", "", "what the critic judges; 3 is just enough"),
    _column("task_margin", "float", "1", "", "load along the task's cone that is balanced, in weights"),
    _column("hold_margin", "float", "1", "", "pushes and turns in any direction, over 0.7 weights"),
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
    _column("metric_status", "statuses", "", "", "of each metric; where it is not OK the metric may be null"),
    _column("hold_status", "text?", "", "", "of the holding test: held lost penetrates unstable invalid"),
    _column("hold_reason", "text?", "", "", "one sentence on it"),
    _column("held", "bool?", "", "", "held against all six pushes; null: not tested, or it could not be"),
    _column("held_directions", "six_bools?", "", "object", f"held a push along {' '.join(DIRECTIONS)}"),
    _column("hold_displacement", "six?", "m", "object", "how far the object moved under each push"),
    _column("hold_rotation", "six?", "rad", "object", "how far it turned under each push"),
    _column("touching_at_grasp", "int?", "1", "", "parts (fingers, palm) pressing, come to the grasp"),
    _column("touching_at_squeeze", "int?", "1", "", "parts pressing, come to the squeeze"),
    _column("parts_at_grasp", "int?", "1", "", "parts nearer than 2 mm at the grasp pose, before any motion"),
    _column("only_by_squeeze", "bool?", "", "", "held, but fewer than two parts are near at the grasp pose"),
    _column("clean", "bool?", "", "", "held, two parts near, cuts into the object less than 1 mm"),
    _column("penetration", "float?", "m", "", "hand into object at the grasp pose"),
    _column("self_penetration", "float?", "m", "", "hand into itself at the grasp pose"),
    _column("contact_distance", "float?", "m", "", "mean distance of the fingers at the grasp pose, ≤ 10 mm"),
    _column("task_suits", "bool", "", "", "whether the task makes sense for the object's shape"),
    _column("task_status", "text?", "", "", "of the task test: done lost penetrates unstable invalid"),
    _column("task_reason", "text?", "", "", "one sentence on it"),
    _column(
        "task_done", "bool?", "", "", "took the object along the task; null: not tested, or could not be"
    ),
    _column("task_progress", "float?", "0..1", "", "share of the way when the test ended"),
    _column("task_displacement", "float?", "m", "", "largest distance of the COG from its path"),
    _column("task_rotation", "float?", "rad", "", "largest angle from the path"),
)
"""All columns, in their order."""


def markdown() -> str:
    """The columns as a table of ``docs/dataset.md``."""
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
        EnvironmentFailure: it is not installed.
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
    """A shard's file; the same rows and facts give the same bytes.

    Args:
        rows: a dictionary of plain values for each grasp, with all columns.
        facts: of the shard, for its metadata: plain JSON values.
    """
    pa = arrow()
    import pyarrow.parquet as pq

    text = json.dumps(facts, sort_keys=True, allow_nan=False)
    table = pa.Table.from_pylist(list(rows), schema=arrow_schema().with_metadata({META: text.encode()}))
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd", write_page_checksum=True)
    return bytes(sink.getvalue())


def facts_of(content: bytes) -> dict[str, Any] | None:
    """The facts in a shard's file; ``None`` where it is no whole shard."""
    pa = arrow()
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(pa.BufferReader(content), page_checksum_verification=True)
        facts: dict[str, Any] = json.loads((table.schema.metadata or {})[META])
        # The checksums leave out the headers: what is read must give this very file again.
        whole = facts["format"] == FORMAT and facts["rows"] == table.num_rows
        whole = whole and parquet_bytes(table.to_pylist(), facts) == content
    except (OSError, ValueError, KeyError, TypeError, pa.ArrowException):
        return None
    return facts if whole else None
