"""PLY and OFF, read by trimesh as whole polygons, with checks for damaged files that trimesh accepts.

A PLY without faces is a point cloud; its camera is read from the element ``camera``.

trimesh reads lists of different lengths from text only, so a binary PLY that has them is converted to text
first.
"""

from __future__ import annotations

import io
import re
import struct
from typing import Any

import numpy as np

from ..exceptions import ObjectError, shown
from ..types import Array, IntArray
from .read_raw import RawMesh, assemble
from .read_text import plain_text, printable
from .read_trimesh import quietly
from .scans.read_points import check_finite
from .scans.scan import RawCloud

_OFF = re.compile(r"(?:\s|#.*\n)*(?:ST)?C?N?OFF\b(?!\s*BINARY)")
_OFF_COUNTS = re.compile(r"(?:\s|#.*\n)*(\d+)[ \t]+(\d+)(?:[ \t]+\d+)?[ \t]*(?:#.*)?\n")
_FORMATS = ("ascii", "binary_little_endian", "binary_big_endian")
_INDICES = ("vertex_indices", "vertex_index")
_CODES = {
    **{"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f"},
    **{"int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f"},
    **{"double": "d", "float64": "d"},
}
_SHORT = "the file is damaged or cut short"


def is_off(data: bytes) -> bool:
    """Whether the file has the header of a text OFF mesh."""
    return _OFF.match(data[:4096].decode("utf-8-sig", "replace")) is not None


def read_off(name: str, data: bytes) -> RawMesh:
    """Read an OFF file (also COFF, NOFF, STOFF); its content is that of a text PLY with another header.

    trimesh's own OFF reader accepts missing faces and cuts concave polygons wrongly.

    Raises:
        ObjectError: See :func:`preshape.objects.load.load_object`.
    """
    text = plain_text(name, data, "an OFF mesh").decode("ascii", "replace")
    start = _OFF.match(text)
    if start is None:
        raise ObjectError(f"{name}: expected OFF in the first line; this is not an OFF mesh, or a binary one")
    counts = _OFF_COUNTS.match(text, start.end())
    if counts is None:
        raise ObjectError(f"{name}: expected the numbers of vertices and faces after OFF, found no numbers")
    points = [f"element vertex {counts[1]}", *(f"property double {axis}" for axis in "xyz")]
    faces = [f"element -face {counts[2]}", "property list int int64 vertex_indices"]
    return _mesh(name, *_read(name, "ascii", [*points, *faces], text[counts.end() :]))


def read_ply(name: str, data: bytes) -> RawMesh | RawCloud:
    """Read a PLY file; the stated vertices are counted, with one normal each [C].

    A file without faces and triangle strips is a point cloud.

    Raises:
        ObjectError: See :func:`preshape.objects.load.load_object`.
    """
    at = data.find(b"end_header")
    end = data.find(b"\n", at) + 1
    if not data.startswith(b"ply") or at < 0 or not end:
        raise ObjectError(f"{name}: expected a header from ply to end_header; this is not a PLY mesh")
    form, elements = "", list[str]()
    for line in data[:at].decode("ascii", "replace").splitlines()[1:]:
        match line.split():
            case ["format", form, *_]:
                pass
            case ["element", kind, count] if count.isdecimal():
                # Under their own names, trimesh would cut faces into fans and turn edges into paths.
                elements.append(f"element {kind if kind == 'vertex' else '-' + kind} {count}")
            case ["property", *_]:
                elements.append(line)
            case [] | ["comment" | "obj_info", *_]:
                pass
            case _:
                raise ObjectError(f"{name}: the PLY header has an unknown line {shown(line)}")
    if form not in _FORMATS:
        raise ObjectError(f"{name}: the PLY header names no format; known: {', '.join(_FORMATS)}")
    body: str | bytes = data[end:]
    if form == "ascii":
        body = plain_text(name, data[end:], "a text PLY mesh").decode("ascii", "replace")
    vertices, raw, rows = _read(name, form, elements, body)
    if len(vertices) and not raw.get("-face", {"length": 0})["length"] and "-tristrips" not in raw:
        _faces(name, raw, rows)  # refuses a file that is cut short
        check_finite(name, vertices, no_echo=False)
        return RawCloud(points=vertices, camera=_camera(raw))
    return _mesh(name, vertices, raw, rows)


def _read(
    name: str, form: str, elements: list[str], body: str | bytes
) -> tuple[Array, dict[str, Any], list[str] | None]:
    """Vertices, the elements as trimesh reads them with whole polygons, and the rows of a text file."""
    from trimesh.exchange.ply import load_ply

    rows: list[str] | None = None
    if isinstance(body, str):
        rows = [row for line in body.splitlines() if (row := line.partition("#")[0].strip())]
        body = "\n".join(rows).encode()
    header = "\n".join(["ply", f"format {form} 1.0", *elements, "end_header\n"]).encode()
    try:
        with quietly(), np.errstate(invalid="raise"):  # NaN must not become an index
            found = load_ply(io.BytesIO(header + body), skip_materials=True)
        raw = found["metadata"]["_ply_raw"]
        if rows is None and not all(_alike(element["data"]) for element in raw.values()):
            raise ValueError("unexpected lengths whose sum is right")
    except ValueError as error:
        if "unexpected length" not in str(error):
            raise
        try:
            return _read(name, "ascii", elements, _as_text(form, elements, body))
        except struct.error:
            raise ObjectError(
                f"{name}: {len(body)} bytes are fewer than the PLY header announces; {_SHORT}"
            ) from error
    return np.asarray(found.get("vertices", np.zeros((0, 3))), dtype=np.float64), raw, rows


def _mesh(name: str, vertices: Array, raw: dict[str, Any], rows: list[str] | None) -> RawMesh:
    corners, sizes = _faces(name, raw, rows)
    return assemble(name, vertices, corners, sizes)


def _camera(raw: dict[str, Any]) -> Array | None:
    """(3,) position of the camera in the file's unit, from the element that PCL writes, or ``None``."""
    table = raw.get("-camera", {"length": 0})
    words = ("view_px", "view_py", "view_pz")
    if not table["length"] or not set(words) <= set(table["properties"]):
        return None
    place = np.array([float(np.ravel(table["data"][word])[0]) for word in words])
    return place if np.isfinite(place).all() and place.any() else None


def _alike(table: Any) -> bool:
    """Whether the lists of a binary element have the same length in every row, as trimesh assumes."""
    lists = [table[word] for word, (kind, _) in table.dtype.fields.items() if kind.names]
    return all((column["f0"] == column["f1"].shape[1]).all() for column in lists)


def _as_text(form: str, elements: list[str], body: bytes) -> str:
    """A binary body as rows of text."""
    mark = ">" if form == "binary_big_endian" else "<"
    plan: list[tuple[int, list[list[str]]]] = []
    for word, *words in map(str.split, elements):
        if word == "element":
            plan.append((int(words[1]), []))
        else:
            plan[-1][1].append([_CODES[kind] for kind in words[:-1] if kind != "list"])
    rows, at = list[str](), 0
    for count, properties in plan:
        for _ in range(count if properties else 0):
            row: list[float] = []
            for *length, kind in properties:
                for code in length:
                    row += struct.unpack_from(mark + code, body, at)
                    at += struct.calcsize(mark + code)
                code = f"{mark}{int(row[-1]) if length else 1}{kind}"
                row += struct.unpack_from(code, body, at)
                at += struct.calcsize(code)
            rows.append(" ".join(map(repr, row)))
    return "\n".join(rows)


def _faces(name: str, raw: dict[str, Any], rows: list[str] | None) -> tuple[IntArray, IntArray]:
    """Corners of all polygons, and the number of corners of each; refuses missing and short rows."""
    before = 0
    for kind, element in raw.items():
        if rows is not None and len(rows) < before + element["length"]:
            found = max(0, len(rows) - before)
            raise ObjectError(
                f"{name}: expected {element['length']} of {printable(kind.lstrip('-'), 40)}, "
                f"found {found}; {_SHORT}"
            )
        if kind == "-face":
            break
        before += element["length"]
    face = raw.get("-face", {"length": 0, "properties": {}})
    count, columns = face["length"], list(face["properties"])
    column = next((word for word in _INDICES if word in columns), None)
    if not count or column is None:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    lists, stated = face["data"][column], None
    if rows is None:
        lists = lists["f1"]
    elif not any("$LIST" in face["properties"][word] for word in columns[: columns.index(column)]):
        place = columns.index(column)
        stated = np.array([float(row.split(None, place + 1)[place]) for row in rows[before : before + count]])
    if lists.dtype == object:
        sizes, corners = np.array([len(own) for own in lists]), np.concatenate(list(lists))
    else:
        sizes, corners = np.full(count, lists.size // count), lists.reshape(-1)
    if stated is not None and (wrong := stated != sizes).any():
        at = int(wrong.argmax())
        raise ObjectError(
            f"{name}: face {at + 1} of {count} announces {stated[at]:g} corners, found {sizes[at]}; {_SHORT}"
        )
    return corners.astype(np.int64), sizes
