"""Simulates the same scenes with the MuJoCo that comes first on the path and prints where everything went.

``test_mujoco_versions`` runs it once with each version. The grips in ``data/planned_grips.json`` were
planned with the built-in hands (seed 0); each posture is the pose of the hand's root (xyz [m], quaternion
wxyz) followed by the joint angles [rad].
"""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np

from preshape import load_hand, load_object
from preshape.export.mjcf import scene_mjcf
from preshape.export.planned import planned_grasps
from preshape.physics.grasps import STAGES, HandPoses
from preshape.physics.hand import physics_hand
from preshape.physics.hold.six_directions import hold_test
from preshape.physics.pieces import ConvexPieces
from preshape.physics.protocol import HoldProtocol
from preshape.physics.scene import build_scene

DATA = Path(__file__).parent / "data"


def held(hand: str, grip: dict, protocol: HoldProtocol) -> dict:
    """The holding test of one grip: its verdict, and ``qpos`` after each stage and every ten steps."""
    mesh = load_object(grip["object"])
    pieces = ConvexPieces(name=mesh.name, pieces=(mesh.vertices,))  # a box and a cylinder are convex
    scene = build_scene(physics_hand(load_hand(hand)), pieces, 1.0, protocol)
    path: list[list[float]] = []
    result = hold_test(
        scene,
        HandPoses(**{name: grip[name] for name in (*STAGES, "object_pose")}),
        protocol,
        observer=lambda _, data: path.append(data.qpos.tolist()),
        row=0,
        object_name=mesh.name,
    )
    probes = [[probe.displacement, probe.rotation] for probe in result.probes]
    return {"verdict": result.status.name, "probes": probes, "path": path}


def exported() -> dict:
    """The scene that ``export mjcf`` writes, under gravity for a second."""
    document = json.loads((DATA / "shadow_mug_lift.json").read_text())
    (grasp, *_), _ = planned_grasps(document, "shadow_mug_lift.json")
    mesh = load_object("mug")
    text = scene_mjcf(grasp, mesh, ConvexPieces(name="mug", pieces=(mesh.vertices,)))
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.gravity[2] = -9.81
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("squeeze").id)
    path = []
    for _ in range(25):
        mujoco.mj_step(model, data, 10)
        path.append(data.qpos.tolist())
    return {"path": path}


def pile(jacobian: str) -> dict:
    """Forty two-part bodies falling on one another, in which 4.0.0 goes wrong with a sparse Jacobian."""
    random = np.random.default_rng(6)
    bodies = ""
    for index in range(40):
        x, y = random.uniform(-0.15, 0.15, 2)
        bodies += (
            f'<body pos="{x:.4f} {y:.4f} {0.05 + 0.03 * index:.4f}"><freejoint/>'
            f'<geom type="{("sphere", "capsule", "box")[index % 3]}" size="0.04 0.04 0.04"/>'
            '<body pos="0 0 0.05"><joint axis="1 0 0"/><geom size="0.03"/></body></body>'
        )
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option jacobian="{jacobian}" cone="elliptic"/><worldbody>'
        f'<geom type="plane" size="2 2 0.1"/>{bodies}</worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    path = []
    for _ in range(40):
        mujoco.mj_step(model, data, 10)
        path.append(data.qpos.tolist())
    return {"path": path}


def main() -> None:
    grips = json.loads((DATA / "planned_grips.json").read_text())
    runs = {hand: held(hand, grip, HoldProtocol()) for hand, grip in grips.items()}
    runs["shadow, many contacts"] = held("shadow", grips["shadow"], HoldProtocol(many_contacts=True))
    runs["exported"] = exported()
    runs |= {f"pile, {jacobian}": pile(jacobian) for jacobian in ("dense", "sparse")}
    print(json.dumps({"version": mujoco.__version__, "runs": runs}))


if __name__ == "__main__":
    main()
