"""``preshape bench critic``: how probably grips of every margin pass the pick test (ENGINE §7).

1. Finish grips of each hand on each object at rest on a table, before any threshold: the best of a small
   search and others at random, fingertip grips and wraps, with three shares of the friction, those that
   balance none of the load among them.
2. Put each to the pick test with the job.
3. Fit the probability of a pick to the grips' margins and kind, and judge it on objects that were held out
   from the fit (:mod:`.critic_figures`).

The grips of each hand and object are stored at once, so an interrupted run goes on where it stopped.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from .._version import __version__
from ..closure.analyser import ClosureAnalyser
from ..closure.calibration import WHOLE
from ..closure.candidates import distinct
from ..closure.finish import FinishOptions
from ..closure.search import DECAY
from ..closure.settings import FRICTION_SHARE, ClosureSettings
from ..closure.wrap_search import WRAP_DECAY
from ..dataset.outcomes import Row
from ..exceptions import InputError, ObjectError
from ..files import MOST_OF_JSON, loads, read_file, write_json
from ..hands.hand import Hand
from ..hands.load import load_hand
from ..hiis.analyser import Aim, Grip
from ..hiis.decision import Settings
from ..hiis.fuzzy import FuzzySets
from ..hiis.learning import search_values
from ..objects.load import load_object
from ..physics.hand import PhysicsHand, physics_hand
from ..physics.pick.objects import PickAnswer, PickObject
from ..physics.pick.picking import pick_test
from ..physics.pick.protocol import PickProtocol, PickResult
from ..physics.pick.runner import pick_scene
from ..physics.pieces import load_pieces
from ..physics.pool import run_jobs
from ..planning.controllers import closure_analyser
from ..planning.grasp_sets import palm_grasps, poses_with_gains
from ..planning.hand_simulation import HandResult
from ..planning.request import PlanRequest
from ..planning.standing import AUTO
from ..planning.verify import work_of
from ..processes import process_count
from ..types import Array, value
from .experiment import Progress

_log = logging.getLogger("preshape.search")

HANDS = ("shadow", "allegro", "leap")
FORMAT = "preshape critic 1"
SHARES = {"usual": FRICTION_SHARE, "bold": ClosureSettings().bold_share, "whole": WHOLE}
"""Shares of the friction with which grips are searched, and their margins computed."""
GRIPS, WRAPS, ELITE, CHILDREN, ROUNDS = 1000, 500, 16, 4, 2
"""Sizes of the small searches."""
EXAMINED = 6
"""Number of candidates that are finished for each grip wanted; many cannot be executed."""


@value
class CriticRun:
    """Settings of the study.

    Attributes:
        things: The objects with their masses.
        hands: Names of built-in hands, or description files.
        task: Task of all objects; ``None`` for each library object's first, and lift for files.
        count: Grips wanted of each kind of candidate, each family and each share of the friction.
        seed: Seed of every random draw.
    """

    things: tuple[PickObject, ...]
    hands: tuple[str, ...] = HANDS
    task: str | None = None
    count: int = 2
    seed: int = 0

    def __post_init__(self) -> None:
        if not self.things or not self.hands:
            raise InputError("the study of the critic needs at least one hand and one object")
        if self.count < 1 or self.seed < 0:
            raise InputError(
                f"the count must be 1 or more and the seed 0 or more, got {self.count} and {self.seed}"
            )

    def task_of(self, thing: PickObject) -> str:
        """The task that an object's grips are for."""
        own = load_object(thing.name, scale=thing.scale).tasks
        return self.task or (own[0] if own else "lift")

    def key(self, hand: PhysicsHand, thing: PickObject) -> str:
        """Hash of what the rows of a hand and an object depend on."""
        mesh = load_object(thing.name, scale=thing.scale)
        state = hashlib.sha256(mesh.vertices.tobytes())
        own = thing.name, thing.mass, thing.scale, self.task, self.count, self.seed
        state.update(repr((FORMAT, __version__, hand.digest, *own)).encode())
        return state.hexdigest()


def run_critic(
    run: CriticRun,
    folder: Path,
    *,
    workers: int | None = None,
    progress: Progress | None = None,
) -> tuple[Row, ...]:
    """Finish the grips and put each to the pick test.

    Args:
        run: Settings of the study.
        folder: Folder for the rows, from which the same call resumes; a longer one takes what it can use.
        workers: Number of processes; by default one for each core.
        progress: Called with the completed fraction and the current step.

    Returns:
        Plain JSON values of each grip, sorted by hand and object: ``hand``, ``object``, ``task``, ``fingers``
        that touch, ``wrap``, the margins ``usual``, ``bold`` and ``whole`` of its squeeze with these shares
        of the friction, ``height`` of the object [m], ``press`` [N], ``status``, ``picked``, ``done`` and
        ``reason``.

    Raises:
        InputError: A hand or object cannot be used, or a file of the folder is damaged.
        EnvironmentFailure: A file cannot be read or written, or a process was killed.
    """
    jobs: list[tuple[str, PickObject, Path]] = []
    for name in run.hands:
        model = physics_hand(load_hand(name))
        for thing in run.things:
            key = run.key(model, thing)
            file = folder / f"{model.name}-{Path(thing.name).stem}-{key[:12]}.json"
            jobs.append((name, thing, file))
    rows: dict[Path, list[Row]] = {}
    for _, _, file in jobs:
        stored = _stored(file)
        if stored is not None:
            rows[file] = stored
    if progress is not None:
        progress(len(rows) / len(jobs), "grips")

    def take(found: list[tuple[Path, list[Row]]]) -> None:
        rows.update(found)
        if progress is not None:
            progress(len(rows) / len(jobs), "grips")

    folder.mkdir(parents=True, exist_ok=True)
    left = [[job] for job in jobs if job[2] not in rows]
    run_jobs(left, _GripTester(run), process_count(workers), take)
    return tuple(row for _, _, file in jobs for row in rows[file])


def _stored(file: Path) -> list[Row] | None:
    """Rows stored by an earlier run; ``None`` if there is no file."""
    if not file.exists():
        return None
    try:
        rows: list[Row] = loads(read_file(file, MOST_OF_JSON))["rows"]
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{file} does not hold rows of this study; remove it") from error
    return rows


class _GripTester:
    """Finishes and tests the grips of one hand on one object, and stores their rows."""

    def __init__(self, run: CriticRun) -> None:
        self.run = run

    def test(self, job: tuple[str, PickObject, Path]) -> tuple[Path, list[Row]]:
        name, thing, file = job
        try:
            rows = list(self._rows(load_hand(name), thing))
        except ObjectError as error:
            _log.warning("%s: %s", thing.name, error)
            rows = []
        write_json(file, {"format": FORMAT, "rows": rows})
        return file, rows

    def _rows(self, hand: Hand, thing: PickObject) -> Iterator[Row]:
        """The rows of one hand on one object."""
        run, model = self.run, physics_hand(hand)
        asked = PlanRequest(
            source=thing.name,
            task=run.task_of(thing),
            hand=hand,
            scale=thing.scale,
            mass=thing.mass,
            table=AUTO,
            settings=Settings(seed=run.seed),
        )
        mesh = asked.load()
        stands, work = asked.standing(mesh), work_of(asked, mesh)
        q, turn = stands.task(asked.asked).q, tuple(stands.pose[3:].tolist())
        protocol, scene = PickProtocol(do=True), None
        for share in SHARES.values():
            search = replace(asked.search, friction_share=share, bold_share=share)
            element = closure_analyser(replace(asked, search=search), hand, mesh)
            demand, critic = element.demand(q), element.critic
            assert critic is not None
            grips = _distinct(finished_grips(element, q, run.count, run.seed))
            if not grips:
                continue
            margins = {name: critic.margins(grips, demand, k).min(axis=1) for name, k in SHARES.items()}
            for row, grip in enumerate(grips):
                scene = scene or pick_scene(model, load_pieces(thing.name), thing, turn, protocol)
                poses = poses_with_gains(hand, HandResult.of_grip(hand, grip), model.gains)
                one = palm_grasps(hand, [thing.name], [thing.scale], poses).for_hand(model)
                given = PickAnswer(
                    poses=one.poses(0), way_in=tuple(grip.approach.tolist()), turn=turn, work=work
                )
                result = pick_test(scene, *given.in_world(), protocol, object_name=thing.name, work=work)
                own = {name: float(found[row]) for name, found in margins.items()}
                yield _row(hand, asked, grip, {**own, "height": critic.height}, result)


def _row(
    hand: Hand,
    asked: PlanRequest,
    grip: Grip,
    measured: dict[str, float],
    result: PickResult,
) -> Row:
    """The row of one grip."""
    return {
        "hand": hand.name,
        "object": asked.object_name,
        "task": asked.asked.label,
        "fingers": list(grip.fingers_touching),
        "wrap": grip.whole_hand,
        **measured,
        "press": grip.press,
        "status": result.status.name.lower(),
        "picked": result.picked,
        "done": result.done,
        "reason": result.reason,
    }


def finished_grips(element: ClosureAnalyser, q: Array, count: int, seed: int) -> list[Grip]:
    """Grips of an analyser that the hand can execute, before any threshold.

    For fingertips and wraps each, these are the best of a small search, some of its last round at random,
    some of the first draw that balance any of the load, and some of it whether or not they do.

    Args:
        element: The analyser; its share of the friction decides what balances.
        q: (6,) task Q.
        count: Number of grips wanted of each of these.
        seed: Seed of the draws.
    """
    aim, demand, search = Aim(values=search_values(FuzzySets())), element.demand(q), element.search
    rng = np.random.default_rng([seed, round(100 * element.settings.friction_share)])
    usual, grips = FinishOptions(count=count, planes=aim.planes), list[Grip]()
    for wrapping in (False, True):
        drawn = element.draws.wraps(rng, aim, WRAPS) if wrapping else element.draws.grips(rng, aim, GRIPS)
        found = search.evaluate(drawn, demand)
        decay = WRAP_DECAY if wrapping else DECAY
        best = search.refine(rng, found, demand, elite=ELITE, children=CHILDREN, rounds=ROUNDS, decay=decay)
        few, random = EXAMINED * count, rng.permutation
        parts = (
            (best.take(distinct(best, 4 * count)), usual),
            (best.take(random(len(best))[:few]), usual),
            (found.take(random(np.flatnonzero(found.score > 0))[:few]), usual),
            (found.take(random(len(found))[:few]), replace(usual, anyway=True)),
        )
        for part, options in parts:
            finished = element.finisher.finish(part, demand, options)
            grips += element.grips(q, [grip for grip in finished if not grip.refused])
    return grips


def _distinct(grips: Sequence[Grip]) -> list[Grip]:
    """The grips without those of the same wrist pose."""
    found: dict[bytes, Any] = {}
    for grip in grips:
        found.setdefault(np.round(grip.palm_pose, 4).tobytes(), grip)
    return list(found.values())
