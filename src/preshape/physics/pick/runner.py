"""Plans and picks up many objects on all cores, and resumes a stopped run from a file.

Each object is planned with an empty memory and tested on its own, from rest. Neither the number of processes
nor the order nor an interruption changes a result.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from ... import spatial
from ...exceptions import EnvironmentFailure, InputError
from ...hands.compiled import no_mujoco_log
from ...objects.load import split_part
from ...processes import process_count
from ..hand import PhysicsHand
from ..hold.checkpoint import Progress, ResultFile, result_taker
from ..hold.report import result_to_json
from ..pieces import ConvexPieces, load_pieces
from ..pool import run_jobs
from ..scene import Scene, build_scene
from .objects import PickAnswers, PickObject
from .picking import pick_test, planned_fields
from .protocol import PickProtocol, PickResult, PickStatus
from .report import PickReport, result_from_json

Cut = Callable[[str], ConvexPieces]
"""Gives the convex pieces of an object by its name; it is sent to worker processes."""

_Job = tuple[int, PickObject]


class PickCheckpoint(ResultFile[PickResult]):
    """Results of the pick test."""

    format = "preshape picks 3"
    kind = "pick tests"
    subject = "objects, planner, hand or settings"
    to_json = staticmethod(result_to_json)
    from_json = staticmethod(result_from_json)


def pick_scene(
    hand: PhysicsHand, pieces: ConvexPieces, thing: PickObject, turn: Sequence[float], protocol: PickProtocol
) -> Scene:
    """The scene of an object on a table at its lowest point.

    Args:
        hand: The hand.
        pieces: The object at scale 1.
        thing: The object's size and mass.
        turn: How the object rests: quaternion wxyz from its frame to the world.
        protocol: Settings of the test.
    """
    up = spatial.rotation_from_quaternion(np.asarray(turn))[2]
    table = float((np.concatenate(pieces.pieces) @ up).min()) * thing.scale
    return build_scene(hand, pieces, thing.scale, protocol.scene(thing.mass), table=table)


class _PickTester:
    """Plans and tests any object of the run."""

    def __init__(self, hand: PhysicsHand, cut: Cut, protocol: PickProtocol, answers: PickAnswers) -> None:
        self.hand, self.cut, self.protocol, self.answers = hand, cut, protocol, answers

    def test(self, job: _Job) -> PickResult:
        import mujoco

        row, thing = job
        label: dict[str, Any] = {"row": row, "object_name": thing.name, "scale": thing.scale}
        answer = self.answers.answer(thing)
        if isinstance(answer, str):
            return PickResult(status=PickStatus.NO_ANSWER, reason=answer, mass=thing.mass, **label)
        try:
            scene = pick_scene(self.hand, self.cut(thing.name), thing, answer.turn, self.protocol)
            return pick_test(scene, *answer.in_world(), self.protocol, work=answer.work, **label)
        except (InputError, EnvironmentFailure) as error:
            reason = str(error)
        except mujoco.FatalError as error:  # one object must not end the whole run
            reason = f"MuJoCo gave up: {error}"
        return PickResult(
            status=PickStatus.INVALID,
            reason=reason,
            mass=thing.mass,
            **planned_fields(*answer.in_world()),
            **label,
        )


def run_picks(
    objects: Sequence[PickObject],
    hand: PhysicsHand,
    answers: PickAnswers,
    *,
    cut: Cut = load_pieces,
    protocol: PickProtocol | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
    checkpoint: str | Path | None = None,
) -> PickReport:
    """Plan and test all objects.

    With more than one process, the calling script needs the guard ``if __name__ == "__main__":``.

    Args:
        objects: The objects (see :func:`preshape.physics.pick.objects.pick_objects`).
        hand: The hand.
        answers: The planner.
        cut: Gives the convex pieces of an object that has an answer; cutting takes up to two minutes.
        protocol: Settings of the test.
        workers: Number of processes; by default one for each core.
        progress: Called after each object.
        checkpoint: File of results, from which a stopped run continues.

    Raises:
        InputError: The number of workers is below 1, or the checkpoint belongs to another run.
        HandError: The hand's model cannot be used.
        EnvironmentFailure: A file cannot be read or written, or a process was killed.
    """
    start = time.perf_counter()
    protocol = protocol or PickProtocol()
    count = process_count(workers)
    with ExitStack() as stack:
        stack.enter_context(no_mujoco_log())
        hand.spec()  # a hand that cannot be used is an error of the run, not of each object
        key = _key(objects, hand, protocol, answers)
        file = stack.enter_context(PickCheckpoint(checkpoint, key)) if checkpoint else None
        done = dict(file.done) if file else {}
        chunks: list[list[_Job]] = [[job] for job in enumerate(objects) if job[0] not in done]
        take = result_taker(done, len(objects), file, progress)
        run_jobs(chunks, _PickTester(hand, cut, protocol, answers), count, take)
    return PickReport(
        results=tuple(done[row] for row in range(len(objects))),
        hand=hand,
        seconds=time.perf_counter() - start,
    )


def _key(
    objects: Sequence[PickObject], hand: PhysicsHand, protocol: PickProtocol, answers: PickAnswers
) -> str:
    """Hash of everything that the results depend on; of a file, its content counts too."""
    import mujoco

    head = f"{mujoco.__version__} {hand.digest} {protocol!r} {answers.digest} {tuple(objects)!r}"
    state = hashlib.sha256(head.encode())
    for thing in objects:
        file = Path(split_part(thing.name)[0])
        if file.is_file():
            state.update(hashlib.sha256(file.read_bytes()).digest())
    return state.hexdigest()
