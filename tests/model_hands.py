"""Hands in text, made for tests: a URDF of boxes, without names that tell what its parts are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field


@dataclass(frozen=True)
class FingerText:
    """One finger: its place on the palm, and its joints from the palm outwards.

    Attributes:
        name: Prefix of its links and joints.
        xyz: Place of its first joint on the palm [m].
        rpy: Orientation of its first joint; it points along its own +z.
        joints: For every joint its axis, limits [rad] and the length of its link [m].
        follows: For a joint that mimics: the joint before it, and the multiplier.
    """

    name: str
    xyz: tuple[float, float, float]
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    joints: Sequence[tuple[str, float, float, float]] = (
        ("0 1 0", -0.35, 0.35, 0.0),
        ("1 0 0", -0.2, 1.6, 0.045),
        ("1 0 0", 0.0, 1.6, 0.03),
        ("1 0 0", 0.0, 1.4, 0.025),
    )
    follows: dict[int, tuple[int, float]] = field(default_factory=dict)


ROW = tuple(FingerText(name, (x, 0.0, 0.095)) for name, x in (("c", 0.022), ("a", 0.0), ("d", -0.022)))
"""Three fingers beside each other, which point along +z and curl to -y."""

THUMB = FingerText(
    "b",
    (0.03, -0.02, 0.02),
    (1.5708, 0.0, 0.0),
    (("0 0 1", -0.8, 0.8, 0.0), ("-1 0 0", -0.2, 1.2, 0.045), ("-1 0 0", 0.0, 1.3, 0.03)),
)
"""A thumb in front of the palm, on the index side of a right hand."""


def hand_urdf(
    fingers: Sequence[FingerText] = (THUMB, *ROW),
    *,
    mount: str = "0 0 0",
    effort: float | None = 1.0,
    shape: str = "collision",
    joint: str = "revolute",
    palm: str = '<box size="0.08 0.025 0.095"/>',
    before: str = "",
) -> str:
    """The URDF of a hand.

    Args:
        fingers: Its fingers.
        mount: Orientation of the palm in the frame of its mount, as roll, pitch and yaw.
        effort: Effort of every joint; ``None`` leaves it out.
        shape: ``collision`` or ``visual``.
        joint: Type of every joint of the fingers.
        palm: Geometry of the palm.
        before: Further links and joints; the first link is ``mount``.
    """
    lines = [
        '<robot name="hand">',
        '<link name="mount"/>',
        before,
        _link("plate", 0.3, "0 0 0.0475", palm, shape),
    ]
    lines.append(
        f'<joint name="on" type="fixed"><origin rpy="{mount}"/><parent link="mount"/>'
        '<child link="plate"/></joint>'
    )
    for finger in fingers:
        parent, place, turn = "plate", finger.xyz, finger.rpy
        for k, (axis, low, high, length) in enumerate(finger.joints):
            name = f"{finger.name}{k}"
            size = max(length - 0.004, 0.008)
            box = f'<box size="0.014 0.012 {size:g}"/>'
            lines.append(_link(f"l{name}", 0.02, f"0 0 {length / 2:g}", box, shape))
            stated = "" if effort is None else f'effort="{effort:g}" '
            mimic = ""
            if k in finger.follows:
                leader, ratio = finger.follows[k]
                mimic = f'<mimic joint="{finger.name}{leader}" multiplier="{ratio:g}"/>'
            lines.append(
                f'<joint name="{name}" type="{joint}"><origin xyz="{_text(place)}" rpy="{_text(turn)}"/>'
                f'<parent link="{parent}"/><child link="l{name}"/><axis xyz="{axis}"/>'
                f'<limit lower="{low:g}" upper="{high:g}" {stated}velocity="5"/>{mimic}</joint>'
            )
            parent, place, turn = f"l{name}", (0.0, 0.0, length), (0.0, 0.0, 0.0)
    return "\n".join([*lines, "</robot>"])


def _text(numbers: Sequence[float]) -> str:
    return " ".join(f"{x:g}" for x in numbers)


def _link(name: str, mass: float, place: str, geometry: str, shape: str) -> str:
    inertia = (
        f'<inertia ixx="{mass / 1e4:g}" iyy="{mass / 1e4:g}" izz="{mass / 1e4:g}" ixy="0" ixz="0" iyz="0"/>'
    )
    return (
        f'<link name="{name}"><inertial><origin xyz="{place}"/><mass value="{mass:g}"/>{inertia}</inertial>'
        f'<{shape}><origin xyz="{place}"/><geometry>{geometry}</geometry></{shape}></link>'
    )
