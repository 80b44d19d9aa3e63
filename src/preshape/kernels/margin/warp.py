"""Wrench margins of one candidate grasp, as a Warp function and a kernel (one thread a candidate).

What is computed is told in :mod:`.host`, which launches it; :mod:`.plain` is the plain version.
Import this module only inside a function: it loads Warp. It runs unchanged on the processor and on CUDA.

The nearest producible wrench is found by Wolfe's method (1976): a set of at most seven affinely independent
support points, whose hull holds the nearest wrench found so far. Small distances drown in a Gram matrix of
single precision, so the set is kept as an orthonormal basis of its edges. The strength is a cutting plane
on top: the plane across the way from the nearest wrench to the target b + k w stops the ray there, and k
shrinks to that. All targets of a candidate go through one loop, one step of the set a turn, so that the
threads of a GPU stay together; the set of one target is where the next begins.
"""
# Types are Warp's, not Python's; and a literal that a loop changes must be written as float(...) or int(...).
# mypy: disable-error-code="attr-defined,call-overload,index,no-untyped-def,operator,untyped-decorator"
# mypy: disable-error-code="valid-type"
# ruff: noqa: RUF046, UP018

from __future__ import annotations

import warp as wp

from .warp_support import FAR, bounded, dot, hardest, highest, mat83, vec6

wp.set_module_options({"enable_backward": False, "max_unroll": 1, "optimization_level": 3})

vec7 = wp.types.vector(length=7, dtype=wp.float32)
mat66 = wp.types.matrix(shape=(6, 6), dtype=wp.float32)
mat76 = wp.types.matrix(shape=(7, 6), dtype=wp.float32)

# What a turn is for; a candidate goes through them in this order.
RESIDUAL = wp.constant(0)
BASE = wp.constant(1)
STRENGTH = wp.constant(2)
DONE = wp.constant(3)

CONTACTS = wp.constant(8)

# As in plain, where they are explained.
GAP = wp.constant(wp.float32(3.0e-3))
GAP_FLOOR = wp.constant(wp.float32(3.0e-6))
K_FLOOR = wp.constant(wp.float32(2.0e-5))
ROUNDING = wp.constant(wp.float32(2.0e-7))
TURNS = wp.constant(60)


@wp.func
def margin(
    arms: mat83,
    normals: mat83,
    count: int,
    mu: float,
    gamma: float,
    base: vec6,
    units: wp.array(dtype=vec6),
    sizes: wp.array(dtype=float),
    axis: vec6,
    cos_half: float,
    sin_half: float,
    anew: int,
    bound: float,
    most: float,
    floor: float,
):
    """Residual and strength of one candidate.

    Args:
        arms: contact positions from the reference point over the length.
        normals: unit inward normals.
        count: contacts, 0..8.
        mu: friction.
        gamma: torsional friction over the length.
        base: wrench that is asked for all the while.
        units: (m,) directions of the wrenches asked for.
        sizes: (m,) their sizes.
        axis: unit, of a cone of wrenches, or zeros. With a cone there is no residual, and strength is against
            every unit wrench of the cone; the search starts from ``units``.
        cos_half: of the cone's half-angle.
        sin_half: of the cone's half-angle.
        anew: from this one of ``units`` on, each descends from the top: of a cone's two valleys the search
            finds the deeper one only where it does not begin at the bottom of the other.
        bound: the search ends where the residual is certainly above this; below 0, only the strength is
            sought.
        most: strength above this is not told from it.
        floor: the search ends where the strength is certainly no more than this.

    Returns:
        Residual, strength, the indices of the wrenches that decided them, and the wrench of the cone that
        decided the strength.
    """
    m = units.shape[0]
    cone = dot(axis, axis) > 0.5
    loaded = dot(base, base) > 0.0
    size = float(1.0)
    for i in range(count):
        size = wp.max(size, 1.0 + wp.length(arms[i]))
    eps = ROUNDING * size

    residual = float(0.0)
    residual_worst = int(-1)
    # No producible wrench is longer than this.
    strength = wp.min(most, wp.sqrt(dot(base, base)) + wp.sqrt(1.0 + mu * mu) * size + gamma)
    strength_worst = int(-1)
    top = float(strength)
    enough = wp.max(floor, K_FLOOR)
    least = float(strength)
    least_worst = int(-1)
    least_wrench = units[0]
    mode = int(RESIDUAL)
    target = int(0)
    asked = units[0]
    worst = asked
    z = base + asked * sizes[0]
    if cone or bound < 0.0:
        mode = BASE
        z = base
        if not loaded:
            mode = STRENGTH
            z = asked * strength

    # The set, and the weights of its nearest point. Its edges from point 0 are the orthonormal ``edges``
    # times the upper triangle ``right``, whose diagonal is kept inverted.
    points = mat76()
    weights = vec7()
    edges = mat66()
    right = mat66()
    t = vec7()
    c = vec7()
    used = int(1)
    fresh = int(1)
    same = bool(False)  # whether z is where it was the turn before
    stalled = bool(False)
    turn = int(0)
    if count > 0:
        height, first = highest(arms, normals, count, mu, gamma, z)
        points[0] = first
        weights[0] = 1.0
    else:
        mode = DONE
        residual = float(FAR)
        strength = float(0.0)
    if mode == STRENGTH and strength <= enough:
        mode = DONE

    while mode != DONE:
        # Complete the orthonormal edges; orthogonalised twice.
        for i in range(fresh, used):
            e = points[i] - points[0]
            long = wp.sqrt(dot(e, e))
            rest = float(long)
            again = bool(i > 1)
            for j in range(i - 1):
                right[j, i - 1] = 0.0
            while again:
                before = rest
                whole = e
                for j in range(i - 1):
                    s = dot(edges[j], whole)
                    right[j, i - 1] = right[j, i - 1] + s
                    e = e - edges[j] * s
                rest = wp.sqrt(dot(e, e))
                # Where little was left, rounding is a large part of it.
                again = rest < 0.5 * before and rest > 1.0e-6 * long
            if rest > 1.0e-6 * long:
                edges[i - 1] = e / rest
                right[i - 1, i - 1] = 1.0 / rest
            else:
                # In the span of the others: it gets no weight and is dropped.
                edges[i - 1] = vec6()
                right[i - 1, i - 1] = 1.0
                stalled = same
        fresh = used

        # The point of the affine hull nearest to z, and its weights.
        away = z - points[0]
        whole = away
        for j in range(used - 1):
            s = dot(edges[j], whole)
            t[j] = s
            away = away - edges[j] * s
        # Again: as a direction, what is left must be square to the edges, however short.
        whole = away
        for j in range(used - 1):
            away = away - edges[j] * dot(edges[j], whole)
        c[0] = 1.0
        for back in range(used - 1):
            j = used - 2 - back
            s = t[j]
            for i in range(j + 1, used - 1):
                s = s - right[j, i] * c[i + 1]
            s = s * right[j, j]
            c[j + 1] = s
            c[0] = c[0] - s

        # Where it is outside the hull: go towards it to the hull's edge, and drop the point left behind.
        theta = float(1.0)
        drop = int(-1)
        for i in range(used):
            if c[i] <= 0.0:
                part = weights[i] / wp.max(weights[i] - c[i], 1.0e-30)
                if drop < 0 or part < theta:
                    theta = part
                    drop = i
        if drop >= 0:
            if same and drop == used - 1 and weights[drop] == 0.0:
                stalled = True
            for i in range(used):
                weights[i] = wp.max(weights[i] + theta * (c[i] - weights[i]), 0.0)
            for i in range(drop, used - 1):
                points[i] = points[i + 1]
                weights[i] = weights[i + 1]
            used = used - 1
            fresh = wp.max(drop, 1)
        else:
            for i in range(used):
                weights[i] = c[i]
            turn = turn + 1
            d = wp.sqrt(dot(away, away))
            finished = bool(stalled or turn >= TURNS)
            if d <= eps or used == 7:
                d = float(0.0)
                finished = True
            same = True
            y = away / wp.max(d, eps)
            height = float(0.0)
            gain = float(0.0)
            q = vec6()
            if d > 0.0:
                height, q = highest(arms, normals, count, mu, gamma, y)
                if mode != RESIDUAL and height < 0.0:
                    height = 0.0
                    q = vec6()
                gain = height - dot(y, z) + d  # how far it lies beyond the nearest point so far
                if mode == RESIDUAL:
                    if d - gain > bound:
                        residual = d - gain
                        residual_worst = target
                        strength = 0.0
                        mode = DONE
                    if gain <= GAP * d + GAP_FLOOR or d <= residual:
                        finished = True
                if mode == BASE and dot(y, base) - height > 10.0 * eps:
                    strength = 0.0
                    mode = DONE
                if mode == STRENGTH:
                    before = strength
                    slope = dot(y, asked)
                    if cone:
                        far, w = hardest(axis, cos_half, sin_half, y)
                        if far > 1.0e-9:
                            k = wp.max(height - dot(y, base), 0.0) / far
                            if k < strength:
                                strength = k
                                worst = w
                                asked = w
                                strength_worst = target
                    else:
                        k, who = bounded(base, units, y, height)
                        if k < strength:
                            strength = k
                            strength_worst = who
                    if d <= wp.max(GAP * before, K_FLOOR) * slope or strength <= enough:
                        finished = True
                    same = strength == before
                    z = base + asked * strength
                if not finished and gain > eps:
                    points[used] = q
                    weights[used] = 0.0
                    used = used + 1
                elif same:
                    finished = True
            stalled = False

            if finished and mode != DONE:
                if mode == RESIDUAL and d > residual:
                    residual = d
                    residual_worst = target
                if mode == BASE:
                    if d > 100.0 * eps:
                        strength = 0.0
                    mode = STRENGTH
                    target = -1
                target = target + 1
                turn = 0
                same = False
                if mode == RESIDUAL and target == m:
                    target = 0
                    mode = STRENGTH
                    if loaded:
                        mode = BASE
                if mode == STRENGTH and (target == m or strength <= enough):
                    mode = DONE
                if mode == STRENGTH and target >= anew:
                    if strength < least:
                        least = strength
                        least_worst = strength_worst
                        least_wrench = worst
                    strength = top
                if mode == RESIDUAL:
                    z = base + units[target] * sizes[target]
                elif mode == BASE:
                    z = base
                elif mode == STRENGTH:
                    asked = units[target]
                    z = base + asked * strength
    if least < strength:
        strength = least
        strength_worst = least_worst
        worst = least_wrench
    if strength <= K_FLOOR:
        strength = 0.0
    return residual, strength, residual_worst, strength_worst, worst


@wp.kernel
def margins(
    units: wp.array(dtype=vec6),
    sizes: wp.array(dtype=float),
    base: vec6,
    axis: vec6,
    cos_half: float,
    sin_half: float,
    anew: int,
    friction: float,
    torsion: float,
    points: wp.array2d(dtype=wp.vec3),
    normals_in: wp.array2d(dtype=wp.vec3),
    counts: wp.array(dtype=wp.int32),
    lengths: wp.array(dtype=float),
    most: wp.array(dtype=float),
    reference: wp.vec3,
    bound: float,
    floor: float,
    first: int,
    residual: wp.array(dtype=float),
    strength: wp.array(dtype=float),
    worst: wp.array2d(dtype=wp.int32),
    wrench: wp.array(dtype=vec6),
):
    """One candidate a thread; see :func:`margin`."""
    tid = first + wp.tid()
    arms = mat83()
    normals = mat83()
    count = wp.clamp(counts[tid], 0, CONTACTS)
    broken = bool(False)
    length = lengths[tid]
    for i in range(count):
        arms[i] = (points[tid, i] - reference) / length
        normals[i] = normals_in[tid, i]
        if not (wp.isfinite(arms[i]) and wp.isfinite(normals[i])):
            broken = True
    if broken:
        count = 0
    r, s, i, j, w = margin(
        arms,
        normals,
        count,
        friction,
        torsion / length,
        base,
        units,
        sizes,
        axis,
        cos_half,
        sin_half,
        anew,
        bound,
        most[tid],
        floor,
    )
    residual[tid] = r
    strength[tid] = s
    worst[tid, 0] = i
    worst[tid, 1] = j
    wrench[tid] = w
