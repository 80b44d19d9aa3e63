"""A recorded test as a film for the viewer: the solids of the scene, and stages with notes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .. import spatial
from ..objects.mesh import TriangleMesh
from ..physics.hold.recording import HoldRecording, Recording
from ..physics.pick.protocol import PickProtocol
from ..physics.pick.recording import PickRecording
from ..physics.protocol import HoldProtocol
from ..physics.scene import OBJECT, PALM, TABLE, Scene
from ..planning.recorded import RecordedRun
from ..viewer.colours import HAND, Colour, finger_colour
from ..viewer.colours import OBJECT as OBJECT_COLOUR
from ..viewer.film import Film, FilmStage
from ..viewer.raycast import Shape
from ..viewer.shapes import box, capsule, join, sphere

TINT = 0.25
"""Share 0..1 of the finger's own colour in the colour of its links; the last link has three times as much."""


def film_of_run(run: RecordedRun, mesh: TriangleMesh) -> Film:
    """The film of a test, with the object's surface in its body's frame, scaled [m]."""
    if isinstance(run.recording, PickRecording):
        assert isinstance(run.rules, PickProtocol)
        return pick_film_of(run.recording, run.scene, run.rules, mesh=mesh)
    assert isinstance(run.rules, HoldProtocol)
    return film_of(run.recording, run.scene, run.rules, mesh=mesh)


def film_of(
    recording: HoldRecording, scene: Scene, protocol: HoldProtocol, *, mesh: TriangleMesh | None = None
) -> Film:
    """The film of a holding test.

    Args:
        recording: The recording.
        scene: Scene of the test.
        protocol: Settings of the test.
        mesh: Surface of the object in its body's frame, scaled [m]; by default the convex pieces are drawn.
    """
    load = protocol.acceleration * protocol.mass
    return Film(
        title=f"{Path(recording.result.object_name).stem} in the hand {recording.hand}",
        subtitle=f"simulated physics · {1e3 * scene.mass:g} g · friction {scene.friction:g} · "
        f"pushes of {load:g} N for {protocol.checks * protocol.check_steps * protocol.timestep:g} s",
        verdict=recording.result.reason,
        passed=recording.result.held,
        stages=stages_of(recording),
        **_moving(recording, scene, mesh),
    )


def pick_film_of(
    recording: PickRecording, scene: Scene, protocol: PickProtocol, *, mesh: TriangleMesh | None = None
) -> Film:
    """The film of a pick test, with its table.

    Args:
        recording: The recording.
        scene: Scene of the test.
        protocol: Settings of the test.
        mesh: Surface of the object in its body's frame, scaled [m]; by default the convex pieces are drawn.
    """
    result = recording.result
    return Film(
        title=f"{Path(result.object_name).stem} in the hand {recording.hand}",
        subtitle=f"simulated physics · {1e3 * scene.mass:g} g · friction {scene.friction:g} · "
        f"lifted by {1e3 * protocol.height:g} mm and held for {protocol.hold:g} s"
        f"{', then the task' if protocol.do else ''}",
        verdict=result.job.reason if result.job else result.reason,
        passed=result.done,
        stages=stages_of(recording),
        table=float(scene.model.geom(TABLE).pos[2]),
        **_moving(recording, scene, mesh),
    )


def _moving(recording: Recording, scene: Scene, mesh: TriangleMesh | None) -> dict[str, Any]:
    """The fields of a film that show what moves, and the forces."""
    found = solids(scene, recording.parts, mesh)
    bodies = [body for body, _ in found]
    places = spatial.pose_from_seven(recording.bodies[:, bodies].reshape(-1, 7))
    centre = scene.model.body_ipos[scene.object_body]
    T = spatial.pose_from_seven(recording.object_pose)
    return {
        "times": recording.times,
        "solids": tuple(shape for _, shape in found),
        "is_object": tuple(body == scene.object_body for body in bodies),
        "poses": places.reshape(len(recording), len(bodies), 4, 4),
        "load": recording.load,
        "load_point": T[:, :3, :3] @ centre + T[:, :3, 3],
        "parts": recording.parts,
        "normal_force": recording.normal,
        "slip": recording.slip,
    }


def stages_of(recording: Recording) -> tuple[FilmStage, ...]:
    """The stages, each with a note on its outcome."""
    probes = recording.result.probes if isinstance(recording, HoldRecording) else ()
    outcome = {probe.name: probe for probe in probes}
    result = []
    for name in recording.stages:
        span = recording.span(name)
        probe = outcome.get(name)
        if probe is not None:
            word = "held" if probe.held else "lost"
            note = f"{word} · moved {_millimetres(probe.displacement)}, {math.degrees(probe.rotation):.1f}°"
        elif name == "pregrasp":
            note = f"gap {_millimetres(float(recording.gap[0]))}"
        else:
            touching = int((recording.normal[span.stop - 1] > 0).sum())
            note = f"{touching} touch · {recording.normal[span.stop - 1].sum():.1f} N in all"
        passed = None if probe is None else probe.held
        result.append(FilmStage(name=name, start=span.start, stop=span.stop, note=note, passed=passed))
    return tuple(result)


def solids(scene: Scene, parts: Sequence[str], mesh: TriangleMesh | None) -> list[tuple[int, Shape]]:
    """Number of each visible body, with its solid in the body's frame."""
    model, result = scene.model, []
    for body in range(model.nbody):
        part = int(scene.part_of_body[body])
        if part == OBJECT and mesh is not None:
            shape = Shape(vertices=mesh.vertices, triangles=mesh.triangles, colour=OBJECT_COLOUR, smooth=True)
            result.append((body, shape))
            continue
        if part < PALM and part != OBJECT:
            continue
        colour = OBJECT_COLOUR if part == OBJECT else _hand_colour(scene, body, parts)
        shapes = [_geom(model, int(geom), colour) for geom in np.flatnonzero(model.geom_bodyid == body)]
        if shapes:
            result.append((body, join(shapes)))
    return result


def _hand_colour(scene: Scene, body: int, parts: Sequence[str]) -> Colour:
    part = int(scene.part_of_body[body])
    if part == PALM:
        return HAND
    last = not (np.asarray(scene.model.body_parentid) == body).any()
    share = 3 * TINT if last else TINT
    own = finger_colour(parts[part], part - 1)
    red, green, blue = ((1 - share) * a + share * b for a, b in zip(HAND, own, strict=True))
    return red, green, blue


def _geom(model: Any, geom: int, colour: Colour) -> Shape:
    """One geom in its body's frame; a cylinder is drawn as a capsule, an ellipsoid as its box."""
    import mujoco

    kinds = mujoco.mjtGeom
    kind, size = int(model.geom_type[geom]), np.array(model.geom_size[geom])
    T = spatial.pose_from_seven(np.concatenate([model.geom_pos[geom], model.geom_quat[geom]]))
    turn, at = T[:3, :3], T[:3, 3]
    if kind == int(kinds.mjGEOM_MESH):
        which = int(model.geom_dataid[geom])
        start, count = int(model.mesh_vertadr[which]), int(model.mesh_vertnum[which])
        first, faces = int(model.mesh_faceadr[which]), int(model.mesh_facenum[which])
        vertices = np.asarray(model.mesh_vert[start : start + count], dtype=np.float64) @ turn.T + at
        triangles = np.asarray(model.mesh_face[first : first + faces], dtype=np.int64)
        return Shape(vertices=vertices, triangles=triangles, colour=colour, smooth=True)
    if kind == int(kinds.mjGEOM_SPHERE):
        return sphere(at, float(size[0]), colour)
    if kind in (int(kinds.mjGEOM_CAPSULE), int(kinds.mjGEOM_CYLINDER)):
        half = float(size[1]) - (float(size[0]) if kind == int(kinds.mjGEOM_CYLINDER) else 0.0)
        along = max(0.0, half) * turn[:, 2]
        return capsule(at - along, at + along, float(size[0]), colour)
    return box(at, size, turn, colour)


def _millimetres(metres: float) -> str:
    return f"{1e3 * metres:.1f} mm" if abs(metres) < 0.1 else f"{1e3 * metres:.0f} mm"
