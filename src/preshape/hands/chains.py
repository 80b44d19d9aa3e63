"""The palm of an unknown model and the chains of hinges that are its fingers.

The palm is the body from which the chains branch off. Joints that carry several fingers, wrists and linkages
belong to no finger and stay fixed.
"""

from __future__ import annotations

import numpy as np

from ..exceptions import HandError
from .skeleton import Skeleton

REACH = 0.45
"""Largest distance of a fingertip's joint from the palm's body [m] [C]; a leg or an arm is longer."""

WRIST = 0.35
"""Largest length of a forearm that stays part of the hand, as an obstacle [m] [C]."""

_TURNED = 0.4
"""Share of its range at which a motor stays that moves palm and thumb at once [C]."""


def palm_and_chains(
    skeleton: Skeleton, root: str | None, label: str
) -> tuple[int, list[tuple[str, ...]], dict[str, float]]:
    """The palm's body, the hinges of every finger from the palm outwards, and the joints that stay fixed."""
    m, source = skeleton.m, skeleton.source
    if root is not None and root not in source.bodies:
        listed = ", ".join(source.bodies[:12])
        raise HandError(f"{label}: there is no body {root!r} to be the hand's mount; it has {listed}, …")
    joints = source.joints_under(root)
    paths = {joint: _path(skeleton, joint, joints) for joint in joints}
    parents = {path[-2] for path in paths.values() if len(path) > 1}
    ends = [joint for joint in joints if joint not in parents]
    if ends and all(joint not in source.hinges for joint in ends):
        raise HandError(
            f"{label}: its fingers slide (joints {', '.join(ends[:4])}); preshape closes fingers on hinges, "
            "so a gripper with sliding jaws cannot be planned for"
        )
    groups = _hands(skeleton, [paths[end] for end in ends if end in source.hinges], root)
    if not groups:
        raise HandError(
            f"{label}: no part of the model looks like a hand: a body with two or more chains of hinges that "
            f"end within {REACH:g} m; name the hand's mount with --root BODY"
        )
    if len(groups) > 1:
        bodies = ", ".join(str(m.body(palm).name) for palm, _ in groups)
        raise HandError(
            f"{label}: {len(groups)} parts of the model look like a hand; choose one with --root BODY, "
            f"where BODY is one of {bodies}"
        )
    palm, found = groups[0]
    under = [joint for joint in joints if palm in source.chain(skeleton.body_of(joint))[1:]]
    chains = [tuple(j for j in path if j in under) for path in found]
    chains = _without_branches(skeleton, chains)
    count = {joint: sum(joint in chain for chain in chains) for joint in under}
    shared = {joint for joint in under if count[joint] > 1}
    chains = [tuple(j for j in chain if j not in shared and j in source.hinges) for chain in chains]
    chains = [chain for chain in chains if chain]
    held = {joint for joint in under if not any(joint in chain for chain in chains)}
    held |= _with_their_motors(skeleton, held, chains)
    chains = [tuple(joint for joint in chain if joint not in held) for chain in chains]
    return (
        palm,
        [chain for chain in chains if chain],
        {joint: skeleton.neutral[joint] for joint in under if joint in held},
    )


def _with_their_motors(skeleton: Skeleton, held: set[str], chains: list[tuple[str, ...]]) -> set[str]:
    """The joints that move with joints that stay fixed, and so stay fixed too.

    A motor that bends the palm and turns the thumb at once stays at an angle where the thumb opposes.
    """
    more: set[str] = set()
    ends = {chain[-1] for chain in chains}
    for joint in sorted(held & set(skeleton.motors)):
        motor = skeleton.motors[joint]
        free = set(motor.joints) - held
        if free and not free & ends and joint in motor.joints:
            low, high = (float(bound) for bound in motor.range)
            far = high if abs(high) > abs(low) else low
            angles = motor.angles(_TURNED * far)
            skeleton.neutral |= {name: float(x) for name, x in zip(motor.joints, angles, strict=True)}
            more |= free
    return more


def _path(skeleton: Skeleton, joint: str, among: tuple[str, ...]) -> tuple[str, ...]:
    """The joints that move a joint's body, from the root outwards, that joint last."""
    chain = set(skeleton.source.chain(skeleton.body_of(joint)))
    end = skeleton.m.joint(joint).id
    return tuple(
        other for other in among if skeleton.body_of(other) in chain and skeleton.m.joint(other).id <= end
    )


def _hands(
    skeleton: Skeleton, paths: list[tuple[str, ...]], root: str | None
) -> list[tuple[int, list[tuple[str, ...]]]]:
    """Bodies with two finger-like chains or more, and these chains; none of them within another."""
    source = skeleton.source
    above: dict[int, list[tuple[str, ...]]] = {}
    for path in paths:
        for body in source.chain(skeleton.body_of(path[-1]))[1:]:
            above.setdefault(body, []).append(path)
    found = []
    top = None if root is None else skeleton.m.body(root).id
    for body, chains in above.items():
        if top is not None and top not in source.chain(body):
            continue
        ways = {_branch(skeleton, path, body) for path in chains}
        place = skeleton.frame(body)[:3, 3]
        reach = max(float(np.linalg.norm(skeleton.anchor(path[-1]) - place)) for path in chains)
        if len(ways) > 1 and reach < REACH:
            found.append((body, chains))
    bodies = {body for body, _ in found}
    return [(body, chains) for body, chains in found if not bodies & set(source.chain(body)[1:])]


def _branch(skeleton: Skeleton, path: tuple[str, ...], body: int) -> str:
    """The first joint of a path beyond a body."""
    return next(joint for joint in path if body in skeleton.source.chain(skeleton.body_of(joint))[1:])


def _without_branches(skeleton: Skeleton, chains: list[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Of chains that share joints and end close to each other, the longest: the others are linkages."""
    kept: list[tuple[str, ...]] = []
    ends = {chain: skeleton.anchor(chain[-1]) for chain in chains}
    for chain in sorted(chains, key=len, reverse=True):
        rivals = [other for other in kept if other[0] == chain[0]]
        alone = [joint for joint in chain if not any(joint in other for other in rivals)]
        close = [other for other in rivals if np.linalg.norm(ends[other] - ends[chain]) < 0.02]
        if not rivals or (len(alone) > 1 and not close):
            kept.append(chain)
    return [chain for chain in chains if chain in kept]


def mount_of(skeleton: Skeleton, palm: int, root: str | None) -> tuple[str | None, dict[str, float]]:
    """The body to be named as root, and the wrist joints between it and the palm, fixed."""
    source = skeleton.source
    if root is not None:
        held = [j for j in source.joints_under(root) if skeleton.body_of(j) in source.chain(palm)]
        return root, {joint: skeleton.neutral[joint] for joint in held}
    chain = source.chain(palm)
    top = chain[-1]
    wrist = [joint for joint in source.joints if skeleton.body_of(joint) in chain]
    others = [joint for joint in source.joints if palm not in source.chain(skeleton.body_of(joint))]
    length = float(np.linalg.norm(skeleton.frame(palm)[:3, 3] - skeleton.frame(top)[:3, 3]))
    if len(wrist) <= 2 and length < WRIST and not [j for j in others if j not in wrist]:
        several = len(source.roots) > 1
        return (str(skeleton.m.body(top).name) if several else None), {
            joint: skeleton.neutral[joint] for joint in wrist
        }
    # An arm or a whole robot: the hand begins at the last body that a joint of the arm moves.
    start = next((body for body in chain if skeleton.m.body_jntnum[body] > 0), top)
    return str(skeleton.m.body(start).name), {}
