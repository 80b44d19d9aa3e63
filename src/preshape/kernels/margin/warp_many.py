"""Wrench margins of many contacts, or of contacts with a largest normal force each.

One thread computes one candidate. The search is that of :mod:`.warp`, compiled a second time, so that the
form for few contacts stays as fast as it is, and this one takes any number.

Import this module only inside a function: it loads Warp. It runs unchanged on the CPU and on CUDA.
"""
# Types are Warp's, not Python's.
# mypy: disable-error-code="attr-defined,call-overload,index,no-untyped-def,operator,untyped-decorator"
# mypy: disable-error-code="valid-type"

from __future__ import annotations

import warp as wp

from .warp import K_FLOOR, margin
from .warp_support import ManyContacts, vec6

wp.set_module_options({"enable_backward": False, "max_unroll": 1, "optimization_level": 3})

# This constant is that of plain.py, which explains it.
BOUNDED_FLOOR = wp.constant(wp.float32(4.0e-6))


@wp.kernel
def many_margins(
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
    arms: wp.array2d(dtype=wp.vec3),
    normals_in: wp.array2d(dtype=wp.vec3),
    counts: wp.array(dtype=wp.int32),
    lengths: wp.array(dtype=float),
    most: wp.array(dtype=float),
    shares: wp.array2d(dtype=float),
    totals: wp.array(dtype=float),
    bounded: wp.bool,
    bound: float,
    floor: float,
    first: int,
    # Out:
    residual: wp.array(dtype=float),
    strength: wp.array(dtype=float),
    worst: wp.array2d(dtype=wp.int32),
    wrench: wp.array(dtype=vec6),
):
    """With bounds the search runs in units of their sum, the total; the results are in newtons again."""
    tid = first + wp.tid()
    contacts = ManyContacts()
    contacts.arms = arms[tid]
    contacts.normals = normals_in[tid]
    contacts.bounded = bounded
    contacts.bounds = shares[tid]
    contacts.mu = friction
    contacts.gamma = torsion / lengths[tid]
    contacts.count = wp.clamp(counts[tid], 0, arms.shape[1])
    total = totals[tid]
    k_floor = float(K_FLOOR)
    if bounded:
        k_floor = BOUNDED_FLOOR
    r, s, i, j, w = margin(
        contacts,
        base / total,
        units,
        sizes,
        1.0 / total,
        axis,
        cos_half,
        sin_half,
        restart,
        bound / total,
        most[tid] / total,
        floor / total,
        k_floor,
    )
    residual[tid] = r * total
    strength[tid] = wp.min(s * total, most[tid])
    worst[tid, 0] = i
    worst[tid, 1] = j
    wrench[tid] = w
