"""The closing kernel: one thread closes one candidate.

The steps, numbered as in the comments, are those of :mod:`.plain`, the specification; this kernel computes
them in single precision. A group of spheres is skipped if its bounding sphere shows that no sphere of the
group can change the result.

Import this module only inside a function: it loads Warp. It runs unchanged on the CPU and on CUDA.
"""

# Types are Warp's, not Python's; and a literal that a loop changes must be written as float(...) or int(...).
# mypy: disable-error-code="attr-defined,call-overload,index,no-untyped-def,operator,untyped-decorator"
# mypy: disable-error-code="valid-type"
# ruff: noqa: RUF046, UP018

import warp as wp

from ..field.warp import field_gradient
from .warp_hand import FAR, FieldArrays, HandArrays, distance_at

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

# The values of Fate in host.py.
CLOSED = wp.constant(0)
PALM_INSIDE = wp.constant(1)
FINGERS_INSIDE = wp.constant(2)
THUMB_MISSES = wp.constant(3)
TOO_FEW = wp.constant(4)

# These constants are those of plain.py, which explains them.
STEPS = wp.constant(64)
RELAXATION = wp.constant(1.96)
EXTRA = wp.constant(1.0e-4)
FALSE_POSITIONS = wp.constant(6)
BISECTIONS = wp.constant(14)


@wp.func
def joint_angle(hand: HandArrays, joint: int, command: float, c: float):
    """Angle of a joint at c of the closing path, on which its motor starts at a command [rad]."""
    motor = hand.motor[joint]
    share = c * float(hand.knots - 1)
    low = wp.min(int(share), hand.knots - 2)
    part = share - float(low)
    along = (1.0 - part) * hand.path[low, motor] + part * hand.path[low + 1, motor] - hand.path[0, motor]
    bounds = hand.range[motor]
    m = wp.clamp(command + along, bounds[0], bounds[1])
    if hand.bent[joint] == 0:
        # Horner's scheme
        angle = float(hand.law[joint, 4])
        angle = angle * m + hand.law[joint, 3]
        angle = angle * m + hand.law[joint, 2]
        angle = angle * m + hand.law[joint, 1]
        return angle * m + hand.law[joint, 0]
    cells = hand.unloaded.shape[0] - 1
    place = (m - bounds[0]) / (bounds[1] - bounds[0]) * float(cells)
    cell = wp.clamp(int(place), 0, cells - 1)
    rest = place - float(cell)
    return (1.0 - rest) * hand.unloaded[cell, joint] + rest * hand.unloaded[cell + 1, joint]


@wp.struct
class NearestSphere:
    """The sphere of some of a finger's joints that is nearest to the object.

    Attributes:
        distance: Its distance [m], less the clearance.
        step: How far the finger may close or open before any of these spheres can touch.
        sphere: Its number, -1 for none.
        centre: Its centre [m].
    """

    distance: wp.float32
    step: wp.float32
    sphere: wp.int32
    centre: wp.vec3


@wp.struct
class Frame:
    """Place and orientation of a joint in the object's frame."""

    place: wp.vec3
    turn: wp.quat


@wp.func
def place_joints(
    # Model:
    hand: HandArrays,
    # In:
    start: wp.array2d(dtype=wp.float32),
    candidate: int,
    first: int,
    end: int,
    c: float,
    before: Frame,
    # Out:
    place: wp.array2d(dtype=wp.vec3),
    turn: wp.array2d(dtype=wp.mat33),
):
    """Place joints ``first`` to ``end`` at c of the closing path, and return the frame of the last."""
    p = before.place
    q = before.turn
    for joint in range(first, end):
        p = p + wp.quat_rotate(q, hand.offset[joint])
        angle = joint_angle(hand, joint, start[candidate, hand.motor[joint]], c)
        q = q * hand.turn[joint] * wp.quat_from_axis_angle(hand.axis[joint], angle)
        place[candidate, joint - first] = p
        turn[candidate, joint - first] = wp.quat_to_matrix(q)
    last = Frame()
    last.place = p
    last.turn = q
    return last


@wp.func
def nearest_placed(
    # Model:
    hand: HandArrays,
    field: FieldArrays,
    # In:
    candidate: int,
    first: int,
    end: int,
    place: wp.array2d(dtype=wp.vec3),
    turn: wp.array2d(dtype=wp.mat33),
    others: NearestSphere,
    clearance: float,
):
    """The nearest sphere of the placed joints ``first`` to ``end`` and of ``others``."""
    least = others.distance
    step = others.step
    which = others.sphere
    centre = others.centre
    # The fingertip first: it is nearest most of the time, so most groups of the other links are skipped.
    for back in range(end - first):
        joint = end - 1 - back
        p = place[candidate, joint - first]
        m = turn[candidate, joint - first]
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
    near = NearestSphere()
    near.distance = least
    near.step = step
    near.sphere = which
    near.centre = centre
    return near


@wp.func
def nearest_at(
    # Model:
    hand: HandArrays,
    field: FieldArrays,
    # In:
    start: wp.array2d(dtype=wp.float32),
    candidate: int,
    first: int,
    end: int,
    c: float,
    before: Frame,
    others: NearestSphere,
    clearance: float,
    # Scratch:
    place: wp.array2d(dtype=wp.vec3),
    turn: wp.array2d(dtype=wp.mat33),
):
    """The nearest sphere of joints ``first`` to ``end`` at c of the closing path, and of ``others``."""
    place_joints(hand, start, candidate, first, end, c, before, place, turn)
    return nearest_placed(hand, field, candidate, first, end, place, turn, others, clearance)


@wp.kernel
def close_hand(
    # Model:
    hand: HandArrays,
    field: FieldArrays,
    # In:
    place: wp.array(dtype=wp.vec3),
    turn: wp.array(dtype=wp.quat),
    start: wp.array2d(dtype=wp.float32),
    mask: wp.array(dtype=wp.int32),
    clearance: wp.float32,
    palm_clearance: wp.float32,
    tolerance: wp.float32,
    wanted: wp.int32,
    first: wp.int32,
    # Scratch: the joints of the finger that closes.
    joint_place: wp.array2d(dtype=wp.vec3),
    joint_turn: wp.array2d(dtype=wp.mat33),
    # Out:
    fate: wp.array(dtype=wp.int32),
    closing: wp.array2d(dtype=wp.float32),
    sphere: wp.array2d(dtype=wp.int32),
    points: wp.array2d(dtype=wp.vec3),
    normals_in: wp.array2d(dtype=wp.vec3),
    counts: wp.array(dtype=wp.int32),
):
    """Close the fingers of one candidate; see :meth:`.host.ClosingKernel.close`."""
    i = first + wp.tid()
    for finger in range(hand.fingers):
        closing[i, finger] = 0.0
        sphere[i, finger] = -1
    for k in range(points.shape[1]):
        points[i, k] = wp.vec3()
        normals_in[i, k] = wp.vec3()
    counts[i] = 0
    nothing = NearestSphere()
    nothing.distance = FAR
    nothing.step = 2.0
    nothing.sphere = -1
    palm = Frame()
    palm.place = place[i]
    palm.turn = turn[i]
    # 1. Palm
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
    # 2. Fingers, the thumb first
    for order in range(hand.fingers):
        finger = order
        if order == 0:
            finger = hand.thumb
        elif order <= hand.thumb:
            finger = order - 1
        moving = hand.moving[finger]
        end = hand.joint_start[finger + 1]
        c = float(0.0)
        # 2.1 Start. Joints that closing does not move are placed once.
        base = hand.joint_start[finger]
        root = place_joints(hand, start, i, base, moving, c, palm, joint_place, joint_turn)
        still = nearest_placed(hand, field, i, base, moving, joint_place, joint_turn, nothing, clearance)
        near = nearest_at(
            hand, field, start, i, moving, end, c, root, still, clearance, joint_place, joint_turn
        )
        if near.distance < 0.0:
            fate[i] = FINGERS_INSIDE
            return
        if (mask[i] >> finger) & 1 == 0:
            continue
        # 2.2 Steps
        trend = float(-0.5)  # change of the bound per unit of the path
        for _ in range(STEPS):
            if near.distance <= tolerance or c >= 1.0:
                break
            before = c
            d_before = near.distance
            bound = near.step
            # The bound at the end of the step is extrapolated by its trend.
            c = wp.min(1.0, before + RELAXATION / (1.0 - trend) * bound + EXTRA)
            near = nearest_at(
                hand, field, start, i, moving, end, c, root, still, clearance, joint_place, joint_turn
            )
            # The bounds at both ends do not cover the step: shorten it.
            if near.distance >= 0.0 and c - before > bound + near.step + 2.0 * EXTRA:
                c = before + bound
                near = nearest_at(
                    hand, field, start, i, moving, end, c, root, still, clearance, joint_place, joint_turn
                )
            trend = wp.clamp((near.step - bound) / (c - before), -1.0, 0.5)
            if near.distance < 0.0:
                # 2.3 Touch. It lies between ``before`` and c.
                low = before
                high = c
                d_low = d_before
                d_high = near.distance
                for k in range(FALSE_POSITIONS + BISECTIONS):
                    share = wp.clamp((d_low - 0.5 * tolerance) / (d_low - d_high), 0.05, 0.95)
                    if k >= FALSE_POSITIONS:
                        share = 0.5
                    c = low + (high - low) * share
                    near = nearest_at(
                        hand, field, start, i, moving, end, c, root, still, clearance, joint_place, joint_turn
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
                    # Not found to the tolerance: the last point outside the object.
                    c = low
                    near = nearest_at(
                        hand, field, start, i, moving, end, c, root, still, clearance, joint_place, joint_turn
                    )
                break
        # 2.4 Contact
        if near.distance <= 3.0 * tolerance:
            gradient = field_gradient(field.distance, field.origin, field.inverse_spacing, near.centre)
            radius = hand.sphere[near.sphere][3]
            closing[i, finger] = c
            sphere[i, finger] = near.sphere
            points[i, found] = near.centre - gradient * (radius + clearance + near.distance)
            normals_in[i, found] = -gradient
            found += 1
        elif finger == hand.thumb:
            fate[i] = THUMB_MISSES
            return
    # 3. Count
    if found < wanted:
        fate[i] = TOO_FEW
        return
    counts[i] = found
    fate[i] = CLOSED
