"""Reading a large OBJ file: time and peak memory beside trimesh, for a torus with exactly known measures."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from .common import row

SIDE = 708  # 2 · 708² = 1 002 528 triangles
RING, TUBE = 0.05, 0.02
SECONDS, MEGABYTES = 3.0, 1000.0

# Each reader runs in a process of its own, to measure its own peak memory. The time includes its imports.
OURS = """
from preshape.objects.load import load_object
mesh = load_object(path)
normals = mesh.normals
attributes = mesh.attributes
answer = [attributes.triangles, attributes.vertices, *mesh.extents, attributes.area, attributes.volume]
"""
TRIMESH = """
import trimesh
mesh = trimesh.load(path, process=False, force="mesh")
normals = mesh.face_normals
answer = [len(mesh.faces), len(mesh.vertices), *mesh.extents, mesh.area, mesh.volume]
"""
FRAME = """
import json, resource, sys, time
import numpy
path, start, before = sys.argv[1], time.perf_counter(), time.process_time()
{code}
seconds = time.perf_counter() - start
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e6
print(json.dumps([time.process_time() - before, seconds, peak, [float(number) for number in answer]]))
"""


def torus(path: Path, side: int = SIDE) -> list[float]:
    """Write a torus as an OBJ file with normals; return the measures that a reader must find."""
    turn = np.arange(side) * 2 * np.pi / side
    around, across = (grid.ravel() for grid in np.meshgrid(turn, turn, indexing="ij"))
    normals = np.stack([np.cos(across) * np.cos(around), np.cos(across) * np.sin(around), np.sin(across)], 1)
    ring = np.stack([np.cos(around), np.sin(around), np.zeros(side * side)], 1)
    points = np.round(RING * ring + TUBE * normals, 7)
    k = np.arange(side)
    i, j = np.meshgrid(k, k, indexing="ij")
    a, b = i * side + j, (i + 1) % side * side + j
    c, d = (i + 1) % side * side + (j + 1) % side, i * side + (j + 1) % side
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    with path.open("w") as file:
        file.writelines(f"v {x:.7f} {y:.7f} {z:.7f}\n" for x, y, z in points.tolist())
        file.writelines(f"vn {x:.5f} {y:.5f} {z:.5f}\n" for x, y, z in normals.tolist())
        rows = (faces + 1).tolist()
        file.writelines(f"f {p}//{p} {q}//{q} {r}//{r}\n" for p, q, r in rows)
    corners = points[faces]
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = float(np.linalg.norm(crosses, axis=1).sum() / 2)
    volume = float(np.einsum("ij,ij->", corners[:, 0], crosses) / 6)
    return [len(faces), len(points), *np.ptp(points, axis=0), area, volume]


def measure(code: str, path: Path) -> tuple[float, float, float, list[float]]:
    """CPU time [s], time [s], peak memory [MB] and the measures found by one reader."""
    command = [sys.executable, "-c", FRAME.format(code=code), str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    cpu, seconds, peak, answer = json.loads(done.stdout)
    return cpu, seconds, peak, answer


def run(side: int = SIDE) -> list[dict[str, Any]]:
    """Let each reader read the same file in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "torus.obj"
        truth = torus(path, side)
        cpu, seconds, peak, answer = measure(OURS, path)
        their_cpu, their_seconds, their_peak, _ = measure(TRIMESH, path)
    right = bool(np.abs(np.array(answer) / truth - 1).max() < 1e-9)  # counts, extents, area, volume
    count = f"load OBJ, {truth[0] / 1e6:.2g} million triangles"
    return [
        row(f"{count}: clock", seconds, "s", SECONDS, _ratio(seconds, their_seconds, "s"), right),
        row(f"{count}: CPU", cpu, "s", None, _ratio(cpu, their_cpu, "s"), right),
        row(f"{count}: peak memory", peak, "MB", MEGABYTES, _ratio(peak, their_peak, "MB"), right),
    ]


def _ratio(ours: float, theirs: float, unit: str) -> str:
    return f"trimesh {theirs:.3g} {unit}, ratio {theirs / ours:.1f}"
