"""The fitting kernel: one thread looks whether one pinch is in place, before a hand is closed there.

Import this module only inside a function: it loads Warp. It runs unchanged on the processor and on CUDA;
:func:`preshape.kernels.fitting.fits_plain` is the plain version.
"""

# Types are Warp's, not Python's; and a literal that a loop changes must be written as float(...) or int(...).
# mypy: disable-error-code="attr-defined,call-overload,index,no-untyped-def,operator,untyped-decorator"
# mypy: disable-error-code="valid-type"
# ruff: noqa: UP018

import warp as wp

from .warp_hand import FieldArrays, distance_at

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


@wp.kernel
def fit_pinch(
    field: FieldArrays,
    palm: wp.array(dtype=wp.vec4),
    mask: wp.array(dtype=wp.int32),
    pads: wp.array2d(dtype=wp.vec3),
    links: wp.array2d(dtype=wp.vec3),
    near: wp.float32,
    room: wp.float32,
    pick: wp.array(dtype=wp.int32),
    place: wp.array(dtype=wp.vec3),
    turn: wp.array(dtype=wp.mat33),
    first: wp.int32,
    # out
    good: wp.array(dtype=wp.int32),
):
    """Whether one pinch fits; see :meth:`.fitting.FittingKernel.fits`."""
    i = first + wp.tid()
    p = place[i]
    m = turn[i]
    row = pick[i]
    fit = bool(True)
    # The opened links first: most of those that do not fit fail on them.
    for k in range(links.shape[1]):
        if fit and distance_at(field, p + m * links[row, k]) <= room:
            fit = False
    for finger in range(pads.shape[1]):
        pinches = (mask[row] >> finger) & 1 == 1
        if fit and pinches and wp.abs(distance_at(field, p + m * pads[row, finger])) >= near:
            fit = False
    for k in range(palm.shape[0]):
        s = palm[k]
        if fit and distance_at(field, p + m * wp.vec3(s[0], s[1], s[2])) <= s[3]:
            fit = False
    good[i] = wp.where(fit, 1, 0)
