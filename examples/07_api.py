"""From an object to a grasp that a robot can execute, and the same grasp for other programs."""

from pathlib import Path

import preshape
from preshape.export.moveit import MoveItOptions, messages_yaml, moveit_grasps
from preshape.export.planned import planned_grasps
from preshape.files import write_json
from preshape.spatial import inverse, pose_from_seven

# From mesh to grasp
mesh = preshape.load_object("mug")  # or load_object("part.stl", unit="mm")
plan = preshape.plan(mesh, "lift", hand="shadow", mass=0.2, friction=0.5, memory="robot.sqlite")
print(plan)  # what the terminal shows: mass, quality, margins, way in, reasons
hand = plan.hand_result
if hand is None:
    raise SystemExit(plan.decision.reason)  # a plan without an answer says why
T_mesh_wrist = pose_from_seven(hand.grasp.palm_pose) @ inverse(plan.hand.T_root_palm)
print(f"wrist in the mesh's frame [m]\n{T_mesh_wrist.round(3)}\njoints [rad]", *hand.joints)
for posture in (hand.pregrasp, hand.grasp, hand.squeeze):  # open, touching, pressing
    print(posture.q.round(2))

# To other programs
document = preshape.plan_to_json(plan)
write_json(Path("plan.json"), document)
grasps, left_out = planned_grasps(document, "plan.json")
messages = moveit_grasps(grasps, MoveItOptions(frame="mug"))
Path("grasps.yaml").write_text(messages_yaml(messages))
print(f"plan.json and grasps.yaml; grasp_quality {messages[0]['grasp_quality']:.2f}")
