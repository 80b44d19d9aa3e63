"""A hand and an object's distance field, in the form that the kernels read.

Import this module only inside a function: it loads Warp.
"""

# Types are Warp's, not Python's.
# mypy: disable-error-code="attr-defined,call-overload,index,no-untyped-def,operator,untyped-decorator"
# mypy: disable-error-code="valid-type"

import warp as wp

from ..field.warp import field_distance

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

FAR = wp.constant(1.0e6)
"""Stands for the distance to nothing [m]."""


@wp.struct
class HandArrays:
    """The arrays of :class:`preshape.kernels.tables.HandTables`."""

    joint_start: wp.array(dtype=wp.int32)
    offset: wp.array(dtype=wp.vec3)
    turn: wp.array(dtype=wp.quat)
    axis: wp.array(dtype=wp.vec3)
    moving: wp.array(dtype=wp.int32)
    sphere: wp.array(dtype=wp.vec4)
    speed: wp.array(dtype=wp.float32)
    group_start: wp.array(dtype=wp.int32)
    group_sphere: wp.array(dtype=wp.int32)
    bound: wp.array(dtype=wp.vec4)
    bound_speed: wp.array(dtype=wp.float32)
    palm: wp.array(dtype=wp.vec4)
    palm_group: wp.array(dtype=wp.int32)
    palm_bound: wp.array(dtype=wp.vec4)
    path: wp.array2d(dtype=wp.float32)
    motor: wp.array(dtype=wp.int32)
    range: wp.array(dtype=wp.vec2)
    law: wp.array2d(dtype=wp.float32)
    bent: wp.array(dtype=wp.int32)
    unloaded: wp.array2d(dtype=wp.float32)
    fingers: wp.int32
    thumb: wp.int32
    knots: wp.int32


@wp.struct
class FieldArrays:
    """The arrays of :class:`preshape.kernels.field.host.DistanceField`."""

    distance: wp.array3d(dtype=wp.float32)
    origin: wp.vec3
    inverse_spacing: wp.float32


@wp.func
def distance_at(field: FieldArrays, x: wp.vec3):
    """Signed distance from a point to the object [m]."""
    return field_distance(field.distance, field.origin, field.inverse_spacing, x)
