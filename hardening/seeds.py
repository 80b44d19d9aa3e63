"""The corpus: small files made by our own writers, in one folder for each reader.

``python -m hardening.seeds`` writes them again; inputs found by fuzzing (``found-*``) are kept.
"""

from __future__ import annotations

import io
import json
import sqlite3
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from preshape import plan
from preshape.files import dumps
from preshape.memory import Memory
from preshape.physics.grasps import write_grasps
from preshape.planning.document import plan_to_json
from preshape.planning.grasp_sets import grasps_from_plans

from . import pincer

CORPUS = Path(__file__).parent / "corpus"
ADDRESS = b"://".join((b"https", b"github.com/mikedh/trimesh"))
"""Address that trimesh writes into its files; the repository must not contain it."""

POINTS = np.array([[0, 0, 0], [0.03, 0, 0], [0, 0.05, 0], [0, 0, 0.07]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def main() -> None:
    """Write the corpus."""
    for reader, files in seeds().items():
        folder = CORPUS / reader
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in files.items():
            data = content.encode() if isinstance(content, str) else content
            # The replacement has the same length, because lengths are part of the formats.
            (folder / name).write_bytes(data.replace(ADDRESS, b"trimesh".ljust(len(ADDRESS))))


def seeds() -> dict[str, dict[str, bytes | str]]:
    """Content of every file by reader and name."""
    return {
        **_meshes(),
        "hand-toml": {"pincer": pincer.TOML},
        "hand-mjcf": {"pincer": pincer.MJCF},
        "hand-urdf": {"pincer": pincer.URDF},
        **_records(),
    }


def _meshes() -> dict[str, dict[str, bytes | str]]:
    import trimesh

    body = trimesh.Trimesh(POINTS, FACES, process=False)

    def exported(kind: str, **options: Any) -> bytes:
        content = body.export(file_type=kind, **options)
        return content.encode() if isinstance(content, str) else bytes(content)

    vertices = "".join(f"v {x:g} {y:g} {z:g}\n" for x, y, z in POINTS)
    tetra = vertices + "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in FACES)
    wedge = (
        "# five corners, seams, relative numbers\no wedge\n" + vertices + "v 0.03 0.05 0\nvn 0 0 1\nvt 0 0\n"
        "f 1/1/1 3/1/1 5/1/1 2/1/1\nf -5 -4 -2\nf 1//1 4//1 3//1\nf 2 5 \\\n 4\nf 3 4 5\n"
    )
    little = exported("ply")
    head, mark, rows = little.partition(b"end_header\n")
    points, faces = rows[: 12 * len(POINTS)], rows[12 * len(POINTS) :]
    turned = np.frombuffer(points, "<f4").astype(">f4").tobytes() + b"".join(
        faces[at : at + 1] + np.frombuffer(faces[at + 1 : at + 13], "<i4").astype(">i4").tobytes()
        for at in range(0, len(faces), 13)
    )
    big = head.replace(b"little", b"big") + mark + turned
    mixed = (
        "ply\nformat ascii 1.0\ncomment mixed\nelement vertex 5\nproperty float x\nproperty float y\n"
        "property float z\nproperty uchar red\nelement face 5\nproperty list uchar int vertex_indices\n"
        "element edge 1\nproperty int a\nproperty int b\nend_header\n"
        "0 0 0 1\n.03 0 0 2\n0 .05 0 3\n0 0 .07 4\n.03 .05 0 5\n"
        "4 0 2 4 1\n3 0 1 3\n3 0 3 2\n3 1 4 3\n3 2 3 4\n0 1\n"
    )
    corners = "0 0 0\n.03 0 0\n0 .05 0\n0 0 .07\n.03 .05 0\n"
    off = f"OFF\n# pyramid\n5 5 0\n{corners}4 0 2 4 1\n3 0 1 3\n3 1 4 3\n3 2 3 4\n3 0 3 2 9 9 9\n"
    files: dict[str, bytes] = trimesh.exchange.gltf.export_gltf(trimesh.Scene([body]), embed_buffers=True)
    return {
        "obj": {"tetra": tetra, "wedge": wedge},
        "stl": {"text": exported("stl_ascii"), "binary": exported("stl")},
        "ply": {"text": exported("ply", encoding="ascii"), "little": little, "big": big, "mixed": mixed},
        "off": {"tetra": exported("off"), "mixed": off},
        "gltf": {"tetra": _compact(files["model.gltf"])},
        "glb": {"tetra": exported("glb")},
    }


def _compact(text: bytes) -> str:
    return json.dumps(json.loads(text), separators=(",", ":"))


def _records() -> dict[str, dict[str, bytes | str]]:
    """Plans, grasps and memories, from a plan for the paper's hand and a plan with a grip of a real hand."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "memory.sqlite"
        with Memory.open(file) as memory:
            plan("cube", "lift", hand="utah_mit", memory=memory)
            document = plan_to_json(plan("cube", "lift", hand="shadow", table=None, memory=memory, count=2))
            keep = memory.experiences()[-2:]
            weights = memory.weights(pincer.HAND)
        assert weights is not None
        small = Path(folder) / "small.sqlite"
        with Memory.open(small) as memory:
            memory.add(keep)
            memory.save_weights(pincer.HAND, weights)
            memory.export(Path(folder) / "memory.json")
        with sqlite3.connect(small) as connection:
            connection.execute("PRAGMA journal_mode = DELETE")
            connection.execute("PRAGMA page_size = 1024")
            connection.execute("VACUUM")
        connection.close()
        write_grasps(Path(folder) / "grasps.npz", grasps_from_plans([document], "plan").grasps)
        exported = json.loads((Path(folder) / "memory.json").read_text())
        exported["weights"][0] |= {"w1": [[0.5, -1.0]], "b1": [0.0], "w2": [[2.0]], "b2": [1e-9]}
        for one in (document, *document["alternatives"]):
            one["transitions"] = one["transitions"][:1]
        return {
            "plan-json": {"cube": json.dumps(json.loads(dumps(document)), separators=(",", ":"))},
            "grasps-npz": {"cube": _stored((Path(folder) / "grasps.npz").read_bytes())},
            "memory": {"two": small.read_bytes()},
            "memory-json": {"two": json.dumps(exported, separators=(",", ":"))},
        }


def _stored(npz: bytes) -> bytes:
    """The same arrays in an archive without compression and dates."""
    import zipfile

    content = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(npz)) as old, zipfile.ZipFile(content, "w") as new:
        for name in old.namelist():
            new.writestr(zipfile.ZipInfo(name), old.read(name))
    return content.getvalue()


if __name__ == "__main__":
    main()
