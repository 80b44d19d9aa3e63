"""A planned grasp as one MuJoCo scene: the hand at the plan's pose, the object, and a keyframe per posture.

The MJCF text needs no other file. The world frame is the mesh frame. The hand's root is fixed, the object is
free, and there is no gravity, as in the holding test (``docs/grasp-file.md``). The table and boxes of a plan
are left out.
"""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np

from ..exceptions import HandError, ObjectError
from ..objects.mesh import TriangleMesh
from ..physics.pieces import ConvexPieces
from ..physics.protocol import HoldProtocol
from ..report.plain import escaped_line
from ..spatial import inverse, pose_from_seven, seven_from_pose
from ..types import Array
from .planned import PlannedGrasp

CLAY, CLEAR = "0.80 0.62 0.42 1", "0.80 0.62 0.42 0.3"


def scene_mjcf(grasp: PlannedGrasp, mesh: TriangleMesh, pieces: ConvexPieces) -> str:
    """The scene as MJCF text, with the mass and friction of the plan.

    Keyframes: ``pregrasp``, ``grasp`` (the fingers touch) and ``squeeze`` (the posture of ``grasp`` with the
    servo targets of the squeeze).

    Args:
        grasp: Hand, postures, mass and friction.
        mesh: The object as planned [m]; it is only drawn.
        pieces: The same object as convex pieces, which are used for collisions.

    Raises:
        InputError: Mass or friction is out of range.
        HandError: The hand's MJCF has no body to place, or MuJoCo refuses it.
        ObjectError: MuJoCo refuses the object.
    """
    hand = grasp.hand
    tree = ElementTree.fromstring(hand.mjcf)
    world, option = tree.find("worldbody"), _child(tree, "option")
    root = world.find("body") if world is not None else None
    if world is None or root is None:
        raise HandError(f"{hand.name}: the MJCF has no body to place")
    tree.set("model", escaped_line(f"{hand.name} at {mesh.name}"))
    for name, setting in (
        ("gravity", "0 0 0"),
        ("timestep", "0.004"),
        ("integrator", "implicitfast"),
        ("cone", "elliptic"),
        ("impratio", "10"),
        ("noslip_iterations", "2"),
        ("jacobian", "dense"),  # MuJoCo 4.0.0 factorises sparse ones wrongly
    ):
        option.set(name, setting)
    # The servo targets of the squeeze may lie beyond the joint limits; the torques stay limited.
    _child(option, "flag").set("clampctrl", "disable")
    seven = seven_from_pose(pose_from_seven(grasp.palm_pose) @ inverse(hand.T_root_palm))
    for name in ("euler", "axisangle", "xyaxes", "zaxis"):
        root.attrib.pop(name, None)
    root.set("pos", _text(seven[:3]))
    root.set("quat", _text(seven[3:]))
    _add_object(tree, world, grasp, mesh, pieces)
    _add_light(world, mesh)
    for old in tree.findall("keyframe"):
        tree.remove(old)
    frames = ElementTree.SubElement(tree, "keyframe")
    object_pose = [0.0, 0, 0, 1, 0, 0, 0]
    for name, posture, target in (
        ("pregrasp", grasp.pregrasp, grasp.pregrasp),
        ("grasp", grasp.grasp, grasp.grasp),
        ("squeeze", grasp.grasp, grasp.squeeze),
    ):
        ElementTree.SubElement(
            frames,
            "key",
            name=name,
            qpos=_text(np.array([*posture, *object_pose])),
            ctrl=_text(hand.controls(target)),
        )
    ElementTree.indent(tree)
    notes = [f"hand: {hand.credit}; {hand.licence}", *([grasp.warning] if grasp.warning else [])]
    comments = "\n".join(f"<!-- {re.sub('-{2,}', '-', escaped_line(note))} -->" for note in notes)
    text = f"{comments}\n{ElementTree.tostring(tree, encoding='unicode')}\n"
    _check(text, grasp, mesh)
    return text


def _add_object(
    tree: ElementTree.Element,
    world: ElementTree.Element,
    grasp: PlannedGrasp,
    mesh: TriangleMesh,
    pieces: ConvexPieces,
) -> None:
    assets = _child(tree, "asset")
    body = ElementTree.SubElement(world, "body", name="object")
    ElementTree.SubElement(body, "freejoint", name="object")
    ElementTree.SubElement(
        assets,
        "mesh",
        name="object",
        scale="1 1 1",
        inertia="shell",  # the surface is drawn only, and may be open
        vertex=_text(mesh.vertices.ravel()),
        face=" ".join(map(str, mesh.triangles.ravel().tolist())),
    )
    ElementTree.SubElement(
        body, "geom", name="object", type="mesh", mesh="object", rgba=CLAY, group="2",
        contype="0", conaffinity="0", mass="0",
    )  # fmt: skip
    rules = HoldProtocol(mass=grasp.mass, friction=grasp.friction)
    density = rules.mass / pieces.volume
    for index, corners in enumerate(pieces.pieces):
        name = f"object_piece_{index}"
        ElementTree.SubElement(
            assets, "mesh", name=name, scale="1 1 1", inertia="convex", vertex=_text(corners.ravel())
        )
        ElementTree.SubElement(
            body, "geom", name=name, type="mesh", mesh=name, rgba=CLEAR, group="3",
            contype="1", conaffinity="1", condim="4", density=repr(density),
            friction=f"{rules.friction} {rules.torsion} 0.0001",
        )  # fmt: skip


def _add_light(world: ElementTree.Element, mesh: TriangleMesh) -> None:
    high = mesh.cog + np.array([0.0, -0.5, 1.0])
    ElementTree.SubElement(world, "light", name="sun", pos=_text(high), dir="0 0.45 -0.9", castshadow="false")


def _child(tree: ElementTree.Element, tag: str) -> ElementTree.Element:
    found = tree.find(tag)
    return found if found is not None else ElementTree.SubElement(tree, tag)


def _text(numbers: Array) -> str:
    return " ".join(repr(float(x)) for x in numbers)


def _check(text: str, grasp: PlannedGrasp, mesh: TriangleMesh) -> None:
    """Compile the scene once, to make sure that MuJoCo can read the text."""
    import mujoco

    try:
        model = mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        wrong = ObjectError if "object" in str(error) else HandError
        raise wrong(f"MuJoCo refuses {mesh.name} with the hand {grasp.hand.name}: {error}") from error
    names = tuple(model.joint(k).name for k in range(model.njnt))
    if names != (*grasp.hand.joints, "object"):
        raise HandError(f"{grasp.hand.name}: the scene has the joints {', '.join(names)}, not the hand's own")
