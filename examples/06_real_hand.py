"""A real hand: from an object and a task to palm pose, preshape, contacts and squeeze."""

import numpy as np

import preshape

# The box lies on a table. The closure analyser serves every hand but utah_mit, such as "allegro:left"
# or "my_hand.toml".
plan = preshape.plan("box", "lift", hand="allegro", memory=":memory:", learn=False)
grip, hand = plan.grasp, plan.hand_result
assert isinstance(grip, preshape.Grip)
assert hand is not None

print(f"{grip.plane.label}, {len(grip.fingers_touching)} fingers: {', '.join(grip.fingers_touching)}")
print(f"way in {np.round(grip.approach, 2)}, clearance {1000 * grip.clearance:.1f} mm")
print(f"palm    {np.round(hand.grasp.palm_pose, 3)}")
print(f"open    {np.round(hand.pregrasp.q, 2)}")
print(f"closed  {np.round(hand.grasp.q, 2)}")
print(f"squeeze {np.round(hand.squeeze.q, 2)}")
print(f"the squeeze balances {grip.task_margin:.1f} times the task's load (quality {grip.quality:.1f} of 6)")
