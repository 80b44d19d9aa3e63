"""OFF, text: counts, vertices, polygons."""

from __future__ import annotations

import re

import numpy as np

from ..exceptions import ObjectError
from .read_raw import RawMesh, assemble
from .read_text import Lines

_HEADER = re.compile(rb"\s*(?:#[^\n]*\n\s*)*(?:ST)?C?N?OFF\b")


def is_off(data: bytes) -> bool:
    """Whether the file says that it is an OFF mesh."""
    return _HEADER.match(data.removeprefix(b"\xef\xbb\xbf")[:4096]) is not None


def read_off(name: str, data: bytes) -> RawMesh:
    """Read an OFF file (also COFF, NOFF and STOFF, whose colours and normals are passed over).

    Raises:
        ObjectError: see :func:`preshape.objects.load.load_object`.
    """
    data = data.removeprefix(b"\xef\xbb\xbf")
    header = _HEADER.match(data)
    if header is None:
        raise ObjectError(f"{name}: expected OFF in the first line, this is not an OFF mesh")
    if re.match(rb"[ \t]+BINARY", data[header.end() :]):
        raise ObjectError(f"{name}: this is a binary OFF file, only text ones are read; export it as text")
    # Blanks in its place keep the line numbers of the messages right.
    data = re.sub(rb"[^\n\r]", b" ", header.group()) + data[header.end() :]
    lines = Lines(name, data, "an OFF mesh")
    content = np.flatnonzero(lines.with_content())
    head = lines.table(_only(lines, content[:1]), integers=True)
    if len(head.values) not in (2, 3) or (head.values < 0).any():
        raise ObjectError(f"{name}: expected the numbers of vertices and faces after OFF, found none")
    vertices, faces = (int(count) for count in head.values[:2])
    if len(content) < 1 + vertices + faces:
        raise ObjectError(
            f"{name}: expected {vertices} vertices and {faces} faces, found {len(content) - 1} lines; "
            "the file is cut short"
        )
    points = lines.table(_only(lines, content[1 : 1 + vertices]))
    polygons = lines.table(_only(lines, content[1 + vertices : 1 + vertices + faces]))
    if (points.counts < 3).any():
        at = int(points.lines[(points.counts < 3).argmax()])
        raise ObjectError(f"{name}: line {at} should hold x, y and z, found {lines.text(at - 1)!r}")
    first = polygons.values[polygons.starts]
    if not ((first >= 0) & (first < polygons.counts)).all():
        at = int(polygons.lines[(~((first >= 0) & (first < polygons.counts))).argmax()])
        raise ObjectError(
            f"{name}: line {at} should hold a number of corners and as many vertices, "
            f"found {lines.text(at - 1)!r}; the file is damaged or cut short"
        )
    sizes = first.astype(np.int64)
    begin = np.cumsum(sizes) - sizes
    place = np.arange(int(sizes.sum())) - np.repeat(begin - polygons.starts - 1, sizes)
    with np.errstate(invalid="ignore"):
        corners = polygons.values[place].astype(np.int64)
    return assemble(name, points.columns(0, 3), corners, sizes)


def _only(lines: Lines, chosen: np.ndarray) -> np.ndarray:
    mask = np.zeros(len(lines.starts), dtype=bool)
    mask[chosen] = True
    return mask
