"""Many grasps: all cores, progress, and a file of results from which a stopped run goes on.

Each grasp is tested alone and from rest, so neither the number of processes nor the order nor a stop in
between changes a result.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path

from ...exceptions import InputError
from ...hands.compiled import no_mujoco_log
from ...processes import process_count
from ...types import Array, value
from ..grasps import STAGES, GraspSet
from ..hand import PhysicsHand
from ..locate import object_pieces
from ..pieces import ConvexPieces
from ..pool import Scenes, run_jobs
from ..protocol import HoldProtocol
from .checkpoint import Checkpoint
from .perturb import perturbed
from .report import HoldReport
from .six_directions import HoldResult, HoldStatus, hold_test

Progress = Callable[[int, int], None]
"""Called with how many grasps are done, and of how many."""

CHUNK = 8  # grasps a task: many enough to share a compiled scene, few enough to spread and to keep


@value
class _Job:
    """One grasp as a process gets it."""

    row: int
    object_name: str
    given_scale: float
    scale: float
    poses: tuple[Array, Array, Array, Array]


class _Tester:
    """Tests any grasp of the run."""

    def __init__(self, hand: PhysicsHand, pieces: Mapping[str, ConvexPieces], protocol: HoldProtocol) -> None:
        self.protocol, self.scenes = protocol, Scenes(hand, pieces, protocol)

    def test(self, job: _Job) -> HoldResult:
        import mujoco

        pregrasp, grasp, squeeze, thing = job.poses
        try:
            return hold_test(
                self.scenes.scene(job.object_name, job.scale),
                pregrasp,
                grasp,
                squeeze,
                thing,
                self.protocol,
                row=job.row,
                object_name=job.object_name,
                scale=job.given_scale,
            )
        except InputError as error:
            return _invalid(job.row, job.object_name, job.given_scale, str(error))
        except mujoco.FatalError as error:  # one grasp is no reason to lose the others
            self.scenes.clear()
            return _invalid(job.row, job.object_name, job.given_scale, f"MuJoCo gave up: {error}")


def run_holds(
    grasps: GraspSet,
    hand: PhysicsHand,
    *,
    protocol: HoldProtocol | None = None,
    objects: str | Path | None = None,
    pieces: Mapping[str, ConvexPieces] | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
    checkpoint: str | Path | None = None,
) -> HoldReport:
    """Put grasps to the holding test.

    A grasp that cannot be tested does not stop the others: see ``HoldReport.raise_for_faults``.
    With more than one process the calling script needs the usual ``if __name__ == "__main__":``.

    Args:
        grasps: the set.
        hand: whose grasps they are.
        protocol: default the field's six directions.
        objects: folder of the objects, see :func:`preshape.physics.pieces.load_pieces`.
        pieces: objects already cut, by name; others are looked for.
        workers: processes; default one for each core.
        progress: called after every few grasps.
        checkpoint: file of results; a run that was stopped goes on from it.

    Raises:
        InputError: the grasps are not for this hand, or the checkpoint is of another run.
        HandError: the hand's model cannot be used.
        EnvironmentFailure: a file cannot be read or written, or a process was killed.
    """
    start = time.perf_counter()
    protocol = protocol or HoldProtocol()
    count = process_count(workers)
    given = grasps.for_hand(hand)
    with ExitStack() as stack:
        stack.enter_context(no_mujoco_log())
        hand.spec()  # a hand that cannot be used is an error of the run, not of each grasp
        found, reasons = _objects(given, objects, pieces or {})
        actual = perturbed(given, found, protocol)
        reasons.update({fault.row: fault.reason for fault in given.faults})
        kept = (
            stack.enter_context(Checkpoint(checkpoint, _key(actual, hand, found, protocol)))
            if checkpoint
            else None
        )
        done = dict(kept.done) if kept else {}
        for row, reason in reasons.items():
            done[row] = _invalid(row, given.objects[row], float(given.scale[row]), reason)
        total = len(given)
        if progress is not None:
            progress(len(done), total)

        def take(results: list[HoldResult]) -> None:
            done.update({result.row: result for result in results})
            if kept is not None:
                kept.add(results)
            if progress is not None:
                progress(len(done), total)

        run_jobs(_chunks(given, actual, set(done)), _Tester(hand, found, protocol), count, take)
    return HoldReport(
        grasps=actual,
        results=tuple(done[row] for row in range(total)),
        seconds=time.perf_counter() - start,
    )


def _objects(
    grasps: GraspSet, folder: str | Path | None, pieces: Mapping[str, ConvexPieces]
) -> tuple[dict[str, ConvexPieces], dict[int, str]]:
    """Every object's pieces, and why the grasps of the others cannot be tested."""
    found: dict[str, ConvexPieces] = {}
    reasons: dict[str, str] = {}
    bad = {fault.row for fault in grasps.faults}
    for row, name in enumerate(grasps.objects):
        if row in bad or name in found or name in reasons:
            continue
        try:
            found[name] = pieces[name] if name in pieces else object_pieces(name, folder)
        except InputError as error:
            reasons[name] = str(error)
    return found, {row: reasons[name] for row, name in enumerate(grasps.objects) if name in reasons}


def _chunks(given: GraspSet, actual: GraspSet, done: set[int]) -> list[list[_Job]]:
    """The grasps still to test, those of one object and size together."""
    groups: dict[tuple[str, float], list[_Job]] = {}
    for row, name in enumerate(given.objects):
        if row in done:
            continue
        scale = float(actual.scale[row])
        poses = (*(getattr(actual, stage)[row] for stage in STAGES), actual.object_pose[row])
        job = _Job(row=row, object_name=name, given_scale=float(given.scale[row]), scale=scale, poses=poses)
        groups.setdefault((name, scale), []).append(job)
    return [jobs[k : k + CHUNK] for jobs in groups.values() for k in range(0, len(jobs), CHUNK)]


def _invalid(row: int, name: str, scale: float, reason: str) -> HoldResult:
    return HoldResult(row=row, object_name=name, scale=scale, status=HoldStatus.INVALID, reason=reason)


def _key(
    grasps: GraspSet, hand: PhysicsHand, pieces: Mapping[str, ConvexPieces], protocol: HoldProtocol
) -> str:
    """Hash of everything that decides the results."""
    import mujoco

    state = hashlib.sha256(f"{mujoco.__version__} {hand.digest} {protocol!r} {grasps.objects!r}".encode())
    for name in sorted(pieces):
        state.update(pieces[name].digest.encode())
    for array in (grasps.scale, grasps.object_pose, *(getattr(grasps, stage) for stage in STAGES)):
        state.update(array.tobytes())
    return state.hexdigest()
