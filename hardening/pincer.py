"""A small hand of our own that is quick to read: two fingers with two hinges each."""

from __future__ import annotations

HAND = "utah_mit"
"""The hand whose experiences the memories of the corpus hold."""

TOML = """name = "pincer"
model = "pincer.xml"
u = 0.05
finger_pitch = 0.05
couplings = [["b2", "b1"]]
left_names = ["r_", "l_"]
[palm]
body = "palm"
points = "+z"
faces = "-y"
pos = [0.0, 0.0, 0.0]
[actuators]
gain = 5.0
damping = 0.1
torque_limit = 1.5
gains = { a1 = 4.0 }
[[finger]]
name = "thumb"
joints = ["a1", "a2"]
tip_body = "a"
tip_pos = [0.0, 0.0, 0.04]
tip_radius = 0.009
closing = [[0.0, 0.0], [0.5, 0.5]]
preshape = { a1 = [-0.2, 0.2] }
[[finger]]
name = "index"
joints = ["b1", "b2"]
tip_body = "b"
tip_pos = [0.0, 0.0, 0.04]
tip_points = [0, 0, 1]
tip_radius = 0.009
open = [0.0, 0.0]
rest = [0.2, 0.2]
closed = [0.5, 0.5]
"""


def _finger(name: str, side: int) -> str:
    return (
        f'<body name="{name}0" pos="0 {0.03 * side} 0.02">'
        f'<joint name="{name}1" axis="{side} 0 0" range="-1 1.5"/>'
        '<geom type="capsule" fromto="0 0 0 0 0 0.03" size="0.008"/>'
        f'<body name="{name}" pos="0 0 0.04"><joint name="{name}2" axis="{side} 0 0" range="-1 1.5"/>'
        '<geom type="box" pos="0 0 0.02" size="0.008 0.008 0.02"/></body></body>'
    )


MJCF = (
    '<mujoco model="pincer"><compiler angle="radian"/><default><geom density="500"/></default><worldbody>'
    '<body name="palm"><geom type="cylinder" size="0.03 0.01"/>'
    f"{_finger('a', -1)}{_finger('b', 1)}</body></worldbody></mujoco>"
)


def _link(name: str, shape: str) -> str:
    return (
        f'<link name="{name}"><inertial><mass value="0.05"/>'
        '<inertia ixx="2e-5" ixy="0" ixz="0" iyy="2e-5" iyz="0" izz="2e-5"/></inertial>'
        f'<collision><origin xyz="0 0 0.02"/><geometry>{shape}</geometry></collision></link>'
    )


def _hinge(name: str, parent: str, child: str, place: str, side: int) -> str:
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{place}"/><axis xyz="{side} 0 0"/>'
        '<limit lower="-1" upper="1.5" effort="1.5" velocity="3"/></joint>'
    )


URDF = (
    '<?xml version="1.0"?><robot name="pincer">'
    + _link("palm", '<box size="0.06 0.06 0.02"/>')
    + "".join(
        _link(f"{name}0", '<cylinder radius="0.008" length="0.03"/>')
        + _link(name, '<sphere radius="0.009"/>')
        + _hinge(f"{name}1", "palm", f"{name}0", f"0 {0.03 * side} 0.02", side)
        + _hinge(f"{name}2", f"{name}0", name, "0 0 0.04", side)
        for name, side in (("a", -1), ("b", 1))
    )
    + "</robot>"
)
