"""The closing kernel: one thread puts the hand in its preshape and closes every finger until it touches."""

import warp as wp

from .warp_field import field_distance, field_gradient

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

# What became of a candidate; the order of ``kernels.closing.Fate``.
CLOSED = wp.constant(0)
PALM_INSIDE = wp.constant(1)
FINGERS_INSIDE = wp.constant(2)
THUMB_MISSES = wp.constant(3)
TOO_FEW = wp.constant(4)
SELF = wp.constant(5)


# Steps along the closing path; how much further than the bound allows they go; steps that find the touch.
STEPS = wp.constant(24)
RELAXED = wp.constant(1.3)
EXTRA = wp.constant(1.0e-4)
FALSE_POSITIONS = wp.constant(6)
HALVINGS = wp.constant(14)


@wp.struct
class HandArrays:
    """See :class:`preshape.kernels.hand_tables.HandTables`."""

    joint_start: wp.array(dtype=wp.int32)
    offset: wp.array(dtype=wp.vec3)
    turn: wp.array(dtype=wp.quat)
    axis: wp.array(dtype=wp.vec3)
    sphere_start: wp.array(dtype=wp.int32)
    sphere: wp.array(dtype=wp.vec4)
    speed: wp.array(dtype=wp.float32)
    bound: wp.array(dtype=wp.vec4)
    bound_speed: wp.array(dtype=wp.float32)
    palm: wp.array(dtype=wp.vec4)
    path: wp.array2d(dtype=wp.float32)
    limits: wp.array(dtype=wp.vec2)
    fingers: wp.int32
    thumb: wp.int32
    knots: wp.int32


@wp.struct
class FieldArrays:
    """See :class:`preshape.kernels.field.DistanceField`."""

    distance: wp.array3d(dtype=wp.float32)
    origin: wp.vec3
    inverse_spacing: wp.float32


@wp.func
def path_offset(hand: HandArrays, joint: int, c: float):
    """Joint angle on the closing path, from its first value."""
    share = c * float(hand.knots - 1)
    low = wp.min(int(share), hand.knots - 2)
    part = share - float(low)
    return (1.0 - part) * hand.path[low, joint] + part * hand.path[low + 1, joint] - hand.path[0, joint]


@wp.func
def nearest_link(
    hand: HandArrays,
    field: FieldArrays,
    start: wp.array2d(dtype=wp.float32),
    candidate: int,
    finger: int,
    c: float,
    place: wp.vec3,
    turn: wp.quat,
    clearance: float,
):
    """Smallest distance of a finger's spheres to the object, the sphere, and how far c may go unharmed.

    Returns (distance, step, centre of the sphere x, y, z, its number).
    """
    p = place
    q = turn
    least = float(1.0e6)
    step = float(2.0)
    which = int(-1)
    centre = wp.vec3(0.0, 0.0, 0.0)
    for joint in range(hand.joint_start[finger], hand.joint_start[finger + 1]):
        p = p + wp.quat_rotate(q, hand.offset[joint])
        angle = wp.clamp(
            start[candidate, joint] + path_offset(hand, joint, c), hand.limits[joint][0], hand.limits[joint][1]
        )
        q = q * hand.turn[joint] * wp.quat_from_axis_angle(hand.axis[joint], angle)
        m = wp.quat_to_matrix(q)
        around = hand.bound[joint]
        free = (
            field_distance(
                field.distance,
                field.origin,
                field.inverse_spacing,
                p + m * wp.vec3(around[0], around[1], around[2]),
            )
            - around[3]
            - clearance
        )
        if free < least or free < step * hand.bound_speed[joint]:
            for k in range(hand.sphere_start[joint], hand.sphere_start[joint + 1]):
                s = hand.sphere[k]
                x = p + m * wp.vec3(s[0], s[1], s[2])
                d = field_distance(field.distance, field.origin, field.inverse_spacing, x) - s[3] - clearance
                if d < least:
                    least = d
                    which = k
                    centre = x
                if d < step * hand.speed[k]:
                    step = d / hand.speed[k]
    return least, step, centre, which


@wp.kernel
def close_hand(
    hand: HandArrays,
    field: FieldArrays,
    place: wp.array(dtype=wp.vec3),
    turn: wp.array(dtype=wp.quat),
    start: wp.array2d(dtype=wp.float32),
    mask: wp.array(dtype=wp.int32),
    clearance: wp.float32,
    palm_clearance: wp.float32,
    tolerance: wp.float32,
    wanted: wp.int32,
    first: wp.int32,
    # out
    fate: wp.array(dtype=wp.int32),
    closing: wp.array2d(dtype=wp.float32),
    sphere: wp.array2d(dtype=wp.int32),
    points: wp.array2d(dtype=wp.vec3),
    normals: wp.array2d(dtype=wp.vec3),
    counts: wp.array(dtype=wp.int32),
):
    i = first + wp.tid()
    at = place[i]
    q = turn[i]
    counts[i] = 0
    m = wp.quat_to_matrix(q)
    inside = bool(False)
    for k in range(hand.palm.shape[0]):
        if not inside:
            s = hand.palm[k]
            x = at + m * wp.vec3(s[0], s[1], s[2])
            d = field_distance(field.distance, field.origin, field.inverse_spacing, x) - s[3]
            if d < palm_clearance:
                inside = True
    if inside:
        fate[i] = PALM_INSIDE
        return
    found = int(0)
    # The thumb first: most candidates fail on it.
    for turnwise in range(hand.fingers):
        finger = turnwise
        if turnwise == 0:
            finger = hand.thumb
        elif turnwise <= hand.thumb:
            finger = turnwise - 1
        closing[i, finger] = 0.0
        sphere[i, finger] = -1
        if inside:
            continue
        used = (mask[i] >> finger) & 1
        c = float(0.0)
        least, step, centre, which = nearest_link(hand, field, start, i, finger, c, at, q, clearance)
        if least < 0.0:
            inside = True
            continue
        if used == 0:
            continue
        for _ in range(STEPS):
            if least <= tolerance or c >= 1.0:
                break
            before = c
            d_before = least
            sure = step
            # The bound is loose: go a little further than it allows, and come back if that was too far.
            c = wp.min(1.0, before + RELAXED * sure + EXTRA)
            least, step, centre, which = nearest_link(hand, field, start, i, finger, c, at, q, clearance)
            if least >= 0.0 and c - before > sure + step + 2.0 * EXTRA:
                # What both ends allow must cover the way between them (Keinert et al. 2014).
                c = before + sure
                least, step, centre, which = nearest_link(hand, field, start, i, finger, c, at, q, clearance)
            if least < 0.0:
                # Overshot, by a little: the touch lies in between.
                low = before
                high = c
                d_low = d_before
                d_high = least
                for k in range(FALSE_POSITIONS + HALVINGS):
                    share = wp.clamp((d_low - 0.5 * tolerance) / (d_low - d_high), 0.05, 0.95)
                    if k >= FALSE_POSITIONS:
                        share = 0.5
                    c = low + (high - low) * share
                    least, step, centre, which = nearest_link(
                        hand, field, start, i, finger, c, at, q, clearance
                    )
                    if least < 0.0:
                        high = c
                        d_high = least
                    else:
                        low = c
                        d_low = least
                    if least >= 0.0 and least <= tolerance:
                        break
                if least < 0.0 or least > tolerance:
                    c = low
                    least, step, centre, which = nearest_link(
                        hand, field, start, i, finger, c, at, q, clearance
                    )
                break
        if least <= 3.0 * tolerance:
            g = field_gradient(field.distance, field.origin, field.inverse_spacing, centre)
            r = hand.sphere[which][3]
            closing[i, finger] = c
            sphere[i, finger] = which
            points[i, found] = centre - g * (r + clearance + least)
            normals[i, found] = -g
            found += 1
        elif finger == hand.thumb:
            fate[i] = THUMB_MISSES
            counts[i] = 0
            return
    if inside:
        fate[i] = FINGERS_INSIDE
        return
    if found < wanted:
        fate[i] = TOO_FEW
        return
    counts[i] = found
    fate[i] = CLOSED


@wp.func
def room_of(planes: wp.array(dtype=wp.vec4), boxes: wp.array2d(dtype=wp.vec3), x: wp.vec3):
    """Distance from a point to the nearest half-space or box that is to be kept out of."""
    room = float(1.0e6)
    for k in range(planes.shape[0]):
        s = planes[k]
        room = wp.min(room, s[0] * x[0] + s[1] * x[1] + s[2] * x[2] - s[3])
    for k in range(boxes.shape[0]):
        middle = 0.5 * (boxes[k, 0] + boxes[k, 1])
        half = 0.5 * (boxes[k, 1] - boxes[k, 0])
        out = wp.vec3(
            wp.abs(x[0] - middle[0]) - half[0],
            wp.abs(x[1] - middle[1]) - half[1],
            wp.abs(x[2] - middle[2]) - half[2],
        )
        away = wp.vec3(wp.max(out[0], 0.0), wp.max(out[1], 0.0), wp.max(out[2], 0.0))
        room = wp.min(room, wp.length(away) + wp.min(wp.max(out[0], wp.max(out[1], out[2])), 0.0))
    return room


@wp.kernel
def clearances(
    hand: HandArrays,
    field: FieldArrays,
    planes: wp.array(dtype=wp.vec4),
    boxes: wp.array2d(dtype=wp.vec3),
    place: wp.array(dtype=wp.vec3),
    turn: wp.array(dtype=wp.quat),
    posture: wp.array2d(dtype=wp.float32),
    first: wp.int32,
    # out
    to_object: wp.array2d(dtype=wp.float32),
    to_rest: wp.array(dtype=wp.float32),
):
    """Distance of each finger, and of the palm (last), to the object; of the whole hand to what is kept out."""
    i = first + wp.tid()
    obstacles = planes.shape[0] + boxes.shape[0]
    room = float(1.0e6)
    m = wp.quat_to_matrix(turn[i])
    least = float(1.0e6)
    for k in range(hand.palm.shape[0]):
        s = hand.palm[k]
        x = place[i] + m * wp.vec3(s[0], s[1], s[2])
        least = wp.min(least, field_distance(field.distance, field.origin, field.inverse_spacing, x) - s[3])
        if obstacles > 0:
            room = wp.min(room, room_of(planes, boxes, x) - s[3])
    to_object[i, hand.fingers] = least
    for finger in range(hand.fingers):
        p = place[i]
        q = turn[i]
        least = float(1.0e6)
        for joint in range(hand.joint_start[finger], hand.joint_start[finger + 1]):
            p = p + wp.quat_rotate(q, hand.offset[joint])
            q = q * hand.turn[joint] * wp.quat_from_axis_angle(hand.axis[joint], posture[i, joint])
            m = wp.quat_to_matrix(q)
            around = hand.bound[joint]
            middle = p + m * wp.vec3(around[0], around[1], around[2])
            free = (
                field_distance(field.distance, field.origin, field.inverse_spacing, middle) - around[3]
            )
            near = bool(free < least)
            if obstacles > 0:
                if room_of(planes, boxes, middle) - around[3] < room:
                    near = True
            if near:
                for k in range(hand.sphere_start[joint], hand.sphere_start[joint + 1]):
                    s = hand.sphere[k]
                    x = p + m * wp.vec3(s[0], s[1], s[2])
                    d = field_distance(field.distance, field.origin, field.inverse_spacing, x) - s[3]
                    least = wp.min(least, d)
                    if obstacles > 0:
                        room = wp.min(room, room_of(planes, boxes, x) - s[3])
        to_object[i, finger] = least
    to_rest[i] = room
