"""The data of a hand for the kernels: joint chains, spheres that fill its links, and the closing path.

:func:`preshape.closure.hand_tables.hand_tables` makes the tables of a hand.
"""

from __future__ import annotations

from ..types import Array, IntArray, value


@value
class HandTables:
    """Arrays over fingers f, joints j, spheres s and groups g of neighbouring spheres.

    Joints are in the hand's order, spheres and groups in the order of their joints.

    Attributes:
        name: Name of the hand.
        fingers: Names of the fingers, in the order of their joints.
        thumb: Index of the thumb among them.
        joint_start: (f + 1,) first joint of each finger.
        offset: (j, 3) the joint's anchor in the frame of the joint before it, or in the palm frame [m].
        turn: (j, 4) orientation at angle zero in that frame, quaternion wxyz.
        axis: (j, 3) unit axis in the joint's own frame.
        moving: (f,) first joint of each finger that closing moves.
        sphere_start: (j + 1,) first sphere of each joint.
        sphere: (s, 4) centre in the joint's frame and radius [m].
        speed: (s,) upper bound on the motion of a sphere per unit of the closing path [m].
        group_start: (j + 1,) first group of each joint.
        group_sphere: (g + 1,) first sphere of each group.
        bound: (g, 4) a sphere round all spheres of the group, in the joint's frame: centre and radius [m].
        bound_speed: (g,) the largest speed of the group's spheres [m].
        palm: (p, 4) spheres of the parts that no joint moves, in the palm frame: centre and radius [m]. Those
            of parts that are only in the way, such as a forearm, come last.
        palm_spheres: Number of the others, on which an object may rest.
        palm_group: (h + 1,) first sphere of each group of palm spheres.
        palm_bound: (h, 4) a sphere round all spheres of each such group: centre and radius [m].
        path: (k, m) the motors' commands at k evenly spaced points of the closing path, from open to closed
            [rad].
        motor: (j,) index of the motor that each joint follows.
        command: (m, j) matrix W that gives the commands of a posture, m = W q.
        range: (m, 2) least and largest command of each motor [rad].
        law: (j, 5) coefficients of each joint's angle in powers of its motor's command, lowest first.
        bent: (j,) 1 for a joint whose angle is read from ``unloaded`` instead, else 0.
        unloaded: (p, j) angles of such joints at p evenly spaced commands over the motor's range [rad].
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
    palm_spheres: int
    palm_group: IntArray
    palm_bound: Array
    path: Array
    motor: IntArray
    command: Array
    range: Array
    law: Array
    bent: IntArray
    unloaded: Array
    tip: Array
