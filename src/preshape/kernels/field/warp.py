"""Signed distance on the device: grid lookup, exact closest point, and the kernels that fill the grid.

Import this module only inside a function: it loads Warp. It runs unchanged on the CPU and on CUDA;
:mod:`.plain` is the specification.

A field is a grid of signed distances [m], negative inside, in the mesh frame: node (i, j, k) is at
``origin + spacing * (i, j, k)``. Every function takes field, origin, inverse spacing and point, in this
order.
"""
# Types are Warp's, not Python's; and a literal that a loop changes must be written as float(...) or int(...).
# mypy: disable-error-code="attr-defined,call-overload,index,no-untyped-def,operator,untyped-decorator"
# ruff: noqa: RUF046, UP018

import warp as wp

wp.config.log_level = max(wp.config.log_level, wp.LOG_ERROR)  # standard output is for the command line
wp.set_module_options({"enable_backward": False, "max_unroll": 1})

THRESHOLD = wp.constant(0.5)
"""Winding number above which a point is inside (Barill et al. 2018)."""

ACCURACY = wp.constant(2.0)
"""A cluster of triangles farther away than this many of its radii counts as one dipole (β in that paper)."""

FACING = wp.constant(0.5)
"""A normal is reversed if its cosine with the direction of increasing distance is below minus this."""

FAR = wp.constant(3.5)
"""Farther from the surface than this many edges of a coarse cell, the field is a lower bound. It is about 5 %
too low, and midway between two surfaces lower still, by up to half the diagonal of a coarse cell."""

HALF_DIAGONAL = wp.constant(0.8661)
"""Half the diagonal of a cube of edge 1, rounded up."""


@wp.func
def field_distance(field: wp.array3d[float], origin: wp.vec3, inverse_spacing: float, p: wp.vec3) -> float:
    """Signed distance at a point [m]: trilinear inside the grid, a lower bound outside it.

    Outside, let q be the nearest point of the grid's box. The surface lies in the box and the box is convex,
    so the angle at q is never acute, and |p - s|² ≥ |p - q|² + |q - s|² for every surface point s. Hence the
    root of |p - q|² + d(q)² never exceeds the distance, and it is continuous at the box.
    """
    x = (p[0] - origin[0]) * inverse_spacing
    y = (p[1] - origin[1]) * inverse_spacing
    z = (p[2] - origin[2]) * inverse_spacing
    cx = wp.clamp(x, 0.0, float(field.shape[0] - 1))
    cy = wp.clamp(y, 0.0, float(field.shape[1] - 1))
    cz = wp.clamp(z, 0.0, float(field.shape[2] - 1))
    i = wp.min(int(cx), field.shape[0] - 2)
    j = wp.min(int(cy), field.shape[1] - 2)
    k = wp.min(int(cz), field.shape[2] - 2)
    u = cx - float(i)
    v = cy - float(j)
    w = cz - float(k)
    a = field[i, j, k]
    b = field[i, j, k + 1]
    c = field[i, j + 1, k]
    d = field[i, j + 1, k + 1]
    low = a + w * (b - a) + v * (c - a + w * (d - c - b + a))
    a = field[i + 1, j, k]
    b = field[i + 1, j, k + 1]
    c = field[i + 1, j + 1, k]
    d = field[i + 1, j + 1, k + 1]
    high = a + w * (b - a) + v * (c - a + w * (d - c - b + a))
    value = low + u * (high - low)
    away = (x - cx) * (x - cx) + (y - cy) * (y - cy) + (z - cz) * (z - cz)
    if away > 0.0:
        value = wp.max(value, 0.0)
        value = wp.sqrt(away / (inverse_spacing * inverse_spacing) + value * value)
    return value


@wp.func
def field_gradient(field: wp.array3d[float], origin: wp.vec3, inverse_spacing: float, p: wp.vec3) -> wp.vec3:
    """Unit gradient of :func:`field_distance`; zero where the interpolant is flat."""
    x = (p[0] - origin[0]) * inverse_spacing
    y = (p[1] - origin[1]) * inverse_spacing
    z = (p[2] - origin[2]) * inverse_spacing
    cx = wp.clamp(x, 0.0, float(field.shape[0] - 1))
    cy = wp.clamp(y, 0.0, float(field.shape[1] - 1))
    cz = wp.clamp(z, 0.0, float(field.shape[2] - 1))
    i = wp.min(int(cx), field.shape[0] - 2)
    j = wp.min(int(cy), field.shape[1] - 2)
    k = wp.min(int(cz), field.shape[2] - 2)
    u = cx - float(i)
    v = cy - float(j)
    w = cz - float(k)
    a = field[i, j, k]
    b = field[i, j, k + 1]
    c = field[i, j + 1, k]
    d = field[i, j + 1, k + 1]
    e = field[i + 1, j, k]
    f = field[i + 1, j, k + 1]
    g = field[i + 1, j + 1, k]
    h = field[i + 1, j + 1, k + 1]
    ab = a + w * (b - a)
    cd = c + w * (d - c)
    ef = e + w * (f - e)
    gh = g + w * (h - g)
    low = ab + v * (cd - ab)
    high = ef + v * (gh - ef)
    rise = wp.vec3(
        high - low,
        (1.0 - u) * (cd - ab) + u * (gh - ef),
        (1.0 - u) * ((1.0 - v) * (b - a) + v * (d - c)) + u * ((1.0 - v) * (f - e) + v * (h - g)),
    )
    ax = x - cx
    ay = y - cy
    az = z - cz
    if ax * ax + ay * ay + az * az > 0.0:
        # The derivative of the root: its part outside the box, and the grid's slope along the box's face.
        value = wp.max(low + u * (high - low), 0.0) * inverse_spacing * inverse_spacing
        if ax != 0.0:
            rise[0] = 0.0
        if ay != 0.0:
            rise[1] = 0.0
        if az != 0.0:
            rise[2] = 0.0
        rise = value * rise + wp.vec3(ax, ay, az)
    return wp.normalize(rise)


@wp.struct
class SurfacePoint:
    """The surface point nearest to a point.

    Attributes:
        distance: Signed distance [m], negative inside; infinite if the mesh has no triangle with an area.
        point: The surface point [m].
        normal_out: Unit normal of its triangle, towards increasing signed distance.
        triangle: Index of its triangle, -1 for none.
    """

    distance: float
    point: wp.vec3
    normal_out: wp.vec3
    triangle: int


@wp.func
def nearest_on_mesh(mesh: wp.uint64, p: wp.vec3, reach: float) -> SurfacePoint:
    """The surface point nearest to a point, exactly.

    Args:
        mesh: ``SurfaceQuery.mesh.id``.
        p: The point, in the mesh frame [m].
        reach: Largest distance that is searched [m].
    """
    found = SurfacePoint()
    found.distance = wp.inf
    found.triangle = -1
    hit = wp.mesh_query_point_sign_winding_number(mesh, p, reach, ACCURACY, THRESHOLD)
    if hit.result:
        q = wp.mesh_eval_position(mesh, hit.face, hit.u, hit.v)
        n = wp.mesh_eval_face_normal(mesh, hit.face)
        away = hit.sign * (p - q)
        length = wp.length(away)
        # Both sides of a single sheet are outside; behind it the normal is reversed, towards the point.
        if wp.dot(n, away) < -FACING * length:
            n = -n
        found.distance = hit.sign * length
        found.point = q
        found.normal_out = n
        found.triangle = hit.face
    return found


@wp.func
def node_of(index: int, shape: wp.vec3i) -> wp.vec3i:
    """Node (i, j, k) of a running number; k counts fastest."""
    return wp.vec3i(index // (shape[1] * shape[2]), (index // shape[2]) % shape[1], index % shape[2])


@wp.func
def position_of(origin: wp.vec3, spacing: float, node: wp.vec3i) -> wp.vec3:
    """Position of a node [m]."""
    return origin + spacing * wp.vec3(float(node[0]), float(node[1]), float(node[2]))


@wp.func
def signed_distance(mesh: wp.uint64, p: wp.vec3, reach: float) -> float:
    """Exact signed distance [m]; ``reach`` if the surface is farther away."""
    hit = wp.mesh_query_point_sign_winding_number(mesh, p, reach, ACCURACY, THRESHOLD)
    found = reach
    if hit.result:
        found = hit.sign * wp.length(p - wp.mesh_eval_position(mesh, hit.face, hit.u, hit.v))
    return found


@wp.kernel
def coarse_nodes(
    # Model:
    mesh: wp.uint64,
    # In:
    first: int,
    origin: wp.vec3,
    spacing: float,
    reach: float,
    # Out:
    distance: wp.array3d[float],
):
    """Exact signed distance at the nodes of the coarsest grid."""
    node = node_of(wp.tid() + first, wp.vec3i(distance.shape[0], distance.shape[1], distance.shape[2]))
    distance[node[0], node[1], node[2]] = signed_distance(mesh, position_of(origin, spacing, node), reach)


@wp.kernel
def fine_nodes(
    # Model:
    mesh: wp.uint64,
    coarse: wp.array3d[float],
    # In:
    first: int,
    origin: wp.vec3,
    spacing: float,
    band: float,
    # Out:
    distance: wp.array3d[float],
):
    """Distance at the nodes of a grid, from the grid of twice its spacing.

    1. Cell. The eight coarse nodes around the node give an upper bound on its distance, and often its sign.
    2. Far from the surface, the interpolated distance less an error bound is a lower bound of the distance.
       Interpolation weights are positive, so interpolating a minimum of distances to surface points never
       exceeds the minimum of the interpolants. The interpolant of one such distance, whose second derivatives
       are at most 1 / r, exceeds it by at most 3 edge² / (8 r). The coarse values may be such lower bounds
       themselves, but only beyond 6.7 of the present edges; and if one corner of a cell is within 3.5 edges,
       no corner is beyond 5.3.
    3. Near the surface with a known sign, the exact distance is searched within the upper bound. The sign is
       known if all eight nodes have it and a ball around one of them contains the node but no surface; such a
       ball has one sign, except across a hole of an open surface.
    4. Otherwise the winding number decides the sign.
    """
    node = node_of(wp.tid() + first, wp.vec3i(distance.shape[0], distance.shape[1], distance.shape[2]))
    # 1. Cell
    i = node[0] // 2
    j = node[1] // 2
    k = node[2] // 2
    edge = 2.0 * spacing
    bound = float(wp.inf)
    least = float(wp.inf)
    mean = float(0.0)
    clear = bool(False)
    inside = int(0)
    for corner in range(8):
        a = i + corner // 4
        b = j + (corner // 2) % 2
        c = k + corner % 2
        at = coarse[a, b, c]
        u = wp.abs(0.5 * float(node[0]) - float(a))
        v = wp.abs(0.5 * float(node[1]) - float(b))
        w = wp.abs(0.5 * float(node[2]) - float(c))
        gap = edge * wp.sqrt(u * u + v * v + w * w)
        bound = wp.min(bound, wp.abs(at) + gap)
        least = wp.min(least, wp.abs(at))
        mean += (1.0 - u) * (1.0 - v) * (1.0 - w) * wp.abs(at)
        if wp.abs(at) > 1.01 * gap:
            clear = True
        if at < 0.0:
            inside += 1
    sign = wp.where(inside == 0, 1.0, -1.0)
    bound = 1.001 * bound + 1.0e-6 * spacing
    if (inside == 0 or inside == 8) and least > wp.max(FAR * edge, band):
        # 2. Far; no point of the cell is farther from its nearest corner than half the diagonal.
        found = sign * (mean - 0.375 * edge * edge / (least - HALF_DIAGONAL * edge))
    elif (inside == 0 or inside == 8) and clear:
        # 3. Near, the sign known
        near = wp.mesh_query_point_no_sign(mesh, position_of(origin, spacing, node), bound)
        found = sign * bound
        if near.result:
            q = wp.mesh_eval_position(mesh, near.face, near.u, near.v)
            found = sign * wp.length(position_of(origin, spacing, node) - q)
    else:
        # 4. Near, the sign unknown
        found = signed_distance(mesh, position_of(origin, spacing, node), bound)
    distance[node[0], node[1], node[2]] = found


@wp.kernel
def closest_points(
    # Model:
    mesh: wp.uint64,
    # In:
    points: wp.array[wp.vec3],
    reach: float,
    first: int,
    # Out:
    distance: wp.array[float],
    point: wp.array[wp.vec3],
    normal_out: wp.array[wp.vec3],
    triangle: wp.array[int],
):
    """:func:`nearest_on_mesh` of many points."""
    t = wp.tid() + first
    found = nearest_on_mesh(mesh, points[t], reach)
    distance[t] = found.distance
    point[t] = found.point
    normal_out[t] = found.normal_out
    triangle[t] = found.triangle


@wp.kernel
def first_hits(
    # Model:
    mesh: wp.uint64,
    # In:
    origins: wp.array[wp.vec3],
    directions: wp.array[wp.vec3],
    reach: float,
    first: int,
    # Out:
    triangle: wp.array[int],
):
    """The triangle that each ray meets first, from either side; -1 for none."""
    t = wp.tid() + first
    hit = wp.mesh_query_ray(mesh, origins[t], directions[t], reach)
    triangle[t] = wp.where(hit.result, hit.face, -1)


@wp.kernel
def sample_field(
    # Model:
    field: wp.array3d[float],
    origin: wp.vec3,
    inverse_spacing: float,
    # In:
    points: wp.array[wp.vec3],
    # Out:
    distance: wp.array[float],
    gradient: wp.array[wp.vec3],
):
    """Distance and gradient at many points, for tests."""
    t = wp.tid()
    distance[t] = field_distance(field, origin, inverse_spacing, points[t])
    gradient[t] = field_gradient(field, origin, inverse_spacing, points[t])
