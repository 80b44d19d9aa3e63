"""The fitting kernel: one thread places one pinch at a patch and tests whether it fits there.

The steps, numbered as in the comments, are those of :mod:`.plain`, the specification.

Import this module only inside a function: it loads Warp. It runs unchanged on the CPU and on CUDA.
"""

# Types are Warp's, not Python's; and a literal that a loop changes must be written as float(...) or int(...).
# mypy: disable-error-code="attr-defined,call-overload,index,no-untyped-def,operator,untyped-decorator"
# mypy: disable-error-code="valid-type"

import warp as wp

from ..closing.warp_hand import FieldArrays, distance_at

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


@wp.struct
class PinchArrays:
    """The arrays of :class:`preshape.kernels.fitting.host.PinchRows`, and the spheres of the palm."""

    palm: wp.array(dtype=wp.vec4)
    mask: wp.array(dtype=wp.int32)
    pads: wp.array2d(dtype=wp.vec3)
    links: wp.array2d(dtype=wp.vec3)
    width: wp.array(dtype=wp.float32)
    thumb: wp.array(dtype=wp.vec3)
    others: wp.array(dtype=wp.vec3)
    thumb_rate: wp.array(dtype=wp.vec3)
    others_rate: wp.array(dtype=wp.vec3)
    opposition: wp.array(dtype=wp.vec3)
    tip: wp.float32


@wp.func
def frame(first: wp.vec3, second: wp.vec3):
    """The rotation whose first column is ``first`` and whose second is as near to ``second`` as possible."""
    across = second - wp.dot(first, second) * first
    across = across / wp.max(wp.length(across), 1.0e-9)
    return wp.matrix_from_cols(first, across, wp.cross(first, across))


@wp.func
def fits(field: FieldArrays, pinch: PinchArrays, row: int, near: float, room: float, p: wp.vec3, m: wp.mat33):
    """Step 5, Fit: 1 if the opened hand is clear, each pad near the surface and the palm outside; else 0."""
    # The opened links first, because most placements that do not fit fail on them.
    for k in range(pinch.links.shape[1]):
        if distance_at(field, p + m * pinch.links[row, k]) <= room:
            return 0
    for finger in range(pinch.pads.shape[1]):
        pad = p + m * pinch.pads[row, finger]
        if (pinch.mask[row] >> finger) & 1 == 1 and wp.abs(distance_at(field, pad)) >= near:
            return 0
    for k in range(pinch.palm.shape[0]):
        s = pinch.palm[k]
        if distance_at(field, p + m * wp.vec3(s[0], s[1], s[2])) <= s[3]:
            return 0
    return 1


@wp.kernel
def place_pinch(
    # Model:
    field: FieldArrays,
    pinch: PinchArrays,
    near: wp.float32,
    room: wp.float32,
    middle: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    width: wp.array(dtype=wp.float32),
    # In:
    pick: wp.array(dtype=wp.int32),
    patch: wp.array(dtype=wp.int32),
    approach: wp.array(dtype=wp.vec3),
    side: wp.array(dtype=wp.vec3),
    tilt: wp.array(dtype=wp.float32),
    off: wp.array(dtype=wp.vec4),
    first: wp.int32,
    # Out:
    place: wp.array(dtype=wp.vec3),
    turn: wp.array(dtype=wp.quat),
    fit: wp.array(dtype=wp.int32),
):
    """Place one pinch; see :meth:`.host.FittingKernel.place`."""
    i = first + wp.tid()
    row = pick[i]
    w = width[patch[i]]
    # 1. Side
    n = normal[patch[i]]
    if wp.dot(n, side[i]) < 0.0:
        n = -n
    # 2. Pads
    more = w - pinch.width[row]
    between = 0.5 * (
        pinch.thumb[row] + more * pinch.thumb_rate[row] + pinch.others[row] + more * pinch.others_rate[row]
    )
    o = pinch.opposition[row]
    aside = more * (pinch.thumb_rate[row] - pinch.others_rate[row] - o)
    facing = wp.normalize((w + 2.0 * pinch.tip) * o + aside)
    # 3. Orientation
    ahead = wp.vec3(0.0, -wp.sin(tilt[i]), wp.cos(tilt[i]))
    m = frame(n, approach[i]) * wp.transpose(frame(facing, ahead))
    e = off[i]
    by = e[0] * n + wp.vec3(e[1], e[2], e[3])
    angle = wp.length(by)
    if angle > 1.0e-9:
        m = wp.quat_to_matrix(wp.quat_from_axis_angle(by / angle, angle)) * m
    # 4. Place
    p = middle[patch[i]] - m * between
    place[i] = p
    turn[i] = wp.normalize(wp.quat_from_matrix(m))
    fit[i] = fits(field, pinch, row, near, room, p, m)
