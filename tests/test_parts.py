"""Parts of objects: exact cuts, groups of files, sidecar files, and the library's own parts."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh

from preshape.exceptions import InputError, ObjectError
from preshape.objects import library
from preshape.objects.load import load_object
from preshape.objects.mesh import TriangleMesh, box_mesh
from preshape.objects.parts import (
    FILE,
    SIDECAR,
    ObjectPart,
    find_part,
    part_of_triangles,
    part_pieces,
    part_surface,
    parts_at,
    whole_surface,
)
from preshape.objects.regions import Facing, HalfSpace, TriangleSet, box, cylinder

BOX = box_mesh("block", np.array([0.06, 0.04, 0.1]))  # area 0.0248 m²


def ball() -> TriangleMesh:
    made = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    return TriangleMesh(name="ball", vertices=np.array(made.vertices), triangles=np.array(made.faces))


@pytest.mark.parametrize(
    ("region", "area"),
    [
        (box([-1, -1, -1], [1, 1, 0]), 0.06 * 0.04 + 0.2 * 0.05),
        (HalfSpace(normal=np.array([0, 0, 2.0]), offset=0.08), 0.06 * 0.04 + 0.2 * 0.01),
        (cylinder([0, 0, -1], [0, 0, 1], 0.01), 2 * np.pi * 0.01**2),
        (Facing(direction=np.array([1.0, 0, 0]), least=0.9), 0.04 * 0.1),
        (box([0, -1, -1], [1, 1, 1]) & box([-1, -1, 0], [1, 1, 1]), 0.03 * 0.04 + 0.05 * 0.1),
        (box([0, -1, -1], [1, 1, 1]) | box([-1, -1, -1], [0, 1, 1]), 0.0248),
        (box([-1, -1, -1], [1, 1, 1]) - box([-1, -1, -1], [1, 1, 0]), 0.06 * 0.04 + 0.2 * 0.05),
    ],
)
def test_the_surface_in_a_region_has_exactly_the_area_of_the_geometry(region, area) -> None:
    inside, outside = region.split(whole_surface(BOX))
    assert inside.area == pytest.approx(area, rel=1e-9)
    assert inside.area + outside.area == pytest.approx(BOX.area, rel=1e-12)


def test_every_point_of_the_pieces_lies_on_its_side_and_on_the_triangle_it_comes_from() -> None:
    mesh = ball()
    region = cylinder([0.01, 0, -1], [0.01, 0, 1], 0.02) & box([-1, -1, -0.3], [1, 0.013, 1])
    for pieces, within in zip(region.split(whole_surface(mesh)), (True, False), strict=True):
        middles = pieces.corners.mean(axis=1)
        radius = np.hypot(middles[:, 0] - 0.01, middles[:, 1])
        # The prism's sides lie within 0.13 % of the circle.
        clear = np.abs(radius - 0.02) > 5e-5
        inside = (radius < 0.02) & (middles[:, 1] <= 0.013)
        assert (inside[clear] == within).all()
        plane = mesh.normals[pieces.owners]
        height = np.einsum("mkj,mj->mk", pieces.corners - mesh.corners[pieces.owners][:, :1], plane)
        assert np.abs(height).max() < 1e-12


def test_a_moved_region_cuts_the_moved_mesh_alike() -> None:
    region = (cylinder([0, 0, -1], [0, 0.1, 1], 0.02) | box([-1, -1, 0.02], [1, 1, 1])) - box(
        [0, 0, 0], [1, 1, 1]
    )
    scale, offset = 2.5, np.array([0.3, -0.1, 0.05])
    mesh = ball()
    moved = TriangleMesh(name="b", vertices=scale * mesh.vertices + offset, triangles=mesh.triangles)
    area = part_pieces(mesh, region).area
    assert part_pieces(moved, region.moved(scale, offset)).area == pytest.approx(scale**2 * area, rel=1e-9)


def test_lids_belong_to_no_part() -> None:
    lidded = TriangleMesh(name="open", vertices=BOX.vertices, triangles=BOX.triangles, lids=2)
    everything = ObjectPart(name="all", region=box([-1, -1, -1], [1, 1, 1]))
    assert len(part_surface(BOX, everything)) == 12
    assert len(part_surface(lidded, everything)) == 10


@pytest.mark.parametrize("text", ["z>0.04", " Z > 4e-2 ", "-1 -1 .04 1 1 1", "-1, -1, 0.04, 1, 1, 1"])
def test_a_text_of_numbers_describes_a_part(text) -> None:
    part = find_part(BOX, text)
    assert part_pieces(BOX, part.region).area == pytest.approx(0.06 * 0.04 + 0.2 * 0.01, rel=1e-9)


@pytest.mark.parametrize(
    ("text", "word"),
    [("", "a part is a name"), ("1 2 3", "3 numbers"), ("1 1 1 0 0 0", "lower corner"), ("z>1", "nothing of"),
     ("handel", "no named parts"), ("q>1", "no named parts"), ("z>nan", "no named parts"),
     ("nan 0 0 1 1 1", "finite")],
)  # fmt: skip
def test_a_part_that_is_not_there_is_refused_with_a_sentence(text, word) -> None:
    with pytest.raises(InputError, match=word):
        find_part(BOX, text)


def test_names_are_found_whatever_their_capitals_and_blanks() -> None:
    wrench = library.load_library_object("wrench")
    assert find_part(wrench, "Large_Jaw").name == find_part(wrench, "large-jaw").name == "large jaw"
    with pytest.raises(InputError, match="known: shank, large jaw, small jaw"):
        find_part(wrench, "jaw")


# --- groups of files -------------------------------------------------------------------------------------


def write_obj(path: Path, *, polygons: bool = False) -> Path:
    """A block whose upper half is the group head, with a name of an object and two materials."""
    lines = [f"v {x} {y} {z}" for x, y, z in BOX.vertices]
    faces = BOX.triangles + 1
    if polygons:  # the two triangles of each side as one face
        faces = [[a, b, c, d] for (a, b, c), (_, _, d) in zip(faces[::2], faces[1::2], strict=True)]
    marks = {0: ["o tool", "g front all", "usemtl red steel"], len(faces) // 2: ["g back", "usemtl wood"]}
    for k, face in enumerate(faces):
        lines += marks.get(k, [])
        lines.append("f " + " ".join(map(str, face)))
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("polygons", [False, True])
def test_groups_objects_and_materials_of_obj_are_parts(tmp_path, polygons) -> None:
    mesh = load_object(write_obj(tmp_path / "block.obj", polygons=polygons))
    areas = {part.name: part_pieces(mesh, part.region).area for part in mesh.parts}
    half = BOX.areas[:6].sum()
    expected = {"tool": BOX.area, "front": half, "all": half, "back": BOX.area - half}
    expected |= {"red steel": half, "wood": BOX.area - half}
    assert areas == pytest.approx(expected)
    assert {part.origin for part in mesh.parts} == {FILE}


def test_groups_survive_what_cleaning_drops(tmp_path) -> None:
    path = write_obj(tmp_path / "block.obj")
    lines = path.read_text().splitlines()
    first = next(k for k, line in enumerate(lines) if line.startswith("f"))
    lines.insert(first, "f 1 1 2")  # no area
    lines.append(lines[first + 1])  # a triangle of the first group again
    path.write_text("\n".join(lines))
    mesh = load_object(path)
    areas = {part.name: part_pieces(mesh, part.region).area for part in mesh.parts}
    assert len(mesh.triangles) == 12
    assert areas["front"] == pytest.approx(BOX.areas[:6].sum())
    assert areas["back"] == pytest.approx(BOX.areas[6:].sum())


def test_nodes_meshes_and_materials_of_glb_are_parts(tmp_path) -> None:
    scene = trimesh.Scene()
    for name, material, height in (("Handle", "wood", 0.0), ("Head", "steel", 0.06)):
        made = (
            trimesh.creation.box((0.02, 0.02, 0.1))
            if height == 0
            else trimesh.creation.icosphere(radius=0.02)
        )
        made.visual = trimesh.visual.TextureVisuals(
            material=trimesh.visual.material.PBRMaterial(name=material)
        )
        moved = trimesh.transformations.translation_matrix([0, 0, height])
        scene.add_geometry(made, node_name=name, geom_name=f"{name} mesh", transform=moved)
    scene.export(tmp_path / "tool.glb")
    mesh = load_object(tmp_path / "tool.glb")
    for name in ("Head", "Head mesh", "steel"):
        low, high = np.array([f(part_surface(mesh, find_part(mesh, name)).vertices, axis=0)
                              for f in (np.min, np.max)])  # fmt: skip
        assert np.allclose(low, [-0.02, -0.02, 0.04], atol=1e-6)
        assert np.allclose(high, [0.02, 0.02, 0.08], atol=1e-6)
    assert part_pieces(mesh, find_part(mesh, "wood").region).area == pytest.approx(0.0088, rel=1e-6)


# --- sidecar files ---------------------------------------------------------------------------------------

SIDE = """
mass = 0.4
com = [0, 0, 0.01]
up = "-x"
rest = [0.0, 1.0, 0.0, 0.0]
tasks = ["strike", "lift"]
[[part]]
name = "grip"
box = [-1, -1, -1, 1, 1, 0]
[[part]]
name = "H"
group = "front"
[[part]]
name = "core"
cylinder = [[0, 0, -1], [0, 0, 1], 0.01]
[[part]]
name = "end"
halfspace = [0, 0, 2, 0.08]
"""


def test_a_sidecar_says_what_the_mesh_cannot(tmp_path) -> None:
    write_obj(tmp_path / "block.obj")
    (tmp_path / "block.preshape.toml").write_text(SIDE)
    mesh = load_object(tmp_path / "block.obj")
    assert (mesh.mass, mesh.up, mesh.tasks) == (0.4, "-x", ("strike", "lift"))
    assert mesh.com.tolist() == [0, 0, 0.01]
    assert mesh.rest.tolist() == [0, 1, 0, 0]
    assert [part.name for part in mesh.parts[:4]] == ["grip", "core", "end", "H"]
    assert {part.origin for part in mesh.parts[:4]} == {SIDECAR}
    areas = [part_pieces(mesh, part.region).area for part in mesh.parts[:4]]
    assert areas == pytest.approx([0.0124, 2 * np.pi * 1e-4, 0.0044, BOX.areas[:6].sum()])


def test_lengths_of_a_sidecar_are_metres_after_unit_and_scale(tmp_path) -> None:
    path = write_obj(tmp_path / "block.obj")
    path.write_text(path.read_text().replace("0.0", "0.00"))  # any file; it is scaled by 10 below
    (tmp_path / "block.preshape.toml").write_text('[[part]]\nname = "end"\nhalfspace = [0, 0, 1, 0.04]\n')
    mesh = load_object(path, scale=10)
    surface = part_surface(mesh, mesh.parts[0])
    assert surface.vertices[:, 2].min() == pytest.approx(0.04)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("weight = 1", "known: mass, com, up, rest, tasks, part"),
        ("mass = -1", "mass"), ("mass = true", "mass"), ("mass = nan", "mass"), ('mass = "1"', "mass"),
        ("com = [1, 2]", "com must be 3 numbers"), ("com = [1, 2, inf]", "com"),
        ('up = "w"', "up must be one of"), ("up = 1", "up must be one of"),
        ("rest = [0, 0, 0, 0]", "unit quaternion"), ("rest = [1, 0, 0]", "4 numbers"),
        ("tasks = 1", "preshape tasks"), ("part = 1", "list of tables"), ("part = [1]", "list of tables"),
        ("[[part]]\nbox = [0,0,0,1,1,1]", "needs a name"),
        ('[[part]]\nname = "a"', "exactly one of"),
        ('[[part]]\nname = "a"\nbox = [0,0,0,1,1,1]\ngroup = "front"', "exactly one of"),
        ('[[part]]\nname = "a"\nsphere = 1', "known: name, box, halfspace, cylinder, group"),
        ('[[part]]\nname = "a"\nbox = [1,0,0,0,1,1]', "lower corner"),
        ('[[part]]\nname = "a"\nhalfspace = [0,0,0,1]', "direction"),
        ('[[part]]\nname = "a"\ncylinder = [[0,0,0],[0,0,0],1]', "apart"),
        ('[[part]]\nname = "a"\ncylinder = [[0,0,0],[0,0,1],0]', "radius"),
        ('[[part]]\nname = "a"\ngroup = "nose"', "does not have; known: tool, front"),
        ('[[part]]\nname = "a"\nbox = [0,0,0,1,1,1]\n[[part]]\nname = "a"\nbox = [0,0,0,1,1,1]', "two parts"),
        ("mass = ", "not TOML"), ("[" * 5000, "not TOML"), ("\0", "not TOML"),
    ],
)  # fmt: skip
def test_a_sidecar_that_cannot_be_used_is_refused_by_name(tmp_path, text, word) -> None:
    write_obj(tmp_path / "block.obj")
    (tmp_path / "block.preshape.toml").write_text(text)
    with pytest.raises(ObjectError, match=word) as error:
        load_object(tmp_path / "block.obj")
    assert "block.preshape.toml" in str(error.value)


def test_a_sidecar_that_is_a_pipe_or_too_large_is_not_read(tmp_path) -> None:
    write_obj(tmp_path / "block.obj")
    side = tmp_path / "block.preshape.toml"
    os.mkfifo(side)
    with pytest.raises(ObjectError, match="not a regular file"):
        load_object(tmp_path / "block.obj")
    side.unlink()
    side.write_bytes(b"#" * (2**20 + 1))
    with pytest.raises(ObjectError, match="too much"):
        load_object(tmp_path / "block.obj")


def test_a_sidecar_that_is_a_link_to_nothing_is_not_passed_over(tmp_path) -> None:
    write_obj(tmp_path / "block.obj")
    (tmp_path / "block.preshape.toml").symlink_to(tmp_path / "gone.toml")
    with pytest.raises(ObjectError, match="a link to a file that does not exist"):
        load_object(tmp_path / "block.obj")


# --- the library -----------------------------------------------------------------------------------------

every_object = pytest.mark.parametrize("name", library.names())


@every_object
def test_every_library_object_has_parts_and_rules_that_name_them(name) -> None:
    mesh = library.load_library_object(name)
    names = [part.name for part in mesh.parts]
    assert len(names) == len(set(names)) >= 2
    for part in mesh.parts:
        share = part_pieces(mesh, part.region).area / mesh.area
        assert 0.005 < share < 0.99, part.name
    for rule in mesh.rules:
        assert set(rule.hold_on) | set(rule.keep_off) <= set(names)
        assert not set(rule.hold_on) & set(rule.keep_off)
        assert set(rule.tasks) <= set(mesh.tasks)
        assert rule.hold_on or rule.keep_off


def bounds(name: str, part: str, scale: float = 1.0) -> np.ndarray:
    """Lower and upper corner of a part [mm], with the object's own at (0, 0, 0) below."""
    mesh = library.load_library_object(name, scale=scale)
    vertices = part_surface(mesh, find_part(mesh, part)).vertices
    return 1000 * np.array([vertices.min(axis=0), vertices.max(axis=0)])


def test_parts_lie_where_their_names_say() -> None:
    # Each line is a dimension of the generator, from the middle of the object's bounding box.
    assert bounds("hammer", "face")[:, 0] == pytest.approx([42.5, 43.7], abs=0.2)
    assert bounds("hammer", "handle")[:, 2] == pytest.approx([-77.5, 51.5], abs=0.1)
    assert bounds("bottle", "cap")[:, 2] == pytest.approx([63.3, 82.5], abs=0.1)
    assert bounds("jar", "lid")[:, 2] == pytest.approx([28.4, 45.6], abs=0.1)
    assert bounds("screwdriver", "handle")[0, 2] == pytest.approx(-5.1, abs=0.1)
    assert bounds("mug", "handle")[0, 0] == pytest.approx(24.8, abs=0.1)
    assert bounds("bolt", "head")[:, 2] == pytest.approx([28.9, 44], abs=0.1)
    assert bounds("light_bulb", "bulb")[:, 2] == pytest.approx([-27.5, 53.5], abs=0.1)
    assert bounds("hammer", "face", scale=0.5)[:, 0] == pytest.approx([21.2, 21.8], abs=0.2)


@pytest.mark.parametrize("name", ["mug", "bowl", "pan", "wine_glass"])
def test_the_inside_of_a_vessel_faces_its_axis_and_its_body_faces_away(name) -> None:
    mesh = library.load_library_object(name)
    rim = part_surface(mesh, find_part(mesh, "rim")).vertices[:, :2]
    centre = (rim.min(axis=0) + rim.max(axis=0)) / 2

    def facing(part: str) -> float:
        """Share of a part's area that faces the axis, or up."""
        pieces = part_pieces(mesh, find_part(mesh, part).region)
        normals = pieces.crosses / np.linalg.norm(pieces.crosses, axis=1, keepdims=True)
        inward = np.einsum("ij,ij->i", normals[:, :2], centre - pieces.corners.mean(axis=1)[:, :2])
        areas = np.linalg.norm(pieces.crosses, axis=1)
        return float(areas[(inward > 1e-6) | (normals[:, 2] > 0.5)].sum() / areas.sum())

    assert facing("inside") > 0.999
    assert facing("bowl" if name == "wine_glass" else "body") < 0.02  # where a handle begins


@pytest.mark.parametrize("name", ["mug", "bottle", "hammer", "teapot", "nut", "domino", "scissors"])
def test_parts_that_share_an_object_out_cover_it_once(name) -> None:
    """These objects' parts without smaller ones in them (a face in a head) add up to the whole surface."""
    mesh = library.load_library_object(name)
    within = {"hammer": ("face", "claw")}.get(name, ())
    areas = [part_pieces(mesh, part.region).area for part in mesh.parts if part.name not in within]
    assert sum(areas) == pytest.approx(mesh.area, rel=0.01)


def test_a_set_of_triangles_keeps_to_them() -> None:
    region = TriangleSet(triangles=np.array([3, 1, 3]))
    assert region.split(whole_surface(BOX))[0].owners.tolist() == [1, 3]


@pytest.mark.parametrize("name", ["mug", "hammer", "bottle"])
def test_points_and_triangles_belong_to_the_last_part_whose_surface_they_lie_on(name) -> None:
    mesh = load_object(name)
    rng = np.random.default_rng(3)
    surfaces = [part_surface(mesh, part) for part in mesh.parts]
    expected, points = [], []
    for k, surface in enumerate(surfaces):
        for triangle in rng.choice(surface.vertices[surface.triangles], 20):
            point = triangle.mean(axis=0)
            if all(_distance(later, point) > 1e-3 for later in surfaces[k + 1 :]):
                points.append(point + 1e-6 * rng.normal(size=3))
                expected.append(mesh.parts[k].name)
    assert len(set(expected)) == len(mesh.parts)
    assert parts_at(mesh, np.array(points)) == expected
    assert parts_at(mesh, np.array(points[:1])) == expected[:1]
    own = part_of_triangles(mesh)
    spots = mesh.corners.mean(axis=1)
    inner = [i for i in range(0, len(own), 97) if _spread(mesh.corners[i]) < 0.005]
    names = ["" if own[i] < 0 else mesh.parts[own[i]].name for i in inner]
    same = np.mean([a == b for a, b in zip(names, parts_at(mesh, spots[inner]), strict=True)])
    assert same > 0.9  # triangles that a border cuts belong to the part that has most of them
    assert parts_at(box_mesh("box", [0.1, 0.1, 0.1]), np.zeros((2, 3))) == ["", ""]


def _spread(corners) -> float:
    return float(np.linalg.norm(np.ptp(corners, axis=0)))


def _distance(surface, point) -> float:
    """Distance from a point to the corners and middles of a surface's triangles."""
    corners = surface.vertices[surface.triangles]
    spots = np.concatenate([corners.reshape(-1, 3), corners.mean(axis=1)])
    return float(np.linalg.norm(spots - point, axis=1).min())
