"""``--verify``: put planned grips to the holding test, best first, until one holds."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ..hands.hand import Hand
from ..objects.mesh import TriangleMesh
from ..physics.hand import physics_hand
from ..physics.hold.six_directions import HoldResult, HoldStatus, hold_test
from ..physics.pieces import decompose
from ..physics.protocol import HoldProtocol
from ..physics.scene import build_scene
from ..types import value
from .grasp_sets import palm_grasps, poses_of
from .hand_simulation import HandResult


@value
class Verification:
    """What the physics said.

    Attributes:
        held: which of the answers held first; ``None`` for none.
        results: of those that were tried, in order.
    """

    held: int | None
    results: tuple[HoldResult, ...]


def verify(
    hand: Hand,
    mesh: TriangleMesh,
    answers: Sequence[HandResult],
    *,
    protocol: HoldProtocol | None = None,
    progress: Callable[[int], None] | None = None,
) -> Verification:
    """Test answers in their order until one holds.

    The object is cut into convex pieces first, which takes up to two minutes for a scan, once.

    Args:
        hand: the hand.
        mesh: the object, at the size planned for.
        answers: the hand on the object; those that did not reach are left out.
        protocol: default the field's six directions.
        progress: called with how many were tried.

    Raises:
        ObjectError: the object encloses no volume.
        EnvironmentFailure: it cannot be cut.
    """
    rules = protocol or HoldProtocol(stop_early=True)
    reached = [(k, answer) for k, answer in enumerate(answers) if answer.grasp is not None]
    if not reached:
        return Verification(held=None, results=())
    physical = physics_hand(hand)
    pieces = decompose(mesh)
    n, poses = len(reached), poses_of([answer for _, answer in reached])
    grasps = palm_grasps(hand, [mesh.name] * n, [1.0] * n, poses).for_hand(physical)
    scene = build_scene(physical, pieces, 1.0, rules)
    results: list[HoldResult] = []
    for row, (index, _) in enumerate(reached):
        results.append(
            hold_test(
                scene,
                grasps.pregrasp[row],
                grasps.grasp[row],
                grasps.squeeze[row],
                grasps.object_pose[row],
                rules,
                row=index,
                object_name=mesh.name,
            )
        )
        if progress is not None:
            progress(len(results))
        if results[-1].held:
            return Verification(held=index, results=tuple(results))
    return Verification(held=None, results=tuple(results))


def telling(result: HoldResult, rules: HoldProtocol) -> bool:
    """Whether a result is worth remembering of a grasp.

    What held something lighter or rougher than usual tells nothing, nor does what lost something heavier or
    smoother, or a simulation that broke.

    Args:
        result: of one grasp.
        rules: of the test.
    """
    usual = HoldProtocol()
    if result.status is HoldStatus.HELD:
        return rules.mass >= usual.mass and rules.friction <= usual.friction
    lost = result.status is HoldStatus.LOST
    return lost and rules.mass <= usual.mass and rules.friction >= usual.friction
