"""One object a file: bodies apart, ground planes, specks, depth meshes, open shells, absurd sizes."""

from __future__ import annotations

import copy
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from preshape.cli.main import run
from preshape.exceptions import InputError, ObjectError
from preshape.hands.load import load_hand
from preshape.objects.checks import other_units
from preshape.objects.load import load_object, mesh_from, split_part
from preshape.objects.mass import object_mass
from preshape.objects.mesh import TriangleMesh, box_mesh
from preshape.physics.pieces import decompose
from preshape.planning.request import PlanRequest
from preshape.planning.session import Session
from preshape.planning.sizes import refuse_absurd_size


def can(
    radius: float = 0.03, height: float = 0.12, at: tuple[float, float, float] = (0, 0, 0)
) -> trimesh.Trimesh:
    return trimesh.creation.cylinder(radius, height, sections=24).apply_translation(at)


def shell(*, caps: bool = False, sections: int = 24) -> trimesh.Trimesh:
    """The wall of a can without its ends."""
    whole = trimesh.creation.cylinder(0.03, 0.12, sections=sections)
    wall = np.abs(whole.face_normals[:, 2]) < 0.5
    return whole if caps else trimesh.Trimesh(whole.vertices, whole.faces[wall])


def sheet(size: float, z: float) -> trimesh.Trimesh:
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * size / 2 + [0, 0, z]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]])


def together(*parts: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.util.concatenate(list(parts))


def saved(folder: Path, *parts: trimesh.Trimesh) -> Path:
    file = folder / "parts.obj"
    together(*parts).export(file)
    return file


def test_bodies_that_lie_apart_are_refused_named_and_chosen(tmp_path: Path) -> None:
    file = saved(tmp_path, can(), can(0.02, 0.08, (0.15, 0, 0)))
    with pytest.raises(ObjectError, match=r"2 bodies that lie apart.*--part-of-file N") as refused:
        load_object(file)
    assert "1: 60 × 60 × 120 mm at 0 0 0 m; 2: 40 × 40 × 80 mm at 0.15 0 0 m" in str(refused.value)
    for part, height, across in (("1", 0.12, 0.06), ("2", 0.08, 0.04), ("all", 0.12, 0.2)):
        np.testing.assert_allclose(load_object(f"{file}#{part}").extents[[2, 0]], [height, across], atol=1e-9)
    with pytest.raises(InputError, match="no part 3 in the file, which holds 1: 60"):
        load_object(f"{file}#3")
    (tmp_path / "parts.obj#1").write_text("a name that ends so")
    assert split_part(f"{file}#1") == (f"{file}#1", None)


@pytest.mark.parametrize("seed", range(6))
def test_the_gap_counts_in_every_pose_and_size(seed: int) -> None:
    """Two boxes with their bounding boxes entangled: apart with a gap of a tenth, one body if they touch."""
    rng = np.random.default_rng(seed)
    size = 10.0 ** rng.uniform(-2, -1)
    pose = trimesh.transformations.random_rotation_matrix(rng.random(3))
    pose[:3, 3] = rng.uniform(-0.3, 0.3, 3)
    rod, other = trimesh.creation.box([1, 0.2, 0.2]), trimesh.creation.box([0.2, 0.5, 0.2])
    for gap, apart in ((0.1, True), (0.0, False), (-0.05, False)):
        body = together(rod, other.copy().apply_translation([0.3, 0.35 + gap, 0]))
        body.apply_scale(size).apply_transform(pose)
        if apart:
            with pytest.raises(ObjectError, match="2 bodies that lie apart"):
                mesh_from(body)
        else:
            assert mesh_from(body).notes == ()


def test_a_cavity_belongs_to_its_body_but_what_lies_in_an_open_corner_does_not() -> None:
    inner = trimesh.creation.icosphere(2, 0.02)
    inner.invert()
    assert len(mesh_from(together(trimesh.creation.icosphere(3, 0.05), inner)).triangles) == 1280 + 320
    wall, floor = trimesh.creation.box([0.01, 0.2, 0.2]), trimesh.creation.box([0.2, 0.2, 0.01])
    corner = trimesh.boolean.union(
        [wall.apply_translation([-0.1, 0, 0]), floor.apply_translation([0, 0, -0.1])]
    )
    assert corner.body_count == 1
    with pytest.raises(ObjectError, match="2 bodies that lie apart"):
        mesh_from(together(corner, trimesh.creation.icosphere(2, 0.03).apply_translation([0.04, 0, 0.03])))


@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_a_ground_plane_and_a_table_top_are_named(tmp_path: Path, turn: float) -> None:
    table = trimesh.creation.box([0.8, 0.6, 0.02]).apply_translation([0, 0, -0.07])
    for plate in (sheet(1.0, -0.06), table):
        parts = [can(), plate]
        for part in parts:
            part.apply_transform(trimesh.transformations.rotation_matrix(turn, [1, 0.3, 0]))
        file = saved(tmp_path, *parts)
        with pytest.raises(ObjectError, match=r"a flat plate besides the object.*1: \d.* mm.*; 2: "):
            load_object(file)
        assert load_object(f"{file}#1").volume == pytest.approx(can().volume, rel=1e-5)


def test_a_lid_with_a_knob_is_one_object() -> None:
    knob = trimesh.creation.icosphere(2, 0.015).apply_translation([0, 0, 0.014])
    assert mesh_from(together(trimesh.creation.cylinder(0.1, 0.004), knob)).extents[0] > 0.19


def test_specks_are_left_out_and_said(tmp_path: Path) -> None:
    specks = [trimesh.creation.box([0.001] * 3).apply_translation(at) for at in ((0.2, 0, 0), (0, 9.0, 0))]
    mesh = load_object(saved(tmp_path, can(), *specks))
    np.testing.assert_allclose(mesh.extents, [0.06, 0.06, 0.12], atol=1e-6)
    assert mesh.notes == ("2 small pieces of the file, apart from the object, are left out",)
    assert mesh.attributes.triangles == len(mesh.triangles)
    with Session(":memory:", learn=False) as session:
        ready = session.prepare(
            PlanRequest(source=mesh, task="lift", learn=False, memory=":memory:", hand="utah_mit")
        )
    assert ready.warnings[0] == mesh.notes[0]


def test_an_open_shell_is_the_same_solid_for_planner_and_physics() -> None:
    open_shell, whole = mesh_from(shell()), mesh_from(shell(caps=True))
    assert whole.notes == ()
    assert open_shell.notes == (
        "the surface is open: 2 holes closed by flat lids; the object is planned and tested as a solid, and "
        "no finger is placed on a lid",
    )
    assert open_shell.volume == pytest.approx(whole.volume, rel=1e-9)
    assert decompose(open_shell).volume == pytest.approx(open_shell.volume, rel=0.02)


def test_lids_are_marked_kept_and_said_of_the_mass() -> None:
    mesh = mesh_from(shell())
    assert mesh.lids == 2 * 24
    inner = mesh.corners[:, :, :2].mean(axis=1)  # only a lid's triangle reaches the axis
    np.testing.assert_array_equal(mesh.is_lid, np.linalg.norm(inner, axis=1) < 0.025)
    for copied in (copy.deepcopy(mesh), replace(mesh, vertices=2 * mesh.vertices)):
        np.testing.assert_array_equal(copied.is_lid, mesh.is_lid)
    assert mesh.same_as(copy.copy(mesh))
    assert not mesh.same_as(replace(mesh, lids=0))
    assert "lids enclose as filled with water: the file's surface is open" in object_mass(mesh).warning
    assert object_mass(mesh, 0.2).warning == object_mass(mesh_from(shell(caps=True))).warning == ""
    with pytest.raises(ObjectError, match="12 of 12 triangles cannot be lids"):
        replace(box_mesh("box", np.ones(3)), lids=12)
    with pytest.raises(ObjectError, match="the number of lids must be a whole number"):
        replace(mesh, lids=-1)


@pytest.mark.parametrize("caps", [True, False])
@pytest.mark.parametrize("step", [2, 3, 7])
def test_mixed_winding_is_mended_and_said(caps: bool, step: int) -> None:
    """Volume and normals are those of the file that is wound consistently, whatever is reversed."""
    right, wrong = shell(caps=caps), shell(caps=caps)
    faces = np.array(wrong.faces)
    faces[::step] = faces[::step, ::-1]
    expected, mended = mesh_from(right), mesh_from(trimesh.Trimesh(wrong.vertices, faces, process=False))
    count = len(faces)
    assert mended.notes == (
        "triangles of the file are wound against their neighbours: "
        f"{-(-count // step)} of {count} were reversed",
        *expected.notes,
    )
    assert mended.volume == pytest.approx(expected.volume, rel=1e-9)
    assert mended.lids == expected.lids
    np.testing.assert_allclose(mended.normals[:count], expected.normals[:count], atol=1e-9)
    assert object_mass(mended).kg == pytest.approx(object_mass(expected).kg, rel=1e-9)


def test_consistent_winding_changes_nothing_even_inside_out() -> None:
    body = trimesh.creation.icosphere(2, 0.03)
    for faces in (body.faces, body.faces[:, ::-1]):
        mesh = mesh_from(trimesh.Trimesh(body.vertices, faces, process=False))
        assert mesh.notes == ()
        np.testing.assert_array_equal(mesh.triangles, faces)


def test_a_small_hole_changes_nothing() -> None:
    ball = trimesh.creation.icosphere(4, 0.05)
    holed = mesh_from(trimesh.Trimesh(ball.vertices, ball.faces[3:]))
    assert (holed.notes, len(holed.triangles)) == ((), len(ball.faces) - 3)


@pytest.mark.parametrize("eye", [(0.0, -1.0, 0.0), (0.3, 0.8, 0.4), (0.0, 0.0, 1.0)])
def test_one_side_of_a_body_is_refused_as_a_depth_image(eye: tuple[float, float, float]) -> None:
    for body in (can(), trimesh.creation.icosphere(3, 0.05), trimesh.creation.box([0.05, 0.08, 0.1])):
        seen = body.face_normals @ np.array(eye) > 0.05
        with pytest.raises(ObjectError, match=r"flat|one side only, as the mesh of a depth image.*points"):
            mesh_from(trimesh.Trimesh(body.vertices, body.faces[seen]))


def test_triangles_that_are_not_joined_are_no_open_surface() -> None:
    """As in a file of loose triangles whose corners differ by rounding."""
    ball = trimesh.creation.icosphere(3, 0.05)
    corners = ball.vertices[ball.faces].reshape(-1, 3)
    shift = np.random.default_rng(0).uniform(-2e-5, 2e-5, corners.shape)
    loose = mesh_from(trimesh.Trimesh(corners + shift, np.arange(len(corners)).reshape(-1, 3), process=False))
    assert (loose.notes, len(loose.triangles)) == ((), len(ball.faces))


# sizes and units ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("factor", "unit", "named", "not_named"),
    [
        (1 / 0.0254, "m", "--unit in makes it 60 × 60 × 120 mm", "--unit mm"),
        (100.0, "m", "--unit cm makes it 60 × 60 × 120 mm", "--unit in"),
        (1000.0, "cm", "--unit mm makes it 60 × 60 × 120 mm", "--unit m "),
        (0.01, "m", "--scale 100 makes it 60 × 60 × 120 mm", "--unit"),
        (0.01, "in", "", "--unit in"),
        (1.0, "mm", "--unit m makes it 60 × 60 × 120 mm", "--unit mm"),
    ],
)
def test_an_absurd_size_names_the_unit_that_fits(
    tmp_path: Path, factor: float, unit: str, named: str, not_named: str
) -> None:
    file = saved(tmp_path, can().apply_scale(factor))
    with pytest.raises(ObjectError, match="check the unit of the file: ") as refused:
        refuse_absurd_size(load_object(file, unit=unit), load_hand("shadow"))
    assert named in str(refused.value)
    assert not_named not in str(refused.value)


def test_a_plausible_size_is_not_refused_for_any_hand() -> None:
    for name in ("utah_mit", "shadow", "allegro", "leap"):
        for extents in ((0.005, 0.005, 0.012), (0.02, 0.02, 1.0), (0.5, 0.5, 0.5)):
            refuse_absurd_size(box_mesh("box", np.array(extents)), load_hand(name))


def test_no_unit_is_named_only_because_it_fits() -> None:
    extents = np.array([0.7, 0.7, 2.0])
    assert other_units(extents, "m") == (
        "check the unit of the file: --unit cm makes it 7 × 7 × 20 mm, "
        "--unit in makes it 17.8 × 17.8 × 50.8 mm"
    )
    assert other_units(1e-9 * extents, "m") == ""


def test_an_absurd_mass_names_its_unit() -> None:
    mesh = mesh_from(can())
    assert object_mass(mesh, 0.3).warning == ""
    assert object_mass(mesh, 300.0).warning.endswith("--mass is in kilograms; 300 g are --mass 0.3")
    large = TriangleMesh(name="can", vertices=100 * mesh.vertices, triangles=mesh.triangles)
    assert "--unit cm makes it" in object_mass(large).warning
    assert math.isclose(object_mass(mesh).kg, 1000 * mesh.volume)


def test_the_command_line_chooses_a_part(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = saved(tmp_path, can(), can(0.02, 0.08, (0.15, 0, 0)))
    words = ["plan", str(file), "--task", "lift", "--memory", ":memory:", "--no-learn", "--json"]
    assert run(words) == 2
    assert "2 bodies that lie apart" in json.loads(capsys.readouterr().out)["reason"]
    assert run([*words, "--part-of-file", "two"]) == 2
    assert "takes a number from 1, or all" in json.loads(capsys.readouterr().out)["reason"]
    assert run([*words, "--part-of-file", "2"]) in (0, 1)
    document = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose(document["object"]["extents"], [0.04, 0.04, 0.08], atol=1e-6)
    assert document["request"]["object"]["source"] == f"{file}#2"
