"""Models as ROS packages have them: every fault of their files is mended and said, or gets a sentence."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from model_hands import hand_urdf
from preshape.cli.main import run
from preshape.exceptions import HandError
from preshape.hands import load_hand
from preshape.hands.check import check_hand
from preshape.hands.compiled import CompiledModel, read_model

BOX = '<box size="0.08 0.025 0.095"/>'


def save(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def mesh(path: Path, scale: float = 1.0) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    trimesh.creation.box((0.08 * scale, 0.025 * scale, 0.095 * scale)).export(path)
    return path


def with_mesh(name: str, more: str = "") -> str:
    return hand_urdf(palm=f'<mesh filename="{name}" {more}/>')


def palm_size(source: CompiledModel) -> list[float]:
    m = source.model
    assert m.nmesh == 1
    return [round(float(x), 4) for x in np.sort(np.ptp(m.mesh_vert, axis=0))]


def refused(path: Path, capfd: pytest.CaptureFixture[str]) -> str:
    """The sentence of the command line, which exits with 2."""
    assert run(["hands", "check", str(path)]) == 2
    said = capfd.readouterr().err
    assert "Traceback" not in said
    return said


# -- meshes -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("place", "name"),
    [
        ("own/meshes/palm.stl", "package://own/meshes/palm.stl"),
        ("own/meshes/palm.stl", "model://own/meshes/palm.stl"),
        ("other_name/meshes/palm.stl", "package://own/meshes/palm.stl"),
        ("own/meshes/palm.STL", "package://own/meshes/palm.stl"),
        ("own/meshes/palm.stl", "../meshes/palm.stl"),
        ("own/urdf/palm.stl", "somewhere/else/palm.stl"),
    ],
)
def test_meshes_are_found_as_ros_finds_them(place: str, name: str, tmp_path: Path) -> None:
    mesh(tmp_path / place)
    model = save(tmp_path / Path(place).parts[0] / "urdf" / "hand.urdf", with_mesh(name))
    assert palm_size(read_model(model)) == [0.025, 0.08, 0.095]


def test_packages_are_looked_for_in_the_ros_path_and_by_their_own_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    model = save(tmp_path / "a" / "hand.urdf", with_mesh("package://hand_description/meshes/palm.stl"))
    mesh(tmp_path / "b" / "checked-out" / "meshes" / "palm.stl")
    said = refused(model, capfd)
    assert 'not found in the package "hand_description"' in said
    assert "ROS_PACKAGE_PATH" in said
    package = save(
        tmp_path / "b" / "checked-out" / "package.xml", "<package><name>hand_description</name></package>"
    )
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"/nowhere:{package.parent}")
    assert palm_size(read_model(model)) == [0.025, 0.08, 0.095]
    monkeypatch.delenv("ROS_PACKAGE_PATH")
    mesh(tmp_path / "c" / "share" / "hand_description" / "meshes" / "palm.stl")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "c"))
    assert palm_size(read_model(model)) == [0.025, 0.08, 0.095]


def test_a_mesh_that_is_nowhere_is_named(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    model = save(tmp_path / "hand.urdf", with_mesh("meshes/palm.stl"))
    assert re.search(
        r"hand\.urdf: the mesh meshes/palm\.stl is not found beside the model", refused(model, capfd)
    )


@pytest.mark.parametrize("kind", ["ply", "off", "glb", "text stl"])
def test_meshes_that_mujoco_cannot_read_are_converted(kind: str, tmp_path: Path) -> None:
    file = tmp_path / f"palm.{kind.split()[-1]}"
    mesh(file)
    if kind == "text stl":
        box = trimesh.load(file)
        file.write_text(trimesh.exchange.stl.export_stl_ascii(box))
    source = read_model(save(tmp_path / "hand.urdf", with_mesh(file.name)))
    assert palm_size(source) == [0.025, 0.08, 0.095]
    assert source.notes == (f"{kind.upper().replace('TEXT', 'text')} meshes were converted",)


def test_collada_is_read_by_pycollada_or_refused_with_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    save(tmp_path / "palm.dae", "<COLLADA/>")
    model = save(tmp_path / "hand.urdf", with_mesh("palm.dae"))
    monkeypatch.setitem(sys.modules, "collada", None)
    said = refused(model, capfd)
    assert "is a COLLADA file: install the package pycollada" in said
    assert "or convert it to STL or OBJ" in said
    # Where only a picture needs it, it need not be readable.
    picture = hand_urdf().replace(
        "</link>", '<visual><geometry><mesh filename="gone.dae"/></geometry></visual></link>'
    )
    assert check_hand(save(tmp_path / "other.urdf", picture)) == []
    monkeypatch.undo()
    pytest.importorskip("collada")
    trimesh.creation.box((0.08, 0.025, 0.095)).export(tmp_path / "palm.dae")
    assert palm_size(read_model(model)) == [0.025, 0.08, 0.095]


@pytest.mark.parametrize(("scale", "more"), [(1000.0, ""), (1.0, 'scale="1e-6 1e-6 1e-6"')])
def test_a_mesh_in_another_unit_is_named_with_its_size(
    scale: float, more: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    mesh(tmp_path / "palm.stl", scale)
    said = refused(save(tmp_path / "hand.urdf", with_mesh("palm.stl", more)), capfd)
    if scale > 1:
        assert "the mesh 'palm' of the link 'plate' measures 25 × 80 × 95 m" in said
        assert 'scale "0.001 0.001 0.001"' in said
    else:
        assert "the mesh 'palm' of the link 'plate' measures 2.5e-08 × 8e-08 × 9.5e-08 m" in said


def test_without_collision_shapes_the_visual_ones_are_used_and_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    source = read_model(save(tmp_path / "hand.urdf", hand_urdf(shape="visual")))
    assert source.notes[0].startswith("no collision shapes: the visual shapes of plate, lb0, lb1, lb2 and")
    assert (source.model.geom_contype > 0).sum() == 16
    # Of one link, too; but not where what is fixed to it has one.
    one = hand_urdf().replace("<collision>", "<visual>", 1).replace("</collision>", "</visual>", 1)
    assert read_model(save(tmp_path / "one.urdf", one)).notes == (
        "no collision shapes: the visual shapes of plate are used",
    )
    mjcf = """<mujoco><worldbody><body name="a"><geom size="0.01" contype="0" conaffinity="0"/>
      <body name="b"><joint range="0 90"/><geom size="0.01"/></body></body></worldbody></mujoco>"""
    assert read_model(save(tmp_path / "hand.xml", mjcf)).notes == (
        "no collision shapes: the visual shapes of a are used",
    )


# -- the rest of the file ---------------------------------------------------------------------------


def test_inertias_that_mujoco_refuses_are_balanced(tmp_path: Path) -> None:
    odd = hand_urdf().replace('ixx="2e-06"', 'ixx="9e-05"')
    assert "9e-05" in odd
    assert check_hand(save(tmp_path / "hand.urdf", odd)) == []


def test_limits_a_hair_off_are_rounded(tmp_path: Path) -> None:
    toml = (Path(__file__).parents[1] / "examples/hands/trident.toml").read_text()
    urdf = (Path(__file__).parents[1] / "examples/hands/trident.urdf").read_text()
    save(tmp_path / "trident.urdf", urdf.replace('upper="1.4"', 'upper="0.749999"'))
    assert check_hand(save(tmp_path / "a.toml", toml)) == []
    assert (
        load_hand(tmp_path / "a.toml").limits[1, 1] == load_hand(tmp_path / "a.toml").at(1.0)[1] == 0.749999
    )
    far = toml.replace("[0.0, 0.75, 1.1]", "[0.0, 0.76, 1.1]")
    assert {finding.code for finding in check_hand(save(tmp_path / "b.toml", far))} == {"outside_limits"}


@pytest.mark.parametrize(
    ("angle", "limits", "note"),
    [
        ("", "0 1.5", "read in rad"),
        ('<compiler angle="radian"/>', "0 90", "read in degrees"),
        ("", "0 85.9437", ""),
        ('<compiler angle="radian"/>', "0 1.5", ""),
    ],
)
def test_the_unit_of_an_mjcfs_angles_is_recognised(
    angle: str, limits: str, note: str, tmp_path: Path
) -> None:
    text = f"""<mujoco>{angle}<worldbody><body name="a"><geom size="0.01"/>
      <body name="b"><joint name="j" range="{limits}" limited="true"/><geom size="0.01"/></body></body>
      </worldbody></mujoco>"""
    source = read_model(save(tmp_path / "hand.xml", text))
    assert source.ranges["j"][1] == pytest.approx(np.pi / 2 if "90" in limits else 1.5, abs=1e-5)
    assert [note in said for said in source.notes] == ([True] if note else [])


def test_limits_of_a_urdf_in_degrees_are_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    said = refused(save(tmp_path / "hand.urdf", hand_urdf().replace('upper="1.6"', 'upper="90"')), capfd)
    assert "are no plausible angles in rad: -0.2 to 90 (degrees?)" in said


@pytest.mark.parametrize("root", ["mujocoinclude", "worldbody", "body"])
def test_a_fragment_of_an_mjcf_is_a_model(root: str, tmp_path: Path) -> None:
    body = """<body name="a"><geom size="0.01"/><body name="b"><joint name="j" range="0 90"/>
      <geom size="0.01"/></body></body>"""
    around = {"mujocoinclude": "<mujocoinclude><worldbody>{}</worldbody></mujocoinclude>", "body": "{}"}
    text = around.get(root, "<worldbody>{}</worldbody>").format(body)
    assert read_model(save(tmp_path / "hand.xml", text)).bodies == ("a", "b")


def test_other_xml_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    said = refused(save(tmp_path / "hand.xml", "<svg/>"), capfd)
    assert "begins with <svg>, which is neither a URDF nor an MJCF" in said


def test_a_xacro_is_expanded_or_refused_with_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    text = hand_urdf().replace("<robot", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"', 1)
    text = text.replace(BOX, '<box size="${2*0.04} 0.025 0.095"/>')
    text = text.replace("</robot>", '<xacro:property name="x" value="1"/></robot>')
    model = save(tmp_path / "hand.urdf.xacro", text)
    monkeypatch.setitem(sys.modules, "xacrodoc", None)
    said = refused(model, capfd)
    assert '"xacro hand.urdf.xacro > hand.urdf"' in said
    assert "install the package xacrodoc" in said
    monkeypatch.undo()
    pytest.importorskip("xacrodoc")
    assert check_hand(model) == []
    broken = save(tmp_path / "broken.xacro", text.replace("2*0.04", "nothing"))
    assert "its xacro cannot be expanded" in refused(broken, capfd)


def test_a_model_that_is_not_there_or_no_xml_is_refused(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert "there is no model" in refused(tmp_path / "none.urdf", capfd)
    assert "MuJoCo cannot read it" in refused(save(tmp_path / "a.urdf", "<robot"), capfd)
    with pytest.raises(HandError, match="cannot read it"):
        read_model(save(tmp_path / "deep.xml", "<mujoco><worldbody>" + "<body>" * 100000))


@pytest.mark.parametrize(
    ("followed", "said"), [("nope", "which the model does not have"), ("mount", "which is fixed")]
)
def test_a_joint_that_mimics_no_moving_joint_is_named(
    followed: str, said: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """MuJoCo would drop the law, and the joint would get a motor that the hand does not have."""
    text = hand_urdf()
    mount = '<link name="flange"/><joint name="mount" type="fixed">'
    mount += '<parent link="{0}"/><child link="flange"/></joint>'
    first = re.search(r'<link name="([^"]+)"', text)
    assert first is not None
    text = text.replace("</robot>", f"{mount.format(first[1])}</robot>")
    joint = re.search(r'<joint name="([^"]+)" type="revolute">', text)
    assert joint is not None
    text = text.replace(joint[0], f'{joint[0]}<mimic joint="{followed}" multiplier="1"/>', 1)
    told = refused(save(tmp_path / "hand.urdf", text), capfd)
    assert f"{joint[1]}' mimics '{followed}', {said}" in " ".join(told.split())
