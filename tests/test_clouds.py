"""Point clouds: reading, refusals, closed surfaces with their seen part, and plans."""

from __future__ import annotations

import io
import json
import struct
from dataclasses import replace

import jsonschema
import numpy as np
import pytest

from preshape.cli import main as cli
from preshape.closure.settings import ClosureSettings
from preshape.exceptions import InputError, ObjectError
from preshape.kernels.field.host import SurfaceQuery
from preshape.kernels.surface_points import surface_points
from preshape.objects.library import load_library_object
from preshape.objects.load import CLOUD_SUFFIXES, load_object
from preshape.objects.mesh import TriangleMesh
from preshape.objects.read_ply import read_ply
from preshape.objects.scans.cleaning import cleaned
from preshape.objects.scans.complete import complete, solid
from preshape.objects.scans.read_points import read_npy, read_pcd, read_xyz
from preshape.objects.scans.scan import RawCloud, Scan
from preshape.objects.scans.sight import HIDDEN, hidden_share, sight_of
from preshape.objects.scans.symmetry import symmetries
from preshape.objects.scans.table import find_table
from preshape.objects.scans.trust import UNSEEN, seen_weight, trust_of
from preshape.physics.pieces import ConvexPieces
from preshape.planner import plan
from preshape.planning.answers import scan_trust, seen_first
from preshape.planning.document import plan_schema, plan_to_json
from preshape.planning.plan import Plan
from preshape.planning.planner_bench import Case
from preshape.planning.standing import standing
from preshape.studies.partial_report import cloud_figures, cloud_tables, write_cloud_report
from preshape.studies.partial_views import CloudRun, agreement, completed, depth_view, run_clouds

pytestmark = pytest.mark.usefixtures("small_pictures")

FEW = np.random.default_rng(0).uniform(0.01, 0.05, (7, 3)).round(4)

R = np.random.default_rng(5)
PLANE = np.column_stack([R.uniform(0, 0.1, (2000, 2)), R.normal(0.5, 0.0008, 2000)])
BALL = R.normal(size=(900, 3))
BALL = 0.03 * BALL / np.linalg.norm(BALL, axis=1, keepdims=True)


def camera_of(mesh: TriangleMesh, turn: float = 0.9, rise: float = 0.6) -> np.ndarray:
    away = [np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)]
    return mesh.cog + 0.6 * np.array(away)


def seen(name: str, *, noise: float = 0.0005) -> tuple[TriangleMesh, np.ndarray, np.ndarray]:
    """A library object, the points of one view of it, and the camera's position."""
    mesh = load_library_object(name)
    camera = camera_of(mesh)
    return mesh, depth_view(mesh, camera, noise=noise, rng=np.random.default_rng(1)), camera


@pytest.fixture(scope="module")
def box() -> tuple[TriangleMesh, np.ndarray, np.ndarray]:
    return seen("box")


@pytest.fixture(scope="module")
def surfaces() -> dict[str, TriangleMesh]:
    """The surfaces from one view of each of some objects."""
    return {name: completed("symmetry", name, *seen(name)[1:]) for name in ("box", "bottle")}


# -- reading -------------------------------------------------------------------------------------------


def pcd(data: str, body: bytes, *, viewpoint: str = "0 0 0 1 0 0 0", count: int = len(FEW)) -> bytes:
    header = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS rgb x y z\nSIZE 4 4 4 8\nTYPE U F F F\nCOUNT 1 1 1 1\n"
        f"WIDTH {count}\nHEIGHT 1\nVIEWPOINT {viewpoint}\nPOINTS {count}\nDATA {data}\n"
    )
    return header.encode() + body


def columns() -> list[bytes]:
    x, y, z = FEW.T
    return [np.arange(7, dtype="<u4").tobytes(), *(c.astype("<f4").tobytes() for c in (x, y)), z.tobytes()]


def lzf(data: bytes) -> bytes:
    """LZF-compressed data with plain runs, and with copies of four or more earlier bytes."""
    out, plain, at = bytearray(), bytearray(), 0

    def flush() -> None:
        for start in range(0, len(plain), 32):
            part = plain[start : start + 32]
            out.extend([len(part) - 1, *part])
        plain.clear()

    while at < len(data):
        length = next(
            (n for n in range(20, 3, -1) if at + n <= len(data) and data[at : at + n] in data[:at]), 0
        )
        if not length:
            plain.append(data[at])
            at += 1
            continue
        flush()
        back = at - data[:at].rindex(data[at : at + length]) - 1
        code = length - 2
        out.extend([(min(code, 7) << 5) | back >> 8, *([code - 7] if code >= 7 else []), back & 255])
        at += length
    flush()
    return bytes(out)


def test_every_kind_of_file_gives_its_points():
    rows = "\n".join(f"{k} {x} {y} {z}" for k, (x, y, z) in enumerate(FEW)).encode()
    table = [struct.pack("<Iffd", k, *point) for k, point in enumerate(FEW)]
    plain = b"".join(columns())
    packed = lzf(plain)
    assert len(packed) < len(plain) + 5  # copies were made: the zeros of the first field
    array = io.BytesIO()
    np.save(array, np.concatenate([FEW, np.full((7, 3), 9.0)], axis=1))
    commas = "x,y,z,red\n7\n" + "\n".join(f"{x},{y};{z} 0.5 # note" for x, y, z in FEW)
    found = {
        "pcd text": read_pcd("f", pcd("ascii", rows)),
        "pcd": read_pcd("f", pcd("binary", b"".join(table))),
        "pcd packed": read_pcd(
            "f", pcd("binary_compressed", struct.pack("<II", len(packed), len(plain)) + packed)
        ),
        "npy": read_npy("f", array.getvalue()),
        "xyz": read_xyz("f", commas.encode()),
    }
    for kind, cloud in found.items():
        assert cloud.points == pytest.approx(FEW, rel=1e-6), kind
        assert cloud.camera is None, kind
    placed = read_pcd("f", pcd("ascii", rows, viewpoint="0.1 -0.2 0.6 1 0 0 0"))
    assert placed.camera == pytest.approx([0.1, -0.2, 0.6])


@pytest.mark.parametrize(
    ("suffix", "content", "says"),
    [
        (".pcd", b"hello", "expected a PCD header"),
        (".pcd", pcd("ascii", b"1 2 3"), "expected 7 points of 4 numbers, found 3"),
        (".pcd", pcd("ascii", b"1 2 three 4"), "should be numbers"),
        (".pcd", pcd("binary", b"\0" * 30), "7 points need 140 bytes, found 30"),
        (".pcd", pcd("binary_compressed", struct.pack("<II", 3, 140) + b"\xff\xff\xff"), "do not hold 7"),
        (".pcd", pcd("zipped", b""), "known: ascii, binary, binary_compressed"),
        (".pcd", pcd("ascii", b"").replace(b"x y z", b"a b c"), "fields x, y and z"),
        (".pcd", pcd("ascii", b"").replace(b"SIZE 4", b"SIZE 3"), "header is invalid"),
        (".pcd", pcd("ascii", b"1 2 3 4", count=1, viewpoint="here 0 0"), "VIEWPOINT"),
        (".npy", b"hello", "expected an NPY array"),
        (".xyz", b"0 0 0\n1 2\n", "line 2 should hold x, y and z, found '1 2'"),
        (".xyz", b"0 0 0\n1 nan 0\n", "1 of 2 points are not finite, the first is point 2"),
        (".xyz", b"\0\1\2", "found binary data"),
        (".xyz", b"Dear reader,\n", "found 0"),
        *((suffix, b" \n", "the file is empty; expected a point cloud") for suffix in CLOUD_SUFFIXES),
        (".pcd", b"\x89PNG", "expected a point cloud, this is a PNG image"),
    ],
)
def test_a_file_that_holds_no_points_is_refused(tmp_path, suffix, content, says):
    file = tmp_path / f"a{suffix}"
    file.write_bytes(content)
    with pytest.raises(ObjectError) as refused:
        load_object(file)
    sentence = str(refused.value)
    assert sentence.startswith(f"{file}: ")
    assert says in sentence
    assert "mesh" not in sentence
    assert "\n" not in sentence


def test_an_array_of_words_or_of_two_columns_is_refused():
    for array, says in ((np.array(["a"]), "other data"), (np.zeros((9, 2)), "got 9 × 2")):
        buffer = io.BytesIO()
        np.save(buffer, array)
        with pytest.raises(ObjectError, match=says):
            read_npy("f", buffer.getvalue())


def ply(points: np.ndarray, form: str, camera: np.ndarray | None = None) -> bytes:
    header = ["ply", f"format {form} 1.0", f"element vertex {len(points)}"]
    header += [f"property double {axis}" for axis in "xyz"]
    if camera is not None:
        header += ["element camera 1", *(f"property float view_p{axis}" for axis in "xyz")]
    header += ["element face 0", "property list uchar int vertex_indices"] if form == "ascii" else []
    text = "\n".join([*header, "end_header\n"]).encode()
    if form == "ascii":
        rows = [*points, *([camera] if camera is not None else [])]
        return text + "\n".join(" ".join(map(repr, map(float, row))) for row in rows).encode() + b"\n"
    last = b"" if camera is None else camera.astype("<f4").tobytes()
    return text + points.astype("<f8").tobytes() + last


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
def test_a_ply_without_faces_is_a_cloud_and_one_that_is_cut_short_is_not(tmp_path, form, box):
    _, points, camera = box
    content = ply(points, form, camera)
    cloud = read_ply("scan.ply", content)
    assert isinstance(cloud, RawCloud)
    assert cloud.points.tolist() == points.tolist()
    assert cloud.camera == pytest.approx(camera, rel=1e-6)
    file = tmp_path / "scan.ply"
    file.write_bytes(content[: len(content) // 2])
    with pytest.raises(ObjectError, match=r"cut short|damaged"):
        load_object(file)


# -- frames and units ----------------------------------------------------------------------------------


def test_the_file_s_frame_is_kept_and_a_camera_at_its_origin_is_found(tmp_path, box, surfaces):
    _, points, camera = box
    file = tmp_path / "scan.npy"
    np.save(file, np.concatenate([points - camera, np.full((400, 3), np.nan)]))  # pixels without an echo
    own = load_object(file)
    assert own.scan is not None
    assert own.scan.camera is not None
    assert own.scan.camera.tolist() == [0, 0, 0]
    assert own.scan.points == len(points)
    assert own.bounds + camera == pytest.approx(surfaces["box"].bounds, abs=1e-4)


def test_the_file_s_unit_is_kept_and_its_camera_is_in_it(tmp_path, monkeypatch):
    file = tmp_path / "scan.npy"
    np.save(file, 1000 * BALL + np.array([0.0, 200.0, 0.0]))
    mesh = load_object(file, unit="mm", view="all", scale=0.5)
    assert mesh.cog == pytest.approx([0, 0.1, 0], abs=1e-3)
    assert mesh.extents == pytest.approx([0.03] * 3, abs=1e-3)
    asked: list[object] = []

    def stop(name: str, cloud: RawCloud, camera: object, **_: object) -> None:
        asked.append(camera)
        raise ObjectError("stopped")

    monkeypatch.setattr("preshape.objects.scans.complete.complete", stop)
    with pytest.raises(ObjectError, match="stopped"):
        load_object(file, unit="mm", view=[0, 0, 500], scale=0.5)
    assert np.asarray(asked[0]) == pytest.approx([0, 0, 0.25])


@pytest.mark.parametrize("name", ["cube", "bottle", "hammer", "ring"])
def test_one_view_is_told_from_points_from_all_round(name):
    mesh, points, camera = seen(name)
    everywhere, _ = surface_points(mesh, 0.002)
    assert hidden_share(points, camera) < HIDDEN < hidden_share(everywhere, camera)


def test_a_camera_that_cannot_have_seen_the_points_is_refused(box):
    mesh, points, camera = box
    with pytest.raises(InputError, match=r"cannot have seen these points: \d+ % of them are behind others"):
        complete("scan", RawCloud(points=points), camera - np.array([0.0, 0.0, 3.0]))
    with pytest.raises(InputError, match="cannot have seen these points: it is among them"):
        complete("scan", RawCloud(points=points), mesh.cog)
    with pytest.raises(InputError, match="position x,y,z or all"):
        complete("scan", RawCloud(points=points), "left")


# -- surfaces ------------------------------------------------------------------------------------------


def closed(mesh: TriangleMesh) -> bool:
    edges = np.concatenate([mesh.triangles[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))])
    return sorted(map(tuple, edges.tolist())) == sorted(map(tuple, edges[:, ::-1].tolist()))


@pytest.mark.parametrize("name", ["box", "bottle"])
def test_one_view_becomes_a_closed_body_that_is_exact_where_it_was_seen(name, surfaces):
    true, mesh = load_library_object(name), surfaces[name]
    camera = camera_of(true)
    assert mesh.scan is not None
    assert closed(mesh)
    assert mesh.volume == pytest.approx(true.volume, rel=0.25)  # positive: outward
    middles = mesh.corners.mean(axis=1)
    off = np.abs(SurfaceQuery(true).closest(middles).distance)
    was_seen = mesh.scan.seen
    assert np.median(off[was_seen]) < 0.0007
    assert np.quantile(off[was_seen], 0.9) < 0.002
    # What faces away from the camera was not seen; what was seen faces it, but for the rim.
    facing = np.einsum("ij,ij->i", mesh.normals, camera - middles) > 0
    assert facing[was_seen].mean() > 0.85
    assert was_seen[facing].mean() > 0.85
    away = np.einsum("ij,ij->i", mesh.normals, camera - middles) < -0.1
    assert was_seen[away].mean() < 0.25
    assert mesh.scan.seen_share == pytest.approx(mesh.areas[was_seen].sum() / mesh.area)


def test_symmetry_guesses_better_than_the_hull_and_than_straight_back(box, surfaces):
    true, points, camera = box
    found = agreement(true, surfaces["box"])
    for method in ("straight", "hull"):
        other = agreement(true, completed(method, "box", points, camera))
        assert found["iou"] > other["iou"] + 0.03
        assert found["chamfer"] < other["chamfer"]


def test_the_solid_lies_nowhere_that_was_seen_to_be_free(box):
    _, points, camera = box
    kept = cleaned("box", points, camera)
    sight = sight_of(kept, camera)
    found = symmetries(sight, kept)
    assert found
    rays = kept - camera
    free = camera + rays * np.linspace(0.3, 0.97, 9)[:, None, None]
    assert (sight.free(free.reshape(-1, 3)) > 0).all()
    assert (solid(sight, found, free.reshape(-1, 3)) > 0).all()
    assert np.quantile(np.abs(sight.free(kept)), 0.95) < 0.002
    just_behind = camera + rays * (1 + 0.004 / np.linalg.norm(rays, axis=1, keepdims=True))
    assert (sight.free(just_behind) < 0).mean() > 0.9
    for one in found:
        assert one.linear @ one.linear.T == pytest.approx(np.eye(3), abs=1e-9)
        assert one.apply(one.apply(kept)) == pytest.approx(kept, abs=1e-9)


@pytest.mark.parametrize("name", ["cube", "bottle"])
def test_points_from_all_round_become_the_whole_body(name):
    true = load_library_object(name)
    points, _ = surface_points(true, 0.0025)
    points = points + np.random.default_rng(0).normal(0, 0.0002, points.shape)
    made = complete(name, RawCloud(points=points))
    mesh = TriangleMesh(name=name, vertices=made.vertices, triangles=made.triangles)
    assert made.scan.camera is None
    assert made.scan.seen_share > 0.98
    assert closed(mesh)
    assert mesh.volume == pytest.approx(true.volume, rel=0.06)
    assert np.abs(SurfaceQuery(true).closest(mesh.corners.mean(axis=1)).distance).mean() < 0.0006


# -- refusals ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("points", "says"),
    [
        (BALL[:50], "needs at least 100 points, found 50"),
        (np.tile(BALL[:1], (500, 1)), "found 1 different points"),
        (PLANE, "all points lie on a plane, within 0.8 mm"),
        (PLANE @ np.linalg.qr(R.normal(size=(3, 3)))[0], "all points lie on a plane"),
        (np.outer(np.linspace(0, 0.1, 500), [1, 1, 1]), "all points lie on a plane"),
        (np.concatenate([BALL, BALL + np.array([0.2, 0, 0])]), r"two separate objects of \d+ and \d+ points"),
        (1000 * BALL, "--unit mm"),
        (np.where(np.arange(900)[:, None] == 3, np.inf, BALL), "1 of 900 points are not finite"),
    ],
    ids=["few", "same", "plane", "turned plane", "line", "two", "millimetres", "infinite"],
)
def test_what_is_no_body_is_refused_with_one_sentence(tmp_path, points, says, capsys):
    file = tmp_path / "scan.npy"
    np.save(file, points)
    options = ["--task", "lift", "--memory", str(tmp_path / "m.sqlite"), "--json"]
    assert cli.run(["plan", str(file), *options]) == 2
    out, _ = capsys.readouterr()
    document = json.loads(out)
    assert document["status"] == "error"
    with pytest.raises(ObjectError, match=says):
        load_object(file)
    assert str(file) in document["reason"]
    assert "\n" not in document["reason"]


def test_the_ball_of_these_tests_and_one_with_stray_points_are_good():
    stray = R.uniform(-0.1, 0.1, (9, 3))
    made = complete("ball", RawCloud(points=np.concatenate([BALL, stray])))
    assert np.ptp(made.vertices, axis=0) == pytest.approx([0.06] * 3, abs=0.003)


@pytest.mark.parametrize("view", ["1,2", "here", "1 2 nan"])
def test_a_view_that_is_no_place_is_refused(view, capsys):
    assert cli.run(["plan", "mug", "--task", "lift", "--view", view]) == 2
    assert "--view takes" in " ".join(capsys.readouterr().err.split())


def test_a_view_of_a_mesh_is_refused():
    with pytest.raises(InputError, match="a view is for a point cloud"):
        load_object("mug", view=[0, 0, 1])


def test_suffixes_of_clouds_are_known():
    assert CLOUD_SUFFIXES == (".pcd", ".xyz", ".npy", ".npz")


# -- tables and pixels without an echo -----------------------------------------------------------------


@pytest.fixture(scope="module")
def on_table(box) -> tuple[TriangleMesh, np.ndarray, np.ndarray]:
    """The box on a tilted table, the points of one view of both, and the camera's position."""
    mesh, _, _ = box
    edges = [(-0.12, -0.15), (0.18, -0.15), (0.18, 0.15), (-0.12, 0.15)]
    table = np.array([[x, y, mesh.bounds[0, 2]] for x, y in edges])
    both = TriangleMesh(
        name="both",
        vertices=np.concatenate([mesh.vertices, table]),
        triangles=np.concatenate([mesh.triangles, np.array([[0, 1, 2], [0, 2, 3]]) + len(mesh.vertices)]),
    )
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    camera = mesh.cog + 0.6 * np.array([0.5, 0.6, 0.7])
    return mesh, depth_view(both, camera, noise=0.0008, rng=np.random.default_rng(1)) @ turn, camera @ turn


def test_a_table_in_a_cloud_is_named_and_cut_off_when_asked(tmp_path, on_table, capsys):
    mesh, points, camera = on_table
    file = tmp_path / "scan.npy"
    np.save(file, points)
    view = camera.tolist()
    with pytest.raises(
        ObjectError, match=r"\d\d % of the points lie on one plane of .* probably a table; .*cut"
    ):
        load_object(file, view=view)
    cut = load_object(file, view=view, cut_table=True)
    assert cut.extents.max() < 1.2 * np.linalg.norm(mesh.extents)
    assert 0.5 * mesh.volume < cut.volume < 2.0 * mesh.volume
    assert len(points) > 3 * cut.scan.points > 300  # the points that are left
    assert load_object(file, view=view, cut_table=False).scan.table is None
    # The plane that was cut off is the table, and its normal is up, however the cloud is turned.
    stands = standing(cut, table="auto")
    assert stands.table == pytest.approx(cut.scan.table)
    heights = cut.vertices @ stands.up - stands.table[3]
    assert -0.01 < heights.min() < 0.01
    own = mesh.vertices[:, 2] - mesh.bounds[0, 2]
    assert heights.max() == pytest.approx(own.max(), rel=0.25)
    assert standing(cut, table="auto", up="z").table[:3].tolist() != stands.table[:3].tolist()
    assert load_object(file, view=view, cut_table=False).extents.max() > 1.4 * cut.extents.max()
    words = ["plan", str(file), "--task", "lift", "--view", ",".join(map(str, view)), "--no-learn", "--json"]
    memory = ["--memory", str(tmp_path / "m.sqlite")]
    assert cli.run([*words, *memory]) == 2
    assert "--cut-table" in json.loads(capsys.readouterr().out)["reason"]
    assert cli.run([*words, *memory, "--cut-table"]) in (0, 1)
    document = json.loads(capsys.readouterr().out)
    assert document["request"]["object"]["cut_table"] is True
    jsonschema.Draft202012Validator(plan_schema()).validate(document)


@pytest.mark.parametrize("name", ["box", "domino", "phone", "plate", "pan", "bowl", "hammer", "hand_wheel"])
def test_no_side_of_an_object_is_taken_for_a_table(name):
    mesh = load_library_object(name)
    for away in ([0, 0, 1], [1, 0.3, 0.5], [-0.5, 0.8, 0.9], [0.2, -0.1, 1.0], [0.7, 0.7, 0.2]):
        camera = mesh.cog + 0.5 * np.array(away) / np.linalg.norm(away)
        assert find_table(depth_view(mesh, camera, noise=0.001, rng=np.random.default_rng(0))) is None


def test_a_cloud_without_a_table_is_not_cut(tmp_path, box):
    _, points, camera = box
    file = tmp_path / "scan.npy"
    np.save(file, points)
    asked, plain = (load_object(file, view=camera, cut_table=cut) for cut in (True, None))
    assert np.array_equal(asked.vertices, plain.vertices)
    with pytest.raises(InputError, match="cutting off a table is for a point cloud"):
        load_object("mug", cut_table=True)


def test_rows_of_zeros_are_no_echoes_and_the_camera_stays_at_the_origin(box):
    _, points, camera = box
    plain = complete("box", RawCloud(points=points - camera))
    holes = np.insert(points - camera, [0, 50, 50, 900, len(points)], [0.0, -0.0, 0.0], axis=0)
    made = complete("box", RawCloud(points=holes))
    assert made.scan.camera is not None
    assert np.array_equal(made.vertices, plain.vertices)
    assert made.scan.points == len(points)


# -- trust and plans -----------------------------------------------------------------------------------


def test_trust_is_what_was_seen():
    scan = Scan(
        points=9, camera=None, seen=np.array([1, 1, 0, 0], dtype=bool), seen_share=0.5, guess="guessed"
    )
    every, half, none = (np.array(rows) for rows in ([0, 1], [0, 2], [2, 3]))
    assert [seen_weight(scan, rows) for rows in (every, half, none)] == [1.0, (1 + UNSEEN) / 2, UNSEEN]
    trusts = [trust_of(scan, rows).trust for rows in (every, half, none)]
    assert trusts == sorted(trusts, reverse=True)
    assert trusts[0] == 1.0
    assert trusts[2] == 0.0
    said = trust_of(scan, half)
    assert said.contacts_seen == (True, False)
    assert said.sentence.startswith("1 of 2 contacts are on seen surface; 50 % of the surface")
    assert trust_of(scan, None).contacts_seen == ()
    assert trust_of(replace(scan, seen_share=0.1), every).trust < trust_of(scan, every).trust


QUICK = ClosureSettings(everywhere=300, elite=8, children=3, rounds=1, persistence=0, threads=1)


@pytest.fixture(scope="module")
def on_cloud(tmp_path_factory, lesson) -> tuple[Plan, np.ndarray]:
    """A plan on one view of a cylinder, and the points."""
    _, points, camera = seen("cylinder")
    file = tmp_path_factory.mktemp("cloud") / "scan.npy"
    np.save(file, points)
    more = {"closure": QUICK, "memory": lesson("shadow"), "learn": False, "count": 4}
    options = {"hand": "shadow", "table": None, **more}
    return plan(file, "lift", view=camera.tolist(), **options), points


def test_a_plan_on_a_cloud_says_which_contacts_were_seen_and_prefers_them(on_cloud):
    made, points = on_cloud
    assert made.answer is not None
    scan = made.mesh.scan
    assert scan is not None
    document = plan_to_json(made)
    jsonschema.Draft202012Validator(plan_schema()).validate({**document, "alternatives": []})
    answers = [made.answer, *made.alternatives]
    assert 1 <= len(answers) <= 4
    for answer, said in zip(answers, [document, *document["alternatives"]], strict=True):
        cloud = said["cloud"]
        contacts = np.array([contact["point"] for contact in said["contacts"]])
        away = np.linalg.norm(points[:, None] - contacts[None], axis=2).min(axis=0)
        assert len(cloud["contacts_seen"]) == len(contacts)
        for marked, distance in zip(cloud["contacts_seen"], away, strict=True):
            assert distance < 0.006 if marked else distance > 0.001
        assert cloud == json.loads(json.dumps(cloud))
        assert cloud["points"] == len(points)
        found = scan_trust(made, answer)
        assert found is not None
        assert found.trust == cloud["trust"]

    def rank(answer):
        margin = -np.log2(1 - min(answer.grasp.judged, 6 - 1e-9) / 6)
        return margin * seen_weight(scan, answer.grasp.contacts.triangles)

    ranks = [rank(answer) for answer in answers]
    assert ranks == sorted(ranks, reverse=True)
    turned = replace(made, answer=answers[-1], alternatives=tuple(answers[:-1]))
    assert seen_first(turned, keep=2).answer is made.answer
    assert len(seen_first(turned, keep=2).alternatives) == min(1, len(answers) - 1)
    unseen = replace(made, mesh=replace(made.mesh, scan=None))
    assert seen_first(unseen, keep=1) is unseen
    assert plan_to_json(unseen)["cloud"] is None


def test_an_answer_at_trust_0_is_no_answer(on_cloud):
    made, _ = on_cloud
    scan = made.mesh.scan
    blind = replace(made, mesh=replace(made.mesh, scan=replace(scan, seen=np.zeros_like(scan.seen))))
    refused = seen_first(blind, keep=2)
    assert refused.answer is None
    assert refused.alternatives == ()
    document = plan_to_json(refused)
    assert document["status"] == "deadlock"
    assert "guessed surface (trust 0)" in document["reason"]
    assert document["best"] is not None
    jsonschema.Draft202012Validator(plan_schema()).validate(document)
    # Of two answers, one of which touches what was seen, only that one is kept.
    answers = [made.answer, *made.alternatives]
    triangles = [set(answer.grasp.contacts.triangles.tolist()) for answer in answers]
    lone = sorted(triangles[-1] - set().union(*triangles[:-1]))
    only = np.isin(np.arange(len(scan.seen)), lone)
    kept = seen_first(replace(made, mesh=replace(made.mesh, scan=replace(scan, seen=only))), keep=4)
    assert kept.answer is answers[-1]
    assert kept.alternatives == ()


def test_the_surface_that_was_planned_with_is_written_whole(tmp_path, box):
    _, points, camera = box
    made = plan(
        completed("hull", "box", points, camera), "lift", memory=":memory:", learn=False, hand="utah_mit"
    )
    file = tmp_path / "box-surface.obj"
    assert file in made.save(tmp_path)
    again = load_object(file)
    assert again.vertices == pytest.approx(made.mesh.vertices, abs=1e-15)
    assert again.scan is None
    from_file = plan(file, "lift", memory=":memory:", learn=False, hand="utah_mit")
    assert len(from_file.save(tmp_path / "again")) == 3  # no surface beside the plan
    assert "seen" in str(made)  # the summary says what is trusted


# -- the study -----------------------------------------------------------------------------------------


def test_the_study_tests_on_the_true_object_and_goes_on_from_what_it_has_kept(
    tmp_path, monkeypatch, on_cloud
):
    study = "preshape.studies.partial_views"
    asked: list[TriangleMesh] = []

    def planned(mesh: TriangleMesh, *_: object, **__: object) -> Plan:
        asked.append(mesh)
        return on_cloud[0]

    monkeypatch.setattr(f"{study}._planned", planned)  # what takes long
    true = load_library_object("cylinder")
    pieces = {"cylinder": ConvexPieces(name="cylinder", pieces=(true.vertices,))}
    case = Case(name="cylinder@1", source="cylinder", scale=1.0)
    run = CloudRun(hands=("shadow",), cases=(case,), views=1, methods=("hull",))
    told: list[tuple[int, int, str]] = []
    options = {"folder": tmp_path, "pieces": pieces, "workers": 1}
    rows = run_clouds(run, **options, progress=lambda *step: told.append(step))
    assert told == [(1, 1, "cylinder@1, shadow")]
    assert [mesh.scan is None for mesh in asked] == [True, False]  # the whole mesh, then the view
    (found,) = rows
    assert found["whole"] is found["held"]  # the same answer on the same true object
    assert 0.4 < found["shapes"]["hull"]["iou"] < 1.0
    monkeypatch.setattr(f"{study}._case_rows", None)  # would be called
    assert run_clouds(run, **options) == json.loads(json.dumps(rows))
    monkeypatch.setattr(f"{study}._case_rows", lambda *_: [])
    other = CloudRun(hands=("shadow",), cases=(case,), views=1, methods=("hull",), seed=1)
    assert run_clouds(other, **options) == []  # another study does not take these for its own


def row(view: int, held: bool, trust: float, *, whole: bool = True, case: str = "a@1") -> dict:
    return {
        "hand": "shadow", "case": case, "view": view, "whole": whole, "held": held, "by_margin": not held,
        "trust": trust, "seen_share": 0.4, "contacts_seen": [True, False], "points": 9,
        "shapes": {"symmetry": {"iou": 0.8, "chamfer": 0.002}},
    }  # fmt: skip


def test_the_figures_count_what_they_say(tmp_path):
    cases = (Case(name="a@1", source="a", scale=1.0), Case(name="b@1", source="b", scale=1.0))
    run = CloudRun(hands=("shadow",), cases=cases, views=2, methods=("symmetry",))
    rows = [row(0, True, 0.9), row(1, False, 0.2), row(0, True, 1.0, whole=False, case="b@1")]
    lost = {"hand": "shadow", "case": "b@1", "view": 1, "whole": False, "held": False, "by_margin": False}
    document = cloud_figures(run, [*rows, {**lost, "refused": "two things"}])
    hand = document["hands"]["shadow"]
    assert (hand["whole_mesh"]["held"], hand["whole_mesh"]["tested"]) == (1, 2)
    assert (hand["cloud"]["held"], hand["cloud"]["tested"]) == (2, 4)
    assert (hand["where_the_whole_mesh_held"]["held"], hand["where_the_whole_mesh_held"]["tested"]) == (1, 2)
    assert hand["cloud_by_margin_alone"]["held"] == 1
    assert [part["tested"] for part in document["trust"]] == [1, 0, 2]
    assert document["shapes"]["symmetry"] == {
        "views": 3,
        "iou": pytest.approx(0.8),
        "chamfer": pytest.approx(0.002),
    }
    assert document["refused"] == [{"hand": "shadow", "case": "b@1", "view": 1, "reason": "two things"}]
    assert all(len(line) == len(t.columns) for t in cloud_tables(document) for line in t.rows)
    written = write_cloud_report(document, tmp_path)
    assert "shadow, b@1, view 1: two things" in written[1].read_text()


@pytest.mark.parametrize("change", [{"views": 0}, {"noise": -1.0}, {"methods": ("best",)}, {"seed": -1}])
def test_a_study_that_makes_no_sense_is_refused(change):
    with pytest.raises(InputError):
        CloudRun(hands=("shadow",), cases=(), **change)
