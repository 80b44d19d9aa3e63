"""The incremental learning unit (§3.5): what one hand has learnt, and how that grows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

from ..memory import Memory
from ..objects.shape import described
from ..tasks import Task
from ..types import ANSWER_KIND, BoolArray, Experience, NetworkWeights
from .analyser import Analyser, Grasp, Grip, HandLayout
from .decision import Settings
from .estimator import InputKind
from .learning import (
    Discovery,
    experience_of,
    experiences_of,
    first_guess,
    learn,
    lesson_key,
    outcomes_of,
    seed_experiences,
    training_set,
    usable,
)
from .lessons import not_yet_learnt, of_this_mesh

OTHER_MODEL = " (another model of this hand)"
"""What the scene of a lesson ends in if another model of the hand learnt it; no request has such a scene."""


class Knowledge:
    """Experiences and weights of one hand, in main memory and on disk.

    Args:
        memory: The memory; with ``memory.read_only`` nothing is added to it.
        layout: The hand.
        settings: Settings of meta control.
        kind: Inputs that describe an object to the estimator.
        scene: The scene of the requests; lessons are stored with it.
        first_lesson: Function that prepares the cube of the first lesson.
        may_store: Whether the first lesson and newly trained weights are stored when the memory is read.

    Attributes:
        memory_state: State of the memory when it was last read or written here (:meth:`Memory.state`).
        experiences: All experiences of the hand, in the order in which they were stored; but those of other
            models of the hand come first, so that they count as earlier, and each in a scene that no request
            has (``OTHER_MODEL``). So their grips are starts for the wider searches and nothing else.
    """

    def __init__(
        self,
        memory: Memory,
        layout: HandLayout,
        settings: Settings,
        *,
        kind: InputKind,
        scene: str,
        first_lesson: Callable[[], Analyser],
        may_store: bool = True,
    ) -> None:
        self.memory, self.layout, self.settings, self.scene = memory, layout, settings, scene
        self._kind: InputKind = kind
        self._may_store = may_store and not memory.read_only
        self.experiences: tuple[Experience, ...] = ()
        self._weights: NetworkWeights | None = None
        # The state is taken first: what another process writes from now on makes it differ.
        self.memory_state = memory.state()
        self._load(first_lesson)

    @property
    def weights(self) -> NetworkWeights:
        """The current weights of the approach estimator."""
        assert self._weights is not None
        return self._weights

    @property
    def own(self) -> tuple[Experience, ...]:
        """The experiences of this model of the hand, in the order in which they were stored."""
        return tuple(e for e in self.experiences if self.layout.owns(e))

    def of_task(self, task: Task, allowed: BoolArray) -> list[Experience]:
        """The lessons of a task and of this scene, on allowed planes, with any object."""
        q = task.q.tobytes()
        return [
            e
            for e in self.experiences
            if e.task.tobytes() == q and e.scene == self.scene and allowed[e.plane - 1]
        ]

    def learn(self, pa: Analyser, task: Task, discovery: Discovery) -> NetworkWeights | None:
        """Store what was found for a task, and train on it.

        Returns:
            The new weights; ``None`` if the memory holds these very lessons.
        """
        found = experiences_of(pa, pa.mesh.name, task.q, discovery, self.settings.sets, self.scene)
        new = not_yet_learnt(found, self.experiences)
        return self._remember(new) if new else None

    def store_grip(self, pa: Analyser, task: Task, grasp: Grasp) -> None:
        """Store an answer of a real hand in mode 0 or 1; the estimator is not taught with it [C]."""
        if not isinstance(grasp, Grip) or self.memory.read_only:
            return
        sets, attributes = self.settings.sets, described(pa.mesh)
        lesson = experience_of(
            pa, pa.mesh.name, ANSWER_KIND, task.q, grasp, sets, attributes, scene=self.scene
        )
        if lesson_key(lesson) not in map(lesson_key, self.experiences):
            with self._writing():
                self.memory.add([lesson])
            self.experiences = (*self.experiences, lesson)

    def learn_outcomes(self, pa: Analyser, task: Task, tried: Sequence[tuple[Grasp, bool]]) -> None:
        """Store the outcomes of grasps in the physics test, and train the estimator accordingly.

        The estimator learns a grasp that held for this object and task. A grasp that lost the object is
        neither learnt nor recalled again [C].

        Args:
            pa: Performance element of the object.
            task: The task of the grasps.
            tried: Each grasp with True if it held, in the order of the tests.
        """
        outcomes = {lesson_key(e): e.outcome for e in self.experiences if e.outcome}
        found = outcomes_of(pa, task.q, tried, self.settings.sets, self.scene)
        if any(outcomes.get(lesson_key(e)) != e.outcome for e in found):
            self._remember(found)

    def renew(self, pa: Analyser, *, may_learn: bool) -> None:
        """Work out again what earlier versions stored of virtual grasps of this object.

        Their net wrenches are in another unit, so only plane, thumb side, approach value and fingers count.
        Grips of real hands need no wrench and stay as they are. A grasp that does not exist on the current
        mesh stays outdated.

        Args:
            pa: Performance element of the object.
            may_learn: Whether the result may be stored.
        """
        outdated = [e for e in self.experiences if e.outdated and e.grip is None]
        lessons = of_this_mesh(outdated, pa.mesh.attributes)
        if not lessons:
            return
        sets, attributes = self.settings.sets, described(pa.mesh)
        renewed: list[tuple[Experience, Experience]] = []
        for e in lessons:
            for grasp in pa.recall(e.task, [e]):
                task = grasp.net_wrench if e.kind in ("best", "landmark") else e.task
                again = experience_of(
                    pa, e.object_name, e.kind, task, grasp, sets, attributes, e.outcome, e.scene
                )
                renewed.append((e, replace(again, created=e.created)))
        if not renewed:
            return
        new = {id(old): again for old, again in renewed}
        self.experiences = tuple(new.get(id(e), e) for e in self.experiences)
        self._weights = self._trained(self.experiences)
        if may_learn and not self.memory.read_only:
            with self._writing():
                self.memory.replace(renewed, self.weights)

    def _remember(self, new: Sequence[Experience]) -> NetworkWeights:
        everything = (*self.experiences, *new)
        weights = self._trained(everything)
        with self._writing():
            # A lost lesson leaves fewer samples than the stored weights had; they are replaced all the same.
            self.memory.add(new, weights, instead_of=self._weights)
        self.experiences, self._weights = everything, weights
        return weights

    def _trained(self, lessons: Sequence[Experience]) -> NetworkWeights:
        """Weights trained on these lessons, from the current ones."""
        seed = self.settings.seed
        return learn(lessons, self.layout.u, self._weights, seed=seed, kind=self._kind)

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Note what this process writes as known, but not what another one wrote in the meantime."""
        unchanged = self.memory.state()[0] == self.memory_state[0]
        yield
        if unchanged:
            self.memory_state = self.memory.state()

    def _stored(self) -> tuple[Experience, ...]:
        """The hand's experiences in the memory, as ``experiences`` has them."""
        found, owns = self.memory.experiences(hand=self.layout.name), self.layout.owns
        others = [replace(e, scene=e.scene + OTHER_MODEL) for e in found if not owns(e)]
        return (*others, *(e for e in found if owns(e))) if others else found

    def _load(self, first_lesson: Callable[[], Analyser]) -> None:
        """Read the memory; if it has no first lesson of this model, learn the cube first (§3.5)."""
        self.experiences = self._stored()
        self._weights = self.memory.weights(self.layout.name)
        own = self.own
        migrated = any(e.outdated and e.grip is None for e in own)
        if not own or (migrated and not any(e.kind == "seed" for e in own)):
            s = self.settings
            cube = first_lesson()
            seeds = seed_experiences(cube, s.sets, enough=s.thresholds.estimation, finger_rule=s.finger_rule)
            if not seeds and not self.experiences:
                # The hand cannot hold the cube, and the estimator still needs weights.
                self._weights = first_guess(cube, self.layout.u, self._kind, seed=s.seed)
                return
            others = self.experiences[: len(self.experiences) - len(own)]
            self.experiences, self._weights = (*others, *seeds, *own), None
            self._weights = self._trained(self.experiences)
            if seeds and self._may_store:
                with self._writing():
                    stored = self.memory.add(seeds, self._weights, first=True)
                if not stored:  # another process was faster
                    self.experiences = self._stored()
                    self._weights = self.memory.weights(self.layout.name)
        x, _ = training_set(self.experiences, self.layout.u, kind=self._kind)
        weights = self._weights
        if weights is None or weights.trained_on != len(x) or not usable(weights, self._kind):
            # Another process has learnt in the meantime, experiences were imported, or a lesson was lost.
            self._weights = self._trained(self.experiences)
            if self._may_store:
                with self._writing():
                    self.memory.save_weights(self.layout.name, self._weights, instead_of=weights)
