"""All four execution modes, task correction and a deadlock, with one memory.

The same commands (add --hand utah_mit --memory FILE to each):

    preshape plan box --task "1 1 .1 .05 .8 .05"            mode 0: the estimate of a fresh memory will do
    preshape plan prism --task lift                         mode 3: unknown object; explored, learnt, answered
    preshape plan prism --task "1 1 .1 .05 .8 .05"          mode 1: the estimated plane is searched
    preshape plan prism --task ".6 .6 .6 -.4 -.4 -.4"       mode 2: known object, but the task does not fit
    preshape plan cone --task strike                        deadlock: no grasp fits, even after learning
"""

import preshape

QUESTIONS = (
    ("box", "1 1 .1 .05 .8 .05"),
    ("prism", "lift"),
    ("prism", "1 1 .1 .05 .8 .05"),
    ("prism", ".6 .6 .6 -.4 -.4 -.4"),
    ("cone", "strike"),
)

with preshape.Memory.open(":memory:") as memory:
    for name, task in QUESTIONS:
        plan = preshape.plan(name, task, hand="utah_mit", memory=memory)
        decision = plan.decision
        print(f"{name:<5} {task:<21} mode {decision.mode}, {decision.status.value}: {decision.reason}")
        for offer in decision.offers:
            print(f"{'':<24} fits: {offer.task.label}, TFVADI {offer.match:.2f}")
        if decision.offers:  # task correction: take the first offer
            corrected = preshape.plan(name, decision.offers[0].task, hand="utah_mit", memory=memory)
            print(f"{'':<24} corrected: {corrected.decision.status.value} in mode {corrected.decision.mode}")
