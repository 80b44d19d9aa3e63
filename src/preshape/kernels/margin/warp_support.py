"""Support functions of wrench sets on the device: how far a set reaches along a direction, and where.

Import this module only inside a function: it loads Warp. :mod:`.plain` is the specification.
"""
# Types are Warp's, not Python's; and a literal that a loop changes must be written as float(...) or int(...).
# mypy: disable-error-code="attr-defined,call-overload,index,no-untyped-def,operator,untyped-decorator"
# mypy: disable-error-code="valid-type"
# ruff: noqa: RUF046, UP018

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

vec6 = wp.types.vector(length=6, dtype=wp.float32)
mat83 = wp.types.matrix(shape=(8, 3), dtype=wp.float32)

FAR = wp.constant(wp.float32(wp.inf))


@wp.func
def dot(a: vec6, b: vec6):
    """The inner product of two wrenches, summed by halves."""
    return (a[0] * b[0] + a[1] * b[1] + a[2] * b[2]) + (a[3] * b[3] + a[4] * b[4] + a[5] * b[5])


@wp.struct
class FewContacts:
    """Up to eight contacts whose normal forces sum to one."""

    arms: mat83
    normals: mat83
    count: wp.int32
    mu: wp.float32
    gamma: wp.float32


@wp.struct
class ManyContacts:
    """Any number of contacts.

    Their normal forces sum to one, or each has a largest one, and these bounds sum to one.
    """

    arms: wp.array(dtype=wp.vec3)
    normals: wp.array(dtype=wp.vec3)
    bounded: wp.bool
    bounds: wp.array(dtype=wp.float32)
    count: wp.int32
    mu: wp.float32
    gamma: wp.float32


@wp.func
def farthest(n: wp.vec3, arm: wp.vec3, mu: float, gamma: float, t: wp.vec3, m: float, s: float):
    """The force and torque of a contact at unit normal force that reach farthest.

    Args:
        n: Inward unit normal.
        arm: Contact point relative to the reference point, divided by ℓ.
        mu: Friction coefficient.
        gamma: Torsional friction divided by ℓ.
        t: The part across the normal of the direction at the contact.
        m: The direction's share of the moment, times gamma.
        s: How far friction reaches along the direction.
    """
    f = n
    twist = float(0.0)
    if s > 1.0e-12:
        f = n + t * (mu * mu / s)
        twist = gamma * m / s
    return f, wp.cross(arm, f) + n * twist


@wp.func
def support(contacts: FewContacts, y: vec6):
    """How far the wrenches of unit normal force reach along y, and the wrench that does."""
    yf = wp.vec3(y[0], y[1], y[2])
    yt = wp.vec3(y[3], y[4], y[5])
    best = float(-1.0e30)
    best_i = int(0)
    best_s = float(0.0)
    best_g = wp.vec3(0.0, 0.0, 0.0)
    best_m = float(0.0)
    for i in range(contacts.count):
        n = contacts.normals[i]
        g = yf + wp.cross(yt, contacts.arms[i])
        along = wp.dot(n, g)
        t = g - n * along
        m = contacts.gamma * wp.dot(n, yt)
        s = wp.sqrt(contacts.mu * contacts.mu * wp.dot(t, t) + m * m)
        if along + s > best:
            best = along + s
            best_i = i
            best_s = s
            best_g = t
            best_m = m
    force, torque = farthest(
        contacts.normals[best_i],
        contacts.arms[best_i],
        contacts.mu,
        contacts.gamma,
        best_g,
        best_m,
        best_s,
    )
    return best, vec6(force[0], force[1], force[2], torque[0], torque[1], torque[2])


@wp.func
def support(contacts: ManyContacts, y: vec6):  # noqa: F811
    """How far the producible wrenches reach along y, and the wrench that does.

    With bounds, the wrenches are the sum of the contacts' truncated cones, so their support is the sum of
    those of the contacts. A contact whose cone does not reach along y gives no force.
    """
    yf = wp.vec3(y[0], y[1], y[2])
    yt = wp.vec3(y[3], y[4], y[5])
    height = float(0.0)
    force = wp.vec3(0.0, 0.0, 0.0)
    torque = wp.vec3(0.0, 0.0, 0.0)
    if not contacts.bounded:
        height = -1.0e30
    for i in range(contacts.count):
        n = contacts.normals[i]
        arm = contacts.arms[i]
        g = yf + wp.cross(yt, arm)
        along = wp.dot(n, g)
        t = g - n * along
        m = contacts.gamma * wp.dot(n, yt)
        s = wp.sqrt(contacts.mu * contacts.mu * wp.dot(t, t) + m * m)
        if contacts.bounded:
            if along + s > 0.0:
                most = contacts.bounds[i]
                f, r = farthest(n, arm, contacts.mu, contacts.gamma, t, m, s)
                height = height + most * (along + s)
                force = force + f * most
                torque = torque + r * most
        elif along + s > height:
            height = along + s
            force, torque = farthest(n, arm, contacts.mu, contacts.gamma, t, m, s)
    return height, vec6(force[0], force[1], force[2], torque[0], torque[1], torque[2])


@wp.func
def cone_support(axis: vec6, cos_half: float, sin_half: float, y: vec6):
    """How far the unit wrenches within the half-angle of the axis reach along y, and the one that does."""
    along = dot(y, axis)
    across = y - axis * along
    width = wp.length(across)
    size = wp.sqrt(along * along + width * width)
    w = axis
    far = along
    if width > 1.0e-7:
        if along >= cos_half * size:
            w = y / size
            far = size
        else:
            w = axis * cos_half + across * (sin_half / width)
            far = along * cos_half + width * sin_half
    return far, w


@wp.func
def plane_bound(base: vec6, units: wp.array(dtype=vec6), y: vec6, height: float):
    """Least k at which base + k w meets the plane across y at ``height``, and the index of that wrench w."""
    far = float(0.0)
    index = int(-1)
    for i in range(units.shape[0]):
        s = dot(y, units[i])
        if s > far:
            far = s
            index = i
    k = float(FAR)
    if far > 1.0e-9:
        k = wp.max(height - dot(y, base), 0.0) / far
    return k, index
