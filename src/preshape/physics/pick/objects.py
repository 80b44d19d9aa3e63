"""The objects of a pick bench, and where the grasps for them come from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from ... import spatial
from ...objects.library import AS_MODELLED
from ...objects.load import load_object
from ...objects.mass import object_mass
from ...types import Array, value
from ..grasps import HandPoses
from ..task.motion import TaskMotion


@value
class PickObject:
    """One object of a bench.

    Attributes:
        name: Library name or file.
        mass: Mass to plan for and to test with [kg].
        scale: Factor on its size.
        seed: Seed of the planner.
    """

    name: str
    mass: float
    scale: float = 1.0
    seed: int = 0


@value
class PickAnswer:
    """A grasp of an object that rests on a table.

    Attributes:
        poses: Poses of the hand's root in the frame of the object.
        way_in: Unit vector along which the hand approaches, in the object's frame.
        turn: How the object rests: quaternion wxyz from its frame to the world, whose z is up.
        work: Motion and load of the task, in the object's frame; ``None`` for a task without motion.
    """

    poses: HandPoses
    way_in: tuple[float, ...]
    turn: tuple[float, ...] = AS_MODELLED
    work: TaskMotion | None = None

    def in_world(self) -> tuple[HandPoses, Array]:
        """The poses and the way in (3,), both in the world; the object's frame has the world's origin."""
        T = spatial.pose_from_seven(np.array([0.0, 0.0, 0.0, *self.turn]))
        return self.poses.moved(T), T[:3, :3] @ np.array(self.way_in)


class PickAnswers(Protocol):
    """A source of grasps; it is sent to worker processes, so it must be picklable."""

    @property
    def digest(self) -> str:
        """Hash of everything that the answers depend on, except the objects."""

    def answer(self, thing: PickObject) -> PickAnswer | str:
        """The grasp for an object, or a sentence that says why there is none."""


def pick_objects(
    sources: Sequence[str],
    *,
    mass: float | None = None,
    masses: Mapping[str, float] | None = None,
    scale: float = 1.0,
    seed: int = 0,
) -> tuple[PickObject, ...]:
    """The objects of a bench with their masses.

    Args:
        sources: Library names and files.
        mass: Mass of every object [kg]; ``None`` takes each object's own, or an estimate from its volume.
        masses: Masses that replace this one, by source [kg].
        scale: Factor on every object's size.
        seed: Seed of the planner.

    Raises:
        InputError: An object cannot be used, or a mass is not positive.
        EnvironmentFailure: A file cannot be read.
    """
    stated = masses or {}
    return tuple(
        PickObject(
            name=source,
            mass=object_mass(load_object(source, scale=scale), stated.get(source, mass)).kg,
            scale=scale,
            seed=seed,
        )
        for source in dict.fromkeys(sources)
    )
