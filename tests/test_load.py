from __future__ import annotations

import base64
import json
import logging
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from preshape.exceptions import InputError, ObjectError, UnknownObject
from preshape.objects.library import names
from preshape.objects.load import SUFFIXES, load_object
from preshape.objects.mesh import TriangleMesh
from preshape.objects.read_raw import group_rows, merge_equal, triangulate

# A tetrahedron of legs 0.03, 0.05, 0.07 and a box of 0.02 × 0.04 × 0.06 are known exactly.
BOX = np.array([[x, y, z] for x in (0, 0.02) for y in (0, 0.04) for z in (0, 0.06)])
QUADS = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
BOX_AREA, BOX_VOLUME = 2 * (0.02 * 0.04 + 0.04 * 0.06 + 0.06 * 0.02), 0.02 * 0.04 * 0.06


def obj(vertices: np.ndarray, faces: list[list[int]], extra: str = "") -> str:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    return "\n".join([*lines, extra, *("f " + " ".join(str(k + 1) for k in face) for face in faces)]) + "\n"


def is_box(mesh: TriangleMesh, factor: float = 1.0) -> None:
    np.testing.assert_allclose(mesh.extents, factor * np.array([0.02, 0.04, 0.06]), rtol=1e-6)
    assert mesh.area == pytest.approx(BOX_AREA * factor**2, rel=1e-6)
    assert mesh.volume == pytest.approx(BOX_VOLUME * factor**3, rel=1e-6)  # signed: outward


def blob() -> trimesh.Trimesh:
    """A lopsided closed body whose coordinates are exact in single precision and in 8 decimals."""
    sphere = trimesh.creation.icosphere(subdivisions=2)
    bumps = 1 + 0.3 * np.random.default_rng(0).random((len(sphere.vertices), 1))
    grid = np.round(sphere.vertices * bumps * [0.5, 1, 2] * 256) / 256
    return trimesh.Trimesh(grid, sphere.faces, process=False)


def save(path: Path, form: str) -> Path:
    body = blob()
    if form == "ply text":
        content: str | bytes = body.export(file_type="ply", encoding="ascii", vertex_normal=False)
    elif form == "stl text":
        content = body.export(file_type="stl_ascii")
    elif form == "obj":
        content = obj(body.vertices, body.faces.tolist())
    else:
        content = body.export(file_type=form)
    file = path / f"blob.{form.split()[0]}"
    file.write_bytes(content.encode() if isinstance(content, str) else content)
    return file


@pytest.mark.parametrize("form", ["obj", "stl", "stl text", "ply", "ply text", "off", "glb"])
def test_every_format_gives_the_same_body(tmp_path: Path, form: str) -> None:
    body = blob()
    mesh = load_object(save(tmp_path, form))
    assert mesh.name == "blob"
    assert mesh.counts == (162, 162, 320, 320)
    assert (len(mesh.vertices), len(mesh.triangles)) == (162, 320)
    np.testing.assert_allclose(mesh.extents, body.extents, rtol=1e-12)
    assert mesh.area == pytest.approx(body.area, rel=1e-9)
    assert mesh.volume == pytest.approx(body.volume, rel=1e-9)
    ours = {tuple(sorted(map(tuple, corner))) for corner in mesh.corners.tolist()}
    theirs = {tuple(sorted(map(tuple, corner))) for corner in body.triangles.tolist()}
    assert ours == theirs


@pytest.mark.parametrize(
    ("unit", "factor"), [("m", 1.0), ("cm", 0.01), ("mm", 0.001), ("in", 0.0254), ("inch", 0.0254)]
)
def test_units_and_scale(tmp_path: Path, unit: str, factor: float) -> None:
    file = tmp_path / "box.obj"
    file.write_text(obj(BOX / factor * 2, QUADS))
    is_box(load_object(file, unit=unit, scale=0.5))
    is_box(load_object(str(file), unit=unit), 2.0)


def test_a_box_of_quads_keeps_the_paper_s_counts(tmp_path: Path) -> None:
    file = tmp_path / "box.obj"
    file.write_text(obj(BOX, QUADS, "vn 0 0 1\nvn 0 1 0\nvt 0 0"))
    mesh = load_object(file)
    is_box(mesh)
    assert mesh.counts == (8, 2, 6, 12)
    attributes = mesh.attributes
    assert (attributes.vertices, attributes.vertex_normals) == (8, 2)
    assert (attributes.faces, attributes.triangles) == (6, 12)


def test_library_names_and_scale() -> None:
    first = names()[0]
    assert load_object(first, scale=2.0).extents == pytest.approx(2 * load_object(first).extents)
    with pytest.raises(InputError, match="are in metres"):
        load_object(first, unit="mm")


def test_a_folder_of_the_same_name_does_not_hide_a_library_object(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / names()[0]).mkdir()
    assert load_object(names()[0]).name == names()[0]
    with pytest.raises(ObjectError, match="this is a folder"):
        load_object(Path(names()[0]))


def test_neither_file_nor_library_object() -> None:
    with pytest.raises(UnknownObject, match=f"no file or built-in object 'nothing_like_it'.*{names()[0]}"):
        load_object("nothing_like_it")


def test_importing_the_loader_is_light() -> None:
    code = (
        "import sys, preshape.objects.load; "
        "print([m for m in ('trimesh', 'scipy', 'mapbox_earcut', 'manifold3d') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_trimesh_is_left_as_it_was(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    log = logging.getLogger("trimesh")
    before = (log.level, log.propagate, list(log.handlers))
    load_object(save(tmp_path, "glb"))
    assert (log.level, log.propagate, list(log.handlers)) == before
    assert not caplog.records


@pytest.mark.parametrize("suffix", [s.upper() for s in SUFFIXES if s not in (".gltf",)])
def test_suffixes_in_capitals(tmp_path: Path, suffix: str) -> None:
    form = suffix[1:].lower()
    assert load_object(save(tmp_path, form).rename(tmp_path / f"B{suffix}")).counts == (162, 162, 320, 320)


# OBJ ---------------------------------------------------------------------------------------------------


def uv_seam(text: str) -> str:
    """An OBJ in which every corner has its own texture coordinate and normal."""
    out, k = [], 0
    for line in text.splitlines():
        if line.startswith("f "):
            words = []
            for word in line.split()[1:]:
                k += 1
                words.append(f"{word}/{k}/{k}")
            out += [f"vt 0 {j}\nvn 0 0 1" for j in range(len(words))]
            line = "f " + " ".join(words)
        out.append(line)
    return "\n".join(out)


def relative(text: str) -> str:
    return "\n".join(
        "f " + " ".join(str(int(word) - 9) for word in line.split()[1:]) if line.startswith("f ") else line
        for line in text.splitlines()
    )


def in_two_groups(text: str) -> str:
    lines = text.splitlines()
    lines[-3:-3] = ["o second", "g here there", "usemtl red", "s 1"]
    return "mtllib missing.mtl\no first\n" + "\n".join(lines)


DIALECTS: dict[str, Callable[[str], str]] = {
    "plain": lambda text: text,
    "seams": uv_seam,
    "relative": relative,
    "two objects, groups, missing materials": in_two_groups,
    "windows lines": lambda text: text.replace("\n", "\r\n"),
    "old mac lines": lambda text: text.replace("\n", "\r"),
    "tabs and indents": lambda text: "\n".join("\t " + line.replace(" ", "\t") for line in text.splitlines()),
    "byte order mark": lambda text: "\ufeff" + text,
    "continued lines": lambda text: text.replace("f 1 2", "f 1 \\\n 2").replace("f 5 7", "f 5 \\\r\n7"),
    "comments": lambda text: "# a # box\n" + text.replace("\n", " # here 1 2\n").replace("f 1", "f 1"),
    "faces first": lambda text: "\n".join(sorted(text.splitlines(), key=lambda line: line[:1] != "f")),
    "mixed corners": lambda text: text.replace("f 1 2 4 3", "f 1/1/1 2//3 4/7 3").replace("f 5", "f 5//1"),
    "colours and weights": lambda text: "\n".join(
        line + (" 1 0 .5" if k % 2 else " 1.0") if line.startswith("v") else line
        for k, line in enumerate(text.splitlines())
    ),
    "lines, points, curves": lambda text: text + "l 1 2 3\np 1\ncstype bspline\ncurv 0 1 1 2\nend\nvp 1 2\n",
    "no last newline": str.rstrip,
    "exponents": lambda text: text.replace("0.02", "+2.0E-2").replace("0.06", "6e-02"),
}


@pytest.mark.parametrize("dialect", DIALECTS)
def test_obj_dialects(tmp_path: Path, dialect: str, capfd: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "box.obj"
    file.write_bytes(DIALECTS[dialect](obj(BOX, QUADS)).encode())
    mesh = load_object(file)
    is_box(mesh)
    assert mesh.counts is not None
    assert mesh.counts[0] == len(mesh.vertices) == 8
    assert mesh.counts[2:] == (6, 12)
    assert capfd.readouterr() == ("", "")


def test_relative_indices_count_from_their_own_line(tmp_path: Path) -> None:
    parts = []
    for quad in QUADS:
        corners = [f"v {x!r} {y!r} {z!r}" for x, y, z in BOX[quad].tolist()]
        parts += [*corners, "f -4 -3 -2 -1"]
    file = tmp_path / "box.obj"
    file.write_text("\n".join(parts))
    mesh = load_object(file)
    is_box(mesh)
    assert mesh.counts == (24, 24, 6, 12)


def test_a_file_read_in_many_pieces_is_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "blob.obj"
    body = blob()
    file.write_text(uv_seam(obj(body.vertices, body.faces.tolist())))
    whole = load_object(file)
    monkeypatch.setattr("preshape.objects.read_text._CHUNK", 97)
    pieces = load_object(file)
    np.testing.assert_array_equal(whole.vertices, pieces.vertices)
    np.testing.assert_array_equal(whole.triangles, pieces.triangles)


# polygons ----------------------------------------------------------------------------------------------

ARROW = [[0, 0], [1, 0.5], [0, 1], [0.3, 0.5]]
L_SHAPE = [[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]]
COMB = [[0, 0], [5, 0], [5, 3], [4, 3], [4, 1], [3, 1], [3, 3], [2, 3], [2, 1], [1, 1], [1, 3], [0, 3]]


def shoelace(points: np.ndarray) -> float:
    x, y = points.T
    return float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2)


@pytest.mark.parametrize("form", ["obj", "ply", "ply binary", "off"])
@pytest.mark.parametrize("outline", [ARROW, L_SHAPE, COMB], ids=["arrow", "L", "comb"])
@pytest.mark.parametrize("shift", [0, 1, 2, 3])
@pytest.mark.parametrize("mirrored", [False, True])
def test_concave_prisms(
    tmp_path: Path, form: str, outline: list[list[float]], shift: int, mirrored: bool
) -> None:
    """Only a correct triangulation gives the area of the prism: a fan over a concave corner is too large."""
    flat = np.roll(np.array(outline, dtype=float), shift, axis=0) / 64
    n = len(flat)
    rim = float(np.linalg.norm(flat - np.roll(flat, -1, axis=0), axis=1).sum())
    area = shoelace(flat)
    vertices = np.concatenate([np.c_[flat, np.zeros(n)], np.c_[flat, np.full(n, 0.25)]])
    faces = [[*range(n)][::-1], [*range(n, 2 * n)]]
    faces += [[k, (k + 1) % n, (k + 1) % n + n, k + n] for k in range(n)]
    if mirrored:
        vertices, faces = vertices * [1, 1, -1], [face[::-1] for face in faces]
    vertices = vertices @ trimesh.transformations.rotation_matrix(0.7 + shift, [1, 2, 3])[:3, :3].T
    file = tmp_path / f"prism.{form.split()[0]}"
    if form == "obj":
        file.write_text(obj(vertices, faces))
    elif form == "off":
        rows = [" ".join(map(repr, v)) for v in vertices.tolist()]
        rows += [f"{len(face)} {' '.join(map(str, face))} 255 0 0" for face in faces]
        file.write_text(f"# made here\nOFF\n\n{len(vertices)} {len(faces)} 0\n" + "\n".join(rows))
    else:
        file.write_bytes(ply(vertices, faces, "binary_big_endian" if "binary" in form else "ascii"))
    mesh = load_object(file)
    assert mesh.counts == (2 * n, 2 * n, n + 2, 4 * n - 4)
    assert mesh.area == pytest.approx(2 * area + rim * 0.25, rel=1e-9)
    assert mesh.volume == pytest.approx(area * 0.25, rel=1e-9)


def ply(vertices: np.ndarray, faces: list[list[int]], form: str, before: str = "", after: str = "") -> bytes:
    """A PLY with other properties around the needed ones."""
    header = (
        f"ply\nformat {form} 1.0\ncomment x\nelement junk 2\nproperty uchar a\n"
        f"element vertex {len(vertices)}\nproperty uchar red\nproperty double x\nproperty double y\n"
        f"property double z\nelement face {len(faces)}\nproperty short group\n"
        "property list uchar int vertex_indices\nproperty list uint float texcoord\nend_header\n"
    )
    if form == "ascii":
        rows = ["1", "2", *(f"9 {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist())]
        rows += [f"7 {len(face)} {' '.join(map(str, face))} 2 0.5 0.25" for face in faces]
        return (header + "\n".join(rows) + "\n").encode()
    mark = ">" if "big" in form else "<"
    body = b"\1\2" + b"".join(struct.pack(mark + "B3d", 9, *v) for v in vertices.tolist())
    for face in faces:
        body += struct.pack(f"{mark}hB{len(face)}iI2f", 7, len(face), *face, 2, 0.5, 0.25)
    return header.encode() + body


def test_triangulate_keeps_area_and_turn_of_random_stars() -> None:
    """Star-shaped polygons have a known area whatever their corners do."""
    rng = np.random.default_rng(3)
    for _ in range(200):
        n = int(rng.integers(4, 15))
        angles = (np.arange(n) + 0.8 * rng.random(n)) * 2 * np.pi / n
        flat = np.c_[np.cos(angles), np.sin(angles)] * rng.uniform(0.1, 1, (n, 1))
        turn = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
        points = np.c_[flat, np.zeros(n)] @ turn.T
        cut, _ = triangulate(points, np.arange(n), np.array([n]))
        a, b, c = (points[cut[:, k]] for k in range(3))
        crosses = np.cross(b - a, c - a) / 2
        assert len(cut) == n - 2
        assert crosses.sum(axis=0) @ turn[:, 2] == pytest.approx(shoelace(flat), rel=1e-9)
        assert np.linalg.norm(crosses, axis=1).sum() == pytest.approx(shoelace(flat), rel=1e-9)


# scans and other formats -------------------------------------------------------------------------------


def test_seams_and_rubbish_are_taken_as_they_are_and_a_large_hole_is_closed(tmp_path: Path) -> None:
    """A doubled face, faces without area and unused vertices change nothing; a missing side gets a lid."""
    vertices = np.concatenate([BOX, [[5, 5, 5], [0.01, 0, 0]]])
    faces = [*QUADS[:5], QUADS[0], QUADS[0][2:] + QUADS[0][:2], [0, 0, 1], [0, 9, 4], [3, 3, 3, 3]]
    file = tmp_path / "scan.obj"
    file.write_text(obj(vertices, faces))
    mesh = load_object(file)
    assert mesh.counts == (10, 10, 10, 18)
    assert (len(mesh.vertices), len(mesh.triangles)) == (8 + 1, 10 + 4)
    np.testing.assert_allclose(mesh.extents, [0.02, 0.04, 0.06])
    assert mesh.area == pytest.approx(BOX_AREA)
    assert mesh.volume == pytest.approx(0.02 * 0.04 * 0.06)
    assert mesh.notes == (
        "the surface is open: a hole closed by flat lids; the object is planned and tested as a solid, and "
        "no finger is placed on a lid",
    )
    assert (mesh.areas > 0).all()


def test_stl_whose_header_begins_with_solid_is_still_binary(tmp_path: Path) -> None:
    content = bytearray(blob().export(file_type="stl"))
    content[:5] = b"solid"
    (tmp_path / "blob.stl").write_bytes(content)
    assert load_object(tmp_path / "blob.stl").counts == (162, 162, 320, 320)


def test_stl_with_more_behind_its_triangles(tmp_path: Path) -> None:
    (tmp_path / "blob.stl").write_bytes(blob().export(file_type="stl") + b"made here")
    assert load_object(tmp_path / "blob.stl").counts == (162, 162, 320, 320)


def test_stl_of_two_solids_whose_second_is_cut_short(tmp_path: Path) -> None:
    text = blob().export(file_type="stl_ascii")
    file = tmp_path / "two.stl"
    file.write_bytes((text + text.replace("solid", "solid café", 1)).encode("latin-1"))
    assert load_object(file).counts == (162, 162, 640, 640)
    file.write_text(text + text[: len(text) // 2])
    with pytest.raises(ObjectError, match=r"found 320 complete facets of 4\d\d.*cut short"):
        load_object(file)


def test_stl_merges_zero_and_minus_zero(tmp_path: Path) -> None:
    content = trimesh.Trimesh(BOX, [face[:3] for face in QUADS], process=False).export(file_type="stl")
    raw = np.frombuffer(content, dtype=np.uint8).copy()
    numbers = raw[84:].reshape(-1, 50)[:, 12:48].copy().view("<f4")
    numbers[::2][numbers[::2] == 0] = -0.0
    raw[84:].reshape(-1, 50)[:, 12:48] = numbers.view(np.uint8)
    (tmp_path / "box.stl").write_bytes(raw.tobytes())
    mesh = load_object(tmp_path / "box.stl")
    assert len(mesh.vertices) == len(np.unique(BOX[[k for face in QUADS for k in face[:3]]], axis=0))
    assert not np.signbit(mesh.vertices).any()


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("mixed", [False, True])
def test_ply_with_needless_elements(tmp_path: Path, form: str, mixed: bool) -> None:
    faces = [*QUADS[1:], QUADS[0][:3], [0, 3, 2]] if mixed else QUADS
    (tmp_path / "box.ply").write_bytes(ply(BOX, faces, form))
    mesh = load_object(tmp_path / "box.ply")
    is_box(mesh)
    assert mesh.counts == (8, 8, len(faces), 12)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
def test_ply_whose_faces_are_quads_on_average(tmp_path: Path, form: str) -> None:
    """One face has a corner less and the next one a corner more, so the length of the file is right."""
    vertices = np.concatenate([BOX, [(BOX[0] + BOX[1]) / 2]])
    faces = [QUADS[1], *QUADS[3:], [0, 8, 2], [8, 1, 3, 2], [0, 4, 5, 1, 8]]
    (tmp_path / "box.ply").write_bytes(ply(vertices, faces, form))
    mesh = load_object(tmp_path / "box.ply")
    is_box(mesh)
    assert mesh.counts == (9, 9, 7, 14)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
def test_ply_with_edges_and_textures(tmp_path: Path, form: str) -> None:
    """Elements that trimesh would turn into paths, split vertices at, or search in another file."""
    content = ply(BOX, QUADS, form).replace(b"comment x", b"comment TextureFile caf\xe9.png\nobj_info 1")
    edge = b"element edge 1\nproperty int vertex1\nproperty int vertex2\n"
    content = content.replace(b"end_header", edge + b"end_header")
    content += b"0 99\n" if form == "ascii" else struct.pack("<2i", 0, 99)
    (tmp_path / "box.ply").write_bytes(content)
    mesh = load_object(tmp_path / "box.ply")
    is_box(mesh)
    assert mesh.counts == (8, 8, 6, 12)


@pytest.mark.parametrize("first", ["OFF\n8 6 12", "OFF 8 6 12", "OFF 8 6", "COFF # x\n# y\n8 6 0"])
def test_off_headers(tmp_path: Path, first: str) -> None:
    rows = [f"{x!r} {y!r} {z!r} 255 0 0" for x, y, z in BOX.tolist()]
    rows += ["4 " + " ".join(map(str, face)) + "  # side" for face in QUADS]
    (tmp_path / "box.off").write_text(first + "\n" + "\n\n".join(rows))
    mesh = load_object(tmp_path / "box.off")
    is_box(mesh)
    assert mesh.counts == (8, 8, 6, 12)


@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_scene_nodes_are_put_in_place(tmp_path: Path, suffix: str) -> None:
    """One cube used three times: moved; rotated and scaled; mirrored, below a node that moves as well."""
    cube = trimesh.creation.box(extents=(0.02, 0.02, 0.02))
    scene = trimesh.Scene()
    scene.add_geometry(cube, node_name="a", geom_name="cube")
    parent = trimesh.transformations.translation_matrix([0.1, 0, 0])
    scene.graph.update(frame_from="world", frame_to="parent", matrix=parent)
    turn = trimesh.transformations.rotation_matrix(np.pi / 2, [0, 0, 1])
    grown = turn @ np.diag([2, 1, 1, 1])
    scene.graph.update(frame_from="parent", frame_to="b", geometry="cube", matrix=grown)
    mirror = trimesh.transformations.translation_matrix([0, 0.2, 0]) @ np.diag([-1, 1, 1, 1])
    scene.graph.update(frame_from="parent", frame_to="c", geometry="cube", matrix=mirror)
    if suffix == "glb":
        (tmp_path / "parts.glb").write_bytes(scene.export(file_type="glb"))
    else:
        for name, content in scene.export(file_type="gltf").items():
            (tmp_path / name).write_bytes(content)
        (tmp_path / "model.gltf").rename(tmp_path / "parts.gltf")
    mesh = load_object(f"{tmp_path}/parts.{suffix}#all")
    assert mesh.counts == (24, 24, 36, 36)
    np.testing.assert_allclose(mesh.bounds, [[-0.01, -0.02, -0.01], [0.11, 0.21, 0.01]], atol=1e-8)
    assert mesh.volume == pytest.approx(4 * 0.02**3, rel=1e-6)  # a mirrored part would count against it
    assert mesh.area == pytest.approx(6 * 0.02**2 * 2 + (2 + 8) * 0.02**2, rel=1e-6)


def test_a_gltf_without_its_buffer_says_so(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    scene = trimesh.Scene(trimesh.creation.box(extents=(0.02, 0.02, 0.02)))
    document = json.loads(scene.export(file_type="gltf")["model.gltf"])
    (tmp_path / "box.gltf").write_text(json.dumps(document))
    with pytest.raises(
        ObjectError, match=r"box\.gltf: its buffer 'gltf_buffer_0.bin' cannot be read .No such"
    ):
        load_object(tmp_path / "box.gltf")
    assert capfd.readouterr() == ("", "")


def gltf_box(**changes: object) -> dict[str, Any]:
    """A box as one primitive, with positions interleaved with other data (a stride of 16 bytes)."""
    triangles = np.array([[q[0], q[k], q[k + 1]] for q in QUADS for k in (1, 2)], dtype="<u2")
    rows = np.c_[BOX, np.full(8, 7.0)].astype("<f4").tobytes()
    binary = rows + triangles.tobytes()
    accessors = [
        {"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5123, "count": 36, "type": "SCALAR"},
    ]
    views = [
        {"buffer": 0, "byteLength": 128, "byteStride": 16},
        {"buffer": 0, "byteOffset": 128, "byteLength": 72},
    ]
    uri = "data:application/octet-stream;base64," + base64.b64encode(binary).decode()
    return {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": len(binary), "uri": uri}],
        "bufferViews": views,
        "accessors": accessors,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "nodes": [{"mesh": 0}],
    } | changes


def load_gltf(folder: Path, document: dict[str, Any]) -> TriangleMesh:
    (folder / "a.gltf").write_text(json.dumps(document))
    return load_object(folder / "a.gltf")


def test_gltf_with_stride_data_uri_and_no_scene(tmp_path: Path) -> None:
    mesh = load_gltf(tmp_path, gltf_box())
    is_box(mesh)
    assert mesh.counts == (8, 8, 12, 12)
    is_box(load_gltf(tmp_path, gltf_box(nodes=[])))


def test_gltf_takes_only_the_shown_scene(tmp_path: Path) -> None:
    nodes = [{"mesh": 0}, {"mesh": 0, "translation": [1, 0, 0]}]
    scenes = [{"nodes": [0]}, {"nodes": [1]}]
    for scene in (0, 1):
        mesh = load_gltf(tmp_path, gltf_box(nodes=nodes, scenes=scenes, scene=scene))
        is_box(mesh)
        assert mesh.cog[0] == pytest.approx(0.01 + scene)


def test_gltf_rotation_is_xyzw_after_scale(tmp_path: Path) -> None:
    turn = [0, 0, np.sqrt(0.5), np.sqrt(0.5)]  # x to y
    node = {"mesh": 0, "rotation": turn, "scale": [2, 1, 1], "translation": [0, 0, 1]}
    mesh = load_gltf(tmp_path, gltf_box(nodes=[node]))
    np.testing.assert_allclose(mesh.bounds, [[-0.04, 0, 1], [0, 0.04, 1.06]], atol=1e-7)


@pytest.mark.parametrize("mode", [0, 1, 3, 5, 6])
def test_gltf_strips_points_and_lines(tmp_path: Path, mode: int) -> None:
    """A square near the box, seen from +x: two triangles as a strip, nothing as lines or points."""
    corners = np.array([[0.0205, 0, 0], [0.0205, 0.01, 0], [0.0205, 0, 0.01], [0.0205, 0.01, 0.01]])
    binary = corners.astype("<f4").tobytes()
    document = gltf_box()
    uri = "data:;base64," + base64.b64encode(binary).decode()
    document["buffers"].append({"byteLength": 48, "uri": uri})
    document["bufferViews"].append({"buffer": 1, "byteLength": 48})
    document["accessors"].append({"bufferView": 2, "componentType": 5126, "count": 4, "type": "VEC3"})
    document["meshes"][0]["primitives"].append({"attributes": {"POSITION": 2}, "mode": mode})
    if mode in (3, 6):  # line strip and fan: trimesh leaves them out, and says so
        with pytest.raises(
            ObjectError, match=f"the scene cannot be read .skipping primitive with mode {mode}"
        ):
            load_gltf(tmp_path, document)
        return
    mesh = load_gltf(tmp_path, document)
    square = mesh.corners[:, :, 0].min(axis=1) > 0.0202
    assert square.sum() == (2 if mode == 5 else 0)
    assert mesh.areas[square].sum() == pytest.approx(1e-4 if mode == 5 else 0)
    np.testing.assert_allclose(mesh.normals[square], np.tile([1.0, 0, 0], (square.sum(), 1)), atol=1e-12)


@pytest.mark.parametrize("normalised", [False, True])
def test_gltf_quantised_positions(tmp_path: Path, normalised: bool) -> None:
    """Signed 16-bit positions that a node scales, by another factor if they are normalised."""
    grid = np.where(BOX > 0, 1000, -1000).astype("<i2")
    factor = 32767 if normalised else 1
    document = gltf_box(nodes=[{"mesh": 0, "scale": [1e-5 * factor, 2e-5 * factor, 3e-5 * factor]}])
    binary = (
        np.c_[grid, grid[:, :1]].tobytes()
        + base64.b64decode(document["buffers"][0]["uri"].partition(",")[2])[128:]
    )
    uri = "data:;base64," + base64.b64encode(binary).decode()
    document["buffers"] = [{"byteLength": len(binary), "uri": uri}]
    document["bufferViews"][0] = {"buffer": 0, "byteLength": 64, "byteStride": 8}
    document["bufferViews"][1]["byteOffset"] = 64
    document["accessors"][0] |= {"componentType": 5122, "normalized": normalised}
    is_box(load_gltf(tmp_path, document))


def test_gltf_keeps_what_hangs_on_a_camera(tmp_path: Path) -> None:
    nodes = [{"camera": 0, "children": [1], "translation": [0, 0, 1]}, {"mesh": 0, "translation": [0, 1, 0]}]
    camera = {"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1, "aspectRatio": 1}}
    mesh = load_gltf(tmp_path, gltf_box(nodes=nodes, cameras=[camera]))
    is_box(mesh)
    np.testing.assert_allclose(mesh.cog, [0.01, 1.02, 1.03])


def test_gltf_scenes_that_have_no_end(tmp_path: Path) -> None:
    """trimesh needs the third power of the length of a chain of nodes, and instances multiply."""
    chain = [{"mesh": 0, "children": [k + 1]} for k in range(32)] + [{"mesh": 0}]
    with pytest.raises(ObjectError, match="33 nodes in 33 levels, at most 2000 in 32 are read"):
        load_gltf(tmp_path, gltf_box(nodes=chain))
    chain[31].pop("children")
    is_box(load_gltf(tmp_path, gltf_box(nodes=chain[:32])))
    many = [{"primitives": gltf_box()["meshes"][0]["primitives"] * 100}]
    with pytest.raises(ObjectError, match="scene has more than 60000000 numbers"):
        load_gltf(tmp_path, gltf_box(nodes=[{"mesh": 0}] * 100, meshes=many))
    document = gltf_box()
    document["accessors"].append({"componentType": 5126, "count": 10**9, "type": "MAT4"})  # of zeros
    with pytest.raises(ObjectError, match="scene has more than 60000000 numbers"):
        load_gltf(tmp_path, document)


def test_a_gltf_buffer_may_say_too_much_if_all_that_is_asked_for_is_there(tmp_path: Path) -> None:
    is_box(load_gltf(tmp_path, damaged("buffers", {"byteLength": 10**6})))


def damaged(place: str, change: dict[str, object]) -> dict[str, Any]:
    document = gltf_box()
    document[place][0] |= change
    return document


DRACO = "KHR_draco_mesh_compression"


def compressed() -> dict[str, Any]:
    """A box whose arrays are only in the data of Draco."""
    document = gltf_box(extensionsUsed=[DRACO], extensionsRequired=[DRACO])
    document["meshes"][0]["primitives"][0]["extensions"] = {DRACO: {"bufferView": 0, "attributes": {}}}
    for accessor in document["accessors"]:
        del accessor["bufferView"]
    return document


def test_a_gltf_may_declare_compression_and_have_empty_parts_beside_good_ones(tmp_path: Path) -> None:
    document = gltf_box(extensionsUsed=[DRACO], extensionsRequired=[DRACO])
    document["accessors"].append({"componentType": 5126, "count": 0, "type": "VEC3"})
    for primitive in ({"attributes": {}}, {"attributes": {"POSITION": 2}}, {"attributes": {"NORMAL": 2}}):
        document["meshes"].append({"primitives": [primitive]})
        document["nodes"].append({"mesh": len(document["meshes"]) - 1})
    document["meshes"].append({"primitives": []})
    is_box(load_gltf(tmp_path, document))


def test_of_a_gltf_it_is_said_that_its_y_is_up(tmp_path: Path) -> None:
    assert "y is up" in load_gltf(tmp_path, gltf_box()).notes[-1]


def test_a_compressed_buffer_view_is_refused_where_its_extension_is_required(tmp_path: Path) -> None:
    document = gltf_box(extensionsRequired=["EXT_meshopt_compression"])
    document["bufferViews"][0]["extensions"] = {"EXT_meshopt_compression": {"buffer": 0}}
    with pytest.raises(ObjectError, match=r"compressed .EXT_meshopt_compression., which cannot be read"):
        load_gltf(tmp_path, document)


@pytest.mark.parametrize(
    ("document", "message"),
    [
        (compressed(), "compressed with Draco .KHR_draco"),
        (damaged("buffers", {"uri": "../secret.bin"}), "only files beside it are read"),
        (damaged("buffers", {"uri": "/etc/hostname"}), "only files beside it are read"),
        (damaged("buffers", {"uri": "http://example.org/a.bin"}), "only files beside it are read"),
        (damaged("bufferViews", {"byteLength": 250}), "damaged one .AssertionError"),
        (damaged("bufferViews", {"byteLength": 10**6}), "more than 60000000 numbers"),
        (damaged("bufferViews", {"byteOffset": -16}), "lies outside its buffer"),
        (damaged("bufferViews", {"buffer": -1}), "no entry -1 among 1"),
        (damaged("bufferViews", {"byteStride": 1}), "lies outside its buffer"),
        (damaged("accessors", {"count": 10**12}), "more than 60000000 numbers"),
        (damaged("accessors", {"count": 9}), "damaged one .AssertionError"),
        (damaged("nodes", {"mesh": 1}), "no entry 1 among 1"),
        (damaged("nodes", {"mesh": -1}), "no entry -1 among 1"),
        (damaged("accessors", {"type": "VEC2"}), "positions must be three plain numbers"),
        (damaged("accessors", {"sparse": {}}), "sparse or empty accessors cannot be read"),
        (damaged("nodes", {"children": [0]}), "scene has no|found no vertices"),
        (gltf_box(nodes=[{"children": [1, 1]}, {"mesh": 0}]), "scene node 1 has two parents"),
        (gltf_box(nodes=[{"mesh": 0, "scale": [1e300, 1, 1]}] * 2), "object is 2e[+]298 ×"),
        (gltf_box(nodes=[{"mesh": 0, "matrix": [float("nan")] * 16}]), "8 of 8 vertices are not finite"),
        (gltf_box(nodes=[{"mesh": 0}] * 10, meshes=[]), "no entry 0 among 0"),
        (gltf_box(meshes=[{"primitives": [{"attributes": {}}]}]), "found no vertices"),
        (gltf_box(meshes=[{"primitives": [{"attributes": {"POSITION": 0}, "mode": 0}]}]), "point cloud"),
        ({"asset": {"version": "2.0"}}, "found no vertices"),
    ],
)
def test_damaged_gltf(tmp_path: Path, document: dict[str, Any], message: str) -> None:
    with pytest.raises(ObjectError, match=message):
        load_gltf(tmp_path, document)


def test_group_rows_equals_numpy_unique() -> None:
    rng = np.random.default_rng(5)
    rows = rng.integers(-3, 3, (2000, 3))
    first, group = group_rows(rows)
    np.testing.assert_array_equal(rows[first][group], rows)
    assert len(first) == len(np.unique(rows, axis=0))
    assert (np.diff(first) > 0).all()
    np.testing.assert_array_equal(first[group] <= np.arange(2000), True)


def test_group_rows_survives_equal_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows (0, 0, 0) and other rows with the key 0 are different groups."""
    odd = np.uint64(0x9E3779B97F4A7C15)
    key = int(np.uint64(1) * odd)
    key ^= key >> 29
    twin = np.array([[0, 0, 0], [1, 0, 0]], dtype=np.int64)
    twin[1, 1] = np.uint64(key).astype(np.int64)  # cancels the first column
    rows = np.tile(twin, (4, 1))
    first, group = group_rows(rows)
    np.testing.assert_array_equal(first, [0, 1])
    np.testing.assert_array_equal(group, [0, 1] * 4)


def test_merge_equal_keeps_positions() -> None:
    rng = np.random.default_rng(6)
    vertices = rng.integers(-2, 3, (300, 3)).astype(float)
    triangles = rng.integers(0, 300, (100, 3))
    merged, moved = merge_equal(vertices, triangles)
    np.testing.assert_array_equal(merged[moved], vertices[triangles])
    assert len(merged) == len(np.unique(vertices, axis=0))
