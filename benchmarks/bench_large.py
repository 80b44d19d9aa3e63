"""An answer for a mesh of a million triangles: CPU time and peak memory, from the file to the grip.

The mesh is a library object whose triangles are divided until there are a million, with noise as a scanner
adds it. The answer is right if the program finds a grip whose contacts lie on the object without noise.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from preshape.kernels.field.host import SurfaceQuery
from preshape.objects.library import load_library_object
from preshape.objects.mesh import TriangleMesh

from .common import row

OBJECT, TRIANGLES, NOISE = "banana", 1_000_000, 5e-5
SECONDS, MEGABYTES = 8.0, 1000.0
NEAR = 1e-3  # m; the noise, and a fingertip on the edge between two triangles

# A first plan teaches the hand to the memory and builds the kernels; then only the large mesh is new.
FIRST = """
from preshape import plan
plan(name, "lift", hand="shadow", memory=memory)
"""
LARGE = """
import resource, time
from preshape import plan
made = plan(name, "lift", hand="shadow", memory=memory, learn=False, mass=0.1, table=None)
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e6
points = made.grasp.contacts.points.tolist() if made.grasp is not None else []
print(json.dumps([time.process_time(), peak, len(made.mesh.triangles), made.mesh.volume, points]))
"""


def divided(mesh: TriangleMesh, least: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a mesh whose triangles were cut in four until they suffice, with noise."""
    import trimesh

    vertices, faces = np.array(mesh.vertices), np.array(mesh.triangles)
    while len(faces) < least:
        vertices, faces = trimesh.remesh.subdivide(vertices, faces)
    return vertices + np.random.default_rng(seed).normal(0.0, NOISE, vertices.shape), faces


def answer(code: str, name: str, folder: Path) -> list[Any]:
    """What one program prints, run in a process of its own with caches in a folder."""
    head = f"import json, os, sys\nos.environ['PRESHAPE_CACHE'] = {str(folder / 'cache')!r}\n"
    head += f"name, memory = {name!r}, {str(folder / 'memory.sqlite')!r}\n"
    done = subprocess.run([sys.executable, "-c", head + code], capture_output=True, text=True, check=True)
    return list(json.loads(done.stdout)) if done.stdout else []


def run(triangles: int = TRIANGLES) -> list[dict[str, Any]]:
    """Plan for the same mesh in a binary STL and in a binary PLY file."""
    import trimesh

    true = load_library_object(OBJECT)
    vertices, faces = divided(true, triangles)
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        answer(FIRST, OBJECT, folder)
        for kind in ("stl", "ply"):
            file = folder / f"large.{kind}"
            trimesh.Trimesh(vertices, faces, process=False).export(file)
            cpu, peak, found, volume, points = answer(LARGE, str(file), folder)
            right = found == len(faces) and abs(volume / true.volume - 1) < 0.01 and len(points) >= 2
            right = right and bool((np.abs(SurfaceQuery(true).closest(points).distance) < NEAR).all())
            what = f"plan for {found / 1e6:.2g} million triangles, {kind.upper()}"
            rows.append(row(f"{what}: CPU", cpu, "s", SECONDS, None, right))
            rows.append(row(f"{what}: peak memory", peak, "MB", MEGABYTES, None, right))
    return rows
