"""What modes 0 and 1 are asked for: the estimate, and in the self-test one after the other."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from preshape.hiis.analyser import Aim
from preshape.hiis.controller import Controller
from preshape.hiis.decision import Status
from preshape.hiis.estimator import Estimate
from preshape.hiis.fuzzy import FuzzySets
from preshape.hiis.virtual_grasp import RayAnalyser
from preshape.memory import Memory
from preshape.tasks import parse_task
from test_controller import LAYOUT, prepared


class Deaf:
    """An element that finds nothing when asked for few approach values, such as mode 0's single one."""

    def __init__(self, element: RayAnalyser, fewest: int) -> None:
        self._element, self._fewest = element, fewest

    def __getattr__(self, name):
        return getattr(self._element, name)

    def explore(self, q, aim):
        found = self._element.explore(q, aim)
        few = len(aim.planes) == 1 and len(aim.values) < self._fewest
        return replace(found.where(np.zeros(len(found), dtype=bool)), reason="deaf") if few else found


def test_the_self_test_goes_on_to_mode_1_where_mode_0_fails(tmp_path):
    """Learnt is what the estimator answers, at mode 0 or by searching the estimated plane (fig. 9)."""
    ways = {}
    for fewest in (0, 2, 10**6):  # hears everything; nothing at one approach value; nothing on one plane
        with Memory.open(tmp_path / f"{fewest}.sqlite") as memory:
            c = Controller(memory, LAYOUT)
            decision = c.teach(Deaf(prepared("mug"), fewest), parse_task("pour"))
            assert "mug" in {e.object_name for e in memory.experiences()}
            ways[fewest] = decision
            assert decision.deadlock == c.deadlock
    assert [ways[fewest].status for fewest in ways] == [Status.ANSWER, Status.ANSWER, Status.DEADLOCK]


def test_mode_0_takes_the_estimated_number_of_fingers_or_as_many_as_fit():
    with Memory.open(":memory:") as memory:
        c = Controller(memory, LAYOUT)
    q, met = parse_task("lift").q, set()
    for name, index, approach_set in product(("mug", "pen", "hammer"), range(1, 13), (1, 3, 5)):
        pa, value = prepared(name), float(FuzzySets().crisp()[approach_set])
        everything = pa.explore(q, Aim(planes=[index], values=[value]))
        for fingers in (2, 3, 4):
            estimate = Estimate(
                plane=index, approach_set=approach_set, fingers=fingers, confidence=1.0, outputs=np.zeros(9)
            )
            found = c.at_estimate(pa, q, estimate)
            most = max((int(n) for n in everything.fingers if n <= fingers), default=None)
            wanted = everything.where(everything.fingers == most)
            assert found.fingers.tolist() == wanted.fingers.tolist(), (name, index, approach_set, fingers)
            assert found.match.tolist() == wanted.match.tolist()
            assert (found.plane == index).all()
            assert (found.value == value).all()
            met.add((fingers, most))
    assert {(2, 2), (3, 3), (4, 4)} <= met
    assert any(most is not None and most < fingers for fingers, most in met), "fewer never had to do"
