"""All four execution modes, task correction and a deadlock, in one memory.

The same from the command line (add --memory FILE to each):

    preshape plan cube --task "1 1 .1 .05 .8 .05"           mode 0: object and task are known
    preshape plan jar --task screw                          mode 3: unknown; explored, learnt, answered
    preshape plan jar --task screw                          mode 1: known; found by searching the plane
    preshape plan jar --task ".6 .6 .6 -.4 -.4 -.4"         mode 2: known, but the task does not fit
    preshape plan cone --task lift                          deadlock: nothing fits, even after learning
"""

import preshape

QUESTIONS = (
    ("cube", "1 1 .1 .05 .8 .05"),
    ("jar", "screw"),
    ("jar", "screw"),
    ("jar", ".6 .6 .6 -.4 -.4 -.4"),
    ("cone", "lift"),
)

with preshape.Memory.open(":memory:") as memory:
    for thing, task in QUESTIONS:
        plan = preshape.plan(thing, task, memory=memory)
        decision = plan.decision
        print(f"{thing:<5} {task:<21} mode {decision.mode}, {decision.status.value}: {decision.reason}")
        for offer in decision.offers:
            print(f"{'':<24} fits: {offer.task.label}, TFVADI {offer.match:.2f}")
        if decision.offers:  # take the first offer: task correction
            corrected = preshape.plan(thing, decision.offers[0].task, memory=memory)
            print(f"{'':<24} corrected: {corrected.decision.status.value} in mode {corrected.decision.mode}")
