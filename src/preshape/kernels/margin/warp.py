"""Wrench margins of one candidate, as a Warp function and a kernel; one thread computes one candidate.

:mod:`.host` defines the results. The specification :mod:`.plain` gives the method; the kernel switches
between its steps 1 to 4. Two things differ:

- A Gram matrix in single precision would lose small distances. The edges of the set of support points are
  therefore stored as an orthonormal basis, which is updated as points join and leave.
- One loop handles all targets of a candidate, one step of the search per iteration, so that the threads of a
  GPU do not diverge.

Import this module only inside a function: it loads Warp. It runs unchanged on the CPU and on CUDA.
"""
# Types are Warp's, not Python's; and a literal that a loop changes must be written as float(...) or int(...).
# mypy: disable-error-code="attr-defined,call-overload,index,no-untyped-def,operator,untyped-decorator"
# mypy: disable-error-code="valid-type"
# ruff: noqa: RUF046, UP018

from __future__ import annotations

from typing import Any

import warp as wp

from .warp_support import FAR, FewContacts, cone_support, dot, plane_bound, support, vec6

wp.set_module_options({"enable_backward": False, "max_unroll": 1, "optimization_level": 3})

vec7 = wp.types.vector(length=7, dtype=wp.float32)
mat66 = wp.types.matrix(shape=(6, 6), dtype=wp.float32)
mat76 = wp.types.matrix(shape=(7, 6), dtype=wp.float32)

# Modes, which say what the current target is for. A candidate goes through them in this order.
RESIDUAL = wp.constant(0)
BASE = wp.constant(1)
STRENGTH = wp.constant(2)
DONE = wp.constant(3)

CONTACTS = wp.constant(8)

# These constants are those of plain.py, which explains them.
GAP = wp.constant(wp.float32(3.0e-3))
GAP_FLOOR = wp.constant(wp.float32(3.0e-6))
K_FLOOR = wp.constant(wp.float32(2.0e-5))
ROUNDING = wp.constant(wp.float32(2.0e-7))
TURNS = wp.constant(60)


@wp.func
def margin(
    contacts: Any,
    base: vec6,
    units: wp.array(dtype=vec6),
    sizes: wp.array(dtype=float),
    scale: float,
    axis: vec6,
    cos_half: float,
    sin_half: float,
    restart: int,
    bound: float,
    most: float,
    floor: float,
    k_floor: float,
):
    """Residual and strength of one candidate.

    Each turn of the loop

    1. completes the orthonormal basis of the set's edges with the points that joined;
    2. finds the nearest point of the affine hull to the target, and its weights;
    3. if that point is outside the hull, moves to the boundary and drops a point; the turn ends;
    4. otherwise takes the support along the direction to the target and, by mode, shrinks the residual's or
       the strength's uncertainty; the support point joins the set;
    5. if the target is finished, records its result and goes to the next target or mode.

    Args:
        contacts: ``FewContacts`` or ``ManyContacts``: contact points relative to the reference point,
            divided by ℓ; inward unit normals; number of contacts; friction coefficient μ; γ/ℓ.
        base: Wrench that is demanded all the time.
        units: (m,) unit directions of the demanded wrenches.
        sizes: (m,) lengths of the demanded wrenches.
        scale: Factor on these lengths.
        axis: Unit axis of a cone of wrenches, or zeros for no cone. With a cone, every unit wrench of it is
            demanded, the search starts from ``units``, and there is no residual.
        cos_half: Cosine of the cone's half-angle.
        sin_half: Sine of the cone's half-angle.
        restart: From this index on, an independent search starts from each of ``units``.
        bound: The search ends as soon as the residual is known to exceed this; if it is negative, only the
            strength is computed.
        most: Strengths above this value are returned as this value.
        floor: The search ends as soon as the strength is known not to exceed this.
        k_floor: Absolute error at which the search of a strength ends; one up to this counts as zero.

    Returns:
        Residual, strength, the indices of the wrenches that decided them, and the wrench of the cone that
        decided the strength.
    """
    m = units.shape[0]
    cone = dot(axis, axis) > 0.5
    loaded = dot(base, base) > 0.0
    size = float(1.0)
    for i in range(contacts.count):
        size = wp.max(size, 1.0 + wp.length(contacts.arms[i]))
    eps = ROUNDING * size

    residual = float(0.0)
    residual_worst = int(-1)
    # No producible wrench is longer than this.
    strength = wp.min(
        most, wp.sqrt(dot(base, base)) + wp.sqrt(1.0 + contacts.mu * contacts.mu) * size + contacts.gamma
    )
    strength_worst = int(-1)
    top = float(strength)
    enough = wp.max(floor, k_floor)
    least = float(strength)
    least_worst = int(-1)
    least_wrench = units[0]
    mode = int(RESIDUAL)
    target = int(0)
    asked = units[0]
    worst = asked
    z = base + asked * (sizes[0] * scale)
    if cone or bound < 0.0:
        mode = BASE
        z = base
        if not loaded:
            mode = STRENGTH
            z = asked * strength

    # The set of support points and the weights of its nearest point. Its edges from point 0 are the
    # orthonormal ``edges`` times the upper triangle ``right``, whose diagonal is stored inverted.
    points = mat76()
    weights = vec7()
    edges = mat66()
    right = mat66()
    t = vec7()
    c = vec7()
    used = int(1)
    fresh = int(1)
    same = bool(False)  # whether the target is that of the last turn
    stalled = bool(False)
    turn = int(0)
    if contacts.count > 0:
        height, first = support(contacts, z)
        points[0] = first
        weights[0] = 1.0
    else:
        mode = DONE
        residual = float(FAR)
        strength = float(0.0)
    if mode == STRENGTH and strength <= enough:
        mode = DONE

    while mode != DONE:
        # 1. Basis; an edge is orthogonalised again where little of it was left, because rounding is then a
        # large part of it.
        for i in range(fresh, used):
            e = points[i] - points[0]
            long = wp.sqrt(dot(e, e))
            rest = float(long)
            repeat = bool(i > 1)
            for j in range(i - 1):
                right[j, i - 1] = 0.0
            while repeat:
                before = rest
                whole = e
                for j in range(i - 1):
                    s = dot(edges[j], whole)
                    right[j, i - 1] = right[j, i - 1] + s
                    e = e - edges[j] * s
                rest = wp.sqrt(dot(e, e))
                repeat = rest < 0.5 * before and rest > 1.0e-6 * long
            if rest > 1.0e-6 * long:
                edges[i - 1] = e / rest
                right[i - 1, i - 1] = 1.0 / rest
            else:
                # In the span of the others: it will get no weight and be dropped.
                edges[i - 1] = vec6()
                right[i - 1, i - 1] = 1.0
                stalled = same
        fresh = used

        # 2. Nearest point of the affine hull
        away = z - points[0]
        whole = away
        for j in range(used - 1):
            s = dot(edges[j], whole)
            t[j] = s
            away = away - edges[j] * s
        # Repeated, because the remainder serves as a direction and must be perpendicular to the edges,
        # however short.
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

        # 3. Outside the hull: move to the boundary and drop the point that has zero weight there.
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
            # 4. Support
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
                height, q = support(contacts, y)
                if mode != RESIDUAL and height < 0.0:
                    height = 0.0
                    q = vec6()
                gain = height - dot(y, z) + d  # how far q lies beyond the nearest point
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
                        far, w = cone_support(axis, cos_half, sin_half, y)
                        if far > 1.0e-9:
                            k = wp.max(height - dot(y, base), 0.0) / far
                            if k < strength:
                                strength = k
                                worst = w
                                asked = w
                                strength_worst = target
                    else:
                        k, index = plane_bound(base, units, y, height)
                        if k < strength:
                            strength = k
                            strength_worst = index
                    if d <= wp.max(GAP * before, k_floor) * slope or strength <= enough:
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

            # 5. Next target
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
                # A restart keeps the least strength so far and begins at the top.
                if mode == STRENGTH and target >= restart:
                    if strength < least:
                        least = strength
                        least_worst = strength_worst
                        least_wrench = worst
                    strength = top
                if mode == RESIDUAL:
                    z = base + units[target] * (sizes[target] * scale)
                elif mode == BASE:
                    z = base
                elif mode == STRENGTH:
                    asked = units[target]
                    z = base + asked * strength
    if least < strength:
        strength = least
        strength_worst = least_worst
        worst = least_wrench
    if strength <= k_floor:
        strength = 0.0
    return residual, strength, residual_worst, strength_worst, worst


@wp.kernel
def margins(
    # Model:
    units: wp.array(dtype=vec6),
    sizes: wp.array(dtype=float),
    base: vec6,
    axis: vec6,
    cos_half: float,
    sin_half: float,
    restart: int,
    friction: float,
    torsion: float,
    # In:
    points: wp.array2d(dtype=wp.vec3),
    normals_in: wp.array2d(dtype=wp.vec3),
    counts: wp.array(dtype=wp.int32),
    lengths: wp.array(dtype=float),
    most: wp.array(dtype=float),
    bound: float,
    floor: float,
    first: int,
    # Out:
    residual: wp.array(dtype=float),
    strength: wp.array(dtype=float),
    worst: wp.array2d(dtype=wp.int32),
    wrench: wp.array(dtype=vec6),
):
    """One thread computes one candidate; see :func:`margin`."""
    tid = first + wp.tid()
    contacts = FewContacts()
    contacts.count = wp.clamp(counts[tid], 0, CONTACTS)
    finite = bool(True)
    length = lengths[tid]
    contacts.mu = friction
    contacts.gamma = torsion / length
    for i in range(contacts.count):
        contacts.arms[i] = points[tid, i] / length
        contacts.normals[i] = normals_in[tid, i]
        if not (wp.isfinite(contacts.arms[i]) and wp.isfinite(contacts.normals[i])):
            finite = False
    if not finite:
        contacts.count = 0
    r, s, i, j, w = margin(
        contacts,
        base,
        units,
        sizes,
        1.0,
        axis,
        cos_half,
        sin_half,
        restart,
        bound,
        most[tid],
        floor,
        K_FLOOR,
    )
    residual[tid] = r
    strength[tid] = s
    worst[tid, 0] = i
    worst[tid, 1] = j
    wrench[tid] = w
