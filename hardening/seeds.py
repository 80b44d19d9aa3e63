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

SIDECAR = """mass = 0.3
tasks = ["pour", "lift"]
up = "+z"

[[part]]
name = "handle"
box = [-0.01, -0.02, -0.03, 0.01, 0.02, 0.03]

[[part]]
name = "rim"
halfspace = [0, 0, 1, 0.05]

[[part]]
name = "wall"
cylinder = [[0, 0, 0], [0, 0, 0.1], 0.04]
"""
SETTINGS = 'hand = "leap"\ntable = "auto"\nmass = 0.2\nmemory = "a.sqlite"\n'
DRIVER = """name = "two"
unit = "deg"
source = "nobody"
whole = true

[[channel]]
name = "0"
motor = ["thumb", "0"]
offset = 180.0
factor = -1
least = 10.0
most = 300

[[channel]]
name = "1"
motor = "index"
at_lower = 0
at_upper = 4095
"""
ARM = """<robot name="two">
<link name="base"/>
<link name="upper"><collision><origin xyz="0 0 .2"/><geometry><box size=".05 .05 .4"/></geometry></collision>
<inertial><mass value="1"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="tip"/>
<joint name="a" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="9" velocity="1"/></joint>
<joint name="b" type="revolute"><parent link="upper"/><child link="tip"/><origin xyz="0 0 .4"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="9" velocity="1"/></joint>
</robot>
"""
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
        **_clouds(),
        "sidecar": {"mug": SIDECAR},
        "settings": {"all": SETTINGS},
        "driver": {"two": DRIVER},
        "arm": {"two": ARM},
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


def _clouds() -> dict[str, dict[str, bytes | str]]:
    """Clouds of 16 points, a depth image, and masks of 16 points."""
    points = np.array([[x, y, 0.5 + 0.01 * x * y] for x in range(4) for y in range(4)], dtype="<f4") / 10

    def numpy_file(array: Any) -> bytes:
        content = io.BytesIO()
        np.save(content, array)
        return content.getvalue()

    def archive(**arrays: Any) -> bytes:
        content = io.BytesIO()
        np.savez(content, **arrays)
        return _stored(content.getvalue())

    def picture(array: Any) -> bytes:
        from PIL import Image

        content = io.BytesIO()
        Image.fromarray(array).save(content, "PNG")
        return content.getvalue()

    text = "".join(f"{x:g} {y:g} {z:g}\n" for x, y, z in points)
    head = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 16\nHEIGHT 1\n"
        "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 16\nDATA "
    )
    columns = points.T.tobytes()
    literal = b"".join(
        bytes([len(part) - 1]) + part for part in (columns[k : k + 32] for k in range(0, 192, 32))
    )
    sizes = np.array([len(literal), len(columns)], dtype="<u4").tobytes()
    chosen = np.arange(16) < 8
    depth, K = 0.5 + points[:, 2].reshape(4, 4), np.array([[4.0, 0, 2], [0, 4.0, 2], [0, 0, 1]])
    return {
        "pcd": {
            "text": f"{head}ascii\n{text}",
            "binary": f"{head}binary\n".encode() + points.tobytes(),
            "packed": f"{head}binary_compressed\n".encode() + sizes + literal,
        },
        "xyz": {"spaces": text, "commas": "# x,y,z\n" + text.replace(" ", ",")},
        "npy": {"points": numpy_file(points), "image": numpy_file(points.reshape(4, 4, 3))},
        "scene-npz": {
            "depth": archive(depth=depth, K=K, T_world_camera=np.eye(4), segmap=chosen.reshape(4, 4)),
            "points": archive(points=points, labels=chosen.astype(np.uint8)),
        },
        "mask": {
            "points": numpy_file(chosen),
            "grey": picture((255 * chosen.reshape(4, 4)).astype(np.uint8)),
            "bits": picture(chosen.reshape(4, 4)),
        },
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
