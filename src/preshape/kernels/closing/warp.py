"""The closing kernel: one thread puts one hand in its preshape and closes every finger until it touches.

A finger goes along its closing path in steps. At each point every sphere's distance over its speed bounds
how far the path is free, onwards and back; a step goes as far as the bounds at both its ends are likely to
cover, and is taken back to what was sure where they do not. Once a step ends inside the object, the touch
lies within it and is found by false position and halving. Bounds of groups spare most of the spheres.

Import this module only inside a function: it loads Warp. It runs unchanged on the processor and on CUDA;
:mod:`preshape.kernels.closing.plain` is the plain version.

R. Bán and G. Valasek, Automatic step size relaxation in sphere tracing, Eurographics short papers, 2023.
B. Keinert et al., Enhanced sphere tracing, Smart Tools and Applications in Graphics, 2014.
"""

# Types are Warp's, not Python's; and a literal that a loop changes must be written as float(...) or int(...).
# mypy: disable-error-code="attr-defined,call-overload,index,no-untyped-def,operator,untyped-decorator"
# mypy: disable-error-code="valid-type"
# ruff: noqa: RUF046, UP018

import warp as wp

from ..field.warp import field_gradient
from .warp_hand import FAR, FieldArrays, HandArrays, distance_at

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

# What became of a candidate; the order of ``kernels.closing.Fate``.
CLOSED = wp.constant(0)
PALM_INSIDE = wp.constant(1)
FINGERS_INSIDE = wp.constant(2)
THUMB_MISSES = wp.constant(3)
TOO_FEW = wp.constant(4)

# Steps along the closing path; their factor; what they go further in any case; steps that find the touch.
STEPS = wp.constant(64)
RELAXED = wp.constant(1.96)
EXTRA = wp.constant(1.0e-4)
FALSE_POSITIONS = wp.constant(6)
HALVINGS = wp.constant(14)


@wp.func
def path_offset(hand: HandArrays, joint: int, c: float):
    """Joint angle on the closing path, from its first value."""
    share = c * float(hand.knots - 1)
    low = wp.min(int(share), hand.knots - 2)
    part = share - float(low)
    return (1.0 - part) * hand.path[low, joint] + part * hand.path[low + 1, joint] - hand.path[0, joint]


@wp.struct
class Nearest:
    """What is nearest to the object of some of a finger's joints.

    Attributes:
        distance: of the nearest sphere [m], less the clearance.
        step: how far the closing may go, or go back, before any sphere can touch.
        sphere: its number, -1 for none.
        centre: of it [m].
    """

    distance: wp.float32
    step: wp.float32
    sphere: wp.int32
    centre: wp.vec3


@wp.struct
class Frame:
    """Where a joint stands in the object's frame."""

    place: wp.vec3
    turn: wp.quat


@wp.func
def put_joints(
    hand: HandArrays,
    start: wp.array2d(dtype=wp.float32),
    candidate: int,
    first: int,
    end: int,
    c: float,
    before: Frame,
    place: wp.array2d(dtype=wp.vec3),
    facing: wp.array2d(dtype=wp.mat33),
):
    """Put joints ``first`` to ``end`` where they stand at c on the closing path; the frame of the last."""
    p = before.place
    q = before.turn
    for joint in range(first, end):
        p = p + wp.quat_rotate(q, hand.offset[joint])
        angle = wp.clamp(
            start[candidate, joint] + path_offset(hand, joint, c),
            hand.limits[joint][0],
            hand.limits[joint][1],
        )
        q = q * hand.turn[joint] * wp.quat_from_axis_angle(hand.axis[joint], angle)
        place[candidate, joint - first] = p
        facing[candidate, joint - first] = wp.quat_to_matrix(q)
    last = Frame()
    last.place = p
    last.turn = q
    return last


@wp.func
def nearest_link(
    hand: HandArrays,
    field: FieldArrays,
    candidate: int,
    first: int,
    end: int,
    place: wp.array2d(dtype=wp.vec3),
    facing: wp.array2d(dtype=wp.mat33),
    others: Nearest,
    clearance: float,
):
    """The nearest sphere of joints ``first`` to ``end`` where they have been put, and of some others."""
    least = others.distance
    step = others.step
    which = others.sphere
    centre = others.centre
    # The fingertip first: it moves most and is nearest most of the time, which spares the rest.
    for back in range(end - first):
        joint = end - 1 - back
        p = place[candidate, joint - first]
        m = facing[candidate, joint - first]
        for group in range(hand.group_start[joint], hand.group_start[joint + 1]):
            around = hand.bound[group]
            free = (
                distance_at(field, p + m * wp.vec3(around[0], around[1], around[2])) - around[3] - clearance
            )
            if free < least or free < step * hand.bound_speed[group]:
                for k in range(hand.group_sphere[group], hand.group_sphere[group + 1]):
                    s = hand.sphere[k]
                    x = p + m * wp.vec3(s[0], s[1], s[2])
                    d = distance_at(field, x) - s[3] - clearance
                    if d < least:
                        least = d
                        which = k
                        centre = x
                    if d < step * hand.speed[k]:
                        step = d / hand.speed[k]
    near = Nearest()
    near.distance = least
    near.step = step
    near.sphere = which
    near.centre = centre
    return near


@wp.func
def nearest_at(
    hand: HandArrays,
    field: FieldArrays,
    start: wp.array2d(dtype=wp.float32),
    candidate: int,
    first: int,
    end: int,
    c: float,
    before: Frame,
    place: wp.array2d(dtype=wp.vec3),
    facing: wp.array2d(dtype=wp.mat33),
    others: Nearest,
    clearance: float,
):
    """The nearest sphere of joints ``first`` to ``end`` at c on the closing path, and of some others."""
    put_joints(hand, start, candidate, first, end, c, before, place, facing)
    return nearest_link(hand, field, candidate, first, end, place, facing, others, clearance)


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
    # scratch: the joints of the finger in hand
    joint_place: wp.array2d(dtype=wp.vec3),
    joint_facing: wp.array2d(dtype=wp.mat33),
    # out
    fate: wp.array(dtype=wp.int32),
    closing: wp.array2d(dtype=wp.float32),
    sphere: wp.array2d(dtype=wp.int32),
    points: wp.array2d(dtype=wp.vec3),
    normals: wp.array2d(dtype=wp.vec3),
    counts: wp.array(dtype=wp.int32),
):
    """Close one hand's fingers, one after the other; see :meth:`.closing.ClosingKernel.close`."""
    i = first + wp.tid()
    for finger in range(hand.fingers):
        closing[i, finger] = 0.0
        sphere[i, finger] = -1
    for k in range(points.shape[1]):
        points[i, k] = wp.vec3()
        normals[i, k] = wp.vec3()
    counts[i] = 0
    nothing = Nearest()
    nothing.distance = FAR
    nothing.step = 2.0
    nothing.sphere = -1
    palm = Frame()
    palm.place = place[i]
    palm.turn = turn[i]
    m = wp.quat_to_matrix(palm.turn)
    inside = bool(False)
    for group in range(hand.palm_bound.shape[0]):
        around = hand.palm_bound[group]
        x = palm.place + m * wp.vec3(around[0], around[1], around[2])
        if not inside and distance_at(field, x) - around[3] < palm_clearance:
            for k in range(hand.palm_group[group], hand.palm_group[group + 1]):
                s = hand.palm[k]
                if distance_at(field, palm.place + m * wp.vec3(s[0], s[1], s[2])) - s[3] < palm_clearance:
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
        moving = hand.moving[finger]
        end = hand.joint_start[finger + 1]
        c = float(0.0)
        # What closing does not move stays where it is.
        base = hand.joint_start[finger]
        root = put_joints(hand, start, i, base, moving, c, palm, joint_place, joint_facing)
        still = nearest_link(hand, field, i, base, moving, joint_place, joint_facing, nothing, clearance)
        near = nearest_at(
            hand, field, start, i, moving, end, c, root, joint_place, joint_facing, still, clearance
        )
        if near.distance < 0.0:
            fate[i] = FINGERS_INSIDE
            return
        if (mask[i] >> finger) & 1 == 0:
            continue
        trend = float(-0.5)
        for _ in range(STEPS):
            if near.distance <= tolerance or c >= 1.0:
                break
            before = c
            d_before = near.distance
            sure = near.step
            # As far as what is sure here and there, by its trend, will cover (Bán and Valasek 2023).
            c = wp.min(1.0, before + RELAXED / (1.0 - trend) * sure + EXTRA)
            near = nearest_at(
                hand, field, start, i, moving, end, c, root, joint_place, joint_facing, still, clearance
            )
            if near.distance >= 0.0 and c - before > sure + near.step + 2.0 * EXTRA:
                # It does not cover the way between: only what is sure (Keinert et al. 2014).
                c = before + sure
                near = nearest_at(
                    hand, field, start, i, moving, end, c, root, joint_place, joint_facing, still, clearance
                )
            trend = wp.clamp((near.step - sure) / (c - before), -1.0, 0.5)
            if near.distance < 0.0:
                # Overshot, by a little: the touch lies in between.
                low = before
                high = c
                d_low = d_before
                d_high = near.distance
                for k in range(FALSE_POSITIONS + HALVINGS):
                    share = wp.clamp((d_low - 0.5 * tolerance) / (d_low - d_high), 0.05, 0.95)
                    if k >= FALSE_POSITIONS:
                        share = 0.5
                    c = low + (high - low) * share
                    near = nearest_at(
                        hand,
                        field,
                        start,
                        i,
                        moving,
                        end,
                        c,
                        root,
                        joint_place,
                        joint_facing,
                        still,
                        clearance,
                    )
                    if near.distance < 0.0:
                        high = c
                        d_high = near.distance
                    else:
                        low = c
                        d_low = near.distance
                        if near.distance <= tolerance:
                            break
                if near.distance < 0.0 or near.distance > tolerance:
                    c = low
                    near = nearest_at(
                        hand,
                        field,
                        start,
                        i,
                        moving,
                        end,
                        c,
                        root,
                        joint_place,
                        joint_facing,
                        still,
                        clearance,
                    )
                break
        if near.distance <= 3.0 * tolerance:
            g = field_gradient(field.distance, field.origin, field.inverse_spacing, near.centre)
            r = hand.sphere[near.sphere][3]
            closing[i, finger] = c
            sphere[i, finger] = near.sphere
            points[i, found] = near.centre - g * (r + clearance + near.distance)
            normals[i, found] = -g
            found += 1
        elif finger == hand.thumb:
            fate[i] = THUMB_MISSES
            return
    if found < wanted:
        fate[i] = TOO_FEW
        return
    counts[i] = found
    fate[i] = CLOSED
