"""Distances of hands in given postures from the object and from obstacles; one thread computes one hand.

Import this module only inside a function: it loads Warp. ``clearances_plain`` and ``link_distances_plain`` of
:mod:`.plain` are the specifications.
"""

# Types are Warp's, not Python's; and a literal that a loop changes must be written as float(...) or int(...).
# mypy: disable-error-code="attr-defined,call-overload,index,no-untyped-def,operator,untyped-decorator"
# mypy: disable-error-code="valid-type"
# ruff: noqa: RUF046, UP018

import warp as wp

from .warp_hand import FAR, FieldArrays, HandArrays, distance_at

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


@wp.func
def obstacle_distance(planes: wp.array(dtype=wp.vec4), boxes: wp.array2d(dtype=wp.vec3), x: wp.vec3):
    """Signed distance from a point to the nearest half-space or box [m]."""
    distance = float(FAR)
    for k in range(planes.shape[0]):
        s = planes[k]
        distance = wp.min(distance, s[0] * x[0] + s[1] * x[1] + s[2] * x[2] - s[3])
    for k in range(boxes.shape[0]):
        middle = 0.5 * (boxes[k, 0] + boxes[k, 1])
        half = 0.5 * (boxes[k, 1] - boxes[k, 0])
        out = wp.vec3(
            wp.abs(x[0] - middle[0]) - half[0],
            wp.abs(x[1] - middle[1]) - half[1],
            wp.abs(x[2] - middle[2]) - half[2],
        )
        away = wp.vec3(wp.max(out[0], 0.0), wp.max(out[1], 0.0), wp.max(out[2], 0.0))
        distance = wp.min(distance, wp.length(away) + wp.min(wp.max(out[0], wp.max(out[1], out[2])), 0.0))
    return distance


@wp.kernel
def clearances(
    # Model:
    hand: HandArrays,
    field: FieldArrays,
    planes: wp.array(dtype=wp.vec4),
    boxes: wp.array2d(dtype=wp.vec3),
    # In:
    place: wp.array(dtype=wp.vec3),
    turn: wp.array(dtype=wp.quat),
    posture: wp.array2d(dtype=wp.float32),
    enough: wp.float32,
    first: wp.int32,
    # Out:
    to_object: wp.array2d(dtype=wp.float32),
    to_obstacles: wp.array(dtype=wp.float32),
):
    """Distance of each finger and, last, of the palm from the object; of the whole hand from the obstacles.

    Distances above ``enough`` are returned as ``enough``. A group of spheres is skipped if its bounding
    sphere is farther away than the least distance so far.
    """
    i = first + wp.tid()
    obstacles = planes.shape[0] + boxes.shape[0]
    free = float(enough)
    m = wp.quat_to_matrix(turn[i])
    least = float(enough)
    for group in range(hand.palm_bound.shape[0]):
        around = hand.palm_bound[group]
        x = place[i] + m * wp.vec3(around[0], around[1], around[2])
        near = bool(distance_at(field, x) - around[3] < least)
        if obstacles > 0 and obstacle_distance(planes, boxes, x) - around[3] < free:
            near = True
        if near:
            for k in range(hand.palm_group[group], hand.palm_group[group + 1]):
                s = hand.palm[k]
                x = place[i] + m * wp.vec3(s[0], s[1], s[2])
                least = wp.min(least, distance_at(field, x) - s[3])
                if obstacles > 0:
                    free = wp.min(free, obstacle_distance(planes, boxes, x) - s[3])
    to_object[i, hand.fingers] = least
    for finger in range(hand.fingers):
        p = place[i]
        q = turn[i]
        least = float(enough)
        for joint in range(hand.joint_start[finger], hand.joint_start[finger + 1]):
            p = p + wp.quat_rotate(q, hand.offset[joint])
            q = q * hand.turn[joint] * wp.quat_from_axis_angle(hand.axis[joint], posture[i, joint])
            m = wp.quat_to_matrix(q)
            for group in range(hand.group_start[joint], hand.group_start[joint + 1]):
                around = hand.bound[group]
                x = p + m * wp.vec3(around[0], around[1], around[2])
                near = bool(distance_at(field, x) - around[3] < least)
                if obstacles > 0 and obstacle_distance(planes, boxes, x) - around[3] < free:
                    near = True
                if near:
                    for k in range(hand.group_sphere[group], hand.group_sphere[group + 1]):
                        s = hand.sphere[k]
                        x = p + m * wp.vec3(s[0], s[1], s[2])
                        least = wp.min(least, distance_at(field, x) - s[3])
                        if obstacles > 0:
                            free = wp.min(free, obstacle_distance(planes, boxes, x) - s[3])
        to_object[i, finger] = least
    to_obstacles[i] = free


@wp.func
def nearest_sphere(
    # Model:
    field: FieldArrays,
    spheres: wp.array(dtype=wp.vec4),
    bounds: wp.array(dtype=wp.vec4),
    group_sphere: wp.array(dtype=wp.int32),
    # In:
    begin: int,
    end: int,
    p: wp.vec3,
    m: wp.mat33,
    enough: float,
):
    """Distance and index of the nearest sphere of groups ``begin`` to ``end``; ``enough`` and -1 if farther.

    The groups are in the frame with origin p and rotation m. Those that end beyond the nearest sphere so far
    are skipped; so the group that begins nearest is searched first.
    """
    least = float(enough)
    which = int(-1)
    nearest = int(begin)
    last = int(end)
    if end - begin > 2:
        low = float(enough)
        last = begin  # no group is near enough
        for group in range(begin, end):
            around = bounds[group]
            free = distance_at(field, p + m * wp.vec3(around[0], around[1], around[2])) - around[3]
            if free < low:
                low = free
                nearest = group
                last = end
    for turn in range(begin, last):
        # ``nearest`` first, and then the others in their order.
        group = turn
        if turn == begin:
            group = nearest
        elif turn <= nearest:
            group = turn - 1
        around = bounds[group]
        if distance_at(field, p + m * wp.vec3(around[0], around[1], around[2])) - around[3] < least:
            for k in range(group_sphere[group], group_sphere[group + 1]):
                s = spheres[k]
                d = distance_at(field, p + m * wp.vec3(s[0], s[1], s[2])) - s[3]
                if d < least:
                    least = d
                    which = k
    if begin == end:
        least = float(FAR)
    return least, which


@wp.kernel
def link_distances(
    # Model:
    hand: HandArrays,
    field: FieldArrays,
    # In:
    place: wp.array(dtype=wp.vec3),
    turn: wp.array(dtype=wp.quat),
    posture: wp.array2d(dtype=wp.float32),
    asked: wp.array2d(dtype=wp.bool),
    enough: wp.float32,
    first: wp.int32,
    # Out:
    distance: wp.array2d(dtype=wp.float32),
    sphere: wp.array2d(dtype=wp.int32),
):
    """Distance from the object of the link after each joint and, last, of the palm; see the host's method."""
    i = first + wp.tid()
    joints = posture.shape[1]
    for link in range(joints + 1):
        distance[i, link] = FAR
        sphere[i, link] = -1
    if asked[i, joints]:
        least, which = nearest_sphere(
            field,
            hand.palm,
            hand.palm_bound,
            hand.palm_group,
            0,
            hand.palm_bound.shape[0],
            place[i],
            wp.quat_to_matrix(turn[i]),
            enough,
        )
        distance[i, joints] = least
        sphere[i, joints] = which
    for finger in range(hand.fingers):
        p = place[i]
        q = turn[i]
        for joint in range(hand.joint_start[finger], hand.joint_start[finger + 1]):
            p = p + wp.quat_rotate(q, hand.offset[joint])
            q = q * hand.turn[joint] * wp.quat_from_axis_angle(hand.axis[joint], posture[i, joint])
            if asked[i, joint]:
                least, which = nearest_sphere(
                    field,
                    hand.sphere,
                    hand.bound,
                    hand.group_sphere,
                    hand.group_start[joint],
                    hand.group_start[joint + 1],
                    p,
                    wp.quat_to_matrix(q),
                    enough,
                )
                distance[i, joint] = least
                sphere[i, joint] = which
