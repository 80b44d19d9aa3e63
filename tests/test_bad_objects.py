from __future__ import annotations

import os
import pickle
import re
import socket
import struct
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh

from preshape.exceptions import EnvironmentFailure, InputError, ObjectError
from preshape.objects.load import SUFFIXES, load_object

TETRA = "v 0 0 0\nv .03 0 0\nv 0 .05 0\nv 0 0 .07\n"
FACES = "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
PLY_HEADER = (
    "ply\nformat {} 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 4\nproperty list uchar int vertex_indices\nend_header\n"
)
PLY_TEXT = (
    PLY_HEADER.format("ascii") + "0 0 0\n.03 0 0\n0 .05 0\n0 0 .07\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"
)
OFF_TEXT = "OFF\n4 4 6\n0 0 0\n.03 0 0\n0 .05 0\n0 0 .07\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"


def tetra(form: str) -> bytes:
    points = np.array([[0, 0, 0], [0.03, 0, 0], [0, 0.05, 0], [0, 0, 0.07]])
    body = trimesh.Trimesh(points, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], process=False)
    content = body.export(file_type=form)
    return content.encode() if isinstance(content, str) else content


STL_TEXT = tetra("stl_ascii").decode()
PNG = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\0\1\0\0\0\1\x08\x02\0\0\0\x90wS\xde"
NAN_STL = tetra("stl")[:96] + struct.pack("<f", np.nan) + tetra("stl")[100:]
LFS = f"version https://git-lfs.github.com/spec/v1\noid sha256:{'0' * 64}\nsize 1234567\n"
WIDE = "v {0} 0 0\nv 0 {0} 0\nv 0 0 {0}\nv {0} {0} {0}\n"

REFUSED: dict[str, tuple[str, str | bytes, str]] = {
    # name: (file, content, what the message says after the file's name)
    "empty": ("a.obj", "", "the file is empty"),
    "blank": ("a.ply", " \n\n\t ", "the file is empty"),
    "unknown suffix": ("a.step", "ISO-10303-21;", r"suffix '\.step' cannot be read.*\.obj, \.stl, \.ply"),
    "no suffix": ("cupboard", TETRA + FACES, "suffix '' cannot be read"),
    "prose": ("a.obj", "Dear reader,\nthere is no mesh here.\n", "no vertex and no face lines"),
    "prose stl": ("a.stl", "Dear reader,\n" * 9, "cut short or not an STL mesh"),
    "short stl": ("a.stl", "Dear reader", "needs 84 bytes, the file has 11"),
    "prose ply": ("a.ply", "Dear reader,\n" * 9, "not a PLY mesh"),
    "prose off": ("a.off", "Dear reader,\n" * 9, "not an OFF mesh"),
    "prose glb": ("a.glb", "Dear reader,\n" * 9, "no GLB mesh, or a damaged one"),
    "prose gltf": ("a.gltf", "Dear reader,\n" * 9, "no GLTF mesh, or a damaged one"),
    "empty gltf": ("a.gltf", "{}", r"no GLTF mesh, or a damaged one|found no vertices"),
    "binary": ("a.obj", bytes(range(256)) * 20, "expected an OBJ mesh as text, found binary data"),
    "image": ("a.obj", PNG, "expected a mesh, this is a PNG image"),
    "image as glb": ("a.glb", PNG, "expected a mesh, this is a PNG image"),
    "archive": ("a.stl", b"PK\x03\x04" + b"\0" * 200, "this is a ZIP archive"),
    "stl as obj": ("a.obj", STL_TEXT, r"suffix says \.obj, the content is STL; rename it to end in \.stl"),
    "ply as stl": ("a.stl", PLY_TEXT, r"suffix says \.stl, the content is PLY"),
    "off as ply": ("a.ply", OFF_TEXT, r"suffix says \.ply, the content is OFF"),
    "glb as obj": ("a.obj", tetra("glb"), r"suffix says \.obj, the content is GLB"),
    "nan": (
        "a.obj",
        TETRA.replace(".05", "nan") + FACES,
        r"1 of 4 vertices are not finite, the first is vertex 3",
    ),
    "infinite": ("a.obj", re.sub(r"\.\d+", "inf", TETRA) + FACES, "3 of 4 vertices are not finite.*vertex 2"),
    "overflow": ("a.obj", TETRA.replace(".05", "1e999") + FACES, "1 of 4 vertices are not finite"),
    "nan ply": (
        "a.ply",
        PLY_TEXT.replace(".05", "NaN"),
        "1 of 4 vertices are not finite, the first is vertex 2",
    ),
    "nan off": (
        "a.off",
        OFF_TEXT.replace(".05", "nan"),
        "1 of 4 vertices are not finite, the first is vertex 2",
    ),
    "nan stl": ("a.stl", NAN_STL, "1 of 12 vertices are not finite, the first is vertex 0"),
    "points": ("a.obj", TETRA, "4 vertices but no faces: this is a point cloud"),
    "lines": ("a.obj", TETRA + "l 1 2 3\np 1\n", "no faces: this is a point cloud"),
    "points ply": (
        "a.ply",
        PLY_TEXT.split("3 0 2 1")[0].replace("face 4", "face 0"),
        "a point cloud needs at least 100 points, found 3",
    ),
    "points off": ("a.off", "OFF\n2 0 0\n0 0 0\n1 1 1\n", "2 vertices but no faces"),
    "faces only": ("a.obj", FACES, "found no vertices"),
    "no triangles": ("a.stl", b"\0" * 84, "found no vertices"),
    "strips": (
        "a.ply",
        PLY_TEXT.replace("element face", "element tristrips").replace("3 0 2", "-1 0 2"),
        "no faces: this is a point cloud",
    ),
    "collinear": ("a.obj", "v 0 0 0\nv .1 .1 .1\nv .3 .3 .3\nf 1 2 3\n", "all 1 triangles have zero area"),
    "one point": ("a.obj", "v 1 1 1\n" * 3 + "f 1 2 3\n", "all 1 triangles have zero area"),
    "flat": ("a.obj", "v 0 0 1\nv 1 0 1\nv 1 2 1\nv 0 2 1\nf 1 2 3 4\n", r"flat, 1 × 2 × 0 m .* along z"),
    "next to flat": ("a.obj", "v 0 0 0\nv 1e-7 0 1\nv 0 2 1\nv 0 2 0\nf 1 2 3 4\n", "flat.* along x"),
    "beyond the end": (
        "a.obj",
        TETRA + FACES.replace("2 3 4", "2 3 9"),
        "face 4 of 4 refers to vertex 9.* 1 to 4",
    ),
    "zero": ("a.obj", TETRA + "f 0 1 2\n", "face 1 of 1 refers to vertex 0.* 1 to 4"),
    "before the start": ("a.obj", TETRA + "f -1 -2 -5\n", "face 1 of 1 refers to vertex -5"),
    "far beyond": ("a.obj", TETRA + "f 1 2 99999999999999999999\n", "vertex 9223372036854775807"),
    "off beyond": ("a.off", OFF_TEXT.replace("3 1 2 3", "3 1 2 4"), "4 of 4 refers to vertex 4.* 0 to 3"),
    "off negative": ("a.off", OFF_TEXT.replace("3 1 2 3", "3 1 2 -1"), "refers to vertex -1"),
    "off nan index": (
        "a.off",
        OFF_TEXT.replace("3 1 2 3", "3 1 2 nan"),
        "no OFF mesh, or a damaged one",
    ),
    "ply beyond": ("a.ply", PLY_TEXT.replace("3 1 2 3", "3 1 2 7"), "face 4 of 4 refers to vertex 7"),
    "two corners": ("a.obj", TETRA + FACES + "f 1 2\n", "face 5 of 5 has 2 corners"),
    "two corners ply": ("a.ply", PLY_TEXT.replace("3 1 2 3", "2 1 2"), "face 4 of 4 has 2 corners"),
    "two coordinates": ("a.obj", TETRA + "v 1 2\n" + FACES, "line 5 should hold x, y and z, found 'v 1 2'"),
    "words": ("a.obj", TETRA + "v one two three\n" + FACES, "line 5 should hold numbers, found 'v one two"),
    "commas": (
        "a.obj",
        (TETRA + FACES).replace(".03", "0,03"),
        "decimal commas, as in 'v 0,03 0 0'; write them with points",
    ),
    "word face": ("a.obj", TETRA + FACES + "f 1/1 /2 3\n", "line 9 should hold numbers"),
    "half a face": ("a.obj", TETRA + FACES + "f 1.5 2 3\n", "line 9 should hold numbers"),
    "off cut": ("a.off", OFF_TEXT[:-20], "expected 4 of face, found 2; the file is damaged or cut short"),
    "off counts": ("a.off", OFF_TEXT.replace("4 4 6", "4"), "numbers of vertices and faces"),
    "off binary": ("a.off", "OFF BINARY\n4 4 6\n", "not an OFF mesh, or a binary one"),
    "off corners": (
        "a.off",
        OFF_TEXT.replace("3 1 2 3", "4 1 2 3"),
        "face 4 of 4 announces 4 corners, found 3",
    ),
    "off flat lines": ("a.off", OFF_TEXT.replace(".03 0 0", ".03 0"), "no OFF mesh, or a damaged one"),
    "off word": ("a.off", OFF_TEXT.replace(".03", "one"), "no OFF mesh, or a damaged one"),
    "off two corners": ("a.off", OFF_TEXT.replace("3 1 2 3", "2 1 2"), "face 4 of 4 has 2 corners"),
    "off huge": ("a.off", OFF_TEXT.replace("4 4 6", "4 99999999999999999 6"), "cut short"),
    "stl cut": ("a.stl", tetra("stl")[:-10], "an STL of 4 triangles needs 284 bytes, the file has 274"),
    "stl text cut": ("a.stl", STL_TEXT[: len(STL_TEXT) // 2], "damaged or cut short"),
    "stl two numbers": (
        "a.stl",
        STL_TEXT.replace("vertex 0.0", "vertex", 1),
        "no STL mesh, or a damaged one",
    ),
    "stl word": (
        "a.stl",
        STL_TEXT.replace("vertex 0.0", "vertex zero", 1),
        "no STL mesh, or a damaged one",
    ),
    "ply cut": ("a.ply", PLY_TEXT[:-20], "expected 4 of face|face .* has"),
    "ply binary cut": ("a.ply", tetra("ply")[:-10], "90 bytes are fewer than the PLY header announces"),
    "ply vertices cut": ("a.ply", tetra("ply")[:-80], "20 bytes are fewer than the PLY header announces"),
    "ply huge": (
        "a.ply",
        PLY_HEADER.format("binary_little_endian").replace("vertex 4", "vertex 99999999999"),
        "0 bytes are fewer than the PLY header announces",
    ),
    "ply format": (
        "a.ply",
        PLY_TEXT.replace("ascii", "ternary"),
        "names no format; known: ascii",
    ),
    "ply no format": ("a.ply", PLY_TEXT.replace("format ascii 1.0\n", ""), "names no format"),
    "ply no z": ("a.ply", PLY_TEXT.replace("float z", "float w"), "no PLY mesh, or a damaged one"),
    "ply type": (
        "a.ply",
        PLY_TEXT.replace("list uchar int", "list uchar quad"),
        "no PLY mesh, or a damaged one",
    ),
    "ply line": (
        "a.ply",
        PLY_TEXT.replace("element face", "elephant face"),
        "unknown line 'elephant",
    ),
    "ply odd row": (
        "a.ply",
        PLY_TEXT.replace("3 1 2 3", "4 1 2 3"),
        "face 4 of 4 announces 4 corners, found 3",
    ),
    "glb cut": ("a.glb", tetra("glb")[:-100], "the header promises 788 bytes, the file has 688"),
    "millimetres": (
        "a.obj",
        WIDE.format(120) + FACES,
        r"120 × 120 × 120 m, .*check the unit of the file: --unit mm makes it 120 × 120 × 120 mm$",
    ),
    "dust": ("a.obj", WIDE.format(6e-5) + FACES, r"6e-05 m, .*--scale 1000 makes it 60 × 60 × 60 mm"),
    "no unit fits": ("a.obj", WIDE.format(1e-7) + FACES, r"1e-07 m, .*such as --unit mm.*--scale"),
    "lfs": ("a.stl", LFS, "a Git LFS pointer and not the mesh file itself; fetch the file with git lfs pull"),
    "lfs points": ("a.xyz", LFS, "a Git LFS pointer and not the point cloud file itself"),
    "commas xyz": ("a.xyz", "0 0 0\n0,03 1,2 5\n" * 99, "decimal commas, as in '0,03 1,2 5'"),
    "commas csv": ("a.xyz", "x;y;z\n0,03;1,2;,5\n" * 99, "decimal commas, as in '0,03;1,2;,5'"),
    "commas off": ("a.off", OFF_TEXT.replace("0 .05 0", "0 0,05 0"), "decimal commas, as in '0 0,05 0'"),
    "commas stl": ("a.stl", STL_TEXT.replace("vertex 0.0", "vertex 0,0"), "decimal commas, as in 'vertex"),
    "map coordinates": (
        "a.obj",
        re.sub(r"v (\S+) (\S+)", lambda m: f"v {4e5 + float(m[1])} {5.4e6 + float(m[2])}", TETRA) + FACES,
        r"lies at 400000\.015 5400000\.025 0\.035 m, so far .*map coordinates.*subtract this position",
    ),
    "galaxy": ("a.obj", WIDE.format(1e300) + FACES, r"1e\+300 × .* m"),
    "beyond numbers": ("a.obj", WIDE.format(1e308) + "v -1e308 0 0\n" + FACES + "f 1 2 5\n", "inf × .* m"),
    "atom": ("a.obj", WIDE.format(1e-300) + FACES, r"1e-300 × .* m"),
}  # fmt: skip


def as_bytes(content: str | bytes) -> bytes:
    return content.encode() if isinstance(content, str) else content


@pytest.mark.parametrize("case", REFUSED)
def test_refused_with_its_own_sentence(tmp_path: Path, case: str, capfd: pytest.CaptureFixture[str]) -> None:
    name, content, message = REFUSED[case]
    file = tmp_path / name
    file.write_bytes(as_bytes(content))
    with warnings.catch_warnings(record=True) as noise:
        warnings.simplefilter("always")
        with pytest.raises(ObjectError) as caught:
            load_object(file)
    assert not noise
    text = str(caught.value)
    assert text.startswith(f"{file}: ")
    assert re.search(message, text.removeprefix(f"{file}: ")), text
    assert "\n" not in text
    assert len(text.removeprefix(str(file))) < 260
    assert caught.value.exit_code == 2
    assert type(pickle.loads(pickle.dumps(caught.value))) is ObjectError  # noqa: S301
    assert capfd.readouterr() == ("", "")


def test_the_good_ones_of_this_file_are_good(tmp_path: Path) -> None:
    """Otherwise the refusals above could have another cause."""
    for name, content in {
        "a.obj": TETRA + FACES, "b.stl": STL_TEXT, "c.ply": PLY_TEXT, "d.off": OFF_TEXT,
        "e.stl": tetra("stl"), "f.ply": tetra("ply"), "g.glb": tetra("glb"),
    }.items():  # fmt: skip
        (tmp_path / name).write_bytes(as_bytes(content))
        mesh = load_object(tmp_path / name)
        assert mesh.counts == (4, 4, 4, 4), name
        assert mesh.volume == pytest.approx(0.03 * 0.05 * 0.07 / 6, rel=1e-6)


@pytest.mark.parametrize(
    ("size", "accepted"), [(0.99e-4, False), (1.01e-4, True), (9.9, True), (10.1, False)]
)
def test_limits_of_size(tmp_path: Path, size: float, accepted: bool) -> None:
    file = tmp_path / "a.obj"
    file.write_text(WIDE.format(size) + FACES)
    if accepted:
        assert load_object(file).extents == pytest.approx([size] * 3)
    else:
        with pytest.raises(ObjectError, match=r"largest extent must lie between 0\.0001 and 10 m"):
            load_object(file)


@pytest.mark.parametrize("path", ["nowhere.obj", "no/such/folder/a.stl", "a.obj/b.obj", "cup.v2", "./cup"])
def test_missing_file(tmp_path: Path, path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.obj").write_text(TETRA)
    with pytest.raises(ObjectError, match=re.escape(path) + ": there is no such file; check the path"):
        load_object(path)


def test_things_that_are_no_files(tmp_path: Path) -> None:
    (tmp_path / "folder.obj").mkdir()
    with pytest.raises(ObjectError, match="this is a folder; name one mesh file in it"):
        load_object(tmp_path / "folder.obj")
    with pytest.raises(ObjectError, match="this is a folder"):
        load_object(str(tmp_path))
    with pytest.raises(ObjectError, match="this is not a path"):
        load_object("a\0b.obj")
    with pytest.raises(EnvironmentFailure, match=r"cannot be read .File name too long"):
        load_object("a" * 5000 + ".obj")
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.obj")
        with pytest.raises(ObjectError, match="not a regular file"):
            load_object(tmp_path / "pipe.obj")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "s.obj"))
        with pytest.raises(ObjectError, match="not a regular file"):
            load_object(tmp_path / "s.obj")


def test_no_permission_is_not_the_object_s_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As with a file of another user; a superuser who runs the test can read everything."""

    def forbidden(*_: object, **__: object) -> bytes:
        raise PermissionError(13, "Permission denied")

    file = tmp_path / "a.obj"
    file.write_text(TETRA + FACES)
    monkeypatch.setattr("preshape.files.open", forbidden, raising=False)
    with pytest.raises(EnvironmentFailure, match=r"cannot be read .Permission denied.") as caught:
        load_object(file)
    assert caught.value.exit_code == 3


def test_a_file_removed_between_look_and_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def late(path: Path, *how: object, **more: object) -> object:
        path.unlink()
        return open(path, *how, **more)  # type: ignore[call-overload]

    file = tmp_path / "a.obj"
    file.write_text(TETRA + FACES)
    monkeypatch.setattr("preshape.files.open", late, raising=False)
    with pytest.raises(ObjectError, match="no such file"):
        load_object(file)


def test_too_little_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise MemoryError

    file = tmp_path / "a.obj"
    file.write_text(TETRA + FACES)
    monkeypatch.setattr("preshape.objects.read_obj.read_obj", full)
    with pytest.raises(EnvironmentFailure, match="not enough memory"):
        load_object(file)


@pytest.mark.parametrize("scale", [0, -1.0, float("nan"), float("inf"), True, "2", None])
def test_scale_must_be_positive_and_finite(scale: object) -> None:
    with pytest.raises(InputError, match="scale must be a positive, finite number, got"):
        load_object("a.obj", scale=scale)  # type: ignore[arg-type]


@pytest.mark.parametrize("unit", ["km", "", "M", None])
def test_unknown_unit(unit: object) -> None:
    with pytest.raises(InputError, match=r"unknown unit .*known: m, cm, mm, in, inch"):
        load_object("a.obj", unit=unit)  # type: ignore[arg-type]


# mutation ----------------------------------------------------------------------------------------------

WORDS = [
    b"nan",
    b"-1",
    b"1e999",
    b"\xff" * 4,
    b"\0" * 4,
    b"/",
    b"#",
    b"\\\n",
    b"\n",
    b"f ",
    b"v ",
    b" 0 ",
    b"9" * 25,
]


def mutate(content: bytes, rng: np.random.Generator) -> bytes:
    data = bytearray(content)
    digits = [k for k, byte in enumerate(content) if byte in b"0123456789"]
    for _ in range(int(rng.integers(1, 3))):
        at, other = (int(k) for k in rng.integers(0, len(data) + 1, 2))
        match int(rng.integers(8)):
            case 6 | 7 if digits and len(data) == len(content):
                data[int(rng.choice(digits))] = int(rng.choice(list(b"0123456789.-")))
            case 0 if at < len(data):
                data[at] = int(rng.integers(256))
            case 1 if at < len(data):
                data[at] ^= 1 << int(rng.integers(8))
            case 2:
                data[at:at] = WORDS[int(rng.integers(len(WORDS)))]
            case 3:
                del data[at : at + int(rng.integers(1, 30))]
            case 4:
                data[at:at] = data[other : other + 40]
            case _:
                data[at : at + 4] = WORDS[int(rng.integers(len(WORDS)))][:4]
    return bytes(data)


SEEDS: dict[str, tuple[str, bytes]] = {
    "obj": (".obj", (TETRA + "vn 0 0 1\n" + FACES.replace("4", "4/1/1") + "f -1 -2 -3 -4\n").encode()),
    "stl": (".stl", tetra("stl")),
    "stl text": (".stl", STL_TEXT.encode()),
    "ply": (".ply", tetra("ply")),
    "ply text": (".ply", PLY_TEXT.encode()),
    "off": (".off", OFF_TEXT.encode()),
    "glb": (".glb", tetra("glb")),
}


@pytest.mark.parametrize("kind", SEEDS)
def test_damaged_files_are_refused_or_right(
    tmp_path: Path, kind: str, capfd: pytest.CaptureFixture[str]
) -> None:
    """A damaged file gives either a valid mesh or an error of one sentence."""
    suffix, content = SEEDS[kind]
    rng = np.random.default_rng(list(kind.encode()))
    outcomes = {"mesh": 0, "refused": 0}
    file = tmp_path / f"a{suffix}"
    rounds = int(os.environ.get("PRESHAPE_FUZZ", "200"))
    for _ in range(rounds):
        file.write_bytes(mutate(content, rng))
        with warnings.catch_warnings(record=True) as noise:
            warnings.simplefilter("always")
            try:
                mesh = load_object(file)
            except ObjectError as error:
                sentence = str(error)
                mesh = None
        assert not noise
        if mesh is None:
            assert "\n" not in sentence
            assert sentence.startswith(f"{file}: ")
            outcomes["refused"] += 1
            continue
        outcomes["mesh"] += 1
        assert np.isfinite(mesh.vertices).all()
        assert set(np.unique(mesh.triangles)) == set(range(len(mesh.vertices)))
        assert (mesh.areas > 0).all()
        assert 1e-4 <= mesh.extents.max() <= 10
        assert mesh.extents.min() >= 1e-6 * mesh.extents.max()
        assert mesh.attributes.triangles >= len(mesh.triangles) or mesh.notes  # lids
        assert np.isfinite(mesh.volume)
    assert outcomes["mesh"] >= rounds // 40, outcomes
    assert outcomes["refused"] >= rounds // 20, outcomes
    assert capfd.readouterr() == ("", "")


def test_every_suffix_is_damaged_somewhere() -> None:
    assert {suffix for suffix, _ in SEEDS.values()} | {".gltf"} == set(SUFFIXES)
