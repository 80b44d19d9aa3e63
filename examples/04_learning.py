"""Learning that lasts: teach objects one by one, close the file, and find everything again."""

import tempfile
from pathlib import Path

import preshape
from preshape.planner import layout_of

LESSONS = [("mug", "pour"), ("bottle", "lift"), ("hammer", "hand_over"), ("dolphin", "push")]
hand = layout_of(preshape.load_hand("utah_mit"))

with tempfile.TemporaryDirectory() as folder:
    file = Path(folder) / "robot.sqlite"
    with preshape.Memory.open(file) as memory:
        teacher = preshape.Controller(memory, hand)
        for thing, task in LESSONS:
            decision = teacher.teach(preshape.load_object(thing), preshape.parse_task(task))
            print(f"taught {thing:<8} {task:<10} {decision.reason}")

    for thing, task in LESSONS:  # what was taught is on disk: another process would find it too
        plan = preshape.plan(thing, task, memory=file)
        print(f"asked  {thing:<8} {task:<10} mode {plan.decision.mode}, {plan.grasp.plane.label}")
        assert plan.decision.mode <= 1
    with preshape.Memory.open(file, read_only=True) as memory:
        print({known.name: known.experiences for known in memory.objects()})
