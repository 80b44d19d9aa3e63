"""Learning that lasts: teach objects one by one, close the memory, and plan with it again."""

import tempfile
from pathlib import Path

import preshape

LESSONS = [("mug", "pour"), ("bottle", "lift"), ("hammer", "hand_over"), ("dolphin", "push")]

with tempfile.TemporaryDirectory() as folder:
    file = Path(folder) / "robot.sqlite"
    with preshape.Session(file) as session:
        for name, task in LESSONS:
            taught = session.teach(preshape.PlanRequest(source=name, task=task, hand="utah_mit"))
            print(f"taught {name:<8} {task:<10} {taught.decision.reason}")

    for name, task in LESSONS:  # the lessons are on disk, where other processes find them too
        plan = preshape.plan(name, task, hand="utah_mit", memory=file)
        print(f"asked  {name:<8} {task:<10} mode {plan.decision.mode}, {plan.grasp.plane.label}")
        assert plan.decision.mode <= 1
    with preshape.Memory.open(file, read_only=True) as memory:
        print({known.name: known.experiences for known in memory.objects()})
