"""Distances of hands in given postures from the object and from obstacles; one thread computes one hand.

Import this module only inside a function: it loads Warp. ``clearances_plain`` of :mod:`.plain` is the
specification.
"""

# Types are Warp's, not Python's; and a literal that a loop changes must be written as float(...) or int(...).
# mypy: disable-error-code="attr-defined,call-overload,index,no-untyped-def,operator,untyped-decorator"
# mypy: disable-error-code="valid-type"

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
