"""Runs the holding test of many grasps on all cores, and resumes a stopped run from a file.

Each grasp is tested on its own, from rest. Neither the number of processes nor the order nor an interruption
changes a result.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np

from ... import spatial
from ...exceptions import InputError
from ...hands.compiled import no_mujoco_log
from ...processes import process_count
from ...types import value
from ..grasps import STAGES, GraspSet, HandPoses
from ..hand import PhysicsHand
from ..locate import object_pieces
from ..pieces import ConvexPieces
from ..pool import Scenes, run_jobs
from ..protocol import HoldProtocol
from .checkpoint import Checkpoint, Progress, result_taker
from .report import HoldReport
from .six_directions import HoldResult, HoldStatus, hold_test

CHUNK = 8
"""Number of grasps of one object that a process tests in succession. They share a compiled scene; more grasps
would spread less evenly over the processes and delay the saving of results."""


@value
class _Job:
    """One grasp, as sent to a worker process."""

    row: int
    object_name: str
    given_scale: float
    scale: float
    poses: HandPoses


class _HoldTester:
    """Tests any grasp of the run."""

    def __init__(self, hand: PhysicsHand, pieces: Mapping[str, ConvexPieces], protocol: HoldProtocol) -> None:
        self.protocol, self.scenes = protocol, Scenes(hand, pieces, protocol)

    def test(self, job: _Job) -> HoldResult:
        import mujoco

        try:
            return hold_test(
                self.scenes.scene(job.object_name, job.scale),
                job.poses,
                self.protocol,
                row=job.row,
                object_name=job.object_name,
                scale=job.given_scale,
            )
        except InputError as error:
            return _invalid(job.row, job.object_name, job.given_scale, str(error))
        except mujoco.FatalError as error:  # one grasp must not end the whole run
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
    """Run the holding test of all grasps.

    A grasp that cannot be tested does not stop the others; see ``HoldReport.raise_for_faults``. With more
    than one process, the calling script needs the guard ``if __name__ == "__main__":``.

    Args:
        grasps: The grasps.
        hand: Their hand.
        protocol: Settings of the test; by default the field's six directions.
        objects: Folder of the objects (see :func:`preshape.physics.pieces.load_pieces`).
        pieces: Convex pieces by object name; objects that are missing are searched and cut.
        workers: Number of processes; by default one for each core.
        progress: Called after every few grasps.
        checkpoint: File of results, from which a stopped run continues.

    Raises:
        InputError: The grasps are not for this hand, or the checkpoint belongs to another run.
        HandError: The hand's model cannot be used.
        EnvironmentFailure: A file cannot be read or written, or a process was killed.
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
        key = _key(actual, hand, found, protocol)
        file = stack.enter_context(Checkpoint(checkpoint, key)) if checkpoint else None
        done = dict(file.done) if file else {}
        for row, reason in reasons.items():
            done[row] = _invalid(row, given.objects[row], float(given.scale[row]), reason)
        chunks = _chunks(given, actual, set(done))
        take = result_taker(done, len(given), file, progress)
        run_jobs(chunks, _HoldTester(hand, found, protocol), count, take)
    return HoldReport(
        grasps=actual,
        results=tuple(done[row] for row in range(len(given))),
        seconds=time.perf_counter() - start,
    )


def perturbed(grasps: GraspSet, pieces: Mapping[str, ConvexPieces], protocol: HoldProtocol) -> GraspSet:
    """Displace, turn and resize the objects by the protocol's errors; the hand poses stay the same.

    The error of a grasp depends only on the seed and its row, so part of a set gets the same errors as the
    whole set. The centre c of the object's bounding box moves by exactly the given distance in a random
    direction. The object turns about c by exactly the given angle about a random axis, and grows or shrinks
    about c, with equal probability, by exactly the given share. Directions and axes are uniform [C].

    Args:
        grasps: The grasps as planned.
        pieces: The objects by name; a row whose object is missing stays unchanged.
        protocol: Errors and seed.
    """
    if not any((protocol.position_error, protocol.turn_error, protocol.size_error)):
        return grasps
    poses, scale = np.array(grasps.object_pose), np.array(grasps.scale)
    bad = {fault.row for fault in grasps.faults}
    for row, name in enumerate(grasps.objects):
        if row in bad or name not in pieces:
            continue
        random = np.random.default_rng([protocol.seed, row])
        direction, axis = (v / np.linalg.norm(v) for v in random.normal(size=(2, 3)))
        factor = 1.0 + protocol.size_error * random.choice([-1.0, 1.0])
        T = spatial.pose_from_seven(poses[row])
        middle = pieces[name].bounds.mean(axis=0)
        centre = T[:3, :3] @ (middle * scale[row]) + T[:3, 3] + protocol.position_error * direction
        rotation = spatial.rotation_from_vector(protocol.turn_error * axis) @ T[:3, :3]
        scale[row] *= factor
        poses[row] = spatial.seven_from_pose(
            spatial.pose(rotation, centre - rotation @ (middle * scale[row]))
        )
    return replace(grasps, object_pose=poses, scale=scale)


def _objects(
    grasps: GraspSet, folder: str | Path | None, pieces: Mapping[str, ConvexPieces]
) -> tuple[dict[str, ConvexPieces], dict[int, str]]:
    """The convex pieces of the objects, by name, and why the rows of other objects cannot be tested."""
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
    """The grasps that are not done, grouped by object and size so that a chunk shares a scene."""
    groups: dict[tuple[str, float], list[_Job]] = {}
    for row, name in enumerate(given.objects):
        if row in done:
            continue
        scale = float(actual.scale[row])
        job = _Job(
            row=row,
            object_name=name,
            given_scale=float(given.scale[row]),
            scale=scale,
            poses=actual.poses(row),
        )
        groups.setdefault((name, scale), []).append(job)
    return [jobs[k : k + CHUNK] for jobs in groups.values() for k in range(0, len(jobs), CHUNK)]


def _invalid(row: int, name: str, scale: float, reason: str) -> HoldResult:
    return HoldResult(row=row, object_name=name, scale=scale, status=HoldStatus.INVALID, reason=reason)


def _key(
    grasps: GraspSet, hand: PhysicsHand, pieces: Mapping[str, ConvexPieces], protocol: HoldProtocol
) -> str:
    """Hash of all that the results depend on."""
    import mujoco

    state = hashlib.sha256(f"{mujoco.__version__} {hand.digest} {protocol!r} {grasps.objects!r}".encode())
    for name in sorted(pieces):
        state.update(pieces[name].digest.encode())
    for array in (grasps.scale, grasps.object_pose, *(getattr(grasps, stage) for stage in STAGES)):
        state.update(array.tobytes())
    return state.hexdigest()
