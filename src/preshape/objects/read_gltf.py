"""glTF and GLB, through trimesh: every triangle of every node of the scene, where its node puts it."""

from __future__ import annotations

import io
import logging
from pathlib import Path

import numpy as np

from ..types import Array, IntArray
from .read_raw import RawMesh, assemble, merge_equal


def read_gltf(name: str, data: bytes, path: Path) -> RawMesh:
    """Read a glTF scene; equal positions are counted once [C].

    Args:
        name: the file, for messages.
        data: its content.
        path: where it lies; a ``.gltf`` file names others beside it.

    Raises:
        ObjectError: see :func:`preshape.objects.load.load_object`.
    """
    import trimesh

    logging.getLogger("trimesh").addHandler(logging.NullHandler())
    kind = "glb" if data[:4] == b"glTF" else "gltf"
    resolver = trimesh.resolvers.FilePathResolver(str(path))
    scene = trimesh.load_scene(
        io.BytesIO(data), file_type=kind, resolver=resolver, process=False, skip_materials=True
    )
    points: list[Array] = [np.zeros((0, 3))]
    faces: list[IntArray] = [np.zeros((0, 3), dtype=np.int64)]
    count = 0
    for node in scene.graph.nodes_geometry:
        transform, geometry = scene.graph[node]
        part = scene.geometry[geometry]
        here = np.asarray(part.vertices, dtype=np.float64).reshape(-1, 3)
        matrix = np.asarray(transform, dtype=np.float64)
        points.append(here @ matrix[:3, :3].T + matrix[:3, 3])
        if hasattr(part, "faces"):
            own = np.asarray(part.faces, dtype=np.int64).reshape(-1, 3)
            outside = (own < 0) | (own >= len(here))
            mirrored = np.linalg.det(matrix[:3, :3]) < 0
            moved = np.where(outside, -1, own + count)  # else it would reach into another part
            faces.append(moved[:, ::-1] if mirrored else moved)
        count += len(here)
    triangles = np.concatenate(faces)
    raw = assemble(name, np.concatenate(points), triangles.reshape(-1), np.full(len(triangles), 3))
    vertices, merged = merge_equal(raw.vertices, raw.triangles)
    return RawMesh(vertices=vertices, triangles=merged, normals=len(vertices), faces=len(merged))
