"""PLY, text and binary, either byte order: the elements ``vertex`` and ``face``; others are passed over."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..exceptions import ObjectError
from ..types import Array, IntArray
from .read_raw import RawMesh, assemble
from .read_text import Lines

_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"},
}
_ORDER = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_INDICES = ("vertex_indices", "vertex_index")


class Property(NamedTuple):
    """One property; ``length`` is the type of a list's length, empty for a single number."""

    name: str
    kind: str
    length: str


class Element(NamedTuple):
    """One element of the header."""

    name: str
    rows: int
    properties: tuple[Property, ...]

    def index_of(self, names: tuple[str, ...]) -> int:
        """Which property has one of these names; -1 for none."""
        return next((k for k, p in enumerate(self.properties) if p.name in names), -1)


def read_ply(name: str, data: bytes) -> RawMesh:
    """Read a PLY file. Its vertices are counted as they stand, with one normal each [C].

    Raises:
        ObjectError: see :func:`preshape.objects.load.load_object`.
    """
    form, elements, body = _header(name, data)
    read = _from_text if form == "ascii" else _from_binary
    vertices, corners, sizes, strips = np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros(0, np.int64), False
    for element, columns in read(name, body, form, elements):
        if element.name == "vertex":
            vertices = _positions(name, element, columns)
        elif element.name == "face" and (place := element.index_of(_INDICES)) >= 0:
            corners, sizes = columns[place]
        strips |= element.name == "tristrips"
    if strips and not len(sizes):
        raise ObjectError(
            f"{name}: the surface is given as triangle strips, only faces are read; re-export it"
        )
    return assemble(name, vertices, corners, sizes)


def _header(name: str, data: bytes) -> tuple[str, list[Element], bytes]:
    """Format, elements, and what follows the header."""
    end = data.find(b"end_header")
    stop = data.find(b"\n", end)
    if not data.startswith(b"ply") or end < 0 or stop < 0:
        raise ObjectError(f"{name}: expected a header from ply to end_header, this is not a PLY mesh")
    form, elements = "", list[Element]()
    for line in data[:end].decode("latin-1").splitlines()[1:]:
        match line.split():
            case ["format", word, *_] if word in _ORDER:
                form = word
            case ["element", word, count] if count.isdecimal():
                elements.append(Element(word, int(count), ()))
            case ["property", "list", length, kind, word] if elements and {length, kind} <= _TYPES.keys():
                elements[-1] = _with(elements[-1], Property(word, _TYPES[kind], _TYPES[length]))
            case ["property", kind, word] if elements and kind in _TYPES:
                elements[-1] = _with(elements[-1], Property(word, _TYPES[kind], ""))
            case [] | ["comment", *_] | ["obj_info", *_]:
                pass
            case _:
                raise ObjectError(f"{name}: cannot make sense of {line!r:.60} in the PLY header")
    if not form:
        raise ObjectError(f"{name}: the PLY header names no format; known: {', '.join(_ORDER)}")
    return form, elements, data[stop + 1 :]


def _with(element: Element, new: Property) -> Element:
    return element._replace(properties=(*element.properties, new))


def _positions(name: str, element: Element, columns: list[Any]) -> Array:
    places = [element.index_of((axis,)) for axis in "xyz"]
    if min(places) < 0 or any(element.properties[k].length for k in places):
        raise ObjectError(f"{name}: expected vertices with x, y and z; the PLY header has no such properties")
    with np.errstate(invalid="ignore"):
        return np.stack([np.asarray(columns[k], dtype=np.float64) for k in places], axis=1)


def _cut_short(name: str, element: Element) -> ObjectError:
    return ObjectError(
        f"{name}: expected {element.rows} of {element.name}, the file ends earlier or does not hold them; "
        "it is damaged or cut short"
    )


def _integers(found: NDArray[Any]) -> IntArray:
    with np.errstate(invalid="ignore"):  # NaN and huge numbers become indices that are out of range
        return found.astype(np.int64)


def _from_text(name: str, body: bytes, form: str, elements: list[Element]) -> Any:
    """Each element with its columns; a list is a pair of flat values and lengths."""
    lines = Lines(name, body, "a text PLY mesh")
    content = np.flatnonzero(lines.with_content())
    for element in elements:
        mine, content = content[: element.rows], content[element.rows :]
        if len(mine) < element.rows:
            raise _cut_short(name, element)
        mask = np.zeros(len(lines.starts), dtype=bool)
        mask[mine] = True
        table = lines.table(mask)
        at = table.starts.copy()
        stop = table.starts + table.counts
        columns: list[Any] = []
        for item in element.properties:
            if (at >= stop).any():
                raise _cut_short(name, element)
            first = table.values[at]
            at = at + 1
            if not item.length:
                columns.append(first)
                continue
            sizes = _integers(first)
            if ((sizes < 0) | (sizes > stop - at)).any():
                raise _cut_short(name, element)
            begin = np.cumsum(sizes) - sizes
            place = np.arange(int(sizes.sum())) + np.repeat(at - begin, sizes)
            columns.append((_integers(table.values[place]), sizes))
            at = at + sizes
        yield element, columns


def _from_binary(name: str, body: bytes, form: str, elements: list[Element]) -> Any:
    """Each element with its columns; a list is a pair of flat values and lengths."""
    order = _ORDER[form]
    offset = 0
    for element in elements:
        if not element.properties or not element.rows:
            yield element, [_empty(item) for item in element.properties]
            continue
        columns, offset = _rows(name, body, offset, order, element)
        yield element, columns


def _empty(item: Property) -> Any:
    none = np.zeros(0, dtype=np.int64)
    return (none, none) if item.length else none


def _rows(name: str, body: bytes, offset: int, order: str, element: Element) -> tuple[list[Any], int]:
    """The rows of one element, at once where every list is as long as in the first row, else one by one."""
    lists = [item for item in element.properties if item.length]
    lengths, _ = _lengths(name, body, offset, order, element)
    fields: list[Any] = []
    for k, item in enumerate(element.properties):
        if item.length:
            fields.append((f"n{k}", order + item.length))
            fields.append((f"p{k}", order + item.kind, (lengths[lists.index(item)],)))
        else:
            fields.append((f"p{k}", order + item.kind))
    record = np.dtype(fields)
    fitting = min(element.rows, (len(body) - offset) // record.itemsize)
    if fitting < element.rows and not lists:
        raise _cut_short(name, element)
    rows = np.frombuffer(body, dtype=record, count=fitting, offset=offset)
    same = fitting == element.rows
    for k, item in enumerate(element.properties):
        if same and item.length:
            same = bool((rows[f"n{k}"] == lengths[lists.index(item)]).all())
    if not same:
        return _one_by_one(name, body, offset, order, element)
    columns: list[Any] = []
    for k, item in enumerate(element.properties):
        found = rows[f"p{k}"]
        if item.length:
            sizes = np.full(element.rows, found.shape[1], dtype=np.int64)
            columns.append((_integers(found.reshape(-1)), sizes))
        else:
            columns.append(found)
    return columns, offset + record.itemsize * element.rows


def _lengths(name: str, body: bytes, offset: int, order: str, element: Element) -> tuple[list[int], int]:
    """Lengths of one row's lists, and where the row ends."""
    lengths = []
    for item in element.properties:
        size = np.dtype(item.kind).itemsize
        if item.length:
            width = np.dtype(item.length).itemsize
            if offset + width > len(body):
                raise _cut_short(name, element)
            with np.errstate(invalid="ignore"):
                length = float(np.frombuffer(body, order + item.length, 1, offset)[0])
            if not 0 <= length * size <= len(body) - offset - width:
                raise _cut_short(name, element)
            lengths.append(int(length))
            offset += width + int(length) * size
        else:
            offset += size
    if offset > len(body):
        raise _cut_short(name, element)
    return lengths, offset


def _one_by_one(name: str, body: bytes, offset: int, order: str, element: Element) -> tuple[list[Any], int]:
    """Rows whose lists differ in length; only the lists are kept, nobody asks for the rest."""
    lists: list[list[NDArray[Any]]] = [[] for _ in element.properties]
    for _ in range(element.rows):
        start = offset
        lengths, offset = _lengths(name, body, start, order, element)
        for k, item in enumerate(element.properties):
            if item.length:
                length = lengths.pop(0)
                start += np.dtype(item.length).itemsize
                lists[k].append(np.frombuffer(body, order + item.kind, length, start))
                start += length * np.dtype(item.kind).itemsize
            else:
                start += np.dtype(item.kind).itemsize
    columns: list[Any] = []
    for item, rows in zip(element.properties, lists, strict=True):
        sizes = np.array([len(row) for row in rows], dtype=np.int64)
        columns.append((_integers(np.concatenate(rows)), sizes) if item.length else np.zeros(element.rows))
    return columns, offset
