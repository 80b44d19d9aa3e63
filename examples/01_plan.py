"""From an object and a task to a preshape of the paper's hand, in a few lines."""

import preshape

plan = preshape.plan("mug", "lift", hand="utah_mit", memory=":memory:", count=2)
grasp, hand = plan.grasp, plan.hand_result

print(plan.decision.status.help)
print(f"{grasp.plane.label}, approach value {grasp.approach_value:+.2f}, {grasp.fingers} fingers")
print(f"TFVADI {grasp.tfvadi:.2f} of 6; the hand: {hand.reason}")
for finger, point in zip(hand.fingers, grasp.contacts.points, strict=True):
    print(f"  {finger:<7} at {(1000 * point).round(1)} mm")
for step in plan.decision.transitions:
    print(f"  mode {step.mode}: {step.outcome}, {step.reason}")
