"""``preshape bench clouds``: how good are the answers on partial views of an object?

A virtual depth camera looks at each object from a few sides. The planner gets only the points of one view.
Its answer goes through the six-direction holding test on the true object. For comparison, the answer on the
whole mesh is tested too. The constants of :mod:`preshape.objects.scans` were chosen with other views and
seeds than those of this study.
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
from ..planner import plan
from ..planning.answers import Answer, scan_trust
from ..planning.plan import Plan
from ..planning.planner_bench import Case, Planned, grasps_of
from ..planning.request import ON_CLOUDS
from ..types import FIELD_MASS, Array, value

Progress = Callable[[int, int, str], None]
"""Called with the number of finished objects, the number of all objects, and the last finished object."""

FOCAL = 600.0
"""Focal length of the camera [pixels], typical of depth cameras [C]."""
DISTANCE = 0.6
"""Distance of the camera from the object's middle [m]."""
LOWEST, HIGHEST = 0.2, 1.05
"""Range of the camera's elevation above the object [rad]."""
METHODS = ("symmetry", "straight", "hull")
"""Methods to complete the far side: by symmetry (as in the planner), straight back, by the convex hull."""
SPACING = 0.002
"""Spacing of the sample points on the surfaces that are compared [m]."""


@value
class CloudRun:
    """Settings of the study.

    Attributes:
        hands: Names of hands.
        cases: Objects at their scales.
        views: Number of views of each object.
        noise: Standard deviation of the depth along each ray [m].
        seed: Seed of views, noise and planner.
        task: The task to plan for.
        methods: Names from :data:`METHODS`. Planning uses the first; shapes are compared for all.
    """

    hands: tuple[str, ...]
    cases: tuple[Case, ...]
    views: int = 4
    noise: float = 0.001
    seed: int = 0
    task: str = "lift"
    methods: tuple[str, ...] = METHODS

    def __post_init__(self) -> None:
        unknown = [method for method in self.methods if method not in METHODS]
        if unknown or not self.methods:
            raise InputError(f"no method {', '.join(unknown) or 'given'}; known: {', '.join(METHODS)}")
        if self.views < 1 or not 0 <= self.noise < 0.1 or self.seed < 0:
            raise InputError(
                "the study needs 1 view or more, noise of 0 to 0.1 m and a seed of 0 or more, got "
                f"{self.views}, {self.noise:g} m and {self.seed}"
            )

    @property
    def key(self) -> dict[str, Any]:
        """The settings as plain JSON values; a stored run with the same key can be resumed."""
        own = {name: getattr(self, name) for name in ("hands", "views", "noise", "seed", "task", "methods")}
        document = {**own, "cases": [[c.name, c.scale] for c in self.cases], "version": __version__}
        plain: dict[str, Any] = json.loads(json.dumps(document))
        return plain


def depth_view(mesh: TriangleMesh, camera: Array, *, noise: float, rng: np.random.Generator) -> Array:
    """Points of an object that a pinhole depth camera sees, one for each pixel.

    Args:
        mesh: The object.
        camera: (3,) Position of the camera [m], mesh frame; it looks at the object's middle.
        noise: Standard deviation of the depth along each ray [m].
        rng: Random generator of the noise.

    Returns:
        (n, 3) Points [m], mesh frame.
    """
    axes = level_axes(mesh.cog - camera)
    distance = float(np.linalg.norm(mesh.cog - camera))
    radius = float(np.linalg.norm(mesh.extents)) / 2
    half = int(np.ceil(FOCAL * radius / max(distance - radius, 0.05)))
    steps = np.arange(-half, half + 1) / FOCAL
    across, down = np.meshgrid(steps, steps)
    rays = np.stack([across, down, np.ones_like(across)], axis=-1).reshape(-1, 3) @ axes
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    hits = RayCaster(mesh).cast(np.broadcast_to(camera, rays.shape).copy(), rays)
    hit = hits.triangle >= 0
    depth = hits.distance[hit] + rng.normal(0.0, noise, int(hit.sum()))
    seen: Array = camera + depth[:, None] * rays[hit]
    return seen


def completed(method: str, name: str, points: Array, camera: Array) -> TriangleMesh:
    """The closed surface of a view's points, with the far side completed by one of the methods.

    Raises:
        ObjectError: The points do not belong to one solid object.
    """
    if method == "symmetry":
        made = complete(name, RawCloud(points=points), camera)
    else:
        clean = cleaned(name, points, camera)
        sight = sight_of(clean, camera)
        depth = (clean - camera) @ sight.forward
        width, _ = outline_width(sight, clean)
        back = float(np.quantile(depth, 0.02)) + width

        def straight(nodes: Array) -> Array:
            return np.maximum(solid(sight, (), nodes), (nodes - camera) @ sight.forward - back)

        grid = grid_round(np.concatenate([clean, clean + max(0.0, back - depth.max()) * sight.forward]))
        function = straight if method == "straight" else _hull(clean)
        vertices, triangles = zero_surface(function, grid)
        made = marked(name, len(points), clean, camera, vertices, triangles, grid, f"guessed: {method}")
    return TriangleMesh(name=name, vertices=made.vertices, triangles=made.triangles, scan=made.scan)


def _hull(points: Array) -> Callable[[Array], Array]:
    from scipy.spatial import ConvexHull

    planes = ConvexHull(points).equations

    def outside(nodes: Array) -> Array:
        found = np.full(len(nodes), -np.inf)
        for normal in planes:  # all planes at once would take gigabytes
            np.maximum(found, nodes @ normal[:3] + normal[3], out=found)
        return found

    return outside


def agreement(true: TriangleMesh, made: TriangleMesh) -> dict[str, float]:
    """Agreement of two solids: intersection divided by union, and mean distance of the surfaces [m]."""
    field = prepare_field(true)
    nodes = np.stack(np.meshgrid(*map(np.arange, field.distance.shape), indexing="ij"), axis=-1)
    points = field.origin + field.spacing * nodes.reshape(-1, 3)[::3]
    inside = field.distance.reshape(-1)[::3] < 0
    query = SurfaceQuery(made)
    other = query.closest(points).distance < 0
    to_made = np.abs(query.closest(surface_points(true, SPACING)[0]).distance).mean()
    to_true = np.abs(SurfaceQuery(true).closest(surface_points(made, SPACING)[0]).distance).mean()
    return {
        "iou": float((inside & other).sum() / max(1, int((inside | other).sum()))),
        "chamfer": float(to_made + to_true) / 2,
    }


def run_clouds(
    run: CloudRun,
    *,
    folder: Path | None = None,
    pieces: dict[str, ConvexPieces] | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> list[dict[str, Any]]:
    """Run the study; there is one row for each hand and view.

    Args:
        run: Settings of the study.
        folder: Folder in which rows are stored at once; a run with the same settings resumes from them.
        pieces: Convex pieces that are already known, by the source of the object.
        workers: Number of processes for the test.
        progress: Called after each object and hand.

    Raises:
        InputError: An argument is not valid.
        EnvironmentFailure: A file cannot be read or written, or a process was killed.
    """
    store = None if folder is None else folder / "rows.json"
    rows = [] if store is None else _stored_rows(store, run.key)
    cut = dict(pieces or {})
    jobs = [(hand, case) for hand in run.hands for case in run.cases]
    done = {(row["hand"], row["case"]) for row in rows}
    models = {hand: load_hand(hand) for hand in run.hands}
    with Memory.open(":memory:") as memory:
        for number, (name, case) in enumerate(jobs, start=1):
            hand = models[name]
            if (hand.name, case.name) not in done:
                if case.source not in cut:
                    cut[case.source] = case.load_pieces()
                rows += _case_rows(run, case, hand, physics_hand(hand), memory, cut, workers)
                if store is not None:
                    write_json(store, {"run": run.key, "rows": rows})
            if progress is not None:
                progress(number, len(jobs), f"{case.name}, {hand.name}")
    return rows


def _stored_rows(file: Path, key: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows of an earlier run with the same settings; none if the file is missing or from another run."""
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
    """Plan on the whole mesh and on every view of one object, and test the answers."""
    mesh = load_object(case.source, scale=case.scale)
    answers: list[Answer | None] = [_planned(mesh, hand, run, memory, count=1).answer]
    rows: list[dict[str, Any]] = []
    for view in range(run.views):
        rng = np.random.default_rng([run.seed, view, *case.name.encode()])
        turn, rise = rng.uniform(0.0, 2 * np.pi), rng.uniform(LOWEST, HIGHEST)
        direction = np.array([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)])
        camera = mesh.cog + DISTANCE * direction
        points = depth_view(mesh, camera, noise=run.noise, rng=rng)
        row: dict[str, Any] = {"hand": hand.name, "case": case.name, "view": view, "points": len(points)}
        chosen: tuple[Answer | None, Answer | None] = (None, None)
        try:
            surfaces = {method: completed(method, case.name, points, camera) for method in run.methods}
            row["shapes"] = {method: agreement(mesh, surface) for method, surface in surfaces.items()}
            chosen = _chosen(_planned(surfaces[run.methods[0]], hand, run, memory, count=ON_CLOUDS), row)
        except ObjectError as error:
            row["refused"] = str(error)
        answers += chosen
        rows.append(row)
    held = _held(answers, case, hand, model, pieces, workers)
    for k, row in enumerate(rows):
        row.update(whole=held[0], held=held[1 + 2 * k], by_margin=held[2 + 2 * k])
    return rows


def _planned(mesh: TriangleMesh, hand: Hand, run: CloudRun, memory: Memory, *, count: int) -> Plan:
    return plan(
        mesh,
        run.task,
        hand=hand,
        analyser="closure",
        mass=FIELD_MASS,
        table=None,
        memory=memory,
        learn=False,
        seed=run.seed,
        count=count,
    )


def _chosen(made: Plan, row: dict[str, Any]) -> tuple[Answer | None, Answer | None]:
    """The first answer and the one with the largest margin; ``row`` gets the first's trust and quality."""
    if made.answer is None:
        row["refused"] = made.decision.reason
        return None, None
    trust = scan_trust(made, made.answer)
    if trust is not None:
        plain = {key: number for key, number in asdict(trust).items() if key != "sentence"}
        row.update(plain, contacts_seen=list(trust.contacts_seen))
    row["quality"] = made.answer.grasp.judged
    return made.answer, max((made.answer, *made.alternatives), key=lambda answer: answer.grasp.judged)


def _held(
    answers: Sequence[Answer | None],
    case: Case,
    hand: Hand,
    model: PhysicsHand,
    pieces: dict[str, ConvexPieces],
    workers: int | None,
) -> list[bool]:
    """Whether each answer held the object; a missing answer counts as not held."""
    given = tuple(answer for answer in answers if answer is not None)
    grasps = grasps_of([Planned(case=case, answers=given, mode=0, reason="", seconds={})], hand)
    if grasps is None:
        return [False] * len(answers)
    report = run_holds(grasps, model, protocol=HoldProtocol(stop_early=True), pieces=pieces, workers=workers)
    results = iter(report.results)
    return [bool(next(results).held) if answer is not None else False for answer in answers]
