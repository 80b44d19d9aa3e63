"""Twenty answers with an arm: all tests, against their inverse kinematics alone in the same run."""

from __future__ import annotations

import importlib.metadata
import statistics
from typing import Any

import numpy as np

from preshape.arm.collision import ArmScene, Surface
from preshape.arm.model import read_arm
from preshape.arm.reach import HandPath, reach
from preshape.hands.load import load_hand
from preshape.objects.load import load_object
from preshape.spatial import inverse, pose, pose_from_seven, quaternion_from_rotation

from .common import median_of, row

ANSWERS, REPEATS = 20, 5
ARMS = (("ur5_robot.urdf", "tool0"), ("panda.urdf", "panda_link8"), ("xarm7.urdf", "link_eef"))


def run() -> list[dict[str, Any]]:
    hand, mesh = load_hand("leap"), load_object("mug")
    mount = pose(np.eye(3), [0, 0, 0.1]) @ inverse(hand.T_root_palm)
    T_base_object = pose(np.eye(3), [0.45, 0.0, 0.05])
    rng = np.random.default_rng(0)
    paths = []
    for _ in range(ANSWERS):
        z = rng.normal(size=3)
        z[2] = -abs(z[2])
        z /= np.linalg.norm(z)
        x = np.cross(z, rng.normal(size=3))
        x /= np.linalg.norm(x)
        turn = quaternion_from_rotation(np.stack([x, np.cross(z, x), z], axis=1))
        paths.append(
            HandPath(
                palm_pose=np.concatenate([-0.12 * z, turn]),
                way_in=z,
                back=0.12,
                up=np.array([0.0, 0.0, 1.0]),
                height=0.2,
                pregrasp=hand.posture("open"),
                grasp=hand.at(0.5),
            )
        )
    table = np.array([0.0, 0.0, 1.0, float(mesh.bounds[0, 2])])
    surfaces = (Surface(name="the object", mesh=mesh, hand_too=False, lifted=True),)
    rows = []
    for file, tip in ARMS:
        found = next(f for f in importlib.metadata.files("example-robot-data") or [] if f.name == file)
        arm = read_arm(str(found.locate()), tip, hand, mount)
        scene = ArmScene(arm, T_base_object, table=table, surfaces=surfaces)
        shares, times, served = [], [], 0
        for _ in range(REPEATS + 1):
            results, seconds = reach(arm, scene, paths, T_base_object, 0)
            shares.append(seconds["total"] / seconds["kinematics"])
            times.append(seconds["total"])
            served = sum(result.reached for result in results)
        pairs = zip(results, paths, strict=True)
        ok = served > 0 and all(_is_there(arm, result, path, T_base_object) for result, path in pairs)
        loaded = median_of(lambda file=found, tip=tip: read_arm(str(file.locate()), tip, hand, mount), 1)
        took = 1e3 * statistics.median(times[1:])
        baseline = f"{took:.0f} ms; {served} reached; reading the arm {loaded:.1f} s"
        name = f"{ANSWERS} answers on {arm.name}, in times of their inverse kinematics"
        rows.append(row(name, statistics.median(shares[1:]), "times", 1.5, baseline, ok))
    return rows


def _is_there(arm: Any, result: Any, path: HandPath, T_base_object: Any) -> bool:
    """Whether MuJoCo has the palm at the grasp where the answer wants it."""
    import mujoco

    if not result.reached:
        return True
    data = mujoco.MjData(arm.model)
    data.qpos[arm.columns] = result.q[result.stages.count("way_in") - 1]
    mujoco.mj_kinematics(arm.model, data)
    body = arm.model.body(arm.tip).id
    T_base_tip = pose(data.xmat[body].reshape(3, 3), data.xpos[body])
    held = T_base_tip @ arm.T_tip_root @ arm.hand.T_root_palm
    return bool(np.abs(held - T_base_object @ pose_from_seven(path.palm_pose)).max() < 2e-4)
