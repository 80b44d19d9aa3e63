"""Links keep the shape that their file has: convex pieces in their own frames, spheres fitted inside."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from preshape.closure.hand_tables import link_shapes
from preshape.exceptions import HandError
from preshape.hands import menagerie
from preshape.hands.check import check_hand
from preshape.hands.collision import ObjectCollision
from preshape.hands.compiled import read_model
from preshape.hands.hulls import DEVIATION, MOST_CORNERS, ellipsoid_corners, few_corners, hull, mesh_pieces
from preshape.hands.kinematics import HandKinematics, LinkShape, hand_hulls
from preshape.hands.link_pieces import geom_pieces, geom_text, mesh_text, outside
from preshape.hands.load import built_in_text, joined, load_hand
from preshape.hands.mirror import mirrored
from preshape.hands.rewrite import rebuilt
from preshape.kernels.hand_spheres import COARSE, FINE, LinkSolid, exposed, link_spheres
from preshape.kernels.hull_spheres import Polyhedron
from preshape.objects.mesh import TriangleMesh
from preshape.spatial import pose
from preshape.types import Array
from preshape.viewer.shapes import link_shape

OUTLINE = np.array([[0, 0], [100, 0], [100, 30], [30, 30], [30, 100], [0, 100]]) / 1000
"""An L of 100 × 100 mm with arms of 30 mm."""
VOLUME = (100 * 30 + 70 * 30) * 20 * 1e-9
TURN = np.array([[1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, np.sqrt(2)]]) / np.sqrt(2)


def plate() -> tuple[Array, Array]:
    """Vertices and triangles of the L as a plate 20 mm thick."""
    n = len(OUTLINE)
    vertices = np.array([[x, y, z] for z in (0.0, 0.02) for x, y in OUTLINE])
    flat = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]
    side = [(k, (k + 1) % n, n + (k + 1) % n) for k in range(n)] + [
        (k, n + (k + 1) % n, n + k) for k in range(n)
    ]
    faces = [(a, c, b) for a, b, c in flat] + [(a + n, b + n, c + n) for a, b, c in flat] + side
    return vertices, np.array(faces)


def union_share(inside: Array, points: Array) -> float:
    """Share of points (n, 3) that lie in one of the spheres (m, 4)."""
    covered = np.zeros(len(points), dtype=bool)
    for sphere in inside:
        covered |= ((points - sphere[:3]) ** 2).sum(axis=1) < sphere[3] ** 2
    return float(covered.mean())


def test_a_slanted_plate_keeps_its_own_shape_and_place() -> None:
    vertices, faces = plate()
    text = (
        '<mujoco><asset><mesh name="l" vertex="{}" face="{}"/></asset><worldbody><body name="b" '
        'pos=".1 .2 .3" quat="0.9 0.1 0.3 0.2"><geom type="mesh" mesh="l" quat="{}"/></body></worldbody>'
        "</mujoco>"
    ).format(
        " ".join(map(str, vertices.ravel())),
        " ".join(map(str, faces.ravel())),
        f"{np.cos(np.pi / 8)} 0 0 {np.sin(np.pi / 8)}",
    )
    source = read_model(text)
    model = source.model
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[0])
    # The frame of a compiled mesh is its inertial frame; the pieces must come out in the body's.
    pieces = geom_pieces(model, 0, pose(turn.reshape(3, 3), model.geom_pos[0]))
    assert 2 <= len(pieces) <= 4
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.11, 0.15, (60_000, 3)) * [1, 1, 0.0] + rng.uniform(0, 0.02, (60_000, 1)) * [
        0,
        0,
        1,
    ]
    within = np.min([outside(piece, points) for piece in pieces], axis=0) < 0
    x, y = ((points @ TURN)[:, :2]).T  # back in the plate's own frame
    reach = 0.0025  # the sides of a cut overlap by a cell of the grid
    shrunk, grown = (
        ((x > -d) & (y > -d) & (x < 0.1 + d) & (y < 0.1 + d) & ((x < 0.03 + d) | (y < 0.03 + d)))
        for d in (-1e-4, reach)
    )
    assert within[shrunk].mean() > 0.995
    assert not within[~grown].any()
    # Written and compiled again, it is where it was.
    again = mujoco.MjModel.from_xml_string(
        "<mujoco><asset>"
        + "".join(mesh_text(f"p{k}", piece) for k, piece in enumerate(pieces))
        + '</asset><worldbody><body name="b">'
        + "".join(geom_text(f"p{k}", piece) for k, piece in enumerate(pieces))
        + "</body></worldbody></mujoco>"
    )
    volume = 0.0
    for g, piece in enumerate(pieces):
        mujoco.mju_quat2Mat(turn, again.geom_quat[g])
        first = int(again.mesh_vertadr[g])
        found = again.mesh_vert[first : first + int(again.mesh_vertnum[g])] @ turn.reshape(3, 3).T
        found = found + again.geom_pos[g]
        assert np.abs(outside(piece, found)).max() < 1e-6
        volume += hull(found).volume
    assert volume == pytest.approx(VOLUME, rel=0.05)


def test_a_hollow_that_nothing_can_enter_is_filled() -> None:
    box = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]) * 0.02
    sides = hull(box)
    shell = np.concatenate([box, 0.7 * box])
    faces = np.concatenate([sides.faces, sides.faces[:, ::-1] + 8])
    order = np.array([int(np.abs(box - corner).sum(axis=1).argmin()) for corner in sides.corners])
    faces = np.concatenate([order[sides.faces], order[sides.faces][:, ::-1] + 8])
    (piece,) = mesh_pieces(shell, faces)
    assert hull(piece).volume == pytest.approx(0.04**3, rel=1e-6)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.003, 0.08), st.floats(1e-9, 1.0))
def test_few_corners_lie_on_the_hull_and_leave_little_out(seed: int, size: float, flat: float) -> None:
    points = np.random.default_rng(seed).normal(size=(300, 3)) * [1.0, 0.6, flat]
    points = size * points / np.linalg.norm(points, axis=1).max()
    few = few_corners(points)
    around = hull(few)
    out = (points @ around.planes[:, :3].T - around.planes[:, 3]).max()
    assert out <= DEVIATION + 1e-9 or len(few) == MOST_CORNERS
    if np.ptp(points @ np.linalg.svd(points - points.mean(axis=0))[2][2]) > 1e-3:
        assert {tuple(p) for p in few} <= {tuple(p) for p in points}
    assert around.volume > 0


@pytest.mark.parametrize(("detail", "limit", "share"), [(COARSE, 0.003, 0.5), (FINE, 0.0005, 0.9)])
def test_spheres_fill_a_polyhedron_and_none_stands_out(detail: float, limit: float, share: float) -> None:
    rng = np.random.default_rng(3)
    for points in (
        rng.normal(size=(16, 3)) * [0.006, 0.008, 0.012],
        ellipsoid_corners(np.array([0.009, 0.011, 0.014])),
        np.array([[x, y, z] for x in (0, 0.02) for y in (0, 0.016) for z in (0, 0.03) if x + y + z < 0.05]),
    ):
        own = hull(points)
        solid = LinkSolid(
            place=np.array([0.01, -0.02, 0.03]),
            facing=TURN,
            radius=0.0,
            half=np.zeros(3),
            hull=Polyhedron(own.corners, own.faces, own.planes),
        )
        spheres = link_spheres([solid], detail)
        assert (solid.distance(spheres[:, :3]) + spheres[:, 3]).max() < 1e-12
        surface, _ = exposed([solid], detail, 0.3 * detail + 0.0004)
        gap = np.min([np.linalg.norm(surface - s[:3], axis=1) - s[3] for s in spheres], axis=0)
        assert gap.max() < limit
        low, high = surface.min(axis=0), surface.max(axis=0)
        inside = rng.uniform(low, high, (12_000, 3))
        inside = inside[solid.distance(inside) < 0]
        assert union_share(spheres, inside) > share


def test_a_hull_touches_an_object_as_exactly_as_a_box_does() -> None:
    half = np.array([0.01, 0.02, 0.03])
    corners = hull(np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half)
    wall = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    checker = ObjectCollision(
        TriangleMesh(name="wall", vertices=wall, triangles=np.array([[0, 1, 2], [0, 2, 3]]))
    )
    for height, grow, hit in ((0.0301, 0.0, 0), (0.0299, 0.0, 1), (0.0299, -0.001, 0), (0.0289, -0.001, 1)):
        place = np.array([0.1, 0.2, height])
        for kind, own in (("hull", corners), ("box", None)):
            shape = LinkShape(
                kind=kind, link="l", body="b", p0=place, p1=place, radius=0.0,
                half=half if own is None else np.zeros(3), rotation=np.eye(3), hull=own,
            )  # fmt: skip
            assert checker.touches(shape, grow) == bool(hit), (kind, height, grow)
    drawn = link_shape(shape), link_shape(LinkShape(
        kind="hull", link="l", body="b", p0=place, p1=place, radius=0.0,
        half=np.zeros(3), rotation=TURN, hull=corners,
    ))  # fmt: skip
    assert np.allclose(drawn[1].vertices, corners.corners @ TURN.T + place)


def test_leap_s_wedge_is_one_shape_for_kinematics_tables_and_mirror() -> None:
    hand = load_hand("leap")
    solids = hand_hulls(hand)
    assert len(solids) == 4
    tips = [s for link in link_shapes(hand) for s in link if s.hull is not None]
    k = HandKinematics(hand)
    k.set_posture(hand.at(0.4))
    shapes = [shape for shape in k.shapes() if shape.kind == "hull"]
    assert [s.link for s in shapes] == ["index_tip", "middle_tip", "ring_tip", "thumb_tip"]
    assert len(tips) == len(shapes)
    centres, _ = k.tips(hand.fingers)
    for finger, centre in zip(hand.fingers, centres, strict=True):
        shape = next(s for s in shapes if s.body == finger.tip_body)
        assert shape.hull is not None
        depth = (
            shape.hull.planes[:, 3] - shape.hull.planes[:, :3] @ (shape.rotation.T @ (centre - shape.p0))
        ).min()
        assert finger.tip_radius - 1e-6 < depth < finger.tip_radius + 3e-4
    other = HandKinematics(mirrored(hand))
    other.set_posture(hand.at(0.4))
    for one, two in zip(shapes, [s for s in other.shapes() if s.kind == "hull"], strict=True):
        assert one.hull is not None
        assert two.hull is not None
        assert one.hull.volume == pytest.approx(two.hull.volume, rel=1e-5)


REFERENCES = {
    "leap_hand": "right_hand.xml",
    "wonik_allegro": "right_hand.xml",
    "shadow_hand": "right_hand.xml",
    "inspire": "inspire_hand_right.urdf",
    "linker_l10": "linkerhand_l10_right.urdf",
    "dex3": "unitree_dex3_right.urdf",
    "barrett": "bhand_model.urdf",
}


@pytest.mark.parametrize("name", REFERENCES)
def test_no_link_collides_that_does_not_in_the_file(name: str, reference: Path, tmp_path: Path) -> None:
    """Over 80 random postures, against the file's own shapes with every pair of bodies free to collide."""
    path = reference / "hands" / name / REFERENCES[name]
    source = read_model(path)
    if path.suffix == ".urdf":
        motors = tmp_path / "motors.toml"
        motors.write_text("[actuators]\ntorque_limit = 1.2\n", encoding="utf-8")
        hand = load_hand(joined(path, motors) if name == "barrett" else path)
    else:
        built_in = built_in_text(menagerie.built_in_of(name))[0]
        hand = rebuilt(menagerie.adapted(built_in, name), source, name)
    k, m = HandKinematics(hand), source.model
    shapes = [source.is_shape(g) for g in range(m.ngeom)]
    m.geom_contype[:] = m.geom_conaffinity[:] = shapes
    m.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_FILTERPARENT
    kept = {k.model.body(b).name for b in range(1, k.model.nbody)}

    def owner(body: int) -> str:
        return next((m.body(b).name for b in source.chain(body) if m.body(b).name in kept), "")

    data = mujoco.MjData(m)
    columns = [int(m.jnt_qposadr[m.joint(joint).id]) for joint in hand.joints]
    collisions = 0
    for q in hand.lawful(np.random.default_rng(1).uniform(*hand.limits.T, (80, len(hand.joints)))):
        k.set_posture(q)
        ours = {
            frozenset(k.model.body(int(k.model.geom(link).bodyid[0])).name for link in hit[:2])
            for hit in k.self_collisions(1e-4)
        }
        data.qpos[columns] = q
        mujoco.mj_kinematics(m, data)
        mujoco.mj_comPos(m, data)
        mujoco.mj_collision(m, data)
        theirs = {
            frozenset(owner(int(m.geom_bodyid[g])) for g in (c.geom1, c.geom2))
            for c in data.contact
            if c.dist < 0
        }
        assert ours <= theirs
        collisions += bool(ours)
    assert collisions > 3


def test_bodies_to_ignore_and_visual_shapes(tmp_path: Path) -> None:
    text = (Path(__file__).parents[1] / "examples" / "hands" / "trident.urdf").read_text(encoding="utf-8")
    toml = (Path(__file__).parents[1] / "examples" / "hands" / "trident.toml").read_text(encoding="utf-8")
    (tmp_path / "trident.urdf").write_text(text, encoding="utf-8")
    (tmp_path / "a.toml").write_text(toml, encoding="utf-8")
    (tmp_path / "b.toml").write_text('ignore = [["thumb_distal", "index_distal"]]\n' + toml, encoding="utf-8")
    one, two = (load_hand(tmp_path / name) for name in ("a.toml", "b.toml"))
    pair = '<exclude body1="thumb_distal" body2="index_distal"/>'
    assert (pair in one.mjcf, pair in two.mjcf) == (False, True)
    (tmp_path / "b.toml").write_text('ignore = [["thumb_distal", "nobody"]]\n' + toml, encoding="utf-8")
    with pytest.raises(HandError, match="'nobody'"):
        load_hand(tmp_path / "b.toml")
    (tmp_path / "b.toml").write_text('ignore = ["thumb_distal"]\n' + toml, encoding="utf-8")
    assert [finding.code for finding in check_hand(tmp_path / "b.toml")] == ["ignore"]
    visual = text.replace("<collision>", "<visual>").replace("</collision>", "</visual>")
    assert visual != text
    (tmp_path / "trident.urdf").write_text(visual, encoding="utf-8")
    kinds = [[s.kind for s in HandKinematics(h).shapes()] for h in (one, load_hand(tmp_path / "a.toml"))]
    assert kinds[0] == kinds[1]
