"""Parts of a USD stage: rigid bodies, shapes, poses, names and values, as MuJoCo's model has them.

Imported by :mod:`.usd`, after it has made sure that ``usd-core`` is installed.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from ..exceptions import HandError
from ..spatial import pose, rotation_from_quaternion, seven_from_pose, transform_points
from ..types import Array

RESERVED = ("Joints", "Motors")
"""Names of the scopes beside the links of a hand."""


def make_rigid(prim: Any, model: Any, body: int) -> None:
    """Make a prim a rigid body with the mass, centre of mass and principal inertia of a MuJoCo body."""
    from pxr import UsdPhysics

    UsdPhysics.RigidBodyAPI.Apply(prim)
    if (mass := float(model.body_mass[body])) <= 0:
        return  # only a root, which is fixed to the world
    api = UsdPhysics.MassAPI.Apply(prim)
    api.CreateMassAttr(mass)
    api.CreateCenterOfMassAttr(float_vector(model.body_ipos[body]))
    api.CreateDiagonalInertiaAttr(float_vector(model.body_inertia[body]))
    api.CreatePrincipalAxesAttr(float_quaternion(model.body_iquat[body]))


def add_geoms(stage: Any, model: Any, body: int, path: str) -> None:
    """The shapes of a body; those that collide in MuJoCo do so in USD."""
    from pxr import UsdGeom, UsdPhysics

    first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    shapes = [(g, model.geom(g).name or f"shape_{k}") for k, g in enumerate(range(first, first + count))]
    for (g, _), name in zip(shapes, identifiers(f"geom_{name}" for _, name in shapes), strict=True):
        shape = _add_shape(stage, model, g, f"{path}/{name}")
        material = int(model.geom_matid[g])
        rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[g]
        shape.CreateDisplayColorAttr([float_vector(rgba[:3])])
        shape.CreateDisplayOpacityAttr([float(rgba[3])])
        if model.geom_group[g] > 2:  # as in MuJoCo's viewers, which do not draw these groups
            shape.CreatePurposeAttr(UsdGeom.Tokens.guide)
        if model.geom_contype[g] or model.geom_conaffinity[g]:
            UsdPhysics.CollisionAPI.Apply(shape.GetPrim())
            if shape.GetPrim().IsA(UsdGeom.Mesh):
                hull = UsdPhysics.MeshCollisionAPI.Apply(shape.GetPrim())
                hull.CreateApproximationAttr(UsdPhysics.Tokens.convexHull)


def _add_shape(stage: Any, model: Any, g: int, path: str) -> Any:
    """A MuJoCo geom as a ``UsdGeom`` shape in the frame of its body.

    Raises:
        HandError: There is no such shape in USD.
    """
    import mujoco
    from pxr import UsdGeom

    kinds = mujoco.mjtGeom
    kind, size = kinds(int(model.geom_type[g])), model.geom_size[g]
    T = pose(rotation_from_quaternion(model.geom_quat[g]), model.geom_pos[g])
    scale = None
    if kind == kinds.mjGEOM_MESH:
        shape = UsdGeom.Mesh.Define(stage, path)
        m = int(model.geom_dataid[g])
        start, corner = int(model.mesh_vertadr[m]), int(model.mesh_faceadr[m])
        vertices = model.mesh_vert[start : start + int(model.mesh_vertnum[m])]
        faces = model.mesh_face[corner : corner + int(model.mesh_facenum[m])]
        _fill_mesh(shape, transform_points(T, vertices), faces)
        return shape
    if kind == kinds.mjGEOM_ELLIPSOID:  # simulators take no scaled spheres
        import trimesh

        shape, ball = UsdGeom.Mesh.Define(stage, path), trimesh.creation.icosphere(subdivisions=3)
        _fill_mesh(shape, transform_points(T, size * ball.vertices), ball.faces)
        return shape
    if kind == kinds.mjGEOM_SPHERE:
        shape = UsdGeom.Sphere.Define(stage, path)
        shape.CreateRadiusAttr(float(size[0]))
    elif kind == kinds.mjGEOM_BOX:
        shape = UsdGeom.Cube.Define(stage, path)
        shape.CreateSizeAttr(2.0)
        scale = size
    elif kind in (kinds.mjGEOM_CAPSULE, kinds.mjGEOM_CYLINDER):
        shape = (UsdGeom.Capsule if kind == kinds.mjGEOM_CAPSULE else UsdGeom.Cylinder).Define(stage, path)
        shape.CreateRadiusAttr(float(size[0]))
        shape.CreateHeightAttr(2.0 * float(size[1]))
        shape.CreateAxisAttr(UsdGeom.Tokens.z)
    else:
        raise HandError(f"USD has no shape for the geom {model.geom(g).name or g} of kind {kind.name}")
    shape.CreateExtentAttr(UsdGeom.Boundable.ComputeExtentFromPlugins(shape, 0.0))
    place(shape.GetPrim(), T, scale)
    return shape


def _fill_mesh(shape: Any, points: Array, faces: Array) -> None:
    from pxr import UsdGeom, Vt

    corners = Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(points, dtype=np.float32))
    shape.CreatePointsAttr(corners)
    shape.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, dtype=np.int32)))
    shape.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(faces.ravel(), np.int32)))
    shape.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    shape.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(corners))


def identifiers(names: Iterable[str]) -> list[str]:
    """A prim's name for each of ``names``, without two alike; the display names have the real ones."""
    from pxr import Tf

    used, found = set(RESERVED), []
    for name in names:
        chosen = base = Tf.MakeValidIdentifier(name)
        number = 1
        while chosen in used:
            number += 1
            chosen = f"{base}_{number}"
        used.add(chosen)
        found.append(chosen)
    return found


def place(prim: Any, T: Array, scale: Array | None = None) -> None:
    """Place a prim at the pose T (4, 4) in its parent, after scaling it along its axes by (3,)."""
    from pxr import Gf, UsdGeom

    seven = seven_from_pose(T)
    placed = UsdGeom.Xformable(prim)
    placed.AddTranslateOp().Set(double_vector(seven[:3]))
    turn = Gf.Quatd(float(seven[3]), double_vector(seven[4:]))
    placed.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(turn)
    if scale is not None:
        placed.AddScaleOp().Set(float_vector(scale))


def set_attribute(prim: Any, name: str, kind: str, content: Any) -> None:
    """Set the attribute ``preshape:name`` of a prim."""
    prim.CreateAttribute(f"preshape:{name}", value_type(kind), True).Set(content)


def value_type(name: str) -> Any:
    """The type of an attribute by its name in ``pxr.Sdf.ValueTypeNames``."""
    from pxr import Sdf

    return getattr(Sdf.ValueTypeNames, name)


def turn_between(old: Array, new: Array) -> Array:
    """(3, 3) The shortest rotation that turns one direction (3,) into another."""
    from scipy.spatial.transform import Rotation

    a, b = np.asarray(old) / np.linalg.norm(old), np.asarray(new) / np.linalg.norm(new)
    if a @ b < -1 + 1e-9:  # a half turn about any axis across it
        axis = np.cross(a, np.eye(3)[int(np.abs(a).argmin())])
        return Rotation.from_rotvec(np.pi * axis / np.linalg.norm(axis)).as_matrix()
    cross = np.cross(a, b)
    return Rotation.from_quat([*cross, 1.0 + a @ b]).as_matrix()


def double_vector(numbers: Array) -> Any:
    """Three numbers in double precision, as USD takes them."""
    from pxr import Gf

    return Gf.Vec3d(*(float(x) for x in numbers))


def float_vector(numbers: Array) -> Any:
    """Three numbers in single precision, as USD takes them."""
    from pxr import Gf

    return Gf.Vec3f(*(float(x) for x in numbers))


def float_quaternion(wxyz: Array) -> Any:
    """A quaternion wxyz (4,) in single precision, as USD takes it."""
    from pxr import Gf

    return Gf.Quatf(float(wxyz[0]), float_vector(wxyz[1:]))
