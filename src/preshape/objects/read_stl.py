"""STL, text and binary: a soup of triangles, whose equal corners become one vertex."""

from __future__ import annotations

import numpy as np

from ..exceptions import ObjectError
from ..types import Array
from .read_raw import RawMesh, assemble, merge_equal
from .read_text import Lines

_HEADER, _RECORD = 84, 50


def read_stl(name: str, data: bytes) -> RawMesh:
    """Read an STL file; the format has no vertices of its own, equal positions are counted once [C].

    Raises:
        ObjectError: see :func:`preshape.objects.load.load_object`.
    """
    corners = _text(name, data) if is_text(data) else _binary(name, data)
    raw = assemble(name, corners, np.arange(len(corners)), np.full(len(corners) // 3, 3))
    vertices, triangles = merge_equal(raw.vertices, raw.triangles)
    return RawMesh(vertices=vertices, triangles=triangles, normals=len(vertices), faces=len(triangles))


def is_text(data: bytes) -> bool:
    """Whether this is a text STL; some binary ones begin with ``solid`` too, but fit their length."""
    return not fits(data) and data[:512].lstrip().lower().startswith(b"solid")


def fits(data: bytes) -> bool:
    """Whether the file is exactly as long as its number of triangles says."""
    return len(data) > _HEADER and len(data) == _HEADER + _RECORD * _triangles(data)


def _triangles(data: bytes) -> int:
    return int.from_bytes(data[80:84], "little")


def _binary(name: str, data: bytes) -> Array:
    if len(data) < _HEADER:
        raise ObjectError(
            f"{name}: found {len(data)} bytes, a binary STL has {_HEADER} or more; this is not an STL mesh"
        )
    count = _triangles(data)
    wanted = _HEADER + _RECORD * count
    if len(data) < wanted:
        raise ObjectError(
            f"{name}: an STL of {count} triangles needs {wanted} bytes, the file has {len(data)}; "
            "it is cut short or not an STL mesh"
        )
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    found = np.frombuffer(data, dtype=record, count=count, offset=_HEADER)
    with np.errstate(invalid="ignore"):  # a signalling NaN is reported later, with its place
        return found["corners"].astype(np.float64).reshape(-1, 3)


def _text(name: str, data: bytes) -> Array:
    lines = Lines(name, data.lower(), "an STL mesh")
    table = lines.table(lines.starting_with(b"vertex"), skip=6)
    if (table.counts != 3).any():
        at = int(table.lines[(table.counts != 3).argmax()])
        raise ObjectError(
            f"{name}: line {at} should hold x, y and z, found {lines.text(at - 1)!r}; "
            "the file is damaged or cut short"
        )
    facets = int(lines.starting_with(b"facet").sum())
    if len(table.counts) != 3 * facets or not lines.starting_with(b"endsolid").any():
        raise ObjectError(
            f"{name}: expected three vertices a facet and a closing endsolid, found {len(table.counts)} "
            f"vertices in {facets} facets; the file is damaged or cut short"
        )
    return table.columns(0, 3)
