"""Scenes of meshes and STL, read by trimesh, with checks where it accepts damaged files."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from logging import WARNING, LogRecord, getLogger
from logging.handlers import BufferingHandler
from typing import Any

import numpy as np

from ..exceptions import ObjectError
from . import checks
from .read_raw import RawMesh, assemble, group_rows, merge_equal
from .read_text import plain_text, printable

_STL_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


@contextmanager
def quietly() -> Iterator[list[LogRecord]]:
    """Collect trimesh's log instead of showing it; raise NumPy's warning about words among numbers."""
    log, notes = getLogger("trimesh"), BufferingHandler(1_000_000)
    level, propagate = log.level, log.propagate
    log.addHandler(notes)
    log.setLevel("DEBUG")
    log.propagate = False
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.filterwarnings("error", message="string or file could not be read")
            yield notes.buffer
    finally:
        log.removeHandler(notes)
        log.setLevel(level)
        log.propagate = propagate


def _stl_size(data: bytes) -> int:
    return 84 + 50 * int.from_bytes(data[80:84], "little")


def is_binary_stl(data: bytes) -> bool:
    """Whether the file's length is that of a binary STL with the stated number of triangles."""
    return len(data) == _stl_size(data)


def is_text_stl(data: bytes) -> bool:
    """Whether the file is a text STL; a binary STL may begin with ``solid`` too, but has the right length."""
    return not is_binary_stl(data) and data[:512].lstrip().lower().startswith(b"solid")


def read_stl(name: str, data: bytes) -> RawMesh:
    """Read an STL file; the format has no shared vertices, so equal positions are counted once [C].

    Raises:
        ObjectError: See :func:`preshape.objects.load.load_object`.
    """
    size, facets = _stl_size(data), int.from_bytes(data[80:84], "little")
    if is_text := is_text_stl(data):
        # Names may hold any byte, and trimesh would guess an encoding.
        data = plain_text(name, data, "an STL mesh").decode("ascii", "replace").encode()
        size, facets = len(data), len(re.findall(rb"(?mi)^[ \t]*facet\b", data))
    if len(data) < size:
        raise ObjectError(
            f"{name}: an STL of {facets} triangles needs {size} bytes, the file has {len(data)}; "
            "it is cut short or not an STL mesh"
        )
    if not is_text:
        return _read_binary_stl(name, data, facets)
    return read_scene(name, data[:size], "stl", {}, facets)


def _read_binary_stl(name: str, data: bytes, facets: int) -> RawMesh:
    """Read a binary STL without trimesh, whose import and copies cost more than a million triangles."""
    rows = np.frombuffer(data, _STL_FACET, facets, offset=84)
    corners = rows["corners"].reshape(-1, 3) + np.float32(0.0)  # -0 becomes 0
    checks.has_faces(name, 3 * facets, facets)
    checks.finite(name, corners, 0)
    first, place = group_rows(corners)
    return RawMesh(
        vertices=corners[first].astype(np.float64),
        triangles=place.reshape(-1, 3),
        normals=len(first),
        faces=facets,
    )


def read_scene(
    name: str,
    data: bytes,
    kind: str,
    files: dict[str, bytes],
    facets: int = -1,
    labels: Mapping[str, Sequence[str]] | None = None,
) -> RawMesh:
    """Read all meshes of a scene, place each by its node, check them and merge equal positions.

    Args:
        name: Name of the file, for messages.
        data: Content of the file.
        kind: Format of the file, as trimesh names it.
        files: Content of the files that it refers to, by name.
        facets: Number of triangles that the file announces; -1 if it announces no number.
        labels: For each node of the scene, the names of the groups that its triangles belong to.

    Raises:
        ObjectError: See :func:`preshape.objects.load.load_object`.
    """
    import trimesh

    with quietly() as notes:
        scene = trimesh.load_scene(
            io.BytesIO(data), file_type=kind, resolver=files, process=False, skip_materials=True
        )
        parts: list[Any] = scene.dump()
    for note in notes:
        text = note.getMessage()
        if kind != "stl" and (note.levelno >= WARNING or text.startswith("skipping primitive")):
            raise ObjectError(
                f"{name}: a part of the scene cannot be read ({printable(text)}); "
                "export it as plain triangles"
            )
    vertices, triangles, count = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=np.int64)], 0
    runs: list[tuple[str, int, int]] = []
    faces = 0
    for part in parts:
        own = np.asarray(getattr(part, "faces", np.zeros((0, 3))), dtype=np.int64)  # none: lines, points
        outside = (own < 0) | (own >= len(part.vertices))
        triangles.append(np.where(outside, -1, own + count))  # otherwise it would refer to another part
        vertices.append(np.asarray(part.vertices, dtype=np.float64))
        count += len(part.vertices)
        names = (labels or {}).get(str(part.metadata.get("node")), ())
        runs += [(label, faces, faces + len(own)) for label in names]
        faces += len(own)
    corners = np.concatenate(triangles)
    if facets not in (-1, len(corners)):
        raise ObjectError(
            f"{name}: expected three vertices in each facet and endsolid at the end, found {len(corners)} "
            f"complete facets of {facets}; the file is damaged or cut short"
        )
    raw = assemble(name, np.concatenate(vertices), corners.reshape(-1), np.full(len(corners), 3), runs=runs)
    merged, indices = merge_equal(raw.vertices, raw.triangles)
    return RawMesh(
        vertices=merged, triangles=indices, normals=len(merged), faces=len(indices), groups=raw.groups
    )
