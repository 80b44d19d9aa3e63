"""Wavefront OBJ (§2.1): vertices, vertex normals, polygons, and names of objects, groups and materials."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from ..exceptions import ObjectError
from ..types import IntArray
from .read_raw import RawMesh, assemble
from .read_text import Lines


def read_obj(name: str, data: bytes) -> RawMesh:
    """Read an OBJ file; all objects and groups become one mesh, which knows the triangles of each.

    Corners with the same ``v`` number share a vertex, so seams of texture or normals do not cut the surface.
    Negative numbers count back from the line of the face. The counts of table 2 are those of the ``v``,
    ``vn`` and ``f`` lines; a file without ``vn`` counts one normal for each vertex [C].

    Raises:
        ObjectError: See :func:`preshape.objects.load.load_object`.
    """
    if b"\\" in data:
        data = re.sub(rb"\\[ \t]*\r?\n", b" ", data)
    lines = Lines(name, data, "an OBJ mesh")
    is_vertex, is_face = lines.starting_with(b"v"), lines.starting_with(b"f")
    if not is_vertex.any() and not is_face.any():
        raise ObjectError(
            f"{name}: found no vertex and no face lines, this is not an OBJ mesh; "
            "check the file and its suffix"
        )
    rows = lines.rows(is_vertex, skip=1)
    short = rows.counts < 3
    if short.any():
        at = int(rows.lines[short.argmax()])
        raise ObjectError(
            f"{name}: line {at} should hold x, y and z, found {lines.text(at - 1)!r}; "
            "the file is damaged or cut short"
        )
    vertices = rows.columns(0, 3)
    faces = lines.rows(is_face, skip=1, integers=True)
    written = faces.values
    corners = written - 1
    relative = written < 0
    if relative.any():
        before = np.cumsum(is_vertex)[faces.lines - 1]
        corners[relative] = (written + np.repeat(before, faces.counts))[relative]
    return assemble(
        name,
        vertices,
        corners,
        faces.counts,
        normals=int(lines.starting_with(b"vn").sum()),
        first=1,
        written=written,
        runs=_runs(lines, faces.lines),
    )


def _runs(lines: Lines, faces: IntArray) -> Iterator[tuple[str, int, int]]:
    """Name, first face and face after the last of each object, group and material.

    Args:
        lines: The file.
        faces: (faces,) number of the line of each face, from 1.
    """
    for word in (b"o", b"g", b"usemtl"):
        marks = np.flatnonzero(lines.starting_with(word))
        starts = np.searchsorted(faces, marks + 1)
        for line, first, after in zip(marks, starts, np.append(starts, len(faces))[1:], strict=True):
            if first < after:
                text = lines.after(line, word)
                # A face may be in several groups; names of objects and materials may have blanks.
                for name in dict.fromkeys(text.split() if word == b"g" else [text]):
                    yield name, int(first), int(after)
