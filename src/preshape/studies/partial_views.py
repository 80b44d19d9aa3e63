"""How good answers on point clouds are: depth views of known objects, planned on, tested on the true object.

A virtual depth camera looks at each object from a few sides. The planner sees its points only; the answer
is put to the six-direction holding test on the true object. Beside it stands the planner's answer on the
whole mesh. Neither views nor seeds of this study served to choose the constants of
:mod:`preshape.objects.scans`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from .._version import __version__
from ..exceptions import InputError, ObjectError
from ..files import write_json
from ..hands.hand import Hand
from ..hands.load import load_hand
from ..kernels.field.host import SurfaceQuery, prepare_field
from ..kernels.rays import RayCaster
from ..kernels.surface_points import surface_points
from ..memory import Memory
from ..objects.load import load_object
from ..objects.mesh import TriangleMesh
from ..objects.scans.cleaning import cleaned
from ..objects.scans.complete import complete, marked, solid
from ..objects.scans.scan import RawCloud
from ..objects.scans.sight import level_axes, sight_of
from ..objects.scans.surface import grid_round, zero_surface
from ..objects.scans.symmetry import outline_width
from ..physics.hand import PhysicsHand, physics_hand
from ..physics.hold.runner import run_holds
from ..physics.pieces import ConvexPieces
from ..physics.protocol import HoldProtocol
from ..planner import ON_CLOUDS, Answer, Plan, plan, scan_trust
from ..planning.planner_bench import Case, Planned, grasps_of
from ..types import Array, value

Progress = Callable[[int, int, str], None]
"""Called with how many objects are done, of how many, and what was done last."""

FOCAL = 600.0
"""Pixels to a tangent of one: a usual depth camera's [C]."""
DISTANCE = 0.6
LOWEST, HIGHEST = 0.2, 1.05
"""Elevations of the camera above the object [rad]."""
METHODS = ("symmetry", "straight", "hull")
"""How the far side is guessed: by symmetry (the product's), straight back, by the convex hull."""
SAMPLE = 0.002


@value
class CloudRun:
    """What is measured.

    Attributes:
        hands: names.
        cases: objects at their sizes.
        views: of each object and size.
        noise: standard deviation along each ray [m].
        seed: of views, noise and planner.
        task: what is planned for.
        methods: of :data:`METHODS`; the first is planned on, shapes are compared for all.
    """

    hands: tuple[str, ...]
    cases: tuple[Case, ...]
    views: int = 4
    noise: float = 0.001
    seed: int = 0
    task: str = "lift"
    methods: tuple[str, ...] = METHODS

    def __post_init__(self) -> None:
        unknown = [m for m in self.methods if m not in METHODS]
        if unknown or not self.methods:
            raise InputError(f"no method {', '.join(unknown) or 'given'}; known: {', '.join(METHODS)}")
        if self.views < 1 or not 0 <= self.noise < 0.1 or self.seed < 0:
            raise InputError("a study needs a view at least, noise of 0 to 0.1 m and a seed of 0 or more")

    @property
    def key(self) -> dict[str, Any]:
        """What must be alike for a run to go on from what is kept."""
        own = {name: getattr(self, name) for name in ("hands", "views", "noise", "seed", "task", "methods")}
        document = {**own, "cases": [[c.name, c.scale] for c in self.cases], "version": __version__}
        alike: dict[str, Any] = json.loads(json.dumps(document))
        return alike


def depth_view(mesh: TriangleMesh, camera: Array, *, noise: float, rng: np.random.Generator) -> Array:
    """Points of an object that a pinhole depth camera sees, one a pixel.

    Args:
        mesh: the object.
        camera: (3,) its position [m], mesh frame; it looks at the middle.
        noise: standard deviation along each ray [m].
        rng: of the noise.

    Returns:
        (n, 3) [m], mesh frame.
    """
    axes = level_axes(mesh.cog - camera)
    away = float(np.linalg.norm(mesh.cog - camera))
    radius = float(np.linalg.norm(mesh.extents)) / 2
    half = int(np.ceil(FOCAL * radius / max(away - radius, 0.05)))
    steps = np.arange(-half, half + 1) / FOCAL
    across, down = np.meshgrid(steps, steps)
    rays = np.stack([across, down, np.ones_like(across)], axis=-1).reshape(-1, 3) @ axes
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    hits = RayCaster(mesh).cast(np.broadcast_to(camera, rays.shape).copy(), rays)
    hit = hits.triangle >= 0
    depth = hits.distance[hit] + rng.normal(0.0, noise, int(hit.sum()))
    seen: Array = camera + depth[:, None] * rays[hit]
    return seen


def guessed(method: str, name: str, points: Array, camera: Array) -> TriangleMesh:
    """The surface of a view's points by one of the methods.

    Raises:
        ObjectError: the points make no body.
    """
    if method == "symmetry":
        made = complete(name, RawCloud(points=points), camera)
    else:
        kept = cleaned(name, points, camera)
        sight = sight_of(kept, camera)
        deep = (kept - camera) @ sight.forward
        width, _ = outline_width(sight, kept)
        back = float(np.quantile(deep, 0.02)) + width

        def straight(nodes: Array) -> Array:
            return np.maximum(solid(sight, (), nodes), (nodes - camera) @ sight.forward - back)

        grid = grid_round(np.concatenate([kept, kept + max(0.0, back - deep.max()) * sight.forward]))
        function = straight if method == "straight" else _hull(kept)
        vertices, triangles = zero_surface(function, grid)
        made = marked(name, len(points), kept, camera, vertices, triangles, grid, f"guessed: {method}")
    return TriangleMesh(name=name, vertices=made.vertices, triangles=made.triangles, scan=made.scan)


def _hull(points: Array) -> Callable[[Array], Array]:
    from scipy.spatial import ConvexHull

    planes = ConvexHull(points).equations

    def outside(nodes: Array) -> Array:
        found = np.full(len(nodes), -np.inf)
        for normal in planes:  # all at once would be gigabytes
            np.maximum(found, nodes @ normal[:3] + normal[3], out=found)
        return found

    return outside


def alike(true: TriangleMesh, made: TriangleMesh) -> dict[str, float]:
    """How like two bodies are: volume they share over volume they have, and mean distance of surfaces [m]."""
    field = prepare_field(true)
    nodes = np.stack(np.meshgrid(*map(np.arange, field.distance.shape), indexing="ij"), axis=-1)
    points = field.origin + field.spacing * nodes.reshape(-1, 3)[::3]
    inside = field.distance.reshape(-1)[::3] < 0
    query = SurfaceQuery(made)
    other = query.closest(points).distance < 0
    there = np.abs(query.closest(surface_points(true, SAMPLE)[0]).distance).mean()
    back = np.abs(SurfaceQuery(true).closest(surface_points(made, SAMPLE)[0]).distance).mean()
    return {
        "iou": float((inside & other).sum() / max(1, int((inside | other).sum()))),
        "chamfer": float(there + back) / 2,
    }


def run_clouds(
    run: CloudRun,
    *,
    folder: Path | None = None,
    pieces: dict[str, ConvexPieces] | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> list[dict[str, Any]]:
    """Measure every object, one row for each hand and view.

    Args:
        run: what.
        folder: where rows are kept as they come; a run of the same kind goes on from there.
        pieces: objects already cut, by source.
        workers: processes of the test.
        progress: called after each object, size and hand.

    Raises:
        InputError: a bad argument.
        EnvironmentFailure: a file or a process failed.
    """
    kept = None if folder is None else folder / "rows.json"
    rows = [] if kept is None else _kept(kept, run.key)
    cut = dict(pieces or {})
    jobs = [(hand, case) for hand in run.hands for case in run.cases]
    done = {(row["hand"], row["case"]) for row in rows}
    models = {hand: load_hand(hand) for hand in run.hands}
    with Memory.open(":memory:") as memory:
        for number, (hand, case) in enumerate(jobs, start=1):
            if (models[hand].name, case.name) not in done:
                if case.source not in cut:
                    cut[case.source] = case.load_pieces()
                model = models[hand]
                rows += _case_rows(run, case, model, physics_hand(model), memory, cut, workers)
                if kept is not None:
                    write_json(kept, {"run": run.key, "rows": rows})
            if progress is not None:
                progress(number, len(jobs), f"{case.name}, {models[hand].name}")
    return rows


def _kept(file: Path, key: dict[str, Any]) -> list[dict[str, Any]]:
    try:
        stored = json.loads(file.read_text(encoding="utf-8"))
        return list(stored["rows"]) if stored["run"] == key else []
    except (OSError, ValueError, KeyError, TypeError):
        return []


def _case_rows(
    run: CloudRun,
    case: Case,
    hand: Hand,
    model: PhysicsHand,
    memory: Memory,
    pieces: dict[str, ConvexPieces],
    workers: int | None,
) -> list[dict[str, Any]]:
    """The whole mesh and every view of one object, planned and tested."""
    mesh = load_object(case.source, scale=case.scale)
    whole = _planned(mesh, hand, run, memory, count=1)
    tests: list[Answer | None] = [whole.answer]
    rows: list[dict[str, Any]] = []
    for view in range(run.views):
        rng = np.random.default_rng([run.seed, view, *case.name.encode()])
        turn, rise = rng.uniform(0.0, 2 * np.pi), rng.uniform(LOWEST, HIGHEST)
        away = np.array([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)])
        camera = mesh.cog + DISTANCE * away
        points = depth_view(mesh, camera, noise=run.noise, rng=rng)
        row: dict[str, Any] = {"hand": hand.name, "case": case.name, "view": view, "points": len(points)}
        answers: tuple[Answer | None, Answer | None] = (None, None)
        try:
            surfaces = {method: guessed(method, case.name, points, camera) for method in run.methods}
            row["shapes"] = {method: alike(mesh, surface) for method, surface in surfaces.items()}
            answers = _chosen(_planned(surfaces[run.methods[0]], hand, run, memory, count=ON_CLOUDS), row)
        except ObjectError as error:
            row["refused"] = str(error)
        tests += answers
        rows.append(row)
    held = _held(tests, case, hand, model, pieces, workers)
    for k, row in enumerate(rows):
        row.update(whole=held[0], held=held[1 + 2 * k], by_margin=held[2 + 2 * k])
    return rows


def _planned(mesh: TriangleMesh, hand: Hand, run: CloudRun, memory: Memory, *, count: int) -> Plan:
    return plan(
        mesh,
        run.task,
        hand=hand.name,
        analyser="closure",
        memory=memory,
        learn=False,
        seed=run.seed,
        count=count,
    )


def _chosen(made: Plan, row: dict[str, Any]) -> tuple[Answer | None, Answer | None]:
    """The answer, and what it would be by margin alone; what is known of it goes into the row."""
    if made.answer is None:
        row["refused"] = made.decision.reason
        return None, None
    said = scan_trust(made, made.answer)
    if said is not None:
        plain = {key: v for key, v in asdict(said).items() if key != "sentence"}
        row.update(plain, contacts_seen=list(said.contacts_seen))
    row["quality"] = made.answer.grasp.judged
    return made.answer, max((made.answer, *made.alternatives), key=lambda a: a.grasp.judged)


def _held(
    answers: Sequence[Answer | None],
    case: Case,
    hand: Hand,
    model: PhysicsHand,
    pieces: dict[str, ConvexPieces],
    workers: int | None,
) -> list[bool]:
    """Of each answer, whether it held; none is one that did not."""
    given = tuple(answer for answer in answers if answer is not None)
    one = Planned(case=case, answers=given, mode=0, reason="", seconds={})
    grasps = grasps_of([one], hand)
    if grasps is None:
        return [False] * len(answers)
    report = run_holds(grasps, model, protocol=HoldProtocol(stop_early=True), pieces=pieces, workers=workers)
    results = iter(report.results)
    return [bool(next(results).held) if answer is not None else False for answer in answers]
