"""What the closing kernel knows of a hand: joint chains, spheres that fill its links, closing paths.

Everything is in the palm frame. :func:`preshape.closure.hand_tables.hand_tables` makes the tables of a hand.
"""

from __future__ import annotations

from ..types import Array, IntArray, value


@value
class HandTables:
    """Arrays over fingers f, joints j (in the hand's order) and spheres s (by joint).

    Attributes:
        name: the hand's.
        fingers: names, in the order of their joints.
        thumb: which of them is the thumb.
        joint_start: (f + 1,) first joint of each finger.
        offset: (j, 3) the joint's anchor in the frame of the joint before it, or of the palm [m].
        turn: (j, 4) orientation at zero angle in that frame, quaternion wxyz.
        axis: (j, 3) unit axis in the joint's own frame.
        moving: (f,) first joint of each finger that its closing moves.
        sphere_start: (j + 1,) first sphere of each joint.
        sphere: (s, 4) centre in the joint's frame, and radius [m].
        speed: (s,) bound on how far a sphere moves for a unit of the closing path [m].
        group_start: (j + 1,) first group of each joint.
        group_sphere: (g + 1,) first sphere of each group.
        bound: (g, 4) a sphere around all spheres of the group.
        bound_speed: (g,) the largest of their speeds [m].
        palm: (p, 4) spheres of what no joint moves [m].
        palm_group: (h + 1,) first sphere of each group of them.
        palm_bound: (h, 4) a sphere around all spheres of the group.
        path: (k, j) closing path, k evenly spaced points from open to closed [rad].
        limits: (j, 2) lower and upper joint limit [rad].
        tip: (f, 3) centre of each fingertip in the frame of its last joint [m].
    """

    name: str
    fingers: tuple[str, ...]
    thumb: int
    joint_start: IntArray
    offset: Array
    turn: Array
    axis: Array
    moving: IntArray
    sphere_start: IntArray
    sphere: Array
    speed: Array
    group_start: IntArray
    group_sphere: IntArray
    bound: Array
    bound_speed: Array
    palm: Array
    palm_group: IntArray
    palm_bound: Array
    path: Array
    limits: Array
    tip: Array
